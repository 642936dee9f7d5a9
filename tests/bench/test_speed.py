# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a step of a push takes, and how much memory. Times are reported, never asserted; counts are asserted."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from scipy import ndimage

from repousse.core import DensityGrid, Material, Push, SphereTool, native

STEP = 0.5
REPEATS = 3
"""Of each push, one after the other: the machine is rarely alone."""
CLAY = Material(full_force=3.3, yield_ratio=0.1)
DIRECTIONS = {
    "+x": (1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "(1,1,0)": (1.0, 1.0, 0.0),
    "(1,1,1)": (1.0, 1.0, 1.0),
    "(.8,.5,.33)": (0.8, 0.5, 0.33),
}
compiled_only = pytest.mark.skipif(not native.available(), reason="asks how fast the compiled kernels are")


def block(size: int, edge: int, density: float) -> np.ndarray:
    """A cube of ``edge`` voxels in the middle of an empty one of ``size``."""
    volume = np.zeros((size,) * 3, np.float32)
    air = (size - edge) // 2
    volume[air : air + edge, air : air + edge, air : air + edge] = density
    return volume


def scan(size: int) -> np.ndarray:
    """Like a CT: a soft body, bone in it, and 4 % of noise, in air."""
    random = np.random.default_rng(1)
    x, y, z = np.ogrid[-1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j, -1.0 : 1.0 : size * 1j]
    body = (np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z)) < 0.78).astype(np.float32)
    texture = ndimage.zoom(random.random((size // 16,) * 3, dtype=np.float32), 16, order=1)
    bone = (np.hypot(x, y) - 0.25 - 0.2 * texture) ** 2 < 0.002
    volume = np.where(bone, np.float32(0.9), 0.3 + 0.3 * texture) * body
    volume += 0.04 * random.standard_normal(volume.shape, dtype=np.float32) * body
    return np.clip(volume, 0.0, 1.0).astype(np.float32)


_kept: dict[str, np.ndarray] = {}


def volume(kind: str, size: int = 256) -> np.ndarray:
    """A fresh array of a kind: "compressible", "saturated" or "CT"; made once, then copied."""
    key = f"{kind} {size}"
    if key not in _kept:
        _kept.clear()
        air = 28 * size // 256
        density = {"compressible": 0.5, "saturated": 1.0}.get(kind)
        _kept[key] = scan(size) if density is None else block(size, size - 2 * air, density)
    return _kept[key].copy()


def path_into(density: np.ndarray, direction, radius: float, depth: float) -> np.ndarray:
    """Poses (n, 3) along ``direction`` through the middle, from first touch to ``depth`` beyond."""
    u = np.array(direction) / np.linalg.norm(direction)
    shape = np.array(density.shape)
    middle = (shape - 1) / 2
    full = ndimage.find_objects((density > 0.0).astype(np.int8))[0]
    low, high = np.array([s.start for s in full]) - 0.5, np.array([s.stop for s in full]) - 0.5
    ways = np.arange(-2.0 * shape.max(), 0.0, 0.25)
    points = middle + ways[:, None] * u
    gap = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    first = ways[int(np.argmax(gap < radius))]
    return middle + (first + np.arange(0.0, depth + 1e-9, STEP))[:, None] * u


def time_steps(benchmark, make, path: np.ndarray, repeats: int) -> Push:
    """Benchmark ``move_to`` on every pose of ``path``: a round is a step, and each repeat has a push of its own."""
    poses = iter([(number, pose) for _ in range(repeats) for number, pose in enumerate(path)])
    push: Push | None = None

    def next_pose():
        nonlocal push
        number, pose = next(poses)
        if number == 0:
            push = make()
        return (pose,), {}

    def step(pose):
        assert push.move_to(pose).sweeps <= 4

    benchmark.pedantic(step, setup=next_pose, rounds=repeats * len(path), iterations=1)
    return push


def pushing(density: np.ndarray, radius: float = 16.0, **options) -> Push:
    # Open, not growing: making an array larger is a cost of its own, and the volumes leave 28 voxels of air.
    return Push(DensityGrid(density, copy=False), SphereTool(radius), CLAY, border="open", **options)


@pytest.fixture(scope="module", autouse=True)
def warm() -> None:
    push = pushing(block(64, 40, 0.9), 8.0)
    for pose in path_into(push.grid.density, (0.3, 0.2, 1.0), 8.0, 10.0):
        push.move_to(pose)


def test_memory_bandwidth(benchmark, figures):
    """What this machine's memory gives, in the same run: the roof over every other figure."""
    source = np.ones(16 << 20, np.float32)
    target, small = np.empty_like(source), np.ones(128 << 10, np.float32)
    benchmark.pedantic(np.copyto, args=(target, source), rounds=9, warmup_rounds=1)
    copy = 2 * source.nbytes / min(benchmark.stats.stats.data) / 1e9
    change = 2 * source.nbytes / _best(lambda: np.multiply(target, np.float32(0.999), out=target), 9) / 1e9
    cached = 2 * small.nbytes / _best(lambda: np.multiply(small, np.float32(0.999), out=small), 400) / 1e9
    values = {"copy": copy, "change in place": change, "in 512 kB": cached}
    benchmark.extra_info.update(values)
    figures.add("memory", "bandwidth, read and written, 64 MB", values, "GB/s")


def _best(call, rounds: int) -> float:
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


@compiled_only
@pytest.mark.parametrize("way", DIRECTIONS)
@pytest.mark.parametrize("kind", ["compressible", "saturated", "CT"])
def test_push_step(benchmark, figures, kind, way):
    path = path_into(volume(kind), DIRECTIONS[way], 16.0, 60.0)
    push = time_steps(benchmark, lambda: pushing(volume(kind)), path, REPEATS)
    assert push.voxels_visited > 0
    targets = {"p99": 3.0} if kind == "saturated" else {"p50": 0.3, "p99": 1.0}
    figures.steps(benchmark, "push 256³, tool 32", f"{kind}, {way}", REPEATS, **targets)


@compiled_only
@pytest.mark.parametrize("kind", ["compressible", "saturated"])
@pytest.mark.parametrize("diameter", [16, 32, 64, 128])
def test_tool_size(benchmark, figures, diameter, kind):
    size = 256 if diameter < 128 else 384
    path = path_into(volume(kind, size), (1.0, 0.0, 0.0), diameter / 2, 60.0)
    time_steps(benchmark, lambda: pushing(volume(kind, size), diameter / 2), path, 2)
    figures.steps(benchmark, "tool size", f"{kind}, tool {diameter}, {size}³", 2)


@compiled_only
@pytest.mark.parametrize("way", ["+x", "+z"])
def test_grid_size(benchmark, figures, way):
    """The same block of 80 voxels in grids of three sizes, step by step in turn, so that all meet the same machine."""
    sizes = (128, 256, 512)
    pushes = [pushing(block(size, 80, 0.5)) for size in sizes]
    paths = [path_into(push.grid.density, DIRECTIONS[way], 16.0, 40.0) for push in pushes]
    spent = {size: [] for size in sizes}

    def run():
        for poses in zip(*paths):
            for size, push, pose in zip(sizes, pushes, poses):
                began = time.perf_counter()
                push.move_to(pose)
                spent[size].append(1000.0 * (time.perf_counter() - began))

    benchmark.pedantic(run, rounds=1)
    assert len({push.voxels_visited for push in pushes}) == 1, "a sweep looks at more voxels in a larger grid"
    for size, milliseconds in spent.items():
        values = dict(zip(("p50", "p99"), np.percentile(milliseconds, (50, 99)).tolist()))
        benchmark.extra_info[f"{size}"] = values
        figures.add("grid size", f"{size}³, {way}", values, "ms")
    ratio = float(np.median(spent[512]) / np.median(spent[128]))
    benchmark.extra_info.update(ratio=ratio, target_ratio=1.2)
    figures.add("grid size", f"512³ over 128³, {way}", {"": ratio}, "", {"": 1.2})


@compiled_only
@pytest.mark.parametrize(("radius", "p99"), [(16.0, 3.0), (32.0, 8.0)])
def test_rim_step(benchmark, figures, radius, p99):
    """Packed clay, the band one radius ahead, pressed one radius deep."""
    path = path_into(volume("saturated"), (0.0, 0.0, -1.0), radius, radius)
    time_steps(benchmark, lambda: pushing(volume("saturated"), radius, band=radius), path, REPEATS)
    figures.steps(benchmark, "rim, d0 = 1, band = R", f"R = {radius:g}, 256³", REPEATS, p99=p99)


@compiled_only
def test_estimate(benchmark, figures):
    """sigma, sigma_f and their gradient: a tool of 32 voxels wholly inside material that never yields."""
    with pytest.warns(UserWarning, match="may never yield"):
        push = Push(DensityGrid(volume("compressible"), copy=False), SphereTool(16.0), Material(3.3, 5.0))
    poses = iter(np.array([128.3, 127.6, 128.1]) + 0.01 * np.arange(2001)[:, None])
    push.move_to(next(poses))
    benchmark.pedantic(lambda pose: push.move_to(pose), setup=lambda: ((next(poses),), {}), rounds=2000)
    microseconds = 1e6 * np.array(benchmark.stats.stats.data)
    values = dict(zip(("p50", "p99"), np.percentile(microseconds, (50, 99)).tolist()))
    benchmark.extra_info.update(**values, target_p50=100.0)
    figures.add("estimate", "σ + σ_f by move_to, no density moved, tool 32", values, "µs", {"p50": 100.0})


@pytest.mark.parametrize("kind", ["compressible", "saturated", "CT"])
def test_numpy_twin(benchmark, figures, monkeypatch, kind):
    """The fallback on the last part of the same push as `test_push_step`, which it is beside in the table."""
    path = path_into(volume(kind), (1.0, 0.0, 0.0), 16.0, 20.0)
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy")
    time_steps(benchmark, lambda: pushing(volume(kind)), path, 1)
    figures.steps(benchmark, "numpy kernels, tool 32, 256³", f"{kind}, +x, 20 deep", 1)


@compiled_only
@pytest.mark.parametrize("size", [256, 512])
def test_memory(benchmark, figures, size):
    """What a push takes beside its grid, and what undoing it keeps."""
    density = block(size, 80, 0.5)
    path = path_into(density, (0.0, 0.0, 1.0), 16.0, 40.0)
    benchmark.extra_info["size"] = size
    tracemalloc.start()
    try:
        push = pushing(density)
        benchmark.pedantic(lambda: [push.move_to(pose) for pose in path], rounds=1)
        scratch = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    push = pushing(block(size, 80, 0.5))
    history = push.remember()
    for pose in path:
        push.move_to(pose)
    values = {"grid": density.nbytes / 2**20, "scratch": scratch, "before-images": history.nbytes / 2**20}
    benchmark.extra_info.update(values)
    figures.add("memory", f"push 40 deep, tool 32, {size}³", values, "MiB")
