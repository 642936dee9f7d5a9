# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zip for Blender: `python .ci/package.py [--platforms linux-x64,macos-arm64] --out FOLDER`.

The manifest says all: for which platforms, and which wheels. Those of other packages come from PyPI by the tags in
their names, our kernels from core/native/build.py, so any machine builds for all of them. Blender's own builder, which
is in the bpy wheel, then makes and validates the zip from a copy of what pyproject.toml names as packages.
"""

import argparse
import importlib.util
import json
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WHEELS = ROOT / "build" / "wheels"
KERNELS = "repousse_kernels"
BESIDE_THE_CODE = ("README.md", "CHANGELOG.md", "LICENSE")


class PackageError(RuntimeError):
    """The zip cannot be built; its text is one line for a person."""


def run(what: str, command: list[str]) -> None:
    """Run a command whose output only matters when it fails; PackageError then, after that output on stderr."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        print(done.stdout, end="", file=sys.stderr)
        raise PackageError(f"{what} failed")


def read_toml(name: str) -> dict:
    """The root's TOML file `name`."""
    return tomllib.loads((ROOT / name).read_text(encoding="utf-8"))


def host_platform() -> str:
    """This machine in Blender's words, as the kernels' build knows it."""
    return runpy.run_path(str(ROOT / "core" / "native" / "build.py"))["host"]()


def platform_of(wheel: str) -> str:
    """Blender's word for the platform that the file name of a wheel ends with."""
    tag = Path(wheel).stem.rpartition("-")[2]
    systems = {"manylinux": "linux", "win": "windows", "macosx": "macos"}
    system = next(name for prefix, name in systems.items() if tag.startswith(prefix))
    return f"{system}-{'arm64' if tag.endswith(('arm64', 'aarch64')) else 'x64'}"


def fetch(wheel: str) -> Path:
    """Path of the wheel of this file name, built or downloaded where it is not there yet."""
    path = WHEELS / wheel
    name, version, python, abi, tags = path.stem.split("-")
    if name == KERNELS:
        build = [sys.executable, str(ROOT / "core" / "native" / "build.py"), "--out", str(WHEELS)]
        run(f"building {wheel}", [*build, "--platform", platform_of(wheel)])
    elif not path.exists():
        download = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        download += ["--only-binary=:all:", "--implementation", python[:2], "--python-version", python[2:]]
        download += ["--abi", abi, *(f"--platform={tag}" for tag in tags.split("."))]
        with tempfile.TemporaryDirectory(dir=WHEELS) as scratch:
            run(f"downloading {wheel}", [*download, "--dest", scratch, f"{name}=={version}"])
            (Path(scratch) / wheel).rename(path)
    return path


def stage(folder: Path, platforms: list[str], wheels: list[Path]) -> None:
    """Copy what is shipped into `folder`, with a manifest that names these platforms and wheels alone."""
    packages = read_toml("pyproject.toml")["tool"]["setuptools"]["packages"]
    for package in {name.split(".")[1] for name in packages if "." in name}:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__", ".*", "*.md"))
    for name in ("__init__.py", *BESIDE_THE_CODE):
        shutil.copy(ROOT / name, folder)

    (folder / "wheels").mkdir()
    for wheel in wheels:
        shutil.copy(wheel, folder / "wheels")

    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    for key, values in (("platforms", platforms), ("wheels", [f"./wheels/{wheel.name}" for wheel in wheels])):
        manifest = re.sub(rf"^{key} = \[.*?\]$", f"{key} = {json.dumps(values)}", manifest, flags=re.M | re.S)
    (folder / "blender_manifest.toml").write_text(manifest, encoding="utf-8")


def make_zip(source: Path, output: Path) -> None:
    """Let Blender's builder make `output` of the folder `source`, and check the result as Blender checks it."""
    bpy = importlib.util.find_spec("bpy")  # only found, not imported: that takes a second and a display's libraries
    assert bpy is not None
    (scripts,) = Path(bpy.submodule_search_locations[0]).glob("*/scripts")
    builder = [sys.executable, str(scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py")]
    tags = f"--valid-tags={scripts / 'modules' / '_bpy_internal' / 'extensions' / 'tags.py'}"
    with tempfile.TemporaryDirectory(dir=output.parent) as scratch:
        made = Path(scratch) / output.name
        run("the build", [*builder, "build", tags, "--source-dir", str(source), "--output-filepath", str(made)])
        run("the check of the zip", [*builder, "validate", tags, str(made)])
        made.rename(output)


def package(platforms: list[str], folder: Path) -> Path:
    """Build the zip for these platforms into `folder` and return its path."""
    manifest = read_toml("blender_manifest.toml")
    unknown = set(platforms) - set(manifest["platforms"])
    if unknown or not platforms:
        raise PackageError(f"no such platform: {', '.join(unknown) or 'none'} (of {', '.join(manifest['platforms'])})")
    WHEELS.mkdir(parents=True, exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    wheels = [fetch(name) for name in map(_file_name, manifest["wheels"]) if platform_of(name) in platforms]
    output = folder / f"{manifest['id']}-{manifest['version']}.zip"
    with tempfile.TemporaryDirectory() as source:
        stage(Path(source), platforms, wheels)
        make_zip(Path(source), output)
    return output


def _file_name(path: str) -> str:
    return path.rpartition("/")[2]


def main() -> int:
    """Build what the command line asks for; 1 with one line on stderr when that fails."""
    parser = argparse.ArgumentParser(description="Build the extension's zip.")
    parser.add_argument("--platforms", default="all", help="all, host, or some of them with commas between")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    options = parser.parse_args()
    try:
        every = read_toml("blender_manifest.toml")["platforms"]
        named = {"all": every, "host": [host_platform()]}.get(options.platforms)
        output = package(named or options.platforms.replace(",", " ").split(), options.out)
    except RuntimeError as error:  # the kernels' build has one of its own
        print(f"package.py: {error}", file=sys.stderr)
        return 1
    print(f"{output}  {output.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
