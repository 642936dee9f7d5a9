# SPDX-License-Identifier: GPL-3.0-or-later
"""The headless door, in this process and as a program: what it writes, what it says, and what it refuses."""

import csv
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core import PRESETS, DensityGrid, Material, Push, Sample, SphereTool, Stroke
from repousse.core.formats import read_volume, write_volume
from repousse.operators import cli

LINE = ["--from", "16,16,38", "--to", "16,16,28", "--radius", "5"]
REPORT_KEYS = {
    *("steps", "mass_before", "mass_after", "mass_out", "moved_mass", "peak_stress", "kernels", "method", "ms"),
    "touched_voxels",
    "quality",
}


@pytest.fixture
def program():
    """The command as a user types it: the console script beside the wheel, or a real Blender's."""
    if bpy.app.module:
        script = Path(sys.executable).with_name("repousse")
        return [str(script)] if script.exists() else [sys.executable, "-m", "repousse.operators.cli"]
    return [bpy.app.binary_path, "--command", "repousse"]


@pytest.fixture
def clay():
    """What LINE does to block:32, by core alone."""
    grid = DensityGrid(np.ones((32, 32, 32)))
    push = Push(grid, SphereTool(5.0), Material())
    contacts = push.follow(Stroke.line((16, 16, 38), (16, 16, 28)))
    return grid, contacts


def run(capfd, *words):
    """Exit code, lines on stdout, lines on stderr."""
    capfd.readouterr()
    code = cli.main([str(word) for word in words])
    told = capfd.readouterr()
    return code, told.out.splitlines(), told.err.splitlines()


def test_push_does_what_core_does_to_the_bit(tmp_path, capfd, clay):
    grid, contacts = clay
    out, report, trace = tmp_path / "o.vdb", tmp_path / "o.json", tmp_path / "o.csv"
    code, said, noted = run(capfd, "push", "block:32", *LINE, "--out", out, "--report", report, "--trace", trace)
    assert (code, len(said), noted) == (0, 1, [])
    assert {path.name for path in tmp_path.iterdir()} == {"o.vdb", "o.json", "o.csv"}
    sculpted = read_volume(out)
    assert sculpted.density.tobytes() == grid.density.tobytes()
    assert np.array_equal(sculpted.transform, grid.transform)
    assert "radius 5" in sculpted.metadata["strokes"]

    told = json.loads(report.read_text())
    assert set(told) >= REPORT_KEYS
    assert set(told["ms"]) == {"p50", "p99", "max"}
    assert 0.0 < told["ms"]["p50"] <= told["ms"]["p99"] <= told["ms"]["max"]
    assert told["steps"] == len(contacts) == 21 and told["quality"] == "exact"
    assert told["mass_before"] == 32**3
    assert told["mass_after"] == pytest.approx(32**3, rel=1e-7)
    assert told["moved_mass"] == pytest.approx(sum(contact.moved_mass for contact in contacts))
    assert told["peak_stress"] == max(contact.stress for contact in contacts)
    before = np.zeros(grid.shape, np.float32)
    low = -grid.transform[:3, 3].astype(int)
    before[tuple(slice(a, a + 32) for a in low)] = 1.0
    assert told["touched_voxels"] == np.count_nonzero(grid.density != before) > 0

    rows = list(csv.reader(trace.read_text().splitlines()))
    assert rows[0] == ["t", "x", "y", "z", "regime", "stress", "yield_stress", "fx", "fy", "fz", "moved_mass"]
    assert len(rows) == 1 + 21
    assert [row[4] for row in rows[1:]] == [contact.regime.value for contact in contacts]
    last = dict(zip(rows[0], rows[-1], strict=True))
    assert [float(last[axis]) for axis in "xyz"] == [16, 16, 28]
    felt = math.hypot(*(float(last[axis]) for axis in ("fx", "fy", "fz")))
    assert felt == pytest.approx(min(float(last["stress"]), float(last["yield_stress"])), rel=1e-6)


def test_the_exponent_changes_what_is_felt_and_no_voxel(tmp_path, capfd, clay):
    """Of a line, with a material and without, and of a recorded stroke, whose own it takes the place of."""
    grid, contacts = clay
    Stroke.line((16, 16, 38), (16, 16, 28), tool=SphereTool(5.0), material=Material(exponent=0.75)).save(
        tmp_path / "s.jsonl"
    )
    as_before = [contact.stress for contact in contacts]

    def pushed(*words):
        out, report, trace = tmp_path / "o.vdb", tmp_path / "o.json", tmp_path / "o.csv"
        words = ("push", "block:32", *words, "--out", out, "--report", report, "--trace", trace)
        assert run(capfd, *words)[0] == 0
        rows = list(csv.DictReader(trace.read_text().splitlines()))
        stress = [float(row["stress"]) for row in rows]
        assert json.loads(report.read_text())["peak_stress"] == max(stress)
        for row in rows:
            felt = math.hypot(*(float(row[axis]) for axis in ("fx", "fy", "fz")))
            assert felt == pytest.approx(min(float(row["stress"]), float(row["yield_stress"])), rel=1e-6, abs=1e-12)
        return read_volume(out).density.tobytes(), stress

    assert pushed(*LINE, "--exponent", 1) == (grid.density.tobytes(), as_before)
    stroke = ["--stroke", tmp_path / "s.jsonl"]
    for m, words in (
        (0.5, [*LINE, "--exponent", 0.5]),
        (0.75, stroke),
        (0.5, [*stroke, "--exponent", 0.5]),
        (1.5, [*stroke, "--exponent", 1.5]),
    ):
        voxels, stress = pushed(*words)
        assert voxels == grid.density.tobytes()
        assert stress == [Material(exponent=m).felt(newtons)[0] for newtons in as_before]
    _, foam = pushed(*LINE, "--material", "foam")
    _, firmer = pushed(*LINE, "--material", "foam", "--exponent", 0.5)
    law = replace(PRESETS["foam"].material, exponent=0.5)
    assert firmer == [law.felt(newtons)[0] for newtons in foam] != foam


@pytest.mark.parametrize("exponent", ["0.4", "2", "-1", "nan", "firm"])
def test_an_exponent_out_of_range_is_refused_in_one_line(tmp_path, capfd, exponent):
    code, said, noted = run(capfd, "push", "block:32", *LINE, "--exponent", exponent, "--out", tmp_path / "o.vdb")
    assert (code, said, len(noted)) == (2, [], 1) and "exponent" in noted[0]
    assert not list(tmp_path.iterdir())


def test_several_strokes_count_from_the_volume_that_was_given(tmp_path, capfd, clay):
    """The first makes the grid grow; the second still goes where it says."""
    lines = [((16, 16, 16), (4, 16, 16)), ((20, 16, 38), (20, 16, 28))]
    grid = DensityGrid(np.ones((32, 32, 32)))
    origin = np.zeros(3)
    words = []
    for n, (start, end) in enumerate(lines):
        stroke = Stroke.line(start, end, tool=SphereTool(5.0))
        stroke.save(tmp_path / f"{n}.jsonl")
        words += ["--stroke", tmp_path / f"{n}.jsonl"]
        push = stroke.push(grid)
        push.follow(Stroke.line(start - origin, end - origin, tool=SphereTool(5.0)))
        origin += push.origin
        assert n or any(origin)
    assert run(capfd, "push", "block:32", *words, "--out", tmp_path / "o.vdb")[0] == 0
    sculpted = read_volume(tmp_path / "o.vdb")
    assert sculpted.density.tobytes() == grid.density.tobytes()
    assert np.array_equal(sculpted.transform, grid.transform)


def test_a_stroke_that_began_on_the_grown_grid_counts_from_that(tmp_path, capfd):
    grid = DensityGrid(np.ones((32, 32, 32)))
    first = Stroke.line((16, 16, 16), (4, 16, 16), tool=SphereTool(5.0))
    first.save(tmp_path / "0.jsonl")
    push = first.push(grid)
    push.follow(first)
    second = Stroke.line((24, 24, 42), (24, 24, 32), tool=SphereTool(5.0)).began_on(grid)
    second.save(tmp_path / "1.jsonl")
    assert push.origin != (0, 0, 0)
    second.push(grid).follow(second)
    words = ["--stroke", tmp_path / "0.jsonl", "--stroke", tmp_path / "1.jsonl"]
    assert run(capfd, "push", "block:32", *words, "--out", tmp_path / "o.vdb")[0] == 0
    assert read_volume(tmp_path / "o.vdb").density.tobytes() == grid.density.tobytes()


@pytest.mark.parametrize("verb", ["push", "pull", "smooth"])
def test_replays_verbs_and_mirrors(tmp_path, capfd, verb):
    """After a stroke that made the grid grow: direction, strength and mirror are those of the volume that was given."""
    first = Stroke.line((16, 16, 16), (4, 16, 16), tool=SphereTool(5.0))
    flow = None if verb == "push" else (0.0, 0.0, 1.0)
    samples = [Sample(0.0, (9.0 + 0.4 * n, 12.0, 19.0), direction=flow, strength=0.5) for n in range(8)]
    second = Stroke(samples, SphereTool(4.0), verb=verb, symmetry="xy", mirror=(15.5, 15.5, 15.5))
    grid = DensityGrid(np.full((32, 32, 32), 0.8))
    push = first.push(grid)
    push.follow(first)
    assert push.origin != (0, 0, 0)
    grown = second.moved_by(-np.array(push.origin))
    contacts = grown.push(grid).follow(grown)
    assert sum(contact.moved_mass for contact in contacts) > 10.0
    words = []
    for n, stroke in enumerate((first, second)):
        stroke.save(tmp_path / f"{n}.jsonl")
        words += ["--stroke", tmp_path / f"{n}.jsonl"]
    assert run(capfd, "push", "block:32:0.8", *words, "--out", tmp_path / "o.vdb")[0] == 0
    assert read_volume(tmp_path / "o.vdb").density.tobytes() == grid.density.tobytes()


@pytest.mark.parametrize(
    ("words", "header"),
    [
        (["--material", "clay"], {"band": 5.0, "material": cli.PRESETS["clay"].material}),
        (["--material", "wax"], {"band": 2.5}),
        (["--material", "foam"], {"band": None}),
        (["--material", "clay", "--band", "none"], {"band": None}),
        (["--band", "7.5", "--rim", "3"], {"band": 7.5, "rim": 3.0}),
        (["--border", "open", "--method", "recursive"], {"border": "open", "method": "recursive"}),
        (["--reach", "9"], {"tool": SphereTool(5.0, 9.0)}),
        ([], {"band": None, "material": Material(), "border": "grow", "method": "sweep", "rim": 2.0}),
    ],
)
def test_options_become_the_stroke(words, header):
    options = cli._parser().parse_args(cli._joined(["push", "block:8", *LINE, *words, "--out", "o.vdb"]))
    [stroke] = cli.strokes_from(options)
    assert {name: getattr(stroke, name) for name in header} == header
    assert len(stroke.samples) == 21


def test_a_recorded_stroke_keeps_its_header_unless_told_otherwise(tmp_path):
    path = tmp_path / "s.jsonl"
    Stroke.line((0, 0, 0), (4, 0, 0), tool=SphereTool(3.0), band=1.5, border="wall").save(path)
    for words, band, border, samples in ([], 1.5, "wall", 9), (["--band", "2", "--step", "1"], 2.0, "wall", 5):
        options = cli._parser().parse_args(["push", "block:8", "--stroke", str(path), *words, "--out", "o.vdb"])
        [stroke] = cli.strokes_from(options)
        assert (stroke.band, stroke.border, len(stroke.samples)) == (band, border, samples)


def test_quality_is_the_strokes_own_unless_told_otherwise(tmp_path, capfd):
    """A line of a draft has a sample a voxel; a recorded stroke, whoever chose, keeps what was chosen pose by pose."""
    block, ends = ["push", "block:32", "--band", "5"], {}
    for quality, steps in (("exact", 21), ("balanced", 21), ("draft", 11)):
        report, out = tmp_path / f"{quality}.json", tmp_path / f"{quality}.vdb"
        words = [*block, *LINE, "--quality", quality, "--report", report, "--out", out]
        assert run(capfd, *words)[0] == 0
        told = json.loads(report.read_text())
        assert (told["quality"], told["steps"]) == (quality, steps)
        ends[quality] = read_volume(out).density.tobytes()
    assert len(set(ends.values())) == 3
    stroke = Stroke.line((16, 16, 38), (16, 16, 28), tool=SphereTool(5.0))
    mixed = [replace(s, quality=("exact", "draft")[n % 2]) for n, s in enumerate(stroke.samples)]
    replace(stroke, samples=mixed).save(tmp_path / "mixed.jsonl")
    report, out = tmp_path / "o.json", tmp_path / "o.vdb"
    words = [*block, "--stroke", tmp_path / "mixed.jsonl", "--report", report, "--out", out]
    assert run(capfd, *words)[0] == 0
    assert json.loads(report.read_text())["quality"] == "exact, draft"
    assert run(capfd, *words, "--quality", "exact")[0] == 0
    assert json.loads(report.read_text())["quality"] == "exact"
    assert read_volume(out).density.tobytes() == ends["exact"]


def test_values_may_begin_with_a_minus_sign(tmp_path, capfd):
    line = ["--from", "-6,-.5,8", "--to", "-5,0,8", "--radius", "3"]
    code, _, noted = run(capfd, "push", "block:16", *line, "--trace", tmp_path / "o.csv", "--out", tmp_path / "o.vdb")
    assert (code, noted) == (0, [])
    assert (tmp_path / "o.csv").read_text().splitlines()[1].startswith("0.0,-6.0,-0.5,8.0,none,")
    assert cli._joined(["--window", "-1000:400", "--half", "x"]) == ["--window=-1000:400", "--half", "x"]


def test_blocks_have_the_density_that_is_asked_for():
    assert cli.open_volume("block:4:0.25").mass == 16.0
    assert cli.open_volume("block:4", density=0.5).mass == 32.0
    assert cli.open_volume("block:4:1", density=0.5).mass == 64.0


def test_info_and_convert_tell_and_keep_what_is_in_a_file(tmp_path, capfd):
    steps = np.linspace(0.0, 1.0, 5 * 6 * 7).reshape(5, 6, 7)
    write_volume(DensityGrid(steps, np.diag([0.5, 0.5, 0.5, 1.0])), tmp_path / "a.vdb")
    code, said, noted = run(capfd, "info", tmp_path / "a.vdb")
    assert (code, noted) == (0, [])
    assert any("5 x 6 x 7 voxels of 0.5" in line and "mass 105" in line for line in said)
    assert run(capfd, "convert", tmp_path / "a.vdb", tmp_path / "b.pvm", "--bits", 16)[0] == 0
    code, _, noted = run(capfd, "convert", tmp_path / "b.pvm", tmp_path / "c.vdb", "--window", "0:65535")
    assert code == 0 and "window 0:65535" in noted[0]
    assert np.abs(read_volume(tmp_path / "c.vdb").density - steps).max() < 1e-5


BAD = {
    "no file": (["push", "{tmp}/none.pvm", *LINE], "none.pvm: cannot be read"),
    "random bytes": (["push", "{tmp}/noise.vdb", *LINE], "noise.vdb: is neither"),
    "no such grid": (["push", "{tmp}/sound.vdb", *LINE, "--grid", "heat"], "sound.vdb: has no grid 'heat'"),
    "an empty block": (["push", "block:0", *LINE], "block:0: "),
    "a block too large": (["push", "block:5000", *LINE], "block:5000: "),
    "density over one": (["push", "block:8:2", *LINE], "block:8:2: "),
    "no line": (["push", "block:8"], "--stroke FILE, or a line by --from, --to and --radius"),
    "half a line": (["push", "block:8", "--from", "1,2,3", "--radius", "4"], "--from, --to and --radius"),
    "no number": (["push", "block:8", "--from", "1,2,x", "--to", "0,0,0", "--radius", "4"], "'x' is not a finite"),
    "two numbers": (["push", "block:8", "--from", "1,2", "--to", "0,0,0", "--radius", "4"], "'1,2' is not a position"),
    "not a number": (["push", "block:8", "--from", "nan,2,3", "--to", "0,0,0", "--radius", "4"], "'nan' is not"),
    "infinite": (["push", "block:8", "--from", "-inf,2,3", "--to", "0,0,0", "--radius", "4"], "'-inf' is not"),
    "radius": (["push", "block:8", *LINE[:4], "--radius", "0.5"], "at least one voxel, not 0.5"),
    "reach": (["push", "block:8", *LINE, "--reach", "5"], "reach must be larger"),
    "step": (["push", "block:8", *LINE, "--step", "0"], "step"),
    "band": (["push", "block:8", *LINE, "--band", "-1"], "band"),
    "material": (["push", "block:8", *LINE, "--material", "jelly"], "jelly"),
    "quality": (
        ["push", "block:8", *LINE, "--quality", "best"],
        'no quality "best": choose from exact, balanced, draft',
    ),
    "auto": (["push", "block:8", *LINE, "--quality", "auto"], "clock of a live stroke: here choose exact, balanced"),
    "window": (["push", "{tmp}/sound.vdb", *LINE, "--window", "3:3"], "'3:3' is not a window"),
    "no such option": (["push", "block:8", *LINE, "--colour", "red"], "--colour"),
    "no such command": (["pull", "block:8"], "pull"),
    "no stroke": (["push", "block:8", "--stroke", "{tmp}/none.jsonl"], "none.jsonl: "),
    "no poses": (["push", "block:8", "--stroke", "{tmp}/noise.vdb"], "noise.vdb, line 1: "),
    "stroke and line": (["push", "block:8", "--stroke", "{tmp}/s.jsonl", "--from", "0,0,0"], "--from has no place"),
    "no such folder": (["push", "block:8", *LINE, "--out", "{tmp}/none/o.vdb"], "none/o.vdb: cannot be written"),
    "no such format": (["push", "block:8", *LINE, "--out", "{tmp}/o.obj"], "o.obj: cannot be written"),
    "one name twice": (["push", "block:8", *LINE, "--trace", "{tmp}/o.vdb"], "o.vdb: two outputs"),
}


def made_bad(tmp_path, words):
    """The words with every output asked for, and the files they speak of."""
    (tmp_path / "noise.vdb").write_bytes(np.random.default_rng(1).bytes(5000))
    write_volume(DensityGrid(np.ones((4, 4, 4))), tmp_path / "sound.vdb")
    Stroke.line((0, 0, 0), (1, 0, 0)).save(tmp_path / "s.jsonl")
    words = [word.replace("{tmp}", str(tmp_path)) for word in words]
    for option, name in ("--out", "o.vdb"), ("--report", "o.json"), ("--trace", "o.csv"), ("--render", "o.png"):
        if option not in words:
            words += [option, str(tmp_path / name)]
    return words


@pytest.mark.parametrize(("words", "what"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_no_file(tmp_path, capfd, words, what):
    words = made_bad(tmp_path, list(words))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    code, said, noted = run(capfd, *words)
    assert (code, said, len(noted)) == (2, [], 1)
    assert noted[0].startswith("repousse: ") and what in noted[0]
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_failure_at_the_end_takes_back_what_was_written(tmp_path, capfd, monkeypatch):
    """A result of an earlier run stays as it was."""
    (tmp_path / "o.vdb").write_bytes(b"earlier")

    def full(*_):
        raise OSError(28, "No space left on device", "o.csv")

    monkeypatch.setattr(cli.Run, "save_trace", full)
    words = ["--out", tmp_path / "o.vdb", "--trace", tmp_path / "o.csv"]
    code, _, noted = run(capfd, "push", "block:16", *LINE, *words)
    assert (code, noted) == (2, ["repousse: o.csv: No space left on device"])
    assert [path.name for path in tmp_path.iterdir()] == ["o.vdb"]
    assert (tmp_path / "o.vdb").read_bytes() == b"earlier"


def test_program_pushes_and_keeps_its_exit_code(tmp_path, program, clay):
    words = ["push", "block:32", *LINE, "--out", str(tmp_path / "o.vdb")]
    done = subprocess.run([*program, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert read_volume(tmp_path / "o.vdb").density.tobytes() == clay[0].density.tobytes()
    (tmp_path / "noise.vdb").write_bytes(b"noise" * 100)
    words[1], words[-1] = str(tmp_path / "noise.vdb"), str(tmp_path / "p.vdb")
    done = subprocess.run([*program, *words], capture_output=True, text=True)
    assert done.returncode == 2
    said = [line for line in done.stderr.splitlines() if line.startswith("repousse: ")]
    assert len(said) == 1 and "noise.vdb" in said[0]
    assert not bpy.app.module or done.stderr.splitlines() == said
    assert {path.name for path in tmp_path.iterdir()} == {"o.vdb", "noise.vdb"}


def test_render_shows_the_dent_beside_the_block_and_leaves_the_file_alone(tmp_path, capfd, monkeypatch):
    from repousse.operators import render

    monkeypatch.setattr(render, "SIZE", (96, 80))
    monkeypatch.setattr(render, "SAMPLES", 4)
    blocks = {name: len(getattr(bpy.data, name)) for name in dir(bpy.data) if hasattr(getattr(bpy.data, name), "new")}
    words = ["--out", tmp_path / "o.vdb", "--render", tmp_path / "o.png"]
    assert run(capfd, "push", "block:32", *LINE, *words)[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {"o.vdb", "o.png"}
    assert {name: len(getattr(bpy.data, name)) for name in blocks} == blocks
    pixels = render._pixels_of(tmp_path / "o.png")
    assert pixels.shape == (80, 192, 4)
    change = np.abs(pixels[:, :96, :3] - pixels[:, 96:, :3]).max(axis=2) > 0.08
    assert 0.005 < change.mean() < 0.5  # a dent, and not another picture
    assert np.abs(pixels[:, :, 0] - pixels[:, :, 2]).max() > 0.2  # clay in front of grey
