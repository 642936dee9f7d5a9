# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels and their numpy twins agree: one by one and over whole pushes, to 1e-5 of what moved."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, SphereTool, dispersion, native, rim, smooth
from repousse.core.native.state import BORDERS, DONE, Workspace, box_from, no_box
from repousse.core.plasticity import estimate
from repousse.core.recursion import disperse_recursively

from .volumes import TINY, apart, half_space, kernels_chosen, line, speckled, walk

WITHIN = 1e-5
N = 36
TOOLS = {"sphere": SphereTool(6), "box": BoxTool((4, 6, 5), 4), "capsule": CapsuleTool((1.0, 4.0, 2.0), 4.0, 7.0)}
VOLUMES = {
    "half-space": lambda: half_space(N, 0.6, 13).density,
    "packed": lambda: half_space(N, 1.0, 13).density,
    "noise": lambda: speckled(N).density,
}
BOTH = ("compiled", "numpy")

pytestmark = pytest.mark.skipif(
    not importlib.util.find_spec("repousse_kernels"),
    reason="the compiled kernels are not installed: there is one of two",
)


@pytest.fixture
def workspaces(monkeypatch):
    """Make a workspace for each kind of kernel, on the same values with the same tool at the same place."""

    def make(values, tool, centre):
        works = []
        for name in BOTH:
            with kernels_chosen(monkeypatch, name):
                work = Workspace(values.copy())
            assert (work.library is not None) == (name == "compiled")
            work.take_up(tool)
            work.tool.centre[:] = centre
            works.append(work)
        return works

    return make


def same(first, second, scale=1.0):
    assert np.abs(np.array(first, float) - np.array(second, float)).max() <= WITHIN * scale


@pytest.mark.parametrize("centre", [(17.3, 16.1, 18.9), (9.0, 17.5, 17.5), (-3.2, 30.4, 34.0), (60.0, 0.0, 0.0)])
@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize("tool", TOOLS)
def test_estimate(workspaces, tool, volume, centre):
    compiled, numpy = workspaces(VOLUMES[volume](), TOOLS[tool], centre)
    for work in (compiled, numpy):
        estimate(work)
    scale = max(numpy.estimate.tool_mass, numpy.estimate.reach_mass)
    same(compiled.estimate.tool_mass, numpy.estimate.tool_mass, scale)
    same(compiled.estimate.reach_mass, numpy.estimate.reach_mass, scale)
    same(compiled.estimate.gradient[:], numpy.estimate.gradient[:], scale)


def test_estimate_changes_nothing(kernels):
    """Twice is the same as once."""
    push = Push(speckled(N), SphereTool(6), Material(3.3, 0.2))
    push.move_to((12.0, 17.0, 17.0))
    work, before = push._work, push.grid.density.tobytes()
    estimate(work)
    first = bytes(work.estimate)
    for _ in range(2):
        estimate(work)
        assert bytes(work.estimate) == first
    assert push.grid.density.tobytes() == before


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("tool", TOOLS)
def test_empty_and_put_back(workspaces, tool, axis, packed):
    values = speckled(N).density
    works = workspaces(values, TOOLS[tool], (15.3, 17.1, 18.9))
    for work in works:
        estimate(work)
        dispersion.empty(work, axis, 0.6 * work.estimate.tool_mass, packed)
    compiled, numpy = works
    taken = float((values - numpy.density).sum(dtype=np.float64))
    assert taken > 50.0
    same(compiled.density, numpy.density)
    same(compiled.emptied_box, numpy.emptied_box)
    for name in ("mass", "tool_loss", "reach_loss"):
        same(getattr(compiled.emptied, name), getattr(numpy.emptied, name), taken)
    assert compiled.emptied.tool_loss == pytest.approx(0.6 * compiled.estimate.tool_mass, rel=1e-6) or packed
    for work in works:
        dispersion.put_back(work, 0.4 * work.emptied.mass)
    same(compiled.density, numpy.density)
    assert (values - numpy.density).sum(dtype=np.float64) == pytest.approx(0.6 * taken, rel=1e-5)
    for work in works:
        dispersion.forget_emptied(work)
        assert not work.emptied_box.any()


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.6, -0.48, 0.64)])
@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize("tool", TOOLS)
def test_density_behind_and_loosen(workspaces, tool, volume, direction):
    values = VOLUMES[volume]()
    works = workspaces(values, TOOLS[tool], (17.3, 17.1, 18.9))
    dense = [dispersion.density_behind(work, direction) for work in works]
    same(*dense)
    assert 0.3 < dense[0] <= 1.0
    for work in works:
        dispersion.loosen(work, dispersion.dominant_axis(direction), dense[0], 0.4)
    compiled, numpy = works
    same(compiled.density, numpy.density)
    same(compiled.emptied_box, numpy.emptied_box)
    taken = float((values - numpy.density).sum(dtype=np.float64))
    assert taken > 50.0
    for name in ("mass", "tool_loss", "reach_loss"):
        same(getattr(compiled.emptied, name), getattr(numpy.emptied, name), taken)
    assert numpy.emptied.mass + numpy.emptied.carry == pytest.approx(taken, rel=1e-6)


@pytest.mark.parametrize("centre", [(17.3, 16.1, 18.9), (1.0, 33.5, 17.5), (60.0, 0.0, 0.0)])
@pytest.mark.parametrize("volume", VOLUMES)
@pytest.mark.parametrize("tool", TOOLS)
def test_smooth(workspaces, tool, volume, centre):
    values = VOLUMES[volume]()
    works = workspaces(values, TOOLS[tool], centre)
    exchanged = [smooth.smooth(work, 0.7, 5) for work in works]
    compiled, numpy = works
    same(compiled.density, numpy.density)
    assert exchanged[0] == pytest.approx(exchanged[1], rel=1e-4, abs=1e-4)
    for work in works:
        changed = np.argwhere(work.density != values)
        assert not work.buffer.any()
        assert (len(changed) > 0) == (exchanged[0] > 0.0)
        if len(changed):
            (low, high) = box_from(work.sweep.dirty)
            assert (changed >= low).all() and (changed < high).all()
        else:
            assert box_from(work.sweep.dirty) is None


DIRECTIONS = [
    (1.0, 0.0, 0.0),
    (0.0, -1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.7, 0.5, -0.5),
    (-0.2, 0.9, 0.4),
    (0.6, -0.2, -0.75),
]


@pytest.mark.parametrize("border", ["wall", "open"])
@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("volume", ["noise", "packed"])
def test_sweep(workspaces, volume, direction, border):
    values = VOLUMES[volume]()
    direction = np.array(direction) / np.linalg.norm(direction)
    works = workspaces(values, SphereTool(6), (16.3, 17.1, 18.9))
    axis = dispersion.dominant_axis(direction)
    for work in works:
        estimate(work)
        dispersion.empty(work, axis, 0.8 * work.estimate.tool_mass, False)
        work.sweep.dirty[:] = no_box()
        dispersion.aim(work, direction, axis, BORDERS.index(border), 9.0)
        dispersion.sweep_emptied(work)
        assert dispersion.sweep(work) == DONE
    compiled, numpy = works
    assert apart(numpy.density, compiled.density, values) <= WITHIN
    for name in ("laid", "reach_gain", "mass_out", "surplus"):
        same(getattr(compiled.sweep, name), getattr(numpy.sweep, name), numpy.emptied.mass)
    total = numpy.sweep.laid + numpy.sweep.mass_out + numpy.sweep.surplus
    assert total == pytest.approx(numpy.emptied.mass, rel=1e-6)


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("direction", DIRECTIONS[2:5])
def test_rim_kernels(workspaces, direction, tool):
    values = VOLUMES["packed"]()
    direction = np.array(direction) / np.linalg.norm(direction)
    works = workspaces(values, TOOLS[tool], (11.3, 17.1, 18.9))
    axis = dispersion.dominant_axis(direction)
    lists = []
    for work in works:
        work.rim.dirty[:] = no_box()
        estimate(work)
        dispersion.empty(work, axis, work.estimate.tool_mass, True)
        rim.find_sources(work, direction)
        work.reserve_rim(1 << 15)
        rim.gather(work, direction, 9.0, 6.0)
        places, weights = (column[: work.rim.count].copy() for column in work.rim_list)
        order = np.argsort(places)
        lists.append((places[order], weights[order]))
    compiled, numpy = works
    count = numpy.sources.count
    assert count == compiled.sources.count > 3
    for name in ("x", "y", "z", "mass"):
        same(getattr(compiled.sources, name)[:count], getattr(numpy.sources, name)[:count], numpy.emptied.mass)
    same(compiled.sources.contact_radius, numpy.sources.contact_radius)
    assert np.array_equal(lists[0][0], lists[1][0]) and len(lists[0][0]) > 100
    same(lists[0][1], lists[1][1], lists[1][1].max())  # what is left over the faintest hats is a difference
    left = [rim.place(work, work.emptied.mass) for work in works]
    same(left[0], left[1], numpy.emptied.mass)
    assert apart(numpy.density, compiled.density, values) <= WITHIN


def test_recursion(workspaces):
    """Voxel by voxel and call by call."""
    values = half_space(20, 0.5, 7).density
    works = workspaces(values, SphereTool(3, 5), (7.2, 9.6, 9.4))
    outcomes = []
    for work in works:
        estimate(work)
        outcomes.append(disperse_recursively(work, np.array([0.8, 0.6, 0.0]), 0.02, "leave"))
    assert outcomes[0].calls == outcomes[1].calls > 100
    assert outcomes[0].emptied == pytest.approx(outcomes[1].emptied, rel=1e-9)
    same(works[0].density, works[1].density)


def compared(values, tool, path, monkeypatch, kappa=0.03, said=None, **options):
    """Distance between the outcomes of both kinds of kernels for one path, and their contacts."""
    ends, contacts = [], []
    for name in BOTH:
        with kernels_chosen(monkeypatch, name):
            push = Push(DensityGrid(values), tool, Material(3.3, kappa), **options)
        contacts.append(walk(push, path, **(said or {})))
        ends.append((push.grid.density, push.origin))
    (compiled, origin), (numpy, numpy_origin) = ends
    assert origin == numpy_origin and compiled.shape == numpy.shape
    before = values
    if compiled.shape != values.shape:
        before = np.zeros_like(compiled)
        before[tuple(slice(-o, n - o) for o, n in zip(origin, values.shape))] = values
    for first, second in zip(*contacts):
        assert first.regime is second.regime
        assert first.stress == pytest.approx(second.stress, rel=1e-4, abs=1e-5)
        assert first.moved_mass == pytest.approx(second.moved_mass, rel=1e-4, abs=1e-3)
        assert first.blocked == second.blocked and first.sweeps == second.sweeps
    return apart(numpy, compiled, before)


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("band", [None, 5.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_pushes_along_each_axis(monkeypatch, axis, band, border):
    direction = np.roll([1.0, 0.31, -0.22], axis)
    values = half_space(N, 0.95 if band else 0.6, 12, axis).density
    start = np.full(3, (N - 1) / 2)
    start[axis] = 4.0
    path = line(start, start + 12.0 * direction / np.linalg.norm(direction), 0.7)
    assert compared(values, SphereTool(6), path, monkeypatch, band=band, border=border) <= WITHIN


@pytest.mark.parametrize("band", [None, 5.0])
@pytest.mark.parametrize("tool", TOOLS)
def test_pushes_with_each_tool(monkeypatch, tool, band):
    path = line((4.0, 14.0, 17.0), (14.0, 18.0, 17.5), 0.7)
    values = VOLUMES["packed" if band else "noise"]()
    assert compared(values, TOOLS[tool], path, monkeypatch, band=band, border="wall", kappa=0.01) <= WITHIN


@pytest.mark.parametrize("verb", ["pull", "smooth"])
@pytest.mark.parametrize("tool", TOOLS)
def test_verbs(monkeypatch, tool, verb):
    path = line((14.0, 14.0, 17.0), (19.0, 20.0, 17.5), 0.7)
    said = {"direction": (-0.8, 0.0, 0.6), "strength": 0.4}
    assert compared(VOLUMES["noise"](), TOOLS[tool], path, monkeypatch, said=said, verb=verb) <= WITHIN


def test_push_through_a_saturated_block(monkeypatch):
    """Growth on the far side, many planes of flux, and nothing but spreading to tell the twins apart."""
    values = np.zeros((44, 32, 30), np.float32)
    values[8:36, 4:28, 3:27] = 1.0
    path = line((2.0, 15.5, 15.0), (10.0, 15.8, 14.7), 0.7)
    assert compared(values, SphereTool(5), path, monkeypatch, kappa=TINY) <= WITHIN


@settings(max_examples=20)
@given(
    centre=st.tuples(*[st.floats(-4, 24)] * 3),
    radius=st.floats(1.0, 7.0),
    seed=st.integers(0, 99),
)
def test_estimate_anywhere(centre, radius, seed):
    values = np.random.default_rng(seed).random((20, 18, 22), np.float32)
    with pytest.MonkeyPatch.context() as patch:
        found = []
        for name in BOTH:
            with kernels_chosen(patch, name):
                work = Workspace(values)
            work.take_up(SphereTool(radius))
            work.tool.centre[:] = centre
            estimate(work)
            found.append([work.estimate.tool_mass, work.estimate.reach_mass, *work.estimate.gradient])
    assert found[0] == pytest.approx(found[1], rel=WITHIN, abs=WITHIN * (1.0 + radius**2))


def test_interleaved_pushes(kernels):
    """Two pushes on two grids, in turns or one after the other: no state is shared."""
    paths = line((6.0, 17.5, 17.5), (15.0, 17.0, 18.0), 0.4), line((18.0, 6.0, 16.0), (17.0, 15.0, 17.0), 0.4)

    def pushes():
        return [
            Push(half_space(N, 0.6, 13), SphereTool(6), Material(3.3, 0.03)),
            Push(half_space(N, 1.0, 13, axis=1), SphereTool(5), Material(3.3, 0.01), band=5.0),
        ]

    apart_, together = pushes(), pushes()
    for push, path in zip(apart_, paths):
        walk(push, path)
    for points in zip(*paths):
        for push, point in zip(together, points):
            push.move_to(point)
    walk(together[0], paths[0][len(paths[1]) :])
    walk(together[1], paths[1][len(paths[0]) :])
    for first, second in zip(apart_, together):
        assert first.grid.density.tobytes() == second.grid.density.tobytes()


@pytest.mark.parametrize("band", [None, 5.0])
def test_deterministic(kernels, band):
    """The same push twice is the same bit for bit."""
    ends = []
    for _ in range(2):
        push = Push(speckled(N), SphereTool(6), Material(3.3, 0.03), band=band)
        contacts = walk(push, line((4.0, 14.0, 17.0), (16.0, 18.0, 17.5), 0.7))
        ends.append((push.grid.density.tobytes(), [(c.stress, c.moved_mass, c.force.tobytes()) for c in contacts]))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cost_does_not_depend_on_the_grid(kernels, axis):
    """Counted, not timed: the voxels of flux that a push looks at are those of its flow, in any grid."""
    visited = []
    for n in (64, 128):
        push = Push(half_space(n, 0.6, 20, axis), SphereTool(6), Material(3.3, 0.03))
        start, end = np.full(3, 31.5), np.full(3, 31.5)
        start[axis], end[axis] = 12.0, 24.0
        walk(push, line(start, end, 0.5))
        visited.append(push.voxels_visited)
    assert visited[0] == visited[1] > 1000
    # A step looks at no more than the tool's section (with what it spreads to) times the planes of tool and front.
    assert visited[0] < 24 * 2 * (2 * 6 + 8) ** 2 * (2 * 6 + 12)


def test_the_name_says_which(monkeypatch):
    with kernels_chosen(monkeypatch, "compiled"):
        assert native.available() and native.name() == "compiled"
    with kernels_chosen(monkeypatch, "numpy"):
        assert not native.available() and native.name() == "numpy"
        assert Push(speckled(N), SphereTool(6), Material())._work.library is None


def test_says_once_which_kernels_it_uses(monkeypatch, caplog):
    native._load.cache_clear()
    with kernels_chosen(monkeypatch, "numpy"):
        for _ in range(3):
            Push(speckled(N), SphereTool(6), Material())
    assert [r.getMessage() for r in caplog.records if r.name == "repousse"] == [
        "Repoussé uses its numpy kernels, as REPOUSSE_KERNELS asks"
    ]


def test_works_without_the_compiled_kernels(monkeypatch, caplog):
    """Not installed, of another version, or not a library at all: one line that says so, and the numpy twins."""
    for broken in (lambda: None, lambda: Path(__file__)):
        caplog.clear()
        native._load.cache_clear()
        monkeypatch.setattr(native, "_find", broken)
        assert not native.available()
        assert not native.available()
        messages = [r.getMessage() for r in caplog.records if r.name == "repousse"]
        assert len(messages) == 1 and "numpy kernels" in messages[0] and "\n" not in messages[0]
    monkeypatch.undo()
    native._load.cache_clear()
