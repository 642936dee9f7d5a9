# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB files: what others write is read, what is written is what was there, what is damaged is refused."""

import struct
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repousse.core.formats import FormatError, describe, list_grids, read_volume, vdb, write_volume
from repousse.core.formats.base import EmptyVolumeError
from repousse.core.grid import DensityGrid

bpy.utils.expose_bundled_modules()
import openvdb  # noqa: E402  (there only now)

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "vdb"
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real volumes are not here")


def placed(turn=(0.0, 0.0, 1.0, 0.0), edges=(1.0, 1.0, 1.0), origin=(0.0, 0.0, 0.0)):
    """A transform from an axis and an angle, voxel edges and the world place of voxel 0."""
    axis, angle = np.array(turn[:3]) / np.linalg.norm(turn[:3]), turn[3]
    cross = np.cross(np.eye(3), axis)
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    matrix[:3, :3] *= edges
    matrix[:3, 3] = origin
    return matrix


def save(path, *grids):
    openvdb.write(str(path), grids=list(grids))
    return path


def filled(kind="FloatGrid", values=((0.25, 0.5), (0.75, 1.0)), name="density", ijk=(0, 0, 0), background=0.0):
    grid = getattr(openvdb, kind)(int(background) if kind.startswith("Int") else background)
    grid.copyFromArray(np.array(values, dtype=float)[..., None], ijk=ijk)
    grid.name = name
    return grid


@given(
    st.tuples(*[st.integers(1, 20)] * 3),
    st.integers(0, 5),
    st.tuples(*[st.floats(-1, 1)] * 2, st.floats(0.1, 1), st.sampled_from([0.0, 0.5, 2.0, np.pi])),
    st.floats(1e-3, 1e3),
    st.tuples(*[st.floats(-1e4, 1e4)] * 3),
)
@settings(max_examples=40)
def test_every_bit_and_the_place_of_every_voxel_survive(tmp_path_factory, shape, border, turn, edge, origin):
    density = np.random.default_rng(sum(shape)).random(shape, np.float32)
    density[density < 0.3] *= np.float32(1e-40)  # also numbers below float32's normal range
    density = np.pad(density, border)  # and empty borders, which OpenVDB does not keep by itself
    grid = DensityGrid(density, placed(turn, (edge,) * 3, origin), "clay", {"stroke": "a.jsonl", "step": 0.5, "n": 7})
    path = tmp_path_factory.mktemp("vdb") / "x.vdb"
    write_volume(grid, path)
    back = read_volume(path)
    assert back.density.tobytes() == grid.density.tobytes()
    assert back.transform == pytest.approx(grid.transform, rel=1e-12, abs=1e-12 * (1 + max(map(abs, origin))))
    assert back.name == "clay"
    assert grid.metadata.items() <= back.metadata.items()
    [info] = list_grids(path)
    assert info.shape == grid.shape
    assert info.edges == pytest.approx((edge,) * 3)


def test_blender_finds_the_grid_where_it_was(tmp_path):
    density = np.zeros((6, 5, 4))
    density[2, 3, 1] = 0.5
    transform = placed((1.0, 2.0, 3.0, 0.7), (0.1, 0.1, 0.1), (4.0, 5.0, 6.0))
    write_volume(DensityGrid(density, transform), tmp_path / "x.vdb")
    grid = openvdb.read(str(tmp_path / "x.vdb"), "density")
    assert grid.gridClass == "fog volume"
    assert grid["generator"].startswith("Repousse")
    assert openvdb.readMetadata(str(tmp_path / "x.vdb"))["generator"].startswith("Repousse")
    assert grid.activeVoxelCount() == 1
    assert grid.getConstAccessor().getValue((2, 3, 1)) == 0.5
    assert grid.transform.indexToWorld((2, 3, 1)) == pytest.approx(tuple((transform @ [2, 3, 1, 1])[:3]))


def test_half_floats_halve_the_file(tmp_path):
    grid = DensityGrid(np.random.default_rng(3).random((40, 40, 40)))
    write_volume(grid, tmp_path / "whole.vdb")
    write_volume(grid, tmp_path / "half.vdb", half=True)
    assert (tmp_path / "half.vdb").stat().st_size < 0.6 * (tmp_path / "whole.vdb").stat().st_size
    assert np.abs(read_volume(tmp_path / "half.vdb").density - grid.density).max() <= 2**-12
    assert list_grids(tmp_path / "half.vdb")[0].value_type == "float (half)"


@pytest.mark.parametrize(
    "matrix", [placed(), placed(origin=(1, 2, 3)), placed(edges=(2, 2, 2)), placed((1, 1, 0, 1.0))]
)
@pytest.mark.parametrize("edges", [(1, 1, 1), (0.5, 1.0, 2.0)])
def test_transforms_are_read_as_openvdb_reads_them(tmp_path, matrix, edges):
    matrix = matrix @ np.diag([*edges, 1.0])
    grid = filled()
    grid.transform = openvdb.createLinearTransform(matrix.T.tolist())
    [info] = list_grids(save(tmp_path / "x.vdb", grid))
    for at in np.vstack([np.zeros(3), np.eye(3)]):
        assert tuple((info.transform @ [*at, 1.0])[:3]) == pytest.approx(grid.transform.indexToWorld(tuple(at)))


@pytest.mark.parametrize("kind", ["FloatGrid", "DoubleGrid", "Int32Grid", "Int64Grid"])
def test_scalars_of_all_kinds(tmp_path, kind):
    if not hasattr(openvdb, kind):
        pytest.skip(f"this build of OpenVDB for Python makes no {kind}, Blender's own does")
    path = save(tmp_path / "x.vdb", filled(kind, ((0, 30), (60, 120)), ijk=(-5, 7, 100)))
    grid = read_volume(path)
    assert grid.density.ravel().tolist() == [0, 0.25, 0.5, 1]
    assert grid.transform[:3, 3].tolist() == [-5, 7, 100]
    assert grid.metadata["window"] == "0:120"
    assert read_volume(path, window=(30, 90)).density.ravel().tolist() == [0, 0, 0.5, 1]


def test_a_mask_is_full_where_it_is_on(tmp_path):
    mask = openvdb.BoolGrid()
    mask.fill((0, 0, 0), (1, 0, 0), True)
    assert read_volume(save(tmp_path / "x.vdb", mask)).density.ravel().tolist() == [1, 1]


def test_a_level_set_is_full_inside_and_half_full_on_its_surface(tmp_path):
    ball = openvdb.createLevelSetSphere(radius=4.0, center=(1.0, 2.0, 3.0), voxelSize=0.25, halfWidth=3.0)
    grid = read_volume(save(tmp_path / "ball.vdb", ball))
    assert grid.voxel_size == pytest.approx(0.25)
    assert grid.mass * 0.25**3 == pytest.approx(4 / 3 * np.pi * 4**3, rel=2e-3)
    index = np.linalg.solve(grid.transform, [1.0, 2.0, 3.0, 1.0])[:3]
    distance = 0.25 * np.linalg.norm(np.indices(grid.shape).T - index, axis=-1).T - 4.0
    assert np.abs(grid.density - np.clip(0.5 - distance / 0.25, 0, 1)).max() < 0.01
    assert "signed distance" in grid.notes[0]
    grown = read_volume(tmp_path / "ball.vdb", window=(0.625, 0.375))  # a surface half a unit further out
    assert grown.mass * 0.25**3 == pytest.approx(4 / 3 * np.pi * 4.5**3, rel=2e-3)


def test_a_grid_among_several(tmp_path):
    vector = openvdb.Vec3SGrid()
    vector.fill((0, 0, 0), (1, 1, 1), (1.0, 0.0, 0.0))
    vector.name = "velocity"
    grids = [vector, *(filled(values=[[n / 10]], name=name) for n, name in enumerate(["a", "b", "b", "", "q[1]"], 1))]
    path = save(tmp_path / "x.vdb", *grids)
    assert [info.key for info in list_grids(path)] == ["velocity", "a", "b[0]", "b[1]", "", "q[1]"]
    for ask, level in (("a", 1), ("b", 2), ("b[0]", 2), ("b[1]", 3), ("", 4), ("q[1]", 5), (2, 2), ("3", 3), (None, 1)):
        assert read_volume(path, grid=ask).mass == pytest.approx(level / 10)
    path = save(tmp_path / "x.vdb", *grids, filled(values=[[0.6]]))
    assert read_volume(path).mass == pytest.approx(0.6)  # "density" before all
    for ask, said in (
        ("velocity", "holds vec3s values"),
        (0, "holds vec3s values"),
        ("c", "no grid 'c'"),
        (9, "no grid 9"),
    ):
        with pytest.raises(FormatError, match=rf"x\.vdb: .*{said}.*'b\[1\]' \(float\)"):
            read_volume(path, grid=ask)


def test_what_has_no_scalars_is_described_all_the_same(tmp_path):
    vector = openvdb.Vec3SGrid()
    vector.fill((0, 0, 0), (1, 1, 1), (1.0, 0.0, 0.0))
    vector.name = "velocity"
    path = save(tmp_path / "x.vdb", vector)
    with pytest.raises(EmptyVolumeError, match="no scalar grid"):
        read_volume(path)
    told = describe(path)
    assert told["grids"][0].key == "velocity"
    assert "no scalar grid" in told["notes"][0]
    with pytest.raises(EmptyVolumeError, match="holds no grids"):
        read_volume(save(tmp_path / "none.vdb"))
    with pytest.raises(EmptyVolumeError, match="no active voxels"):
        read_volume(save(tmp_path / "hollow.vdb", openvdb.FloatGrid()))
    zeros = openvdb.FloatGrid()
    zeros.fill((0, 0, 0), (2, 2, 2), 0.0)
    with pytest.raises(EmptyVolumeError, match="holds nothing: its values go from 0 to 0"):
        read_volume(save(tmp_path / "zeros.vdb", zeros))


@pytest.mark.parametrize(
    ("values", "background", "window", "expected"),
    [
        ((-0.5, 0.5, 1.0), 0.0, "0:1", (0.0, 0.5, 1.0)),  # below nothing is nothing
        ((-1.0, 0.5, 2.0), 0.0, "0:2", (0.0, 0.25, 1.0)),
        ((-1000.0, 0.0, 1000.0), -1000.0, "-1000:1000", (0.0, 0.5, 1.0)),  # Hounsfield: the file says what air is
        ((0.0, 0.2, 1.0), 0.0, "0:1", (0.0, np.float32(0.2), 1.0)),
        ((float("nan"), 0.2, 1.0), 0.0, "0:1", (0.0, np.float32(0.2), 1.0)),
        ((float("inf"), 1.0, 2.0), 0.0, "0:2", (0.0, 0.5, 1.0)),
    ],
)
def test_the_window_that_is_taken_and_told(tmp_path, values, background, window, expected):
    grid = openvdb.FloatGrid(background)
    for at, value in enumerate(values):
        grid.fill((at, 0, 0), (at, 0, 0), value)
    read = read_volume(save(tmp_path / "x.vdb", grid))
    assert tuple(read.density.ravel().tolist()) == expected
    assert read.metadata["window"] == window
    assert any("no finite number" in note for note in read.notes) == (not np.isfinite(values).all())
    assert any("of class 'unknown'" in note for note in read.notes)


def test_values_all_below_the_background_ask_for_a_window(tmp_path):
    path = save(tmp_path / "x.vdb", filled(values=((-4, -3), (-2, -1)), background=0.0))
    with pytest.raises(FormatError, match="give a window"):
        read_volume(path)
    assert read_volume(path, window=(-5, -1)).density.ravel().tolist() == [0.25, 0.5, 0.75, 1.0]


def test_a_box_that_would_fill_the_memory_is_refused(tmp_path):
    far = filled()
    far.fill((1_000_000_000, 0, 0), (1_000_000_000, 0, 0), 1.0)
    far.fill((-1_000_000_000, 0, 0), (-1_000_000_000, 0, 0), 1.0)
    with pytest.raises(FormatError, match="spans 2000000001 x 2 x 1 voxels, more than the 536870912"):
        read_volume(save(tmp_path / "far.vdb", far))


@pytest.mark.parametrize("at", [1 << 30, (1 << 31) - 1, -(1 << 30), -(1 << 31)])
def test_indices_with_which_openvdb_would_crash_or_hang_are_refused(tmp_path, at):
    grid = openvdb.FloatGrid()
    grid.getAccessor().setValueOn((0, 0, at), 1.0)
    with pytest.raises(FormatError, match=r"far\.vdb: grid '' lies too far out"):
        read_volume(save(tmp_path / "far.vdb", grid))
    near = openvdb.FloatGrid()
    near.getAccessor().setValueOn((0, 0, int(at * 0.499)), 1.0)
    assert read_volume(save(tmp_path / "near.vdb", near)).mass == 1.0


def test_a_shape_that_is_not_the_values_is_not_believed(tmp_path):
    for shape in ("1 1 1", "0 0 0", "99999 99999", "x", "-2 3 4"):
        grid = filled()
        grid[vdb.SHAPE] = shape
        assert read_volume(save(tmp_path / "x.vdb", grid)).shape == (2, 2, 1)
    grid[vdb.SHAPE] = "99999 99999 99999"
    with pytest.raises(FormatError, match="spans 99999 x 99999 x 99999 voxels"):
        read_volume(save(tmp_path / "x.vdb", grid))


def test_shear_is_refused_and_unequal_voxels_become_cubes(tmp_path):
    grid = filled()
    grid.transform = openvdb.createLinearTransform([[1, 0, 0, 0], [0.3, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    with pytest.raises(FormatError, match=r"x\.vdb: its transform shears"):
        read_volume(save(tmp_path / "x.vdb", grid))
    grid.transform = openvdb.createLinearTransform([[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [3, 4, 5, 1]])
    cubes = read_volume(save(tmp_path / "x.vdb", grid))
    assert cubes.density[:, :, 0].tolist() == [[0.25, 0.25, 0.5, 0.5], [0.75, 0.75, 1, 1]]
    assert cubes.transform[:3, 3] == pytest.approx([3, 3.5, 5])
    frustum = filled()
    frustum.transform = openvdb.createFrustumTransform((0, 0, 0), (1, 1, 1), 0.5, 2.0)
    with pytest.raises(FormatError, match="linear"):
        read_volume(save(tmp_path / "f.vdb", frustum), grid="density")


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "sound.vdb"
    write_volume(DensityGrid(np.random.default_rng(5).random((12, 12, 12)), metadata={"made": "of clay"}), path)
    return path.read_bytes()


def test_a_file_cut_anywhere_is_refused(tmp_path, sound):
    path = tmp_path / "cut.vdb"
    for length in [*range(1500), *range(1500, len(sound), 37), *range(len(sound) - 50, len(sound))]:
        path.write_bytes(sound[:length])
        with pytest.raises(FormatError, match=r"cut\.vdb: (damaged|is)") as error:
            read_volume(path)
        assert "\n" not in str(error.value)


def test_lengths_and_counts_that_lie_are_refused_before_openvdb_believes_them(tmp_path, sound):
    path = tmp_path / "liar.vdb"
    places = {"a name's length": sound.index(b"density") - 4, "a text's length": sound.index(b"of clay") - 4}
    names = sound.index(b"UniformScaleMap") + 15
    places |= {"tiles of the root": names + 15 * 8 + 8, "branches of the root": names + 15 * 8 + 12}
    for at in places.values():
        assert struct.unpack_from("<I", sound, at)[0] <= 7
        for lie in (0xFFFFFFFF, 0x7FFFFFFF, 0x00FFFFFF):
            path.write_bytes(sound[:at] + struct.pack("<I", lie) + sound[at + 4 :])
            with pytest.raises(FormatError, match=r"liar\.vdb: damaged"):
                read_volume(path)


@pytest.mark.parametrize("keep", [0, 8, 24, 70])
def test_a_million_random_bytes_are_refused(tmp_path, sound, keep):
    path = tmp_path / "noise.vdb"
    path.write_bytes(sound[:keep] + np.random.default_rng(keep).bytes(1_000_000))
    with pytest.raises(FormatError, match=r"noise\.vdb: "):
        read_volume(path)


@pytest.mark.skipif(
    not bpy.app.module, reason="Debian's OpenVDB crashes when it drops a tree that it could not finish reading"
)
def test_a_tree_of_noise_is_an_error_or_a_grid_but_never_the_end(tmp_path, sound):
    path = tmp_path / "noise.vdb"
    noise = np.random.default_rng(8)
    refused = 0
    for _ in range(60):
        data = bytearray(sound)
        for at in noise.integers(len(sound) // 2, len(sound), 5):
            data[at] = noise.integers(256)
        path.write_bytes(data)
        try:
            read_volume(path)
        except FormatError as error:
            refused += 1
            assert str(path) in str(error)
    assert refused


def test_a_failed_write_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "x.vdb"
    path.write_bytes(b"before")
    grid = DensityGrid(np.ones((2, 2, 2)))
    with pytest.raises(FormatError, match=r"x\.vdb: cannot be written, OpenVDB says"):
        write_volume(DensityGrid(np.ones((2, 2, 2)), metadata={"n": object()}), path)
    write = openvdb.write

    def cut(name, **content):
        write(name, **content)
        Path(name).write_bytes(Path(name).read_bytes()[:-9])

    monkeypatch.setattr(openvdb, "write", cut)  # as OpenVDB does on a full disk, without a word
    with pytest.raises(FormatError, match=r"x\.vdb: cannot be written whole"):
        write_volume(grid, path)
    assert path.read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["x.vdb"]


def test_without_blender_there_is_one_clear_line(tmp_path, sound, monkeypatch):
    path = tmp_path / "x.vdb"
    path.write_bytes(sound)
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(FormatError, match=r"x\.vdb: \.vdb files need OpenVDB, which comes with Blender"):
        read_volume(path)
    assert list_grids(path)[0].key == "density"


@real
@pytest.mark.parametrize(
    ("name", "shape", "edge", "said"),
    [
        ("smoke_v222_half", (111, 222, 112), 0.47619, "window 0:5.71"),
        ("cube_ls_v222_half", (225, 225, 225), 0.05, "signed distance"),
        ("levelset_noname", (79, 77, 77), 0.03, "signed distance"),
        ("aniso_affine", (109, 190, 99), 0.01, "resampled to cubes of 0.01"),
        ("three_grids_same_name", (11, 11, 11), 0.1, "window 0:10"),
        (
            "scivis_negative_values",
            (81, 81, 81),
            1.0,
            "values -0.235319 to 1.38177 became density by the window 0:1.38",
        ),
        ("mantaflow_gas_half_5grids", (21, 21, 32), 0.47297, "as they are"),
        ("bunny32_class_unknown", (32, 32, 25), 1.0, "class 'unknown'"),
        ("sphere_fog_v223", (11, 9, 11), 0.2, "as they are"),
    ],
)
def test_real_volumes_are_read_as_their_manifest_says(name, shape, edge, said):
    grid = read_volume(DATA / f"{name}.vdb")
    assert grid.shape == shape
    assert grid.voxel_size == pytest.approx(edge, rel=1e-4)
    assert any(said in note for note in grid.notes)


@real
def test_real_volumes_keep_their_mass_and_place_when_resampled():
    [info] = list_grids(DATA / "aniso_affine.vdb")
    raw = vdb.read(DATA / "aniso_affine.vdb", None)
    grid = read_volume(DATA / "aniso_affine.vdb")
    assert info.edges == pytest.approx((0.01, 0.02, 0.01))
    volume = abs(np.linalg.det(raw.transform[:3, :3]))
    assert grid.mass * grid.voxel_size**3 == pytest.approx(raw.values.sum(dtype=float) * volume, rel=1e-6)
    turned = np.sqrt(0.5) * grid.voxel_size  # by 45 degrees about y
    assert grid.transform[[0, 0, 2, 2], [0, 2, 0, 2]] == pytest.approx([turned, turned, -turned, turned])


@real
def test_real_volumes_that_cannot_be_sculpted_say_why():
    with pytest.raises(EmptyVolumeError, match=r"sphere-div2_allzero\.vdb: grid 'density' holds nothing"):
        read_volume(DATA / "sphere-div2_allzero.vdb")
    with pytest.raises(
        EmptyVolumeError, match=r"pointgrid_only\.vdb: holds no scalar grid .* 'points' \(ptdataidx32\)"
    ):
        read_volume(DATA / "pointgrid_only.vdb")
    masses = {read_volume(DATA / "three_grids_same_name.vdb", grid=f"density[{n}]").shape for n in range(3)}
    assert masses == {(11, 11, 11), (19, 19, 22)}
    assert len(list_grids(DATA / "mantaflow_gas_half_5grids.vdb")) == 5


@real
def test_real_volumes_cut_in_twenty_places_are_refused(tmp_path):
    path = tmp_path / "cut.vdb"
    for whole in sorted(DATA.glob("*.vdb")):
        data = whole.read_bytes()
        for part in range(20):
            path.write_bytes(data[: len(data) * part // 20])
            with pytest.raises(FormatError, match=r"cut\.vdb: (damaged|is empty)"):
                read_volume(path)
