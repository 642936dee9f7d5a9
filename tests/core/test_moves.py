# SPDX-License-Identifier: GPL-3.0-or-later
"""What a move says beside its place, what others may rely on meanwhile, and pushes that share a grid."""

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, SphereTool, dispersion
from repousse.core import push as push_module

from .volumes import half_space, in_frame, line, speckled, walk

N = 40
CLAY = Material(3.3, 0.03)
MIDDLE = (N - 1) / 2
SIDEWAYS = (0.0, 0.6, 0.8)


def test_a_given_direction_is_where_density_goes(kernels):
    """The centre of mass of what moved goes along it, whatever the way of the tool."""
    for direction in ((1.0, 0.0, 0.0), SIDEWAYS, (0.6, 0.0, -0.8)):
        grid = half_space(N, 0.5, 8)
        before = grid.density.astype(np.float64)
        push = Push(grid, SphereTool(5), CLAY)
        for x in (17.0, 17.2, 17.5):
            push.move_to((x, MIDDLE, MIDDLE), direction=direction)
        change = grid.density - before
        moment = np.array(
            [(change * np.arange(N).reshape([-1 if b == a else 1 for b in range(3)])).sum() for a in range(3)]
        )
        assert moment @ direction > 200.0
        assert moment / np.linalg.norm(moment) == pytest.approx(direction, abs=0.1)


def test_a_given_direction_that_is_the_way_changes_nothing(kernels):
    """A straight push that says where it goes is the push that does not, but for rounding."""
    ends = []
    for direction in (None, (1.0, 0.0, 0.0)):
        grid = half_space(N, 0.5, 14)
        walk(
            Push(grid, SphereTool(5), CLAY),
            line((4.0, MIDDLE, MIDDLE), (16.0, MIDDLE, MIDDLE), 0.5),
            direction=direction,
        )
        ends.append(grid.density)
    assert ends[1] == pytest.approx(ends[0], abs=1e-6)


@pytest.mark.parametrize(
    "said",
    [
        {"direction": (1.0, 1.0, 0.0)},
        {"direction": (0.0, 0.0, 0.0)},
        {"direction": (float("nan"), 0.0, 1.0)},
        {"direction": (1.0, 0.0)},
        {"direction": "up"},
        {"direction": 3},
        {"strength": 1.5},
        {"strength": -0.1},
        {"strength": float("nan")},
        {"strength": "much"},
    ],
    ids=str,
)
@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
def test_bad_moves(verb, said):
    """One line, and neither grid nor push has moved."""
    grid = half_space(N, 0.5, 14)
    before, push = grid.density.tobytes(), Push(grid, SphereTool(5), CLAY, verb=verb)
    with pytest.raises(ValueError, match=r"direction|strength") as error:
        push.move_to((14.0, MIDDLE, MIDDLE), **said)
    assert "\n" not in str(error.value)
    assert grid.density.tobytes() == before and push._position is None


def test_a_direction_need_not_be_exact(kernels):
    """What is a unit vector to a thousandth is taken as one."""
    ends = []
    for length in (1.0, 1.0009, 0.9991):
        grid = half_space(N, 0.5, 14)
        push = Push(grid, SphereTool(5), CLAY)
        push.move_to((14.0, MIDDLE, MIDDLE), direction=np.array(SIDEWAYS) * length)
        ends.append(grid.density)
    assert ends[1] == pytest.approx(ends[0], abs=1e-5) and ends[2] == pytest.approx(ends[0], abs=1e-5)


@pytest.mark.parametrize(
    ("density", "before", "after"),
    [(0.8, {"band": 9.0}, {"band": 1.0}), (1.0, {"border": "open"}, {"border": "wall"})],
    ids=["band", "border"],
)
def test_what_changes_is_noticed(kernels, density, before, after):
    """A push with another band or border goes on as one that was made with it: nothing made ready outlives it."""
    way = (1.0, 0.0, 0.0)
    push = Push(half_space(N, density, 10), SphereTool(4), CLAY, **before)
    push.move_to((18.0, MIDDLE, MIDDLE), direction=way)
    fresh, same = (Push(DensityGrid(push.grid.density), SphereTool(4), CLAY, **how) for how in (after, before))
    for name, value in after.items():
        setattr(push, name, value)
    for each in (push, fresh, same):
        each.move_to((18.5, MIDDLE, MIDDLE), direction=way)
    as_new, as_old = (np.abs(push.grid.density - other.grid.density).sum() for other in (fresh, same))
    assert as_old > 5.0 and as_new < 0.05 * as_old


@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
@pytest.mark.parametrize("border", ["grow", "wall"])
def test_epoch(kernels, monkeypatch, verb, border):
    """Odd from before density leaves the tool until all of it lies again, growth included; and it only rises."""
    grid = DensityGrid(np.ones((20, 20, 20), np.float32))
    push = Push(grid, SphereTool(4), CLAY, border=border, verb=verb)
    seen = []

    def watched(module, name):
        kernel = getattr(module, name)

        def watch(*given):
            seen.append((name, push.epoch, grid.density.sum(dtype=np.float64)))
            done = kernel(*given)
            seen.append((name, push.epoch, grid.density.sum(dtype=np.float64)))
            return done

        monkeypatch.setattr(module, name, watch)

    for name in ("empty", "loosen", "sweep", "put_back", "forget_emptied"):
        watched(dispersion, name)
    watched(push_module.smoothing, "smooth")
    watched(push_module, "estimate")
    grown, kept, mass = grid.grow, push.epoch, grid.mass
    monkeypatch.setattr(grid, "grow", lambda *given: (seen.append(("grow", push.epoch, None)), grown(*given)))
    assert kept % 2 == 0
    for z in np.arange(13.0, 17.0, 0.5):
        push.move_to((9.5, 9.5, z), direction=(0.0, 0.0, 1.0), strength=0.4)
        assert push.epoch % 2 == 0 and push.epoch >= kept
        kept = push.epoch
    names = {name for name, _, _ in seen}
    assert names >= {"push": {"empty", "sweep"}, "pull": {"loosen", "sweep"}, "smooth": {"smooth"}}[verb]
    assert verb == "smooth" or names >= ({"grow"} if border == "grow" else {"put_back"})
    for name, epoch, there in seen:
        assert epoch % 2 == (name != "estimate")
        if epoch % 2 == 0:
            assert there == pytest.approx(mass, rel=1e-6)
    flights = [epoch for _, epoch, _ in seen]
    assert flights == sorted(flights) and kept >= 2


def test_epoch_stands_still_while_nothing_moves(kernels):
    push = Push(half_space(N, 0.5, 14), SphereTool(5), Material(3.3, 10.0 / 24.0 * 0.9), border="wall")
    walk(push, line((4.0, MIDDLE, MIDDLE), (9.6, MIDDLE, MIDDLE), 0.5))
    assert push.contacts[0].stress > 0.0 and push.epoch == 0


def test_pushes_that_share_a_grid_follow_its_growth(kernels):
    """In turns, while each makes it grow on its side: what comes out is what one push after another would do."""
    values = np.zeros((48, 24, 24), np.float32)
    values[:, 2:22, 2:22] = 1.0
    left, right = line((16.0, 11.5, 11.5), (3.0, 11.5, 11.5), 0.5), line((31.0, 11.5, 11.5), (44.0, 11.5, 11.5), 0.5)
    grids, origins = [], []
    for interleaved in (True, False):
        grid = DensityGrid(values)
        pushes = [Push(grid, SphereTool(4), CLAY) for _ in range(2)]
        if interleaved:
            for first, second in zip(left, right):
                pushes[0].move_to(first)
                pushes[1].move_to(second)
        else:
            walk(pushes[0], left)
            walk(pushes[1], right)
        assert grid.mass == pytest.approx(values.sum(dtype=np.float64), rel=1e-7)
        assert pushes[0].origin == pushes[1].origin and pushes[0].origin[0] < 0 and grid.shape[0] > 56
        assert grid.grown == tuple(-o for o in pushes[0].origin)
        grids.append(grid)
        origins.append(pushes[0].origin)
    views = [in_frame(g, o, (-32, -32, -32), (112, 88, 88)) for g, o in zip(grids, origins)]
    assert np.abs(views[0] - views[1]).max() <= 1e-4


def test_a_push_made_later_has_its_own_frame(kernels):
    """Poses count from the first voxel that the grid had when the push was made, boxes too."""
    values = np.ones((24, 24, 24), np.float32)
    grid = DensityGrid(values)
    first = Push(grid, SphereTool(4), CLAY)
    walk(first, line((12.0, 11.5, 11.5), (3.0, 11.5, 11.5), 0.5))
    below = grid.grown[0]
    assert below > 0
    second = Push(grid, SphereTool(4), CLAY)
    assert second.origin == (0, 0, 0) and first.origin[0] == -below
    contact = second.move_to((float(below) + 18.0, 11.5 + grid.grown[1], 11.5 + grid.grown[2]))
    contact = second.move_to((float(below) + 19.0, 11.5 + grid.grown[1], 11.5 + grid.grown[2]))
    (low, _, _), (high, _, _) = contact.dirty
    assert low > below + 10 and high >= below + 19


def test_histories_of_pushes_that_share_a_grid(kernels):
    """Each keeps before-images of what its own push changes, also when the other makes the grid grow."""
    values = np.zeros((48, 24, 24), np.float32)
    values[:, 2:22, 2:22] = 1.0
    grid = DensityGrid(values)
    first, second = (Push(grid, SphereTool(4), CLAY) for _ in range(2))
    history = first.remember()
    second.join(history)
    for a, b in zip(
        line((16.0, 11.5, 11.5), (3.0, 11.5, 11.5), 0.5), line((31.0, 11.5, 11.5), (44.0, 11.5, 11.5), 0.5)
    ):
        first.move_to(a)
        second.move_to(b)
    assert first.origin[0] < 0
    first.restore(history)
    second.forget(history, 0.0)
    assert grid.density.tobytes() == values.tobytes() and grid.shape == values.shape
    assert grid.grown == first.origin == second.origin == (0, 0, 0)


def test_a_history_of_its_own_follows_growth(kernels):
    """A push that keeps before-images for itself finds them in their places after each growth by another."""
    values = np.zeros((48, 24, 24), np.float32)
    values[:, 2:22, 2:22] = np.random.default_rng(2).uniform(0.7, 1.0, (48, 20, 20))
    grid = DensityGrid(values)
    grower, keeper = (Push(grid, SphereTool(4), CLAY) for _ in range(2))
    history, origins = keeper.remember(), []
    for turn in range(3):
        walk(grower, line((8.0 - 5.0 * turn, 11.5, 11.5), (4.0 - 5.0 * turn, 11.5, 11.5), 0.5), continuous=True)
        walk(keeper, line((36.0, 11.5, 11.5 + turn), (38.0, 11.5, 11.5 + turn), 0.5))
        origins.append(grower.origin[0])
    assert origins[0] > origins[-1] and keeper.origin == grower.origin
    where = np.add(np.argwhere(np.ones((12, 24, 24))), (34, 0, 0))
    now = in_frame(grid, keeper.origin, (34, 0, 0), (12, 24, 24))
    assert np.abs(now - values[34:46]).sum() > 20.0
    assert history.original(where).tobytes() == values[34:46].tobytes()


@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
def test_restores_after_each_verb(kernels, verb):
    """Bit for bit; and then the same path leads to the same voxels as the first time."""
    grid = speckled((41, 33, 37))
    push = Push(grid, SphereTool(5), CLAY, verb=verb, band=4.0)
    before, history, ends = grid.density.tobytes(), push.remember(), []
    path = line((14.0, 16.0, 18.0), (20.0, 17.0, 19.0), 0.6)
    for _ in range(2):
        walk(push, path, direction=(0.6, 0.0, 0.8) if verb == "pull" else None, strength=0.4)
        ends.append(grid.density.tobytes())
        assert ends[-1] != before
        epoch = push.epoch
        push.restore(history)
        assert grid.density.tobytes() == before
        assert push.epoch > epoch and push.epoch % 2 == 0
        history = push.remember()
    assert ends[0] == ends[1]


def test_an_error_in_flight_is_seen_until_a_restore(kernels, monkeypatch):
    """The epoch stays odd, for mass is missing; a restore brings both back."""
    grid = half_space(N, 0.6, 10)
    before, push = grid.density.tobytes(), Push(grid, SphereTool(5), CLAY)
    history = push.remember()
    with monkeypatch.context() as patch:
        patch.setattr(dispersion, "sweep", lambda work: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            walk(push, line((8.0, MIDDLE, MIDDLE), (14.0, MIDDLE, MIDDLE)))
    assert push.epoch % 2 == 1 and grid.density.tobytes() != before
    push.restore(history)
    assert push.epoch % 2 == 0 and grid.density.tobytes() == before
    mass = grid.mass
    walk(push, line((8.0, MIDDLE, MIDDLE), (14.0, MIDDLE, MIDDLE)))
    assert grid.mass == pytest.approx(mass, rel=1e-7) and push.epoch % 2 == 0


def test_there_is_no_such_verb():
    with pytest.raises(ValueError, match="melt"):
        Push(half_space(16, 0.5, 8), SphereTool(4), CLAY, verb="melt")
