# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools: signed distances, fractional coverage, and the volumes that forces are calibrated by."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.core import BoxTool, CapsuleTool, SphereTool

SHAPES = {
    "ball": SphereTool(5.0).volume,
    "box": BoxTool((3.0, 5.0, 7.0), 2.0).volume,
    "capsule": CapsuleTool((4.0, -2.0, 1.0), 3.0).volume,
}
coordinates = st.floats(-14.0, 14.0)


def distance(shape, point):
    return float(shape.distance(*np.array(point, float)))


def nearest_on_surface(name, point):
    """Signed distance by the book, each shape in its own way."""
    point = np.array(point, float)
    if name == "ball":
        return np.linalg.norm(point) - 5.0
    if name == "capsule":
        axis = np.array([4.0, -2.0, 1.0])
        low, high = -1.0, 1.0  # the distance to the segment's points falls, then rises
        for _ in range(100):
            third = (high - low) / 3.0
            near, far = (np.linalg.norm(point - t * axis) for t in (low + third, high - third))
            low, high = (low, high - third) if near <= far else (low + third, high)
        return np.linalg.norm(point - low * axis) - 3.0
    excess = np.abs(point) - [3.0, 5.0, 7.0]
    return excess.max() if excess.max() < 0 else np.linalg.norm(np.maximum(excess, 0.0))


@pytest.mark.parametrize("name", SHAPES)
@given(point=st.tuples(coordinates, coordinates, coordinates))
def test_distance(name, point):
    assert distance(SHAPES[name], point) == pytest.approx(nearest_on_surface(name, point), abs=1e-6)


@pytest.mark.parametrize("name", SHAPES)
@given(
    a=st.tuples(coordinates, coordinates, coordinates),
    b=st.tuples(coordinates, coordinates, coordinates),
)
def test_distance_never_runs_ahead_of_the_way(name, a, b):
    """A signed distance is 1-Lipschitz, so coverage is continuous: no jump however the tool moves."""
    assert abs(distance(SHAPES[name], a) - distance(SHAPES[name], b)) <= math.dist(a, b) + 1e-9


@pytest.mark.parametrize("name", SHAPES)
@given(point=st.tuples(coordinates, coordinates, coordinates))
def test_coverage_is_a_ramp_of_one_voxel(name, point):
    far = distance(SHAPES[name], point)
    expected = 1.0 if far <= -0.5 else 0.0 if far >= 0.5 else 0.5 - far
    assert float(SHAPES[name].coverage(*np.array(point))) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", SHAPES)
@given(point=st.tuples(*[st.floats(-9.0, 9.0)] * 3))
def test_normal_is_the_gradient_of_the_distance(name, point):
    shape, step = SHAPES[name], 1e-5
    point = np.array(point)
    gradient = np.array(
        [(distance(shape, point + e) - distance(shape, point - e)) / (2 * step) for e in step * np.eye(3)]
    )
    if abs(np.linalg.norm(gradient) - 1.0) > 1e-4:
        return  # on a crease there are two
    normal = np.array(shape.normal(*point)).ravel()
    # At the same height above two faces the normal is between them; elsewhere it is the gradient.
    assert normal == pytest.approx(gradient, abs=2e-3) or normal @ gradient > 0.5


def test_normal_points_out_of_the_nearest_face():
    box = SHAPES["box"]
    for axis, half in enumerate((3.0, 5.0, 7.0)):
        for sign in (-1.0, 1.0):
            point = np.zeros(3)
            point[axis] = sign * (half - 0.4)
            expected = np.zeros(3)
            expected[axis] = sign
            assert np.array(box.normal(*point)).ravel() == pytest.approx(expected)


@pytest.mark.parametrize(
    "tool",
    [SphereTool(1.0), SphereTool(5.3), SphereTool(16), BoxTool((2, 3.5, 6), 2), CapsuleTool((3, -5, 1), 4.2)],
    ids=lambda tool: f"{tool.kind}{tool.radius:g}",
)
@pytest.mark.parametrize("whole", ["volume", "surroundings"])
def test_covered_volume_is_the_sum_of_coverage(tool, whole):
    """Newtons are shared out over it: the mean over where the tool may stand between voxels, and a lattice sum."""
    shape = getattr(tool, whole)
    half = [math.ceil(e) + 2 for e in shape.extent]
    sums = []
    for offset in np.random.default_rng(0).random((8, 3)):
        axes = np.ogrid[tuple(slice(-h, h + 1) for h in half)]
        sums.append(float(shape.coverage(*(a - o for a, o in zip(axes, offset))).sum()))
    # Flat faces move whole planes in and out of the ramp, but its sum over a voxel of travel is the same.
    assert np.mean(sums) == pytest.approx(shape.covered_volume, rel=0.01 if tool.radius > 1.0 else 0.05)


def test_covered_volume_in_closed_form():
    assert SphereTool(16).volume.covered_volume == pytest.approx(4 / 3 * math.pi * (16**3 + 16 / 4), rel=1e-12)


def test_reach_surrounds_the_tool():
    sphere = SphereTool(8)
    assert sphere.reach == 12.0 and sphere.surroundings.radius == 12.0
    assert CapsuleTool((1, 2, 3), 4).reach == 6.0
    assert BoxTool((8, 9, 10), 6).surroundings.half_size == (14, 15, 16)
    for tool in (sphere, CapsuleTool((1, 2, 3), 4), BoxTool((8, 9, 10), 6)):
        x, y, z = np.ogrid[-20:21, -20:21, -20:21]
        assert (tool.surroundings.coverage(x, y, z) >= tool.volume.coverage(x, y, z)).all()


@given(st.floats(1.0, 60.0))
def test_scaled(radius):
    for tool in (SphereTool(8, 10), CapsuleTool((1, 2, 3), 4, 7), BoxTool((8, 9, 10), 6)):
        other = tool.scaled(radius)
        assert other.radius == pytest.approx(radius)
        assert other.kind == tool.kind
        ratio = radius / tool.radius
        assert other.volume.covered_volume == pytest.approx(
            ratio**3 * tool.volume.covered_volume, rel=0.6 if radius < 3 else 0.1
        )
        assert np.array(other.surroundings.extent) == pytest.approx(ratio * np.array(tool.surroundings.extent))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SphereTool(0.99),
        lambda: SphereTool(float("nan")),
        lambda: SphereTool(float("inf")),
        lambda: SphereTool(8, 8),
        lambda: SphereTool(8, float("nan")),
        lambda: BoxTool((8, 0.5, 8), 4),
        lambda: BoxTool((8, 8), 4),
        lambda: BoxTool((8, float("nan"), 8), 4),
        lambda: BoxTool((8, 8, 8), 0),
        lambda: CapsuleTool((1, 2), 4),
        lambda: CapsuleTool((1, 2, float("inf")), 4),
        lambda: CapsuleTool((1, 2, 3), 0),
        lambda: SphereTool(8).scaled(0.5),
    ],
)
def test_bad_tools(make):
    with pytest.raises(ValueError) as error:
        make()
    assert "\n" not in str(error.value)
