# SPDX-License-Identifier: GPL-3.0-or-later
"""Strokes through a volume without a hand or a window, and what is told of them: report, trace, picture."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..core import Contact, DensityGrid, Regime, Sample, Stroke, native
from ..core.grid import Box, union
from ..core.stroke import hash_of
from ..core.tool import vector

TRACE_COLUMNS = ("t", "x", "y", "z", "regime", "stress", "yield_stress", "fx", "fy", "fz", "moved_mass")


@dataclass
class Run:
    """Strokes through one grid: every sample with its contact and wall time in ms, and the grid before.

    ``origin`` is where the grid's first voxel now lies in the voxels that it had before.
    """

    grid: DensityGrid
    before: DensityGrid
    strokes: list[Stroke]
    origin: tuple[int, int, int] = (0, 0, 0)
    samples: list[Sample] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    dirty: Box | None = None

    @classmethod
    def of(cls, grid: DensityGrid, strokes: list[Stroke], name: str) -> Run:
        """Push every stroke through ``grid``, which is changed in place; ``name`` is what errors call it."""
        run = cls(grid, DensityGrid(grid.density, grid.transform), strokes)
        for number, stroke in enumerate(strokes, start=1):
            try:
                run._follow(stroke, f"stroke {number} of {len(strokes)}")
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
        return run

    def _follow(self, stroke: Stroke, what: str) -> None:
        # Poses count from the volume as it was given, unless a stroke says that it began on the grid that is here now.
        shift = np.array(self.origin)
        if shift.any() and stroke.grid_hash is not None and stroke.grid_hash == hash_of(self.grid):
            shift[:] = 0
        push = stroke.moved_by(-shift).push(self.grid)
        for sample in progress(stroke.samples, what):
            began = time.perf_counter()
            contact = push.walk(replace(sample, position=vector(sample.position - shift)), stroke.continuous)
            self.ms.append((time.perf_counter() - began) * 1e3)
            self.samples.append(sample)
            self.contacts.append(contact)
            if contact.dirty is not None:
                low, high = (tuple(int(v) for v in np.array(end) + self.origin) for end in contact.dirty)
                self.dirty = union(self.dirty, (low, high))
        self.origin = tuple(int(a + b) for a, b in zip(self.origin, push.origin, strict=True))

    def report(self) -> dict:
        """What `--report` writes. Masses in voxels' worth, stresses in newtons, times in ms a step."""
        p50, p99 = np.percentile(self.ms, (50, 99)).tolist()
        return {
            "steps": len(self.contacts),
            "mass_before": self.before.mass,
            "mass_after": self.grid.mass,
            "mass_out": sum(contact.mass_out for contact in self.contacts),
            "moved_mass": sum(contact.moved_mass for contact in self.contacts),
            "peak_stress": max(contact.stress for contact in self.contacts),
            "kernels": native.name(),
            "method": ", ".join(dict.fromkeys(stroke.method for stroke in self.strokes)),
            "quality": ", ".join(dict.fromkeys(sample.quality for sample in self.samples)),
            "ms": {"p50": p50, "p99": p99, "max": max(self.ms)},
            "touched_voxels": self.touched_voxels(),
            "blocked_steps": sum(contact.blocked for contact in self.contacts),
            "peak_residual": max(contact.residual for contact in self.contacts),
            "shape": list(self.grid.shape),
            "voxel_size": self.grid.voxel_size,
        }

    def touched_voxels(self) -> int:
        """Voxels whose density is not what it was before."""
        if self.dirty is None:
            return 0
        low, high = np.array(self.dirty[0]), np.array(self.dirty[1])
        low, high = np.maximum(low, self.origin), np.minimum(high, np.add(self.origin, self.grid.shape))
        after = _part(self.grid.density, low - self.origin, high - self.origin)
        before = np.zeros_like(after)
        inner, outer = np.clip(low, 0, self.before.shape), np.clip(high, 0, self.before.shape)
        _part(before, inner - low, outer - low)[...] = _part(self.before.density, inner, outer)
        return int(np.count_nonzero(after != before))

    def save_trace(self, path: Path) -> None:
        """A line of `TRACE_COLUMNS` for each sample: seconds, voxels, newtons, voxels' worth."""
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(TRACE_COLUMNS)
            for sample, contact in zip(self.samples, self.contacts, strict=True):
                felt = (contact.stress, contact.yield_stress, *contact.force.tolist(), contact.moved_mass)
                rows.writerow((sample.time, *sample.position, contact.regime.name.lower(), *felt))

    def render(self, path: Path) -> None:
        """Before and after, side by side, seen from the side that was pushed."""
        try:
            from . import render
        except ImportError as error:
            raise ValueError("--render needs Blender or its bpy package: run this there") from error
        felt = [contact.force for contact in self.contacts if contact.regime is Regime.PLASTIC]
        axes = self.before.transform[:3, :3]
        towards = axes @ np.sum(felt, axis=0) if felt else None
        low, high = (np.array(end) for end in self.dirty or ((0, 0, 0), self.before.shape))
        render.before_after(self.before, self.grid, path, towards, low, high)


def progress(items: Iterable, what: str) -> Iterable:
    """The items, shown going by on a terminal."""
    if not sys.stderr.isatty():
        return items
    try:
        from tqdm import tqdm
    except ImportError:
        return _percentage(list(items), what)
    return tqdm(items, desc=what, unit="step", leave=False)


def _percentage(items: list, what: str) -> Iterator:
    for done, item in enumerate(items):
        print(f"\r{what}: {100 * done // len(items)} %", end="", file=sys.stderr, flush=True)
        yield item
    print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def told_of(stroke: Stroke) -> str:
    """A stroke in a few words, for a file's metadata."""
    start, end = (tuple(round(v, 3) for v in stroke.samples[n].position) for n in (0, -1))
    return f"{stroke.tool.kind} of radius {stroke.tool.radius:g}, {len(stroke.samples)} samples from {start} to {end}"


def summary(report: dict) -> str:
    """A report in one line."""
    ms = report["ms"]
    return (
        f"{report['output']}: {report['steps']} steps moved {report['moved_mass']:.6g} voxels' worth and touched "
        f"{report['touched_voxels']} voxels; mass {report['mass_before']:.10g} -> {report['mass_after']:.10g}, "
        f"{report['mass_out']:.6g} out; peak stress {report['peak_stress']:.4g} N; "
        f"{ms['p50']:.3g} ms a step (p99 {ms['p99']:.3g}, {report['kernels']} kernels)"
    )


def _part(array: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The view of a half-open box."""
    return array[tuple(slice(int(a), int(max(a, b))) for a, b in zip(low, high, strict=True))]
