# SPDX-License-Identifier: GPL-3.0-or-later
"""The headless door: `repousse push|info|convert`, in a shell or as `blender --command repousse ...`.

Bad input is one line on stderr and exit code 2. Outputs appear all together at the end, or not at all.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import sys
import time
import uuid
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..core import PRESETS, Contact, DensityGrid, Regime, Sample, SphereTool, Stroke, native
from ..core.formats import MAX_VOXELS, describe, read_volume, write_volume
from ..core.grid import Box, union
from ..core.native.state import BORDERS
from ..core.push import METHODS
from ..core.stroke import hash_of

EXIT_BAD_INPUT = 2
DEFAULT_STEP = 0.5
VOLUME_SUFFIXES = (".vdb", ".pvm")
TRACE_COLUMNS = ("t", "x", "y", "z", "regime", "stress", "yield_stress", "fx", "fy", "fz", "moved_mass")
LINE_OPTIONS = ("start", "end", "radius", "reach")
"""What draws a line, and so has no place beside a recorded stroke."""


def main(argv: list[str] | None = None) -> int:
    """Run one command (default: of ``sys.argv``). Returns the exit code: 0, or 2 for bad input."""
    try:
        options = _parser().parse_args(_joined(sys.argv[1:] if argv is None else list(argv)))
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: _say(str(message))
            options.run(options)
    except SystemExit as finished:  # --help
        return int(finished.code or 0)
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        return _refuse(what)
    except MemoryError:
        return _refuse("this needs more memory than there is")
    except ValueError as error:
        return _refuse(str(error))
    return 0


# ---- commands


def push(options: argparse.Namespace) -> None:
    """`repousse push`: strokes through a volume, and all that was asked for about it."""
    strokes = strokes_from(options)
    out, picture = _named(options.out, VOLUME_SUFFIXES), options.render and _named(options.render, (".png",))
    with Outputs() as outputs:
        parts = {
            name: outputs.add(path)
            for name, path in (("out", out), ("render", picture), ("report", options.report), ("trace", options.trace))
            if path
        }
        preset = PRESETS.get(options.material)
        grid = open_volume(options.input, options.grid, options.window, preset.density if preset else 1.0)
        for note in grid.notes:
            _say(f"{options.input}: {note}")
        run = Run.of(grid, strokes, options.input)
        report = run.report() | {"input": str(options.input), "output": str(out)}
        grid.metadata["strokes"] = "; ".join(told(stroke) for stroke in strokes)
        write_volume(grid, parts["out"])
        if options.trace:
            run.save_trace(parts["trace"])
        if options.render:
            run.render(parts["render"])
        if options.report:
            parts["report"].write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(summary(report))


def info(options: argparse.Namespace) -> None:
    """`repousse info`: what is in a file, and what would be read of it."""
    if _block(options.input):
        grid = open_volume(options.input)
        print(f"{options.input}: {_by(grid.shape)} voxels, mass {grid.mass:.10g}")
        return
    found = describe(options.input, options.grid, options.window)
    print(f"{found['file']}: {len(found['grids'])} grid(s)")
    for grid in found["grids"]:
        edges = "non-linear" if grid.edges is None else " x ".join(f"{edge:.6g}" for edge in grid.edges)
        unread = "" if grid.readable else ", cannot be sculpted"
        shape = _by(grid.shape) if grid.shape else "?"
        print(f"  {grid.key!r}: {grid.kind}, {grid.value_type}, {shape} voxels of {edges}{unread}")
    if found["values"]:
        print(f"values of {found['grid']!r}: {found['values'][0]:.9g} to {found['values'][1]:.9g}")
    if found["shape"]:
        print(f"density: {_by(found['shape'])} voxels of {found['voxel_size']:.6g}, mass {found['mass']:.10g}")
        for name, value in found["metadata"].items():
            print(f"  {name}: {value}")
    for note in found["notes"]:
        print(f"note: {note}")


def convert(options: argparse.Namespace) -> None:
    """`repousse convert`: a volume of one format written as another."""
    out = _named(options.out, VOLUME_SUFFIXES)
    with Outputs() as outputs:
        part = outputs.add(out)
        grid = open_volume(options.input, options.grid, options.window)
        for note in grid.notes:
            _say(f"{options.input}: {note}")
        write_volume(grid, part, half=options.half, bits=options.bits)
    print(f"{out}: {_by(grid.shape)} voxels of {grid.voxel_size:.6g}, mass {grid.mass:.10g}")


# ---- volumes and strokes from what was typed


def open_volume(
    source: str | os.PathLike, grid: str | None = None, window: tuple[float, float] | None = None, density: float = 1.0
) -> DensityGrid:
    """A volume by file name, or ``block:N[:density]``: a cube of N voxels, of ``density`` where it gives none."""
    block = _block(source)
    if not block:
        return read_volume(source, grid, window)
    edge, filled = int(block[1]), float(block[2]) if block[2] else density
    if not 1 <= edge**3 <= MAX_VOXELS:
        raise ValueError(f"{source}: a block has from 1 to {int(MAX_VOXELS ** (1 / 3))} voxels along an edge")
    if not 0.0 < filled <= 1.0:
        raise ValueError(f"{source}: the density of a block is over 0 and at most 1")
    made = np.full((edge,) * 3, filled, np.float32)
    return DensityGrid(made, metadata={"source": str(source)}, copy=False)


def strokes_from(options: argparse.Namespace) -> list[Stroke]:
    """The strokes that were asked for; options that were given take the place of what a file's header says."""
    header = {
        name: getattr(options, name) for name in ("method", "border", "rim") if getattr(options, name) is not None
    }
    preset = PRESETS.get(options.material)
    if options.material:
        header["material"] = preset.material
    if not options.stroke:
        if options.start is None or options.end is None or options.radius is None:
            raise ValueError("give --stroke FILE, or a line by --from, --to and --radius")
        tool = SphereTool(options.radius, options.reach)
        header |= _band_of(options, tool.radius)
        return [Stroke.line(options.start, options.end, options.step or DEFAULT_STEP, tool=tool, **header)]
    for name in LINE_OPTIONS:
        if getattr(options, name) is not None:
            raise ValueError(f"--{ {'start': 'from', 'end': 'to'}.get(name, name) } has no place beside --stroke")
    strokes = []
    for path in options.stroke:
        stroke = Stroke.load(path)
        if not stroke.samples:
            raise ValueError(f"{path}: the stroke has no poses")
        stroke = replace(stroke, **header, **_band_of(options, stroke.tool.radius))
        strokes.append(stroke if options.step is None else stroke.resample(options.step))
    return strokes


def _band_of(options: argparse.Namespace, radius: float) -> dict[str, float | None]:
    if options.band is not None:
        return {"band": None if options.band == "none" else options.band}
    if options.material:
        share = PRESETS[options.material].band
        return {"band": None if share is None else share * radius}
    return {}


# ---- a push, and what is told of it


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
        push = stroke.push(self.grid)
        for sample in progress(stroke.samples, what):
            began = time.perf_counter()
            contact = push.move_to(sample.position - shift, sample.radius, stroke.continuous)
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


def told(stroke: Stroke) -> str:
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


# ---- outputs


class Outputs:
    """Files that are written under temporary names and appear together when the ``with`` block ends well."""

    def __init__(self) -> None:
        self._parts: dict[Path, Path] = {}

    def add(self, path: str | os.PathLike) -> Path:
        """The temporary name for an output, with its suffix. ValueError where the output could not be made."""
        path = Path(path)
        if path in self._parts:
            raise ValueError(f"{path}: two outputs have this name")
        if path.is_dir():
            raise ValueError(f"{path}: cannot be written: it is a folder")
        part = path.with_name(f".{uuid.uuid4().hex[:8]}.{path.name}")
        with part.open("wb"):  # a folder that is not there or takes no file says so now, not after the work
            self._parts[path] = part
        return part

    def __enter__(self) -> Outputs:
        return self

    def __exit__(self, kind, error, trace) -> None:
        try:
            if kind is None:
                for path, part in self._parts.items():
                    part.replace(path)
        finally:
            for part in self._parts.values():
                with contextlib.suppress(OSError):
                    part.unlink(missing_ok=True)


# ---- the command line


class _OneLineParser(argparse.ArgumentParser):
    """Says what is wrong in one line, and leaves the exit code to `main`."""

    def __init__(self, **settings) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> None:
        raise ValueError(f"{message} (see {self.prog} --help)")


def _parser() -> argparse.ArgumentParser:
    parser = _OneLineParser(prog="repousse", description="Push a tool into a volume that yields and pushes back.")
    commands = parser.add_subparsers(required=True, metavar="push|info|convert", parser_class=_OneLineParser)
    source = "a .vdb or .pvm file, or block:N[:density]"

    def command(name: str, run, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=text)
        made.set_defaults(run=run)
        made.add_argument("input", metavar="IN", help=source)
        made.add_argument("--grid", metavar="NAME", help="which grid of a .vdb: name, name[1] or index")
        made.add_argument(
            "--window", type=_window, metavar="LO:HI", help="the value that becomes density 0, and that which becomes 1"
        )
        return made

    made = command("push", push, "Push strokes through a volume. Coordinates and lengths are in voxels.")
    made.add_argument("--stroke", action="append", metavar="FILE", help="a recorded stroke; may be given several times")
    made.add_argument("--from", dest="start", type=_position, metavar="X,Y,Z", help="where the tool's centre starts")
    made.add_argument("--to", dest="end", type=_position, metavar="X,Y,Z", help="where it ends")
    made.add_argument("--radius", type=_number, metavar="R", help="of the tool, a ball")
    made.add_argument("--reach", type=_number, metavar="S", help="how far from its centre it feels (1.5 R)")
    made.add_argument("--step", type=_number, metavar="H", help=f"between samples ({DEFAULT_STEP})")
    feels = "; ".join(f"{name}: {preset.feel}" for name, preset in PRESETS.items())
    made.add_argument(
        "--material", choices=PRESETS, metavar="NAME", help=f"{feels}. Sets --band, and a block's density"
    )
    made.add_argument("--method", choices=METHODS, help="sweep, or the paper's recursion for small volumes")
    made.add_argument("--border", choices=BORDERS, help="what happens where density would leave the volume (grow)")
    made.add_argument("--band", type=_band, metavar="N", help="how far ahead of the tool material goes, or none")
    made.add_argument("--rim", type=_number, metavar="X", help="width of the rim in contact radii (2)")
    made.add_argument("--out", required=True, metavar="OUT.vdb", help="the sculpted volume")
    made.add_argument("--render", metavar="PNG", help="a picture: before, and after")
    made.add_argument("--report", metavar="JSON", help="what it did, in numbers")
    made.add_argument("--trace", metavar="CSV", help="what the hand would have felt, a line a sample")

    command("info", info, "Tell what is in a volume file.")

    made = command("convert", convert, "Write a volume in another format.")
    made.add_argument("out", metavar="OUT", help="a .vdb or .pvm file")
    made.add_argument("--half", action="store_true", help="a .vdb of half the size: 11 bits instead of 24")
    made.add_argument("--bits", type=int, choices=(8, 16), default=8, help="of a .pvm's voxels (8)")
    return parser


def _joined(words: list[str]) -> list[str]:
    """`--from -20,0,0` as `--from=-20,0,0`, for argparse takes what begins with a minus sign for an option."""
    joined: list[str] = []
    for word in words:
        before = joined[-1] if joined else ""
        if before.startswith("--") and "=" not in before and re.match(r"-(\d|\.|inf|nan)", word, re.IGNORECASE):
            joined[-1] = f"{before}={word}"
        else:
            joined.append(word)
    return joined


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _position(text: str) -> tuple[float, ...]:
    values = tuple(_number(part) for part in text.split(","))
    if len(values) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not a position X,Y,Z")
    return values


def _window(text: str) -> tuple[float, ...]:
    values = tuple(_number(part) for part in text.split(":"))
    if len(values) != 2 or values[0] == values[1]:
        raise argparse.ArgumentTypeError(f"{text!r} is not a window LO:HI with two different ends")
    return values


def _band(text: str) -> float | str:
    return text if text == "none" else _number(text)


def _block(source: str | os.PathLike) -> re.Match | None:
    return re.fullmatch(r"block:(\d{1,4})(?::(\d*\.?\d+))?", str(source))


def _named(path: str, suffixes: tuple[str, ...]) -> Path:
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: cannot be written: its name must end in {' or '.join(suffixes)}")
    return Path(path)


def _part(array: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The view of a half-open box."""
    return array[tuple(slice(int(a), int(max(a, b))) for a, b in zip(low, high, strict=True))]


def _by(shape: Iterable[int]) -> str:
    return " x ".join(map(str, shape))


def _say(text: str) -> None:
    print(f"repousse: {' '.join(text.split())}", file=sys.stderr)


def _refuse(text: str) -> int:
    _say(text)
    return EXIT_BAD_INPUT
