# SPDX-License-Identifier: GPL-3.0-or-later
"""PVM files against a decoder that follows the format's rules bit by bit, and against hostile input."""

import os
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core.formats import FormatError, describe, list_grids, pvm, read_volume, write_volume
from repousse.core.formats.base import EmptyVolumeError
from repousse.core.grid import DensityGrid

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "pvm"
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real volumes are not here")


def literal(data, block=None):
    """Decode a DDS envelope by the letter of its rules, a bit and a byte at a time."""
    bits = "".join(f"{byte:08b}" for byte in data[8:]) + "0" * 16
    at = 0

    def take(count):
        nonlocal at
        at += count
        return int(bits[at - count : at] or "0", 2)

    planes, strip = take(2) + 1, take(16) + 1
    out = []
    while at + 10 <= len(bits):
        length, code = take(7), take(3)
        if not length:
            break
        width = code + 1 if code else 0
        for _ in range(length):
            residual = take(width) - 2 ** (width - 1) if width else 0
            i = len(out)
            guess = out[i - 1] if i else 0
            if i > strip and strip != 1:
                guess += out[i - strip] - out[i - strip - 1]
            out.append((guess + residual) % 256)
    step = planes * block if data.startswith(b"DDS v3e\n") else max(len(out), 1)
    joined = [0] * len(out)
    for begin in range(0, len(out), step):
        places = range(begin, min(begin + step, len(out)))
        order = [at for plane in range(planes) for at in places[plane::planes]]
        for at_stream, at_file in zip(places, order, strict=True):
            joined[at_file] = out[at_stream]
    return bytes(joined)


def decoded(data):
    return pvm._envelope(Path("x.pvm"), data).unpack().tobytes()


@st.composite
def streams(draw):
    """A DDS stream of any runs, also such as no encoder would write."""
    runs = draw(st.lists(st.tuples(st.integers(1, 127), st.integers(0, 7)), max_size=30))
    noise = np.random.default_rng(draw(st.integers(0, 99)))
    bits = f"{draw(st.integers(0, 3)):02b}{draw(st.sampled_from([0, 1, 2, 6, 40, 300, 65535])):016b}"
    for length, code in runs:
        width = code + 1 if code else 0
        bits += f"{length:07b}{code:03b}" + "".join(map(str, noise.integers(0, 2, length * width)))
    bits += "0" * (-len(bits) % 8)
    magic = draw(st.sampled_from([b"DDS v3d\n", b"DDS v3e\n"]))
    return magic + bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))


@given(streams(), st.sampled_from([3, 16, 1000]))
def test_the_vectorised_decoder_does_what_the_literal_one_does(data, block):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pvm, "BLOCK", block)
        patch.setattr(pvm, "PIECE", 7)  # so that runs and bytes cross the border of a piece
        assert decoded(data) == literal(data, block)


@given(
    st.integers(0, 400),
    st.integers(1, 60),
    st.integers(1, 4),
    st.sampled_from([0, 1, 3, 20, 255]),
    st.sampled_from([3, 16, 1 << 24]),
)
def test_what_is_encoded_is_decoded_by_both(size, width, components, roughness, block):
    noise = np.random.default_rng(size)
    smooth = np.cumsum(noise.integers(-roughness, roughness + 1, size + 1)) // 2
    container = smooth.astype(np.uint8).tobytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pvm, "BLOCK", block)
        patch.setattr(pvm, "PIECE", 5)
        data = pvm.encode(container, width, components)
        assert data[:8] == (b"DDS v3e\n" if len(container) > block else b"DDS v3d\n")
        assert decoded(data) == container
        assert literal(data, block) == container


def test_a_volume_wider_than_a_strip_can_be_has_strip_one():
    voxels = np.arange(70000, dtype=np.uint8).reshape(70000, 1, 1)
    container = pvm.pack(voxels, (1, 1, 1), {})
    data = pvm.encode(container, 70000, 1)
    assert int.from_bytes(data[8:11], "big") >> 6 == 0  # 2 + 16 bits: one plane, strip 1
    assert decoded(data) == container


def test_runs_worked_out_by_hand():
    # one plane, strip 2; run of 3 with 2 bits: +1 +1 -1; run of 2 with 0 bits
    bits = "00" + f"{1:016b}" + "0000011" + "001" + "11" + "11" + "01" + "0000010" + "000"
    bits += "0" * (-len(bits) % 8)
    data = b"DDS v3d\n" + bytes(int(bits[at : at + 8], 2) for at in range(0, len(bits), 8))
    # 0+1, 1+1, 2-1 (still the short form at i = strip), then 1+2-1 = 2 and 2+1-2 = 1
    assert list(decoded(data)) == [1, 2, 1, 2, 1]


@given(
    st.tuples(*[st.integers(1, 9)] * 3),
    st.sampled_from([np.uint8, np.uint16]),
    st.tuples(*[st.sampled_from([1.0, 0.5, 1.4, 3.0])] * 3),
    st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9), max_size=4),
    st.booleans(),
)
@settings(max_examples=60)
def test_shapes_bits_edges_and_texts_survive(tmp_path_factory, shape, dtype, edges, texts, bare):
    noise = np.random.default_rng(sum(shape))
    voxels = noise.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    texts = dict(zip(pvm.TEXTS, texts, strict=False))
    container = pvm.pack(voxels, edges, texts)
    path = tmp_path_factory.mktemp("pvm") / "no-suffix"
    path.write_bytes(container if bare else pvm.encode(container, shape[0], voxels.itemsize))
    volume = pvm.read(path, None)
    texts = {name: text for name, text in texts.items() if text}
    expected = "PVM3" if texts else "PVM2" if edges != (1.0, 1.0, 1.0) else "PVM"
    assert (volume.values == voxels).all()
    assert volume.info.edges == edges
    assert (volume.info.kind, volume.info.metadata) == (expected, texts)
    assert container.startswith(expected.encode() + b"\n")


def test_a_grid_written_with_16_bits_comes_back_at_its_own_level(tmp_path):
    density = np.linspace(0.0, 0.5, 60).reshape(3, 4, 5)
    grid = DensityGrid(density, np.diag([0.25, 0.25, 0.25, 1.0]), metadata={"description": "ein Würfel", "n": 3})
    for bits, step in ((8, 1 / 255), (16, 1 / 65535)):
        write_volume(grid, tmp_path / "x.pvm", bits=bits)
        assert (tmp_path / "x.pvm").read_bytes().startswith(b"DDS v3d\n")
        back = read_volume(tmp_path / "x.pvm")
        assert np.abs(back.density - grid.density).max() <= 0.5 * step + 1e-7
        assert back.voxel_size == 0.25
        assert back.metadata["description"] == "ein Würfel"
        assert "generator=Repousse" in back.metadata["parameter"]
    write_volume(back, tmp_path / "y.pvm")  # its note of 16 bits does not outlive them
    assert np.abs(read_volume(tmp_path / "y.pvm").density - grid.density).max() <= 0.5 / 255 + 1e-4
    with pytest.raises(FormatError, match="8 or 16"):
        write_volume(grid, tmp_path / "z.pvm", bits=12)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.pvm", "y.pvm"]


def test_windows_of_8_and_16_bits(tmp_path):
    path = tmp_path / "x.pvm"
    path.write_bytes(b"PVM\n2 2 1\n1\n" + bytes([0, 51, 102, 204]))
    grid = read_volume(path)
    assert grid.density[:, :, 0].tolist() == [[0, np.float32(102 / 255)], [np.float32(0.2), np.float32(0.8)]]
    assert grid.metadata["window"] == "0:255"
    assert "window 0:255" in grid.notes[0]
    grid = read_volume(path, window=(51, 153))  # air of a scan is not zero
    assert grid.density.reshape(-1, order="F").tolist() == [0, 0, 0.5, 1]
    assert "50.00% of the voxels lie outside" in grid.notes[0]
    assert read_volume(path, window=(204, 0)).density.reshape(-1, order="F").tolist() == [1, 0.75, 0.5, 0]
    path.write_bytes(b"PVM\r\n3  1 1\r\n2\r\n" + bytes([1, 0, 2, 0, 4, 0]))
    assert read_volume(path).density.ravel().tolist() == [0.25, 0.5, 1.0]
    assert read_volume(path).metadata["window"] == "0:1024"
    for window in ((3, 3), (0, float("nan"))):
        with pytest.raises(FormatError, match=r"x\.pvm: a window needs two different finite ends"):
            read_volume(path, window=window)


def test_rgb_is_read_as_luminance(tmp_path):
    path = tmp_path / "x.pvm"
    path.write_bytes(b"PVM\n4 1 1\n3\n" + bytes([255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255]))
    assert read_volume(path).density.ravel() == pytest.approx([0.2126, 0.7152, 0.0722, 1.0], abs=1e-6)
    assert list_grids(path)[0].value_type == "rgb8"


def test_unequal_edges_become_cubes_of_the_same_mass(tmp_path):
    path = tmp_path / "x.pvm"
    voxels = np.random.default_rng(1).integers(0, 256, (5, 6, 7), np.uint8)
    path.write_bytes(pvm.pack(voxels, (1, 1, 1.4), {}))
    grid = read_volume(path)
    assert grid.shape == (5, 6, 10)
    assert grid.mass * grid.voxel_size**3 == pytest.approx(voxels.sum() / 255 * 1.4, rel=1e-6)
    assert any("1 x 1 x 1.4" in note and "5 x 6 x 7 became 5 x 6 x 10" in note for note in grid.notes)


def small_file(version, bare):
    voxels = np.random.default_rng(4).integers(0, 9, (5, 4, 3), np.uint16 if version == "PVM2" else np.uint8)
    texts = {"description": "d", "comment": "longer"} if version == "PVM3" else {}
    container = pvm.pack(voxels, (1, 1, 1 if version == "PVM" else 1.0005), texts)
    return container if bare else pvm.encode(container, 5, voxels.itemsize)


@pytest.mark.parametrize("bare", [True, False])
@pytest.mark.parametrize("version", ["PVM", "PVM2", "PVM3"])
def test_a_file_cut_at_any_byte_is_refused(tmp_path, version, bare):
    data = small_file(version, bare)
    path = tmp_path / "cut.pvm"
    path.write_bytes(data)
    read_volume(path)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(FormatError, match=r"cut\.pvm: (damaged|is)") as error:
            read_volume(path)
        assert "\n" not in str(error.value)


def test_bytes_after_the_volume_are_told(tmp_path):
    path = tmp_path / "x.pvm"
    path.write_bytes(b"PVM\n2 1 1\n1\n\7\7more")
    assert "4 bytes after the volume were ignored" in read_volume(path).notes
    path.write_bytes(small_file("PVM", bare=False) + bytes(3))  # V^3 fills its last word of 32 bits
    assert not any("ignored" in note for note in read_volume(path).notes)
    path.write_bytes(small_file("PVM", bare=False) + bytes(3) + b"tail of another file")
    assert any("ignored" in note for note in read_volume(path).notes)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (
            b"PVM\n100000 100000 100000\n1\n",
            "100000 x 100000 x 100000 voxels of 1 bytes, 1000000000000000 in all, but it holds 64",
        ),
        (b"PVM\n9999999999 9999999999 9999999999\n2\n", "in all, but it holds 64"),
        (b"PVM\n4 4 5\n1\n", "80 in all, but it holds 64"),
        (b"PVM\n4 0 4\n1\n", "nothing"),
        (b"PVM\n4 4 4\n0\n", "nothing"),
        (b"PVM\n4 4 1\n4\n", "4 bytes a voxel"),
        (b"PVM\n-4 4 4\n1\n", "no PVM header"),
        (b"PVM2\n4 4 4\n1\n", "no PVM header"),
        (b"PVM2\n4 4 4\n1 0 1\n1\n", "voxel edges"),
        (b"PVM2\n4 4 4\n1 1e999 1\n1\n", "voxel edges"),
        (b"PVM2\n4 4 4\n1 --1 1\n1\n", "voxel edges"),
        (b"PVM3\n4 4 4\n1 1 1\n1\n", "only 0 of the 4 texts"),
    ],
)
@pytest.mark.parametrize("bare", [True, False])
def test_a_header_that_lies_is_refused_before_its_memory_is_taken(tmp_path, head, said, bare):
    container = head + bytes(range(1, 65))
    path = tmp_path / "liar.pvm"
    path.write_bytes(container if bare else pvm.encode(container, 4, 1))
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match=r"liar\.pvm: ") as error:
            read_volume(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 23
    finally:
        tracemalloc.stop()
    assert said in str(error.value)
    with pytest.raises(FormatError):
        list_grids(path)


def test_a_stream_that_would_unpack_to_too_much_is_refused_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "bomb.pvm"
    runs = int(b"1111111000" * 4000, 2) << 6  # 4000 runs of 127 zeros
    path.write_bytes(b"DDS v3d\n" + runs.to_bytes(5003, "big"))
    with pytest.raises(FormatError, match="no PVM header"):
        read_volume(path)
    monkeypatch.setattr(pvm, "MAX_VOXELS", 100_000)
    with pytest.raises(FormatError, match="would unpack to"):
        read_volume(path)


@pytest.mark.parametrize("magic", [b"", *pvm.MAGICS])
def test_a_million_random_bytes_are_refused_within_a_second(tmp_path, magic):
    path = tmp_path / "noise.pvm"
    path.write_bytes(magic + np.random.default_rng(7).bytes(1_000_000))
    start = time.perf_counter()
    with pytest.raises(FormatError, match=r"noise\.pvm: "):
        read_volume(path)
    assert time.perf_counter() - start < 1.0


def test_a_volume_of_zeros_is_told_and_described(tmp_path):
    path = tmp_path / "zeros.pvm"
    path.write_bytes(b"PVM\n2 1 1\n2\n" + bytes(4))
    with pytest.raises(EmptyVolumeError, match=r"zeros\.pvm: grid 'density' holds nothing"):
        read_volume(path)
    told = describe(path)
    assert told["values"] == (0.0, 0.0)
    assert "holds nothing" in told["notes"][0]


def test_description_has_what_info_shows(tmp_path):
    path = tmp_path / "x.pvm"
    path.write_bytes(pvm.pack(np.full((2, 3, 4), 51, np.uint8), (2.0, 2.0, 2.0), {"comment": "c"}))
    told = describe(path)
    assert told["shape"] == (2, 3, 4)
    assert told["voxel_size"] == 2.0
    assert told["values"] == (51.0, 51.0)
    assert told["mass"] == pytest.approx(24 / 5)
    assert told["grids"][0].metadata == {"comment": "c"}


@pytest.mark.parametrize("name", ["missing.pvm", "folder", "empty.pvm", "text.pvm"])
def test_what_is_no_volume_is_named(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.pvm").touch()
    (tmp_path / "text.pvm").write_text("PVMH")
    for ask in (read_volume, list_grids, describe):
        with pytest.raises(FormatError, match=name):
            ask(tmp_path / name)


def test_there_is_no_second_grid_in_a_pvm_file(tmp_path):
    path = tmp_path / "x.pvm"
    path.write_bytes(b"PVM\n1 1 1\n1\n\7")
    assert read_volume(path, grid="density").mass == read_volume(path, grid=0).mass
    with pytest.raises(FormatError, match="no grid 'flame'"):
        read_volume(path, grid="flame")


def test_a_failed_write_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    grid = DensityGrid(np.ones((2, 2, 2)))
    path = tmp_path / "x.pvm"
    path.write_bytes(b"before")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(FormatError, match=r"x\.pvm: cannot be written: No space left on device"):
        write_volume(grid, path)
    assert path.read_bytes() == b"before"
    for name in ("gone/x.pvm", "gone/x.vdb", "x.raw"):
        with pytest.raises(FormatError, match="cannot be written"):
            write_volume(grid, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["x.pvm"]


def test_a_256_cube_is_read_in_under_four_seconds(tmp_path):
    x, y, z = np.ogrid[:256, :256, :256]
    noise = np.random.default_rng(2).integers(0, 8, (256, 256, 256), np.uint8)
    voxels = (((x - 128) ** 2 + (y - 120) ** 2 + (z - 90) ** 2) // 190).clip(0, 240).astype(np.uint8) + noise
    path = tmp_path / "big.pvm"
    path.write_bytes(pvm.encode(pvm.pack(voxels, (1, 1, 1), {}), 256, 1))
    assert path.read_bytes()[:8] == b"DDS v3e\n"
    start = time.perf_counter()
    grid = read_volume(path)
    assert time.perf_counter() - start < 4.0
    assert (np.rint(grid.density * 255) == voxels).all()


@real
@pytest.mark.parametrize(("name", "raw"), [("Bucky.pvm", "Bucky.32x32x32.raw"), ("nucleon_41.pvm", "nucleon.raw")])
def test_real_volumes_decode_to_their_raw_files(name, raw):
    values = pvm.read(DATA / name, None).values
    assert values.tobytes(order="F") == (DATA / raw).read_bytes()


@real
@pytest.mark.parametrize(
    ("name", "kind", "shape", "voxel_size", "low", "high"),
    [
        ("Drop.pvm", "PVM", (256, 256, 8), 1.0, 0, 255),
        ("Lobster.pvm", "PVM3", (301, 324, 79), 1.0, 0, 255),
        ("bonsai_256.pvm", "PVM", (256, 256, 256), 1.0, 0, 255),
        ("engine_128x128x64_pvm2_aniso.pvm", "PVM2", (128, 128, 160), 1.0, 0, 255),
        ("walnut_u16_128x96x114.pvm", "PVM3", (128, 96, 114), 1.0, 0, 22526),
        ("nucleon_rgb.pvm", "PVM", (41, 41, 41), 1.0, 0, 233),
        ("nucleon_plain_uncompressed_pvm3.pvm", "PVM3", (41, 41, 82), 1.0, 0, 249),
        ("width1_strip1.pvm", "PVM", (1, 41, 1681), 1.0, 0, 249),
    ],
)
def test_real_volumes_are_read_as_their_manifest_says(name, kind, shape, voxel_size, low, high):
    told = describe(DATA / name)
    assert told["grids"][0].kind == kind
    assert (told["shape"], told["voxel_size"]) == (shape, voxel_size)
    assert told["values"] == pytest.approx((low, high), abs=1)


@real
def test_real_volumes_agree_with_one_another_and_with_their_reference():
    golden = np.fromfile(DATA / "nucleon.raw", np.uint8)
    assert pvm.read(DATA / "width1_strip1.pvm", None).values.tobytes(order="F") == golden.tobytes()
    assert pvm.read(DATA / "nucleon_plain_uncompressed_pvm3.pvm", None).values.tobytes(order="F") == golden.tobytes()
    texts = list_grids(DATA / "walnut_u16_128x96x114.pvm")[0].metadata
    assert sorted(texts) == sorted(pvm.TEXTS)
    with pytest.raises(FormatError, match=r"damaged: .* 5461344 in all, but it holds 3750458"):
        read_volume(DATA / "Lobster_damaged_crlf.pvm")
