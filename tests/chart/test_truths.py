# SPDX-License-Identifier: GPL-3.0-or-later
"""The finite elements that the chart trusts, against what is known of indentation without them; and their cache."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest

from tests.bench.truths import CASES, load
from tests.bench.truths.cache import FILES, fingerprint, path_of, stored_fingerprint
from tests.bench.truths.case import DEPTHS
from tests.bench.truths.checks import checks
from tests.bench.truths.indentation import extrapolated
from tests.bench.truths.measures import CELL, TOP, contact_radius, filled, rim, volumes
from tests.bench.truths.mesh import cylinder
from tests.bench.truths.solid import FOAM, Solid
from tests.bench.truths.yielding import hardened, returned

KEPT = [(name, size) for name, case in CASES.items() for size in case.sizes]
truth = cache(load)


def integral(values, places):
    """By trapezia: numpy 1 and 2 name theirs differently."""
    return float((0.5 * (values[1:] + values[:-1]) * np.diff(places)).sum())


@pytest.mark.parametrize("check", list(checks(0.04, 0.03, 0.03)), ids=lambda check: check.what)
def test_against_what_is_known(check):
    """The solver itself, on a mesh as coarse as a test can wait for."""
    found = check.measure()
    assert check.low <= found <= check.high


@pytest.mark.parametrize(("name", "size"), KEPT)
def test_the_cache_is_of_this_solver(name, size):
    assert stored_fingerprint(path_of(name, size)) == fingerprint(CASES[name].solid, size)


def test_the_cache_holds_nothing_else_and_little():
    files = list(FILES.iterdir())
    assert set(files) == {path_of(name, size) for name, size in KEPT}
    assert sum(file.stat().st_size for file in files) < 1 << 20


def test_the_fingerprint_tells_solids_and_meshes_apart():
    prints = {fingerprint(case.solid, size) for case in CASES.values() for size in (0.04, 0.02, 0.01)}
    assert len(prints) == 3 * len(CASES)


@pytest.mark.parametrize("name", CASES)
def test_a_truth_is_whole(name):
    kept = truth(name)
    for field in fields(kept):
        value = getattr(kept, field.name)
        if isinstance(value, np.ndarray) and field.name != "rim_radius":
            assert np.isfinite(value).all(), field.name
    assert kept.depths == pytest.approx(DEPTHS, abs=1e-4)
    assert np.isfinite(kept.rim_radius).tolist() == (kept.rim_h[-1] > 0.0).tolist()
    assert kept.kinetic < 0.01, "it was pressed too fast to be at rest"
    # The force rises with depth, but for the steps of a contact that takes in one node after the other.
    settled = kept.depth > 0.02
    assert (np.diff(kept.force[settled][::8]) > 0.0).all()


@pytest.mark.parametrize("name", CASES)
def test_the_surface_touches_the_sphere_up_to_the_contact_radius(name):
    """Inside the contact the surface is the sphere's, outside it is free."""
    kept = truth(name)
    for depth, profile in zip(kept.depths, kept.profile_z):
        a = np.interp(depth, kept.depth, kept.contact_radius)
        r = kept.profile_r
        sphere = 1.0 - depth - np.sqrt(1.0 - np.minimum(r, 1.0) ** 2)
        within = r < a - 0.02
        assert profile[within] == pytest.approx(sphere[within], abs=2e-3)
        beside = (r > a + 0.03) & (r < 1.0)
        assert (profile[beside] < sphere[beside]).all()


@pytest.mark.parametrize("name", CASES)
def test_mass_and_volume_agree(name):
    """What the raster of a dense solid lacks lies over its surface; a foam's is where it was crushed, but for what its
    elastic far field has taken through the raster's edge."""
    kept = truth(name)
    rows, columns = kept.density.shape[1:]
    rings = np.pi * CELL**3 * (2.0 * np.arange(columns) + 1.0)
    at_first = rings.sum() * (rows - TOP / CELL)
    for depth, density, profile in zip(kept.depths, kept.density, kept.profile_z):
        cap = np.pi * depth**2 * (1.0 - depth / 3.0)
        over = -integral(2.0 * np.pi * kept.profile_r * profile, kept.profile_r)
        missing = at_first - (density * rings).sum()
        if kept.case.crushable:
            assert 0.0 < missing / cap < over / cap - 0.9
        else:
            assert missing == pytest.approx(over, abs=0.01 * cap)


def test_the_raster_of_a_foam_is_crushed_ahead_of_the_sphere_only():
    kept = truth("foam-500")
    deepest = kept.density[-1]
    locked = 1.0 / kept.case.solid.filled
    assert 0.9 * locked < deepest.max() < 1.1 * locked
    row = round((TOP + kept.depths[-1]) / CELL)  # under the lowest point of the sphere
    assert deepest[row + 1 : row + 4, 0].min() > 0.85 * locked
    assert deepest[-8:].max() < 1.02
    assert deepest[:, -8:].max() < 1.02


def test_volumes_of_a_cylinder():
    r, z = cylinder(0.1)
    assert volumes(r, z).sum() == pytest.approx(np.pi * r.max() ** 2 * -z.min())
    assert (volumes(r, z) > 0.0).all()


def test_what_lies_under_a_cone():
    r = np.linspace(0.0, 3.0, 301)
    z = 0.1 * (1.0 - r)
    under = (filled(r, z) * np.pi * CELL**3 * (2.0 * np.arange(48) + 1.0)).sum()
    assert under == pytest.approx(np.pi * 9.0 * 2.5 + np.pi * 9.0 * 0.1 - 0.1 * 2.0 * np.pi * 9.0, rel=1e-4)


def test_a_rim_is_told_between_nodes():
    r = np.arange(0.0, 2.0, 0.07)
    height, place = rim(r, 0.1 - (r - 0.73) ** 2)
    assert (height, place) == pytest.approx((0.1, 0.73), abs=2e-3)
    assert rim(r, -1.0 / (1.0 + r)) == pytest.approx((0.0, np.nan), nan_ok=True)


def test_a_contact_ends_between_nodes():
    """A gap that opens with the power 3/2, as Hertz's does."""
    depth, a = 0.1, 0.317
    r = np.arange(0.0, 1.0, 0.05)
    gap = np.maximum(r - a, 0.0) ** 1.5
    z = 1.0 - depth - np.sqrt((1.0 + gap) ** 2 - r**2)
    assert contact_radius(r, z, gap == 0.0, depth) == pytest.approx(a, abs=1e-3)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_meshes_are_extrapolated(order):
    sizes = np.array([0.04, 0.02, 0.01])
    assert extrapolated(0.3 + 2.0 * sizes[:, None] ** order) == pytest.approx(np.array([0.3]))
    jagged = np.array([[0.3], [0.31], [0.305]])
    assert extrapolated(jagged) == pytest.approx(jagged[-1])


@pytest.mark.parametrize("solid", [Solid(0.01, 0.05), Solid(0.01, 0.05, FOAM), Solid(0.01, 0.0, 1.0)])
@pytest.mark.parametrize("trial", [(-0.02, 0.03), (0.03, 0.001), (0.0, 0.02), (-0.01, 0.5)])
def test_a_stress_returns_to_yield(solid, trial):
    """It meets the strength that it then has, and its plastic work is that of the equivalent stress and strain."""
    (p, q), (bulk, shear, yield_stress, hardening, _, alpha) = trial, solid.constants
    a = 1.0 / (1.0 + (alpha / 3.0) ** 2)
    of_deviator, of_mean, strain = returned(p, q, yield_stress, bulk, shear, hardening, alpha)
    left_p, left_q = of_mean * p, of_deviator * q
    equivalent = np.sqrt(a * (left_q**2 + (alpha * left_p) ** 2))
    if strain == 0.0:
        assert equivalent <= yield_stress
        return
    assert equivalent == pytest.approx(yield_stress + hardening * strain)
    work = left_q * (q - left_q) / (3.0 * shear) + left_p * (p - left_p) / bulk
    assert work == pytest.approx(equivalent * strain)


def test_a_foam_squeezed_one_way_keeps_its_width():
    """Plastic Poisson ratio 0: under uniaxial stress Y, p = -Y/3 and q = Y, its plastic strain is along it alone, so
    that its deviator 2/3 (along - across) is 2/3 of its volume's along + 2 across."""
    (bulk, shear, _, _, _, alpha), strength, x = Solid(0.01, 0.0, FOAM).constants, 0.01, 0.5
    a = 1.0 / (1.0 + (alpha / 3.0) ** 2)
    q, p = strength * (1.0 + 3.0 * shear * a * x), -strength / 3.0 * (1.0 + bulk * alpha**2 * a * x)
    of_deviator, of_mean, strain = returned(p, q, strength, bulk, shear, 0.0, alpha)
    assert (of_deviator * q, of_mean * p) == pytest.approx((strength, -strength / 3.0))
    deviator, volume = (1.0 - of_deviator) * q / (3.0 * shear), -(1.0 - of_mean) * p / bulk
    assert deviator == pytest.approx(2.0 / 3.0 * volume)
    assert volume == pytest.approx(strain)


def test_a_foam_locks_where_its_pores_are_closed():
    solid = Solid(0.01, 0.0, FOAM, filled=0.5)
    plateau, _ = hardened(0.4 * solid.locking_strain, 0.01, 0.0, solid.locking_strain)
    locked, rise = hardened(solid.locking_strain, 0.01, 0.0, solid.locking_strain)
    assert plateau == pytest.approx(0.01, rel=1e-3)
    assert locked == pytest.approx(0.02)
    assert rise == pytest.approx(10 * 0.01 / solid.locking_strain)
    assert hardened(3.0, 0.01, 0.1, Solid(0.01).locking_strain) == pytest.approx((0.31, 0.1))
