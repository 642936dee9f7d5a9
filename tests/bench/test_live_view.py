# SPDX-License-Identifier: GPL-3.0-or-later
"""What the live view costs a frame: sending what changed, marching, and showing a picture again."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="asks how long Blender's graphics take")

import addon_utils  # noqa: E402  Blender makes it importable with bpy
import gpu  # noqa: E402

from repousse.core import DensityGrid  # noqa: E402
from repousse.core.bricks import BrickMap  # noqa: E402
from repousse.ui import live_view, texture  # noqa: E402  the add-on, which needs Blender here

ADDON = "bl_ext.user_default.repousse"
WIDTH, HEIGHT = 800, 600
ROUNDS = 10


@pytest.fixture(scope="module", autouse=True)
def graphics():
    assert addon_utils.enable(ADDON, default_set=True) is not None
    try:
        gpu.init()
        gpu.types.GPUOffScreen(8, 8)
    except (AttributeError, SystemError, RuntimeError) as error:
        pytest.skip(f"Blender draws nothing here: {error}")
    yield
    addon_utils.disable(ADDON, default_set=True)


def ball(size: int) -> np.ndarray:
    axes = np.ogrid[-1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j]
    distance = np.sqrt(sum(axis.astype(np.float32) ** 2 for axis in axes))
    return np.clip((0.8 - distance) * (size / 2) + 0.5, 0.0, 1.0).astype(np.float32)


@pytest.fixture(scope="module", params=[128, 256, 512])
def density(request):
    return ball(request.param)


@pytest.fixture(scope="module")
def sent(density):
    """A view that has the grid."""
    view = live_view.LiveView()
    view.texture.upload(BrickMap(density))
    return view


def finished(sent: texture.DensityTexture) -> None:
    """Wait for the graphics card, by reading back the smaller texture, which is sent last."""
    sent.bricks.read()


def reported(benchmark, figures, what: str, limit: float | None = None) -> None:
    milliseconds = 1e3 * np.array(benchmark.stats.stats.data)
    values = {"median": float(np.median(milliseconds)), "least": float(milliseconds.min())}
    benchmark.extra_info.update({f"{name} ms": value for name, value in values.items()})
    section = f"live view, {gpu.platform.device_type_get().lower()}"
    figures.add(section, what, values, "ms", {} if limit is None else {"median": limit})


def test_upload(benchmark, figures, density):
    sent = texture.DensityTexture()

    def upload():
        sent.upload(BrickMap(density))
        finished(sent)

    benchmark.pedantic(upload, rounds=3)
    reported(benchmark, figures, f"upload {len(density)}³")


@pytest.mark.parametrize("edge", [16, 32, 48, 64])
def test_patch(benchmark, figures, density, sent, edge):
    low = len(density) // 2 - edge // 2 + 3

    def patch():
        sent.texture.patch(density, ((low,) * 3, (low + edge,) * 3))
        finished(sent.texture)

    benchmark.pedantic(patch, rounds=ROUNDS, warmup_rounds=1)
    reported(benchmark, figures, f"patch {edge}³ of {len(density)}³")


def frame(size: int, fog: bool) -> live_view.Frame:
    """The ball as high as the picture, from a corner."""
    turned = np.linalg.qr(np.array([[1.0, 1.0, -1.0], [-1.0, 1.0, -1.0], [0.0, 1.0, 1.0]]))[0]
    view = np.eye(4)
    view[:3, :3] = turned.T
    view[:3, 3] = -view[:3, :3] @ np.full(3, (size - 1) / 2.0) - (0.0, 0.0, 2.5 * size)
    near, far = 0.1 * size, 10.0 * size
    projection = np.diag([2.9 * HEIGHT / WIDTH, 2.9, 0.0, 0.0])
    projection[2] = 0.0, 0.0, -(far + near) / (far - near), -2.0 * far * near / (far - near)
    projection[3, 2] = -1.0
    return live_view.Frame.of(projection, view, WIDTH, HEIGHT, 0.5, fog=fog)


@pytest.mark.parametrize("edge", [16, 32, 48, 64])
def test_patch_and_march(benchmark, figures, density, sent, edge):
    """What a step of a stroke costs: its box is sent, and the part of the picture is marched in which that is seen."""
    buffers = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA16F")
    what, size = frame(len(density), False), len(density)
    middle = (np.full(3, size / 2.0) + 0.4 * size * np.array((1.0, -1.0, 1.0)) / np.sqrt(3.0)).astype(int)
    box = tuple(tuple(int(m + side * edge // 2) for m in middle) for side in (-1, 1))
    source = SimpleNamespace(grid=DensityGrid(density, copy=False), take_changes=lambda: (False, [box]))

    def step():
        sent.update(source)
        sent.draw(1, what)
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    with buffers.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 1.0), depth=1.0)
        sent.draw(1, what)
        pixels = sent.marched_pixels
        benchmark.pedantic(step, rounds=ROUNDS)
    share = (sent.marched_pixels - pixels) / (ROUNDS * WIDTH * HEIGHT)
    benchmark.extra_info["share of the picture"] = share
    reported(benchmark, figures, f"patch {edge}³ of {size}³ and march {share:.0%} of {WIDTH} x {HEIGHT}")


@pytest.mark.parametrize("fog", [False, True], ids=["surface", "fog"])
def test_march(benchmark, figures, density, sent, fog):
    buffers = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA16F")
    what = frame(len(density), fog)

    def draw():
        sent.draw(1, what)
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    def another_view():
        sent.draw(1, frame(len(density), not fog))

    with buffers.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 1.0), depth=1.0)
        draw()
        marches = sent.marches
        benchmark.pedantic(draw, setup=another_view, rounds=3)
    assert sent.marches == marches + 6
    reported(benchmark, figures, f"march {'fog' if fog else 'surface'}, {len(density)}³, {WIDTH} x {HEIGHT}")


def test_the_same_picture_again(benchmark, figures, density, sent):
    buffers = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA16F")
    what = frame(len(density), False)

    def draw():
        sent.draw(1, what)
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    with buffers.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 1.0), depth=1.0)
        draw()
        marches = sent.marches
        benchmark.pedantic(draw, rounds=ROUNDS)
    assert sent.marches == marches
    reported(benchmark, figures, f"the same picture again, {len(density)}³, {WIDTH} x {HEIGHT}")
