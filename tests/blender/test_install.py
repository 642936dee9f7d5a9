# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip holds what it should and nothing else; Blender installs it, and disabling it leaves nothing behind."""

import base64
import hashlib
import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    name.split(".")[1]
    for name in tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    if "." in name
}
MAGIC = {"linux": b"\x7fELF", "windows": b"MZ", "macos": b"\xcf\xfa\xed\xfe"}

builds_zips = pytest.mark.skipif(
    not (bpy.app.module and importlib.util.find_spec("ziglang")), reason="only the environment of make setup builds"
)


@pytest.fixture(scope="session")
def zip_path(tmp_path_factory):
    """The extension for this machine: the zip under test (run.py), else one that is built here."""
    if given := os.environ.get("REPOUSSE_ZIP"):
        return Path(given)
    folder = tmp_path_factory.mktemp("zip")
    subprocess.run(
        [sys.executable, ".ci/package.py", "--platforms", "host", "--out", str(folder)], cwd=ROOT, check=True
    )
    (path,) = folder.iterdir()  # one file, and no temporary one beside it
    return path


@pytest.fixture(scope="session")
def archive(zip_path):
    with zipfile.ZipFile(zip_path) as archive:
        yield archive


@pytest.fixture(scope="session")
def manifest(archive):
    return tomllib.loads(archive.read("blender_manifest.toml").decode())


def test_zip_holds_the_add_on_and_nothing_else(archive, manifest):
    code = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in {".py", ".c", ".dat", ".toml"}
    }
    beside = {"__init__.py", "blender_manifest.toml", "README.md", "CHANGELOG.md", "LICENSE"}
    wheels = {wheel.removeprefix("./") for wheel in manifest["wheels"]}
    assert set(archive.namelist()) == code | beside | wheels
    assert {"core/push.py", "core/native/kernels.c", "operators/cli.py", "ui/icons/repousse.push.dat"} <= code
    assert {"device/loop.py", "device/profiles/links.toml"} <= code
    assert not {"tests", ".ci", "build"} & {name.split("/")[0] for name in archive.namelist()}


def test_zip_has_the_wheels_of_its_platforms_alone(manifest):
    (platform,) = manifest["platforms"]
    names = [Path(wheel).name for wheel in manifest["wheels"]]
    assert sorted(name.split("-")[2] for name in names if name.startswith("hidapi-0.15.0-")) == [
        "cp311",
        "cp313",
        "cp314",
    ]
    assert [name.split("-")[2:4] for name in names if name.startswith("repousse_kernels-")] == [["py3", "none"]]
    tag = {"linux": "manylinux", "windows": "win", "macos": "macosx"}[platform.split("-")[0]]
    assert all(Path(name).stem.split("-")[-1].startswith(tag) for name in names)


def test_committed_manifest_has_every_wheel_of_every_platform():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    platform_of = runpy.run_path(str(ROOT / ".ci" / "package.py"))["platform_of"]
    found = sorted((platform_of(name), *Path(name).name.split("-")[:3:2]) for name in manifest["wheels"])
    assert found == sorted(
        (platform, *wheel)
        for platform in manifest["platforms"]
        for wheel in [("repousse_kernels", "py3"), ("hidapi", "cp311"), ("hidapi", "cp313"), ("hidapi", "cp314")]
    )


def test_manifest_is_as_the_extensions_platform_wants_it(manifest):
    assert (manifest["schema_version"], manifest["id"], manifest["type"]) == ("1.0.0", "repousse", "add-on")
    assert manifest["blender_version_min"] == "4.5.0"
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert len(manifest["tagline"]) <= 64 and manifest["tagline"][-1].isalnum()
    assert list(manifest["permissions"]) == ["files", "clipboard"]  # what the code uses, and no more
    assert all(len(reason) <= 64 and reason[-1].isalnum() for reason in manifest["permissions"].values())


def test_one_version_everywhere(manifest):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    (kernels,) = (Path(wheel).name.split("-")[1] for wheel in manifest["wheels"] if "repousse_kernels" in wheel)
    assert project["version"] == manifest["version"] == kernels
    assert re.search(rf"^## \[{re.escape(manifest['version'])}\]", changelog, re.MULTILINE)


def test_kernels_wheel_is_whole(archive, manifest, tmp_path):
    (name,) = (wheel.removeprefix("./") for wheel in manifest["wheels"] if "repousse_kernels" in wheel)
    (tmp_path / "wheel").write_bytes(archive.read(name))
    with zipfile.ZipFile(tmp_path / "wheel") as wheel:
        (record,) = (entry for entry in wheel.namelist() if entry.endswith(".dist-info/RECORD"))
        rows = dict(row.split(",", 1) for row in wheel.read(record).decode().splitlines())
        assert set(rows) == set(wheel.namelist())
        assert rows.pop(record) == ","
        for entry, row in rows.items():
            data = wheel.read(entry)
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            assert row == f"sha256={digest},{len(data)}"
        (library,) = (entry for entry in wheel.namelist() if entry.startswith("repousse_kernels/kernels."))
        assert wheel.read(library).startswith(MAGIC[manifest["platforms"][0].split("-")[0]])


@builds_zips
def test_same_source_makes_the_same_wheel(tmp_path):
    wheels = []
    for name in ("one", "two"):
        command = [sys.executable, "core/native/build.py", "--out", str(tmp_path / name)]
        done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
        wheels.append(Path(done.stdout.strip()))
    assert wheels[0].name == wheels[1].name
    assert wheels[0].read_bytes() == wheels[1].read_bytes()


@builds_zips
def test_unknown_platform_is_refused_in_one_line(tmp_path):
    command = [sys.executable, ".ci/package.py", "--platforms", "linux-x64,beos-x64", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "beos-x64" in done.stderr and len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="session")
def life(zip_path, tmp_path_factory):
    """What life.py saw in its two rounds, in a Blender of its own with a fresh user folder."""
    folder = tmp_path_factory.mktemp("life")
    script = str(Path(__file__).with_name("life.py"))
    command = [sys.executable, script]
    if not bpy.app.module:
        command = [bpy.app.binary_path, "--background", "--python-exit-code", "1", "--python", script, "--"]
    report = folder / "report.json"
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")}
    done = subprocess.run(
        [*command, str(zip_path), str(report)],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    assert done.returncode == 0, done.stdout
    assert "Traceback" not in done.stdout, done.stdout
    return json.loads(report.read_text(encoding="utf-8"))


def test_blender_installs_the_zip_with_its_wheels(life):
    for found in life:
        assert found["enabled"]
        assert found["kernels"].startswith("compiled")
        assert {"repousse_kernels", "hid"} <= set(found["unpacked"])


def test_enabling_adds_the_operators_and_nothing_of_another_name(life):
    for found in life:
        assert {"REPOUSSE_OT_import_volume", "REPOUSSE_OT_export_vdb"} <= set(found["added"]["types"])
        assert all(name.lower().startswith("repousse") for name in found["added"]["types"])


def test_disabling_leaves_nothing_behind_and_takes_nothing_away(life):
    for found in life:
        assert found["left"] == {}
        assert found["taken"] == {}


def test_enabling_again_does_the_same(life):
    first, second = life
    assert first["added"] == second["added"]
