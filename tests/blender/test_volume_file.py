# SPDX-License-Identifier: GPL-3.0-or-later
"""A .vdb that is written again and again: the sculpted grid to the bit, and all else in the file as it was."""

import struct
from pathlib import Path

import bpy
import numpy as np
import pytest

from repousse.core import DensityGrid
from repousse.core.bricks import BRICK, MIXED
from repousse.core.formats import FormatError, VolumeFile, list_grids, read_volume, vdb, write_volume
from repousse.core.formats.layout import lay_out

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  (there only now)

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "vdb"
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real volumes are not here")


def bytes_of(path):
    """Of each grid of a file, by its unique name: type, parent, metadata and transform, topology, values."""
    data = path.read_bytes()
    layout = lay_out(path)
    parts = {
        part.unique: (part.kind, part.parent, data[part.begin : part.blocks], data[part.blocks : part.end])
        for part in layout.parts
    }
    return data[slice(*layout.metadata)], parts


def noise(shape=(40, 33, 26), seed=1):
    values = np.random.default_rng(seed).random(shape, dtype=np.float32)
    values[values < 0.3] = 0.0
    return values


def filled(kind, name, value, low=(-3, 2, 1), high=(12, 9, 30)):
    made = getattr(openvdb, kind)()
    made.name = name
    made.fill(low, high, value)
    return made


@pytest.fixture
def crowd(tmp_path):
    """A file with grids of many types around the density, and with metadata of its own."""
    density = openvdb.FloatGrid()
    density.copyFromArray(noise())
    density.name = "density"
    half = filled("FloatGrid", "flame", 0.123456)
    half.saveFloatAsHalf = True
    kinds = {
        "Int32Grid": ("count", -7),
        "Int64Grid": ("long", 1 << 40),
        "DoubleGrid": ("exact", 0.1),
        "BoolGrid": ("mask", True),
    }
    grids = [
        filled("FloatGrid", "temperature", 1234.5),
        filled("Vec3SGrid", "velocity", (1.0, -2.0, 3.5)),
        density,
        half,
        *(filled(kind, *what) for kind, what in kinds.items() if hasattr(openvdb, kind)),  # a distribution's has fewer
        filled("FloatGrid", "temperature", 3.0, (5, 5, 5), (6, 6, 6)),
    ]
    grids[0].transform = openvdb.createLinearTransform(0.3)
    grids[1]["who"] = "Ada"
    path = tmp_path / "crowd.vdb"
    openvdb.write(str(path), grids=grids, metadata={"scene": "smoke", "frame": 12, "rate": 0.5})
    return path


def changed(file, seed=3):
    """Change some boxes of a file's grid, and return them."""
    random = np.random.default_rng(seed)
    boxes = []
    for n in range(6):
        low = random.integers(0, np.array(file.grid.shape) - 1)
        high = np.minimum(low + random.integers(1, 20, 3), file.grid.shape)
        inside = tuple(slice(a, b) for a, b in zip(low, high))
        file.grid.density[inside] = (0.0, 1.0, random.random(tuple(high - low), dtype=np.float32))[n % 3]
        boxes.append((tuple(low.tolist()), tuple(high.tolist())))
    return boxes


def test_other_grids_and_the_files_metadata_stay_to_the_byte(crowd, tmp_path):
    about, before = bytes_of(crowd)
    file = VolumeFile(crowd)
    for number in range(3):
        path = tmp_path / f"{number}.vdb"
        file.write(path, changed(file, number))
        told, after = bytes_of(path)
        assert told == about
        assert list(after) == list(before)
        assert {name: part for name, part in after.items() if name != "density"} == {
            name: part for name, part in before.items() if name != "density"
        }
        assert read_volume(path).density.tobytes() == file.grid.density.tobytes()
        crowd.unlink(missing_ok=True)  # the last revision alone is needed for the next


def test_openvdb_reads_what_was_written_through(crowd, tmp_path):
    file = VolumeFile(crowd)
    file.write(tmp_path / "new.vdb", changed(file))
    before, about = openvdb.readAll(str(crowd))
    after, told = openvdb.readAll(str(tmp_path / "new.vdb"))
    assert told == about == {"scene": "smoke", "frame": 12, "rate": 0.5}
    assert [(type(grid), grid.name) for grid in after] == [(type(grid), grid.name) for grid in before]
    for old, new in zip(before, after):
        if old.name != "density":
            assert (new.activeVoxelCount(), new.transform, new.metadata) == (
                old.activeVoxelCount(),
                old.transform,
                old.metadata,
            )
            for value, was in zip(new.citerOnValues(), old.citerOnValues()):
                assert (value.value, value.min, value.max) == (was.value, was.min, was.max)


@pytest.mark.parametrize("boxes", ["boxes", "all"])
def test_every_bit_of_every_revision(tmp_path, boxes):
    """Also voxels and whole bricks that become empty, and those that were full."""
    values = noise()
    values[:16] = 1.0
    write_volume(DensityGrid(values), tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    for number in range(1, 25):
        touched = changed(file, number)
        file.write(tmp_path / f"{number}.vdb", touched if boxes == "boxes" else None)
        back = openvdb.read(str(tmp_path / f"{number}.vdb"), "density")
        array = np.empty(file.grid.shape, np.float32)
        back.copyToArray(array)
        assert array.tobytes() == file.grid.density.tobytes()
        assert back.activeVoxelCount() == np.count_nonzero(array)


def blocks(shape=(40, 32, 24)):
    """Bricks that are empty, full or neither, in blocks."""
    random = np.random.default_rng(5)
    kinds = random.choice(3, [n // BRICK for n in shape], p=(0.4, 0.4, 0.2))
    kind = kinds.repeat(BRICK, 0).repeat(BRICK, 1).repeat(BRICK, 2)
    return np.where(kind == 2, random.random(shape, np.float32), kind).astype(np.float32)


def test_only_bricks_that_are_neither_empty_nor_full_are_leaves(tmp_path):
    """In the first file and in each that follows: what fills a brick takes the room of a voxel."""
    write_volume(DensityGrid(blocks()), tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    for number in range(4):
        back = openvdb.read(str(tmp_path / f"{number}.vdb"), "density")
        assert back.leafCount() == (file.grid.bricks.states == MIXED).sum()
        assert back.activeVoxelCount() == np.count_nonzero(file.grid.density)
        boxes = [((2, 3, 4), (19, 17, 21)), ((0, 8, 0), (40, 16, 8))][number % 2 :]
        for low, high in boxes:
            file.grid.density[tuple(slice(a, b) for a, b in zip(low, high))] = number % 2
        file.write(tmp_path / f"{number + 1}.vdb", boxes)
        assert read_volume(tmp_path / f"{number + 1}.vdb").density.tobytes() == file.grid.density.tobytes()


def test_few_copies_are_made(tmp_path):
    """Of clay that is full but for its surface, what is copied is the surface; of noise, all at once."""
    copied = []

    class Counted:
        def __init__(self, fog):
            self.fill, self._fog = fog.fill, fog

        def copyFromArray(self, array, **more):  # noqa: N802  (OpenVDB's name)
            copied.append(array.size)
            self._fog.copyFromArray(array, **more)

    clay = np.zeros((64, 64, 64), np.float32)
    clay[:, :, :36], clay[:, :, 36] = 1.0, 0.5
    for values, expected in ((clay, [48 * 48 * 8]), (noise((64, 64, 64)), [48 * 48 * 64])):
        grid = DensityGrid(values)
        fog = vdb.fog_of(grid, tmp_path / "x.vdb")
        vdb.change(Counted(fog), grid, ((3, 5, 0), (45, 48, 64)))
        assert copied == expected
        copied.clear()
        back = np.empty(values.shape, np.float32)
        fog.copyToArray(back)
        assert back.tobytes() == values.tobytes()


def test_boxes_may_reach_out_of_the_grid_or_be_empty(tmp_path):
    write_volume(DensityGrid(noise()), tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    file.grid.density[:3] = 0.5
    file.write(tmp_path / "1.vdb", [((-5, -5, -5), (3, 99, 99)), ((4, 4, 4), (4, 9, 9)), ((50, 0, 0), (60, 9, 9))])
    assert read_volume(tmp_path / "1.vdb").density.tobytes() == file.grid.density.tobytes()


def test_a_grid_that_grew_is_written_where_it_now_lies(crowd, tmp_path):
    _, before = bytes_of(crowd)
    file = VolumeFile(crowd)
    file.write(tmp_path / "1.vdb", [])
    file.grid.grow((8, 0, 16), (0, 8, 0))
    file.grid.density[:4] = 0.25
    file.write(tmp_path / "2.vdb", [((0, 0, 0), (4, 41, 42))])
    back = read_volume(tmp_path / "2.vdb")
    assert back.shape == (48, 41, 42)
    assert back.density.tobytes() == file.grid.density.tobytes()
    assert np.array_equal(back.transform, file.grid.transform)
    assert bytes_of(tmp_path / "2.vdb")[1]["temperature\x1e0"] == before["temperature\x1e0"]
    file.grid.density[9, 9, 9] = 0.75
    file.write(tmp_path / "3.vdb", [((9, 9, 9), (10, 10, 10))])
    assert read_volume(tmp_path / "3.vdb").density.tobytes() == file.grid.density.tobytes()


def test_reading_and_writing_our_own_file_changes_nothing(tmp_path):
    grid = DensityGrid(noise(), np.diag([0.1, 0.1, 0.1, 1.0]), "smoke", {"step": 3})
    write_volume(grid, tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    file.write(tmp_path / "1.vdb", [])
    again = VolumeFile(tmp_path / "1.vdb")
    assert again.grid.density.tobytes() == grid.density.tobytes()
    assert np.array_equal(again.grid.transform, grid.transform)
    assert (again.grid.name, again.grid.metadata["step"]) == ("smoke", 3)


def test_values_that_a_window_made_density_are_written_as_density(tmp_path):
    source = openvdb.FloatGrid()
    source.copyFromArray(100.0 * noise())
    source.name = "density"
    source["repousse_shape"] = "40 33 26"  # as a program leaves it that scales what we wrote
    openvdb.write(str(tmp_path / "0.vdb"), grids=[source])
    file = VolumeFile(tmp_path / "0.vdb")
    file.write(tmp_path / "1.vdb", [((0, 0, 0), (1, 1, 1))])
    assert file.grid.density.max() == 1.0
    assert read_volume(tmp_path / "1.vdb").density.tobytes() == file.grid.density.tobytes()


def test_grids_that_share_a_tree_keep_it(tmp_path):
    density = openvdb.FloatGrid()
    density.copyFromArray(noise())
    density.name = "density"
    twins = [density]
    for number in range(3):
        twins.append(density.copy())
        twins[-1].name = f"twin {number}"
        twins[-1].transform = openvdb.createLinearTransform(1.0 + number)
    openvdb.write(str(tmp_path / "0.vdb"), grids=twins)
    assert [part.parent for part in lay_out(tmp_path / "0.vdb").parts] == ["", "density", "density", "density"]
    file = VolumeFile(tmp_path / "0.vdb")
    before = file.grid.density.copy()
    file.grid.density[:] = 1.0
    file.write(tmp_path / "1.vdb", None)
    parts = lay_out(tmp_path / "1.vdb").parts
    assert [part.parent for part in parts] == ["", "", "twin 0", "twin 0"]
    data = (tmp_path / "1.vdb").read_bytes()
    begun = [struct.unpack_from("<q", data, part.placed + 8)[0] for part in parts]
    assert begun == [parts[0].blocks, parts[1].blocks, 0, 0]  # as OpenVDB marks a grid without values of its own
    assert (read_volume(tmp_path / "1.vdb").density == 1.0).all()
    for number in range(3):
        twin = read_volume(tmp_path / "1.vdb", f"twin {number}")
        assert twin.density.tobytes() == before.tobytes()
        assert twin.voxel_size == 1.0 + number


def test_one_of_several_grids_of_a_name_is_changed_alone(tmp_path):
    openvdb.write(
        str(tmp_path / "0.vdb"), grids=[filled("FloatGrid", "density", 0.25 * n, (n, 0, 0), (9, 9, 9)) for n in (1, 2)]
    )
    file = VolumeFile(tmp_path / "0.vdb", "density[1]")
    assert (file.grid.density == 0.5).all()
    file.grid.density[0, 0, 0] = 0.75
    file.write(tmp_path / "1.vdb", [((0, 0, 0), (1, 1, 1))])
    assert [info.key for info in list_grids(tmp_path / "1.vdb")] == ["density[0]", "density[1]"]
    assert (read_volume(tmp_path / "1.vdb", "density[0]").density == 0.25).all()
    assert read_volume(tmp_path / "1.vdb", "density[1]").density.tobytes() == file.grid.density.tobytes()


def test_after_a_failed_write_the_next_has_both_changes(tmp_path, monkeypatch):
    write_volume(DensityGrid(noise()), tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    file.grid.density[:9] = 0.5
    with pytest.raises(FormatError, match=r"1\.vdb: cannot be written: No such file or directory"):
        file.write(tmp_path / "nowhere" / "1.vdb", [((0, 0, 0), (9, 33, 26))])
    write = openvdb.write

    def cut(name, **content):
        write(name, **content)
        Path(name).write_bytes(Path(name).read_bytes()[:-9])

    with monkeypatch.context() as full:
        full.setattr(openvdb, "write", cut)  # as OpenVDB does on a full disk, without a word
        with pytest.raises(FormatError, match=r"1\.vdb: cannot be written whole"):
            file.write(tmp_path / "1.vdb", [])
    assert [path.name for path in tmp_path.iterdir()] == ["0.vdb"]
    file.grid.density[20:] = 0.25
    file.write(tmp_path / "1.vdb", [((20, 0, 0), (40, 33, 26))])
    assert read_volume(tmp_path / "1.vdb").density.tobytes() == file.grid.density.tobytes()


def test_after_a_failed_write_what_is_taken_back_is_not_written(tmp_path):
    write_volume(DensityGrid(noise()), tmp_path / "0.vdb")
    file = VolumeFile(tmp_path / "0.vdb")
    before = file.grid.density.copy()
    file.grid.density[:9] = 0.5
    with pytest.raises(FormatError, match=r"1\.vdb: cannot be written: No such file or directory"):
        file.write(tmp_path / "nowhere" / "1.vdb", [((0, 0, 0), (9, 33, 26))])
    file.grid.density[:] = before
    file.write(tmp_path / "1.vdb", [])
    assert read_volume(tmp_path / "1.vdb").density.tobytes() == before.tobytes()


@real
@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("mantaflow_gas_half_5grids", None),
        ("three_grids_same_name", "density[1]"),
        ("smoke_v222_half", None),
        ("sphere_fog_v223", None),
        ("cube_ls_v222_half", None),
    ],
)
def test_real_volumes_keep_their_other_grids(tmp_path, name, key):
    source = DATA / f"{name}.vdb"
    file = VolumeFile(source, key)
    file.grid.density[:3] = 0.5
    file.write(tmp_path / "1.vdb", None)
    about, before = bytes_of(source)
    told, after = bytes_of(tmp_path / "1.vdb")
    assert told == about and list(after) == list(before)
    sculpted = next(part.unique for part in lay_out(tmp_path / "1.vdb").parts if "repousse_shape" in part.metadata)
    assert {**after, sculpted: None} == {**before, sculpted: None}
    assert read_volume(tmp_path / "1.vdb", key).density.tobytes() == file.grid.density.tobytes()
    again, _ = openvdb.readAll(str(tmp_path / "1.vdb"))
    for new, old in zip(again, openvdb.readAll(str(source))[0]):
        if "repousse_shape" not in new.metadata:
            assert (new.activeVoxelCount(), new.evalActiveVoxelBoundingBox()) == (
                old.activeVoxelCount(),
                old.evalActiveVoxelBoundingBox(),
            )
