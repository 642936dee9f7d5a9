# SPDX-License-Identifier: GPL-3.0-or-later
"""The headless door: `repousse push|info|convert`, in a shell or as `blender --command repousse ...`.

Bad input is one line on stderr and exit code 2. Outputs appear all together at the end, or not at all.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core import PRESETS, DensityGrid, Material, SphereTool, Stroke
from ..core.formats import MAX_VOXELS, describe, read_volume, write_volume
from ..core.material import EXPONENTS
from ..core.native.state import BORDERS
from ..core.push import METHODS
from ..core.quality import QUALITIES, quality_named
from .outputs import Outputs
from .run import Run, summary, told_of

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
VOLUME_SUFFIXES = (".vdb", ".pvm")
LINE_OPTIONS = ("start", "end", "radius", "reach")
"""What draws a line, and so has no place beside a recorded stroke."""


def main(argv: list[str] | None = None) -> int:
    """Run one command (default: of ``sys.argv``). Returns the exit code: 0, or 2 for bad input."""
    try:
        options = _parser().parse_args(_joined(sys.argv[1:] if argv is None else list(argv)))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            notes = options.run(options)
    except SystemExit as finished:  # --help
        return int(finished.code or 0)
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        return _refuse(what)
    except MemoryError:
        return _refuse("this needs more memory than there is")
    except ValueError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    notes += [str(warning.message) for warning in told if warning.category is UserWarning]
    for note in dict.fromkeys(notes):  # after the work: a failure is one line alone
        _say(note)
    return 0


def push(options: argparse.Namespace) -> list[str]:
    """`repousse push`: strokes through a volume, and all that was asked for about it. Returns what to tell besides."""
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
        run = Run.of(grid, strokes, options.input)
        report = run.report() | {"input": str(options.input), "output": str(out)}
        grid.metadata["strokes"] = "; ".join(told_of(stroke) for stroke in strokes)
        write_volume(grid, parts["out"])
        if options.trace:
            run.save_trace(parts["trace"])
        if options.render:
            run.render(parts["render"])
        if options.report:
            parts["report"].write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(summary(report))
    return _notes(options.input, grid)


def info(options: argparse.Namespace) -> list[str]:
    """`repousse info`: what is in a file, and what would be read of it."""
    if _block(options.input):
        grid = open_volume(options.input)
        print(f"{options.input}: {_by(grid.shape)} voxels, mass {grid.mass:.10g}")
        return []
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
    return []


def convert(options: argparse.Namespace) -> list[str]:
    """`repousse convert`: a volume of one format written as another."""
    out = _named(options.out, VOLUME_SUFFIXES)
    with Outputs() as outputs:
        part = outputs.add(out)
        grid = open_volume(options.input, options.grid, options.window)
        write_volume(grid, part, half=options.half, bits=options.bits)
    print(f"{out}: {_by(grid.shape)} voxels of {grid.voxel_size:.6g}, mass {grid.mass:.10g}")
    return _notes(options.input, grid)


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
    if not options.stroke:
        if options.start is None or options.end is None or options.radius is None:
            raise ValueError("give --stroke FILE, or a line by --from, --to and --radius")
        tool = SphereTool(options.radius, options.reach)
        header |= {"material": _material_of(options, Material())} | _band_of(options, tool.radius)
        quality = quality_named(options.quality or "exact")
        step = quality.longest_step if options.step is None else options.step
        return [Stroke.line(options.start, options.end, step, tool=tool, **header).at_quality(quality.name)]
    for name in LINE_OPTIONS:
        if getattr(options, name) is not None:
            raise ValueError(f"--{ {'start': 'from', 'end': 'to'}.get(name, name) } has no place beside --stroke")
    strokes = []
    for path in options.stroke:
        stroke = Stroke.load(path)
        if not stroke.samples:
            raise ValueError(f"{path}: the stroke has no poses")
        material = _material_of(options, stroke.material)
        stroke = replace(stroke, material=material, **header, **_band_of(options, stroke.tool.radius))
        stroke = stroke if options.quality is None else stroke.at_quality(options.quality)
        strokes.append(stroke if options.step is None else stroke.resample(options.step))
    return strokes


def _material_of(options: argparse.Namespace, given: Material) -> Material:
    material = PRESETS[options.material].material if options.material else given
    return material if options.exponent is None else replace(material, exponent=options.exponent)


def _band_of(options: argparse.Namespace, radius: float) -> dict[str, float | None]:
    if options.band is not None:
        return {"band": None if options.band == "none" else options.band}
    if options.material:
        share = PRESETS[options.material].band
        return {"band": None if share is None else share * radius}
    return {}


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
    made.add_argument("--step", type=_number, metavar="H", help="between samples (0.5, of a draft 1)")
    feels = "; ".join(f"{name}: {preset.feel}" for name, preset in PRESETS.items())
    made.add_argument(
        "--material", choices=PRESETS, metavar="NAME", help=f"{feels}. Sets --band, and a block's density"
    )
    low, high = EXPONENTS
    made.add_argument(
        "--exponent",
        type=_number,
        metavar="M",
        help=f"force grows as the material in the tool to this power, {low:g} to {high:g} (1, the paper's)",
    )
    made.add_argument("--method", choices=METHODS, help="sweep, or the paper's recursion for small volumes")
    made.add_argument("--border", choices=BORDERS, help="what happens where density would leave the volume (grow)")
    made.add_argument("--band", type=_band, metavar="N", help="how far ahead of the tool material goes, or none")
    made.add_argument("--rim", type=_number, metavar="X", help="width of the rim in contact radii (2)")
    made.add_argument(
        "--quality", type=_quality, metavar="Q", help=f"{', '.join(QUALITIES)}; of a recorded stroke what it says"
    )
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


def _quality(text: str) -> str:
    if text == "auto":
        raise argparse.ArgumentTypeError("auto goes by the clock of a live stroke: here choose " + ", ".join(QUALITIES))
    try:
        return quality_named(text).name
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _block(source: str | os.PathLike) -> re.Match | None:
    return re.fullmatch(r"block:(\d{1,4})(?::(\d*\.?\d+))?", str(source))


def _named(path: str, suffixes: tuple[str, ...]) -> Path:
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: cannot be written: its name must end in {' or '.join(suffixes)}")
    return Path(path)


def _notes(source: str, grid: DensityGrid) -> list[str]:
    return [f"{source}: {note}" for note in grid.notes]


def _by(shape: Iterable[int]) -> str:
    return " x ".join(map(str, shape))


def _say(text: str) -> None:
    print(f"repousse: {' '.join(text.split())}", file=sys.stderr)


def _refuse(text: str) -> int:
    _say(text)
    return EXIT_BAD_INPUT
