# SPDX-License-Identifier: GPL-3.0-or-later
"""Between pixels and voxels: a ray passes through what its pixel shows, and lengths are those on the screen."""

import numpy as np
import pytest

from repousse.operators.aim import Aim

WIDTH, HEIGHT = 800, 600
TO_WORLD = np.array([[0.0, -0.02, 0.0, 1.0], [0.02, 0.0, 0.0, -0.5], [0.0, 0.0, 0.02, -6.0], [0.0, 0.0, 0.0, 1.0]])


def clip(perspective):
    """Voxels to clip space, for an eye at the world's origin that looks down -z."""
    near, far, wide = 0.1, 100.0, 0.4
    tall = wide * HEIGHT / WIDTH
    matrix = np.diag([1.0 / wide, 1.0 / tall, -(far + near) / (far - near), 0.0])
    matrix[2, 3], matrix[3, 2] = -2.0 * far * near / (far - near), -1.0
    if not perspective:
        matrix = np.diag([1.0 / (6.0 * wide), 1.0 / (6.0 * tall), -1.0 / far, 1.0])
    return matrix @ TO_WORLD


@pytest.mark.parametrize("perspective", [True, False])
def test_a_ray_passes_through_what_its_pixel_shows(perspective):
    to_clip, point = clip(perspective), np.array((30.0, 52.0, 11.0))
    x, y, _, w = to_clip @ (*point, 1.0)
    origin, way = Aim(to_clip, WIDTH, HEIGHT).ray((x / w + 1.0) * WIDTH / 2.0, (y / w + 1.0) * HEIGHT / 2.0)
    off = point - origin
    assert np.linalg.norm(way) == pytest.approx(1.0)
    assert off @ way > 0.0, "it looks away"
    assert np.linalg.norm(off - (off @ way) * np.array(way)) < 1e-6


@pytest.mark.parametrize("perspective", [True, False])
def test_a_length_on_the_screen_is_so_many_voxels_there(perspective):
    point = np.array((30.0, 52.0, 11.0))
    distance = -(TO_WORLD @ (*point, 1.0))[2] if perspective else 6.0
    wanted = 40.0 * 2.0 * 0.4 * distance / WIDTH / 0.02
    assert Aim(clip(perspective), WIDTH, HEIGHT).length(tuple(point), 40.0) == pytest.approx(wanted, rel=1e-6)
