# SPDX-License-Identifier: GPL-3.0-or-later
"""Strokes: what is saved is what is loaded, a replay leads to the same voxels, and a hostile file is refused."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from repousse.core import BoxTool, CapsuleTool, DensityGrid, Material, Push, Sample, SphereTool, Stroke
from repousse.core.stroke import hash_of
from repousse.core.tool import unit

from .volumes import half_space

finite = st.floats(-1e6, 1e6)
sizes = st.floats(1.0, 100.0)
vectors = st.tuples(finite, finite, finite)
samples = st.builds(
    Sample,
    time=finite,
    position=vectors,
    rotation=st.tuples(finite, finite, finite, finite),
    radius=st.none() | sizes,
    quality=st.sampled_from(["exact", "balanced", "draft"]),
    direction=st.none() | st.sampled_from([(0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.36, 0.48, 0.8)]),
    strength=st.none() | st.floats(0.0, 1.0),
)
tools = st.one_of(
    sizes.map(SphereTool),
    st.builds(lambda r, more: SphereTool(r, r + more), sizes, sizes),
    st.builds(BoxTool, st.tuples(sizes, sizes, sizes), sizes),
    st.builds(lambda axis, r, more: CapsuleTool(axis, r, r + more), vectors, sizes, sizes),
)
strokes = st.builds(
    Stroke,
    samples=st.lists(samples, max_size=6),
    tool=tools,
    material=st.builds(Material, st.floats(0.01, 100.0), st.floats(1e-6, 1.0)),
    method=st.sampled_from(["sweep", "recursive"]),
    border=st.sampled_from(["grow", "wall", "open"]),
    band=st.none() | st.floats(0.0, 100.0),
    rim=st.floats(0.0, 10.0),
    wake=st.floats(0.0, 10.0),
    verb=st.sampled_from(["push", "pull", "smooth"]),
    symmetry=st.sampled_from(["", "x", "xyz"]),
    mirror=st.none() | vectors,
    continuous=st.booleans(),
    voxel_size=st.none() | st.floats(1e-6, 10.0),
    grid_hash=st.none() | st.text("0123456789abcdef", min_size=32, max_size=32),
)
in_a_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)


@in_a_folder
@given(stroke=strokes)
def test_round_trip(tmp_path, stroke):
    path = tmp_path / "é stroke.jsonl"
    stroke.save(path)
    assert Stroke.load(path) == stroke
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_file_is_lines_of_json(tmp_path):
    path = tmp_path / "stroke"
    Stroke.line((0, 0, 0), (2, 0, 0), step=1.0, tool=SphereTool(3), band=4.0).save(path)
    header, *poses = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    assert header["repousse_stroke"] == 1
    assert header["tool"] == {"kind": "sphere", "radius": 3, "reach": 4.5}
    assert header["band"] == 4.0 and header["method"] == "sweep"
    assert [pose["position"] for pose in poses] == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]


def length(stroke):
    positions = np.array([sample.position for sample in stroke.samples])
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


@given(
    points=st.lists(st.tuples(*[st.floats(-50.0, 50.0)] * 3), min_size=2, max_size=6),
    step=st.floats(0.1, 20.0),
)
def test_resample(points, step):
    """The same ends, samples no farther apart than the step and all on the old path, time that never runs back."""
    stroke = Stroke([Sample(0.1 * i, tuple(map(float, p))) for i, p in enumerate(points)])
    fine = stroke.resample(step)
    assert fine.samples[0].position == pytest.approx(points[0], abs=1e-9)
    assert fine.samples[-1].position == pytest.approx(points[-1], abs=1e-9)
    positions = np.array([s.position for s in fine.samples])
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= step * (1 + 1e-6)
    # Between samples corners may be cut, never by more than a step each.
    assert length(stroke) + 1e-6 >= length(fine) >= length(stroke) - 2 * step * len(points)
    assert np.all(np.diff([s.time for s in fine.samples]) >= 0.0)
    if len(points) == 2:
        assert length(fine) == pytest.approx(length(stroke), abs=1e-6)
    for position in positions:
        a, b = np.array(points[:-1]), np.array(points[1:])
        part = np.clip(((position - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-30), 0.0, 1.0)
        assert np.linalg.norm(a + part[:, None] * (b - a) - position, axis=1).min() < 1e-6


def test_line():
    stroke = Stroke.line((0, 0, 0), (3, 4, 0))
    assert len(stroke.samples) == 11
    assert stroke.samples[0].position == (0, 0, 0) and stroke.samples[-1].position == (3, 4, 0)
    assert stroke.samples[-1].time == pytest.approx(0.05)
    assert len(Stroke.line((1, 2, 3), (1, 2, 3)).samples) >= 1
    assert len(Stroke().resample(0.5).samples) == 0


@pytest.mark.parametrize("options", [{}, {"band": 5.0}, {"border": "wall"}, {"tool": BoxTool((3, 5, 4), 3)}])
def test_a_replay_leads_to_the_same_voxels(kernels, options, tmp_path):
    """Through a file and on another grid that holds the same: bit for bit, whatever else has happened meanwhile."""
    header = {"tool": SphereTool(5), "material": Material(3.3, 0.03)} | options
    stroke = Stroke.line((3.1, 14.2, 15.7), (17.3, 16.1, 13.4), step=0.7, **header)
    stroke.samples[8:] = [Sample(s.time, s.position, s.rotation, stroke.tool.radius + 1) for s in stroke.samples[8:]]
    first = half_space(32, 0.9, 12)
    stroke = stroke.began_on(first)
    contacts = stroke.push(first).follow(stroke)
    assert sum(contact.moved_mass for contact in contacts) > 100.0
    stroke.save(tmp_path / "stroke")
    loaded = Stroke.load(tmp_path / "stroke")
    again = half_space(32, 0.9, 12)
    assert loaded.grid_hash == hash_of(again) and loaded.voxel_size == again.voxel_size
    time.sleep(0.01)  # the clock has no say
    loaded.push(again).follow(loaded)
    assert again.shape == first.shape
    assert again.density.tobytes() == first.density.tobytes()


def test_only_what_is_said_is_written(tmp_path):
    """A sample without direction and strength has the lines it always had; files from before are read as ever."""
    plain, told = Sample(0.0, (1.0, 2.0, 3.0)), Sample(0.0, (1.0, 2.0, 3.0), direction=(0.0, 0.0, 1.0), strength=0.5)
    Stroke([plain, told]).save(tmp_path / "stroke")
    lines = (tmp_path / "stroke").read_text(encoding="utf-8").splitlines()
    assert set(json.loads(lines[1])) == {"time", "position", "rotation", "radius", "quality"}
    assert set(json.loads(lines[2])) == set(json.loads(lines[1])) | {"direction", "strength"}
    header = json.loads(lines[0])
    del header["mirror"]
    (tmp_path / "old").write_text("\n".join([json.dumps(header), *lines[1:]]), encoding="utf-8")
    assert Stroke.load(tmp_path / "old") == Stroke([plain, told])


def test_a_direction_is_read_as_a_unit_vector(tmp_path):
    """To a thousandth; and once it is one it stays so to the last bit, however often it is written."""
    along = (0.6003, 0.0, 0.8004)
    path = tmp_path / "stroke"
    Stroke([Sample(0.0, (1.0, 2.0, 3.0), direction=along)]).save(path)
    read = Stroke.load(path).samples[0].direction
    assert np.linalg.norm(read) == pytest.approx(1.0, abs=1e-15) and read == pytest.approx(along, abs=1e-3)
    for along in np.random.default_rng(0).normal(size=(100, 3)):
        once = unit(along / np.linalg.norm(along) * 1.0005)
        assert unit(once) == once
    Stroke([Sample(0.0, (1.0, 2.0, 3.0), direction=read)]).save(path)
    assert Stroke.load(path).samples[0].direction == read


@pytest.mark.parametrize(
    "said",
    [
        {"direction": [0, 0, 1.01]},
        {"direction": [0, 0, 0]},
        {"direction": [0, 1]},
        {"direction": [0, 0, float("inf")]},
        {"direction": "xyz"},
        {"direction": 7},
        {"strength": 1.01},
        {"strength": -0.01},
        {"strength": float("nan")},
        {"strength": "half"},
        {"quality": "best"},
        {"quality": ""},
        {"quality": None},
        {"quality": ["exact"]},
    ],
    ids=str,
)
def test_bad_directions_and_strengths(tmp_path, said):
    path, lines = saved(tmp_path)
    lines[2] = json.dumps(json.loads(lines[2]) | said)
    path.write_text("\n".join(lines), encoding="utf-8")
    refused(path, 3)


def test_hash_is_of_the_voxels():
    values = np.random.default_rng(0).random((4, 5, 6), np.float32)
    other = values.copy()
    other[3, 4, 5] = np.nextafter(other[3, 4, 5], np.float32(2.0))
    hashes = {hash_of(DensityGrid(v)) for v in (values, other, values.reshape(5, 4, 6), values.reshape(4, 6, 5))}
    assert len(hashes) == 4
    assert hash_of(DensityGrid(values)) == hash_of(DensityGrid(values, np.diag([2, 2, 2, 1])))


def test_follow_honours_continuous():
    """A long jump between two samples is a move only when the stroke says so."""
    for continuous in (False, True):
        jump = [Sample(0, (9.0, 4.0, 15.5)), Sample(1, (9.0, 28.0, 15.5))]
        stroke = Stroke(jump, SphereTool(4), Material(3.3, 0.03), border="wall", continuous=continuous)
        grid = half_space(32, 0.6, 10)
        before = grid.density.copy()
        stroke.push(grid).follow(stroke)
        assert (grid.density[:, 15:17] != before[:, 15:17]).any() == continuous


def test_follow_takes_each_radius():
    """A sample's radius is the tool's from there on; none leaves it as it is."""
    radii = [None, 5.0, None, 6.0]
    stroke = Stroke([Sample(i, (4.0 + 0.4 * i, 15.5, 15.5), radius=r) for i, r in enumerate(radii)], SphereTool(4))
    push = stroke.push(half_space(32, 0.6, 10))
    seen = []
    for sample in stroke.samples:
        push.follow(Stroke([sample]))
        seen.append(push.tool.radius)
    assert seen == [4.0, 5.0, 5.0, 6.0]


GOOD = Stroke.line((0, 0, 0), (3, 0, 0), step=1.0, tool=SphereTool(4))


def saved(tmp_path):
    path = tmp_path / "stroke"
    GOOD.save(path)
    return path, path.read_text(encoding="utf-8").splitlines()


def refused(path, line=None):
    with pytest.raises(ValueError) as error:
        Stroke.load(path)
    message = str(error.value)
    assert str(path) in message and "\n" not in message
    assert f"line {'' if line is None else line}" in message
    assert len(message) < len(str(path)) + 300


def header_with(lines, **fields):
    record = json.loads(lines[0])
    for name, value in fields.items():
        if value is KeyError:
            del record[name]
        else:
            record[name] = value
    return json.dumps(record)


BAD_HEADERS = [
    {"repousse_stroke": 2},
    {"repousse_stroke": None},
    {"repousse_stroke": KeyError},
    {"tool": KeyError},
    {"tool": None},
    {"tool": 5},
    {"tool": {"kind": "cone", "radius": 4}},
    {"tool": {"kind": "sphere"}},
    {"tool": {"kind": "sphere", "radius": "big"}},
    {"tool": {"kind": "sphere", "radius": 0.5}},
    {"tool": {"kind": "sphere", "radius": float("nan")}},
    {"tool": {"kind": "sphere", "radius": 4, "colour": "red"}},
    {"tool": {"kind": ["sphere"], "radius": 4}},
    {"material": KeyError},
    {"material": {"full_force": -1}},
    {"material": {"full_force": "strong"}},
    {"material": {"hardness": 3}},
    {"material": [1, 2]},
]
BAD_POSES = [
    "",
    "{",
    "null",
    "[]",
    "5",
    "{}",
    '{"position": null}',
    '{"position": [1, 2]}',
    '{"position": [1, 2, 3, 4]}',
    '{"position": [1, 2, NaN]}',
    '{"position": [1, 2, Infinity]}',
    '{"position": [1, 2, 1e400]}',
    '{"position": ["a", "b", "c"]}',
    '{"position": {"x": 1}}',
    '{"position": [1, 2, 3], "radius": 0.1}',
    '{"position": [1, 2, 3], "radius": NaN}',
    '{"position": [1, 2, 3], "radius": [4]}',
    '{"position": [1, 2, 3], "time": "now"}',
    '{"position": [1, 2, 3], "time": NaN}',
    '{"position": [1, 2, 3], "rotation": [1, 0, 0]}',
    '{"position": [1, 2, 3], "rotation": 1}',
    "[" * 100_000,
    '{"position": [1, 2, ' + "9" * 5000 + "]}",
]


@pytest.mark.parametrize("fields", BAD_HEADERS, ids=str)
def test_bad_headers(tmp_path, fields):
    path, lines = saved(tmp_path)
    path.write_text("\n".join([header_with(lines, **fields), *lines[1:]]), encoding="utf-8")
    refused(path, 1)


@pytest.mark.parametrize("pose", BAD_POSES, ids=lambda pose: pose[:40] or "nothing")
def test_bad_poses(tmp_path, pose):
    path, lines = saved(tmp_path)
    path.write_text("\n".join([*lines[:3], pose, *lines[3:]]) + "\n", encoding="utf-8")
    refused(path, 4)


@pytest.mark.parametrize(
    "fields",
    [
        {"method": "magic"},
        {"method": 5},
        {"border": []},
        {"band": -1},
        {"band": float("nan")},
        {"band": "wide"},
        {"rim": None},
        {"rim": [2]},
        {"wake": float("inf")},
        {"verb": "melt"},
        {"verb": 7},
        {"symmetry": "x"},
        {"symmetry": "xx", "mirror": [8, 8, 8]},
        {"symmetry": 5, "mirror": [8, 8, 8]},
        {"symmetry": "x", "mirror": [8, 8]},
        {"symmetry": "x", "mirror": [8, float("inf"), 8]},
        {"symmetry": "x", "mirror": "ab8"},
    ],
    ids=str,
)
def test_bad_options_never_reach_a_grid(tmp_path, fields):
    """Refused when it is loaded or at the latest when it is to be pushed, always with a ValueError of one line."""
    path, lines = saved(tmp_path)
    path.write_text("\n".join([header_with(lines, **fields), *lines[1:]]), encoding="utf-8")
    grid = half_space(16, 0.6, 8)
    before = grid.density.tobytes()
    with pytest.raises(ValueError) as error:
        Stroke.load(path).push(grid)
    assert "\n" not in str(error.value)
    assert grid.density.tobytes() == before


@in_a_folder
@given(cut=st.floats(0.0, 1.0))
def test_truncated(tmp_path, cut):
    """Cut inside a line it is refused with that line's number; cut between lines it is a shorter stroke."""
    path, _ = saved(tmp_path)
    whole = path.read_bytes()
    part = whole[: int(cut * len(whole))]
    path.write_bytes(part)
    between_lines = part.endswith(b"\n") or (part and whole[len(part) :].startswith(b"\n")) or part == whole
    if between_lines:
        assert Stroke.load(path).samples == GOOD.samples[: part.rstrip().count(b"\n")]
    else:
        refused(path, part.count(b"\n") + 1)


@in_a_folder
@given(data=st.binary(max_size=400))
def test_random_bytes(tmp_path, data):
    path = tmp_path / "stroke"
    path.write_bytes(data)
    refused(path)


@in_a_folder
@given(data=st.binary(min_size=1, max_size=20), at=st.floats(0.0, 1.0))
def test_bytes_turned_over(tmp_path, data, at):
    """It is refused, or it is a stroke that may be pushed or is refused then."""
    path, _ = saved(tmp_path)
    whole = path.read_bytes()
    place = int(at * len(whole))
    path.write_bytes(whole[:place] + data + whole[place + len(data) :])
    try:
        stroke = Stroke.load(path)
        stroke.push(half_space(12, 0.6, 6))
    except ValueError as error:
        assert "\n" not in str(error)
    else:
        assert all(np.isfinite(sample.position).all() for sample in stroke.samples)


def test_a_million_random_bytes(tmp_path):
    path = tmp_path / "stroke"
    path.write_bytes(np.random.default_rng(0).bytes(1_000_000))
    began = time.monotonic()
    refused(path)
    path.write_bytes(b"{" * 1_000_000)
    refused(path, 1)
    assert time.monotonic() - began < 2.0


def test_a_missing_file(tmp_path):
    with pytest.raises(OSError):
        Stroke.load(tmp_path / "nothing")


def test_too_many_poses(tmp_path, monkeypatch):
    from repousse.core import stroke as module

    path, lines = saved(tmp_path)
    monkeypatch.setattr(module, "MOST_SAMPLES", len(lines) - 2)
    refused(path, len(lines))


def test_nothing_is_left_half_written(tmp_path, monkeypatch):
    """A save that fails leaves the old file whole and nothing beside it."""
    path, _ = saved(tmp_path)
    before = path.read_bytes()

    def full(*_, **__):
        raise OSError("no space left on device")

    for broken in ("write_text", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(*((Path, "write_text", full) if broken == "write_text" else (os, "replace", full)))
            with pytest.raises(OSError, match="no space"):
                Stroke.line((5, 5, 5), (9, 9, 9)).save(path)
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]


def test_a_stroke_makes_its_push():
    stroke = Stroke(tool=SphereTool(5, 9), material=Material(1.0, 0.02), border="wall", band=3.0, rim=1.5, wake=0.5)
    grid = half_space(24, 0.6, 10)
    push = stroke.push(grid)
    assert isinstance(push, Push) and push.grid is grid
    assert (push.tool, push.material, push.border, push.band, push.rim, push.wake) == (
        stroke.tool,
        stroke.material,
        "wall",
        3.0,
        1.5,
        0.5,
    )
