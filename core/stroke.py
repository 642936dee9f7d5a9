# SPDX-License-Identifier: GPL-3.0-or-later
"""Stroke: the path of a tool as it was solved, and all that is needed to walk it again to the same voxels.

A file is JSON lines: a header, then a line for each pose. Replay follows the poses, never the clock.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import dist
from pathlib import Path
from typing import Any

import numpy as np

from .grid import DensityGrid
from .material import Material
from .push import Push
from .quality import LONGEST_STEP, quality_named
from .symmetry import SymmetricPush
from .tool import BoxTool, CapsuleTool, SphereTool, Tool, Vector, unit, vector

SCHEMA = 1
PACE = 100.0
"""Voxels a second at which a drawn line is taken to be walked."""
MOST_SAMPLES = 10_000_000
"""A file with more poses than this is refused: hours of an arm at 1 kHz."""

_TOOLS = {tool.kind: tool for tool in (SphereTool, BoxTool, CapsuleTool)}


@dataclass(frozen=True)
class Sample:
    """One pose: seconds since the stroke began, voxels, a unit quaternion (w, x, y, z), and how it was solved.

    ``radius`` is the tool's in voxels; None leaves it as it is. ``direction`` is the unit vector along which material
    flows, None the displacement; ``strength``, from 0 to 1, is what pulling and smoothing work with, None is 1;
    ``quality`` is what the step to it may cost (core/quality.py).
    """

    time: float
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    radius: float | None = None
    quality: str = "exact"
    direction: Vector | None = None
    strength: float | None = None


@dataclass
class Stroke:
    """A recorded or drawn path, with the tool and material that walked it.

    ``voxel_size`` is in world units and ``grid_hash`` that of the grid it began on, both None when it is drawn for any
    grid. ``continuous``: jumps are moves. ``symmetry`` names the axes that are mirrored, such as "xy", at planes which
    meet in ``mirror`` (voxels). The other fields are :class:`Push`'s.
    """

    samples: list[Sample] = field(default_factory=list)
    tool: Tool = field(default_factory=lambda: SphereTool(16.0))
    material: Material = field(default_factory=Material)
    method: str = "sweep"
    border: str = "grow"
    band: float | None = None
    rim: float = 2.0
    wake: float = 1.0
    verb: str = "push"
    symmetry: str = ""
    mirror: Vector | None = None
    continuous: bool = False
    voxel_size: float | None = None
    grid_hash: str | None = None

    @classmethod
    def line(cls, start: Iterable[float], end: Iterable[float], step: float = LONGEST_STEP, **header: Any) -> Stroke:
        """A straight path from ``start`` to ``end`` (voxels), a sample every ``step`` voxels and one at the end.

        ``header`` are further fields of the stroke.
        """
        if not (np.isfinite(step) and step > 0.0):
            raise ValueError(f"the step is a positive number of voxels, not {step:g}")
        begin, finish = vector(start), vector(end)
        if not np.isfinite((begin, finish)).all():
            raise ValueError(f"a line runs between finite positions, not from {start} to {end}")
        samples = [Sample(0.0, begin), Sample(dist(begin, finish) / PACE, finish)]
        return cls(samples, **header).resample(step)

    def resample(self, step: float) -> Stroke:
        """The same path with a sample every ``step`` voxels of its length, and its two ends."""
        if not (np.isfinite(step) and step > 0.0):
            raise ValueError(f"the step is a positive number of voxels, not {step:g}")
        if len(self.samples) < 2:
            return dataclasses.replace(self, samples=list(self.samples))
        positions = np.array([s.position for s in self.samples], dtype=np.float64)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
        steps = max(1, int(np.ceil(length[-1] / step - 1e-9)))
        if steps > MOST_SAMPLES:
            raise ValueError(f"a step of {step:g} voxels makes {steps} samples: take a longer one")
        wanted = np.linspace(0.0, length[-1], steps + 1)
        times = np.interp(wanted, length, [s.time for s in self.samples])
        path = np.stack([np.interp(wanted, length, positions[:, a]) for a in range(3)], axis=1)
        nearest = np.searchsorted(length, wanted, side="right") - 1
        samples = [
            dataclasses.replace(self.samples[n], time=float(t), position=tuple(p))
            for n, t, p in zip(np.clip(nearest, 0, len(self.samples) - 1), times, path.tolist(), strict=True)
        ]
        return dataclasses.replace(self, samples=samples)

    def at_quality(self, quality: str) -> Stroke:
        """The same stroke with another quality at every pose."""
        name = quality_named(quality).name
        return dataclasses.replace(self, samples=[dataclasses.replace(s, quality=name) for s in self.samples])

    def push(self, grid: DensityGrid) -> Push | SymmetricPush:
        """A push as the header says, on a grid."""
        how = (self.tool, self.material, self.method, self.border, self.band, self.rim, self.wake, self.verb)
        if not self.symmetry:
            return Push(grid, *how)
        if self.mirror is None:
            raise ValueError(f'a stroke with the symmetry "{self.symmetry}" needs a mirror: the point to mirror at')
        return SymmetricPush(grid, *how, axes=self.symmetry, centre=self.mirror)

    def moved_by(self, offset: Iterable[float]) -> Stroke:
        """The same stroke ``offset`` voxels (x, y, z) away."""
        i, j, k = vector(offset)

        def there(place: Vector) -> Vector:
            return place[0] + i, place[1] + j, place[2] + k

        samples = [dataclasses.replace(sample, position=there(sample.position)) for sample in self.samples]
        mirror = None if self.mirror is None else there(self.mirror)
        return dataclasses.replace(self, samples=samples, mirror=mirror)

    def began_on(self, grid: DensityGrid) -> Stroke:
        """The same stroke, told which grid it begins on."""
        return dataclasses.replace(self, voxel_size=grid.voxel_size, grid_hash=hash_of(grid))

    def to_text(self) -> str:
        """What the stroke's file holds."""
        tool = {"kind": self.tool.kind, **vars(self.tool)}
        header = {"repousse_stroke": SCHEMA, "tool": tool, "material": vars(self.material)}
        header |= {name: getattr(self, name) for name in _HEADER}
        lines = [json.dumps(header)] + [json.dumps(_record_of(s)) for s in self.samples]
        return "\n".join(lines) + "\n"

    def save(self, path: str | os.PathLike) -> None:
        """Write the file, whole or not at all."""
        path = Path(path)
        unfinished = path.with_name(path.name + f".{os.getpid()}.part")
        try:
            unfinished.write_text(self.to_text(), encoding="utf-8")
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)

    @classmethod
    def from_lines(cls, lines: Iterable[str], name: str) -> Stroke:
        """Read the lines of a file; ``name`` is what an error calls it.

        Raises ValueError with one line that names the file, the line and what is wrong.
        """
        number, rest = 0, iter(lines)
        try:
            stroke = _stroke_from(_record(next(rest, "")))
            for number, line in enumerate(rest, start=1):
                if number > MOST_SAMPLES:
                    raise ValueError(f"more than {MOST_SAMPLES} poses")
                stroke.samples.append(_sample_from(_record(line)))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            reason = f"there is no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
            raise ValueError(f"{name}, line {number + 1}: {reason}") from error
        return stroke

    @classmethod
    def load(cls, path: str | os.PathLike) -> Stroke:
        """Read a file. Raises ValueError as :meth:`from_lines`, and OSError when the file cannot be read."""
        with open(path, encoding="utf-8") as lines:
            return cls.from_lines(lines, str(path))


_HEADER = (
    *("method", "border", "band", "rim", "wake", "verb", "symmetry", "mirror", "continuous", "voxel_size", "grid_hash"),
)
_ONLY_IF_GIVEN = ("direction", "strength")
"""Fields of a sample that are written only where they say something."""


def hash_of(grid: DensityGrid) -> str:
    """A hash of a grid's shape and density, 32 hexadecimal digits."""
    digest = hashlib.blake2b(str(grid.shape).encode(), digest_size=16)
    digest.update(grid.density.data)
    return digest.hexdigest()


def _record(line: str) -> dict:
    record = json.loads(line)
    if not isinstance(record, dict):
        raise ValueError("not a record in braces")
    return record


def _record_of(sample: Sample) -> dict:
    record = dataclasses.asdict(sample)
    return {name: value for name, value in record.items() if value is not None or name not in _ONLY_IF_GIVEN}


def _numbers(record: dict, name: str, count: int) -> list[float]:
    values = [float(v) for v in record[name]]
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{name} is {count} finite numbers")
    return values


def _sample_from(record: dict) -> Sample:
    radius = record.get("radius")
    radius = None if radius is None else float(radius)
    if radius is not None and not (np.isfinite(radius) and radius >= 1.0):
        raise ValueError(f"the radius must be at least one voxel, not {radius:g}")
    time = float(record.get("time", 0.0))
    if not np.isfinite(time):
        raise ValueError("time is a finite number of seconds")
    w, x, y, z = _numbers(record, "rotation", 4) if "rotation" in record else (1.0, 0.0, 0.0, 0.0)
    position = vector(_numbers(record, "position", 3))
    direction, strength = record.get("direction"), record.get("strength")
    direction = None if direction is None else unit(direction)
    strength = None if strength is None else float(strength)
    if strength is not None and not 0.0 <= strength <= 1.0:
        raise ValueError(f"the strength is a number from 0 to 1, not {strength:g}")
    quality = quality_named(record.get("quality", "exact")).name
    return Sample(time, position, (w, x, y, z), radius, quality, direction, strength)


def _stroke_from(record: dict) -> Stroke:
    schema = record.get("repousse_stroke")
    if schema != SCHEMA:
        raise ValueError(f"not a Repoussé stroke of version {SCHEMA}")
    tool = dict(record["tool"])
    kind = tool.pop("kind", None)
    if kind not in _TOOLS:
        raise ValueError(f'there is no tool "{kind}": choose from {", ".join(_TOOLS)}')
    header = {name: record[name] for name in _HEADER if name in record}
    if header.get("mirror") is not None:
        header["mirror"] = vector(_numbers(record, "mirror", 3))
    return Stroke(tool=_TOOLS[kind](**tool), material=Material(**record["material"]), **header)
