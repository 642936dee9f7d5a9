# SPDX-License-Identifier: GPL-3.0-or-later
"""The rule from a solid to how a block is packed, against the rims that finite elements give that solid."""

from functools import cache

import numpy as np
import pytest

from repousse.core.material import packing
from tests.bench.truths import CASES, load
from tests.bench.truths.case import DEPTHS
from tests.bench.truths.trial import HAS_A_RIM, packing_of, press

SOLIDS = ("mises-500", "mises-500-h100", "mises-200", "mises-100", "mises-50", "mises-500-h10", "foam-500")
WITHIN = 0.06
"""Of the depth."""
A_TENTH_OF_A_VOXEL = 0.12
"""In voxels: what a tool of 32 does in its first two voxels is a matter of where they lie."""


@cache
def pressed(name):
    return press(16, packing_of(CASES[name]))


@pytest.mark.parametrize("name", SOLIDS)
def test_the_rim_is_as_high_as_that_of_the_elements(name):
    allowed = np.maximum(WITHIN, A_TENTH_OF_A_VOXEL / (16 * np.array(DEPTHS)))
    assert (np.abs(pressed(name).rim - load(name).rim) <= allowed).all()


@pytest.mark.parametrize("name", SOLIDS)
def test_it_is_highest_where_theirs_is(name):
    there = load(name).rim > HAS_A_RIM
    assert pressed(name).radius[there] == pytest.approx(load(name).rim_radius[there], abs=0.1)


def test_what_yields_at_once_and_does_not_harden_is_packed():
    assert (packing(500.0, 1.0).density, packing(500.0, 1.0).band) == (1.0, 1.0)


def test_units_do_not_matter():
    assert packing(70e9, 0.2e9, 1e9) == packing(70e3, 0.2e3, 1e3)


def test_what_yields_later_gets_more_room():
    densities = [packing(ratio, 1.0).density for ratio in (500, 300, 200, 100, 50, 10)]
    assert (np.diff(densities) < 0.0).all()
    assert min(densities) >= 0.6


def test_what_hardens_spreads_farther_and_gets_more_room():
    rims = [packing(200.0, 1.0, hardening).rim for hardening in (0.0, 0.5, 1.0, 100.0)]
    assert (np.diff(rims) > 0.0).all()
    assert rims[-1] == 4.0
    assert packing(200.0, 1.0, 20.0).density < packing(200.0, 1.0, 2.0).density == packing(200.0, 1.0).density


def test_foam_compacts():
    assert (packing(500.0, 1.0, filled=0.4).density, packing(500.0, 1.0, filled=0.4).band) == (0.4, None)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"young_modulus": 0.0}, "young_modulus"),
        ({"young_modulus": float("inf")}, "young_modulus"),
        ({"yield_stress": -1.0}, "yield_stress"),
        ({"hardening": float("nan")}, "hardening"),
        ({"hardening": -1.0}, "hardening"),
        ({"filled": 0.0}, "filled"),
        ({"filled": 1.5}, "filled"),
    ],
)
def test_bad_solids(wrong, said):
    with pytest.raises(ValueError, match=said):
        packing(**{"young_modulus": 100.0, "yield_stress": 1.0, **wrong})
