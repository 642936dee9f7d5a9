# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile kernels.c for any platform from any machine, each into a wheel that every Python can use.

`python core/native/build.py [--platform linux-x64 ...] --out FOLDER` prints the path of each wheel. The compiler is
the `zig cc` of the `ziglang` package; it needs no system compiler, SDK or network. The wheel holds an empty package
and the library, which the loader opens with ctypes, so one wheel serves all versions of Python (py3-none-PLATFORM).
"""

import argparse
import base64
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).with_name("kernels.c")
ROOT = SOURCE.parents[2]
CACHE = ROOT / "build" / "zig"
CACHE_LIMIT = 1 << 30  # bytes; zig never removes what it has cached
PACKAGE = "repousse_kernels"

FLAGS = [
    *("-std=c99", "-O3", "-fno-math-errno", "-fPIC", "-shared", "-fvisibility=hidden", "-s"),
    "-ffp-contract=off",  # or arm64 fuses multiply and add, and rounds otherwise than x86-64 and the numpy twins
    *("-Wall", "-Wextra", "-Werror"),
]


class Target(NamedTuple):
    """What one of Blender's platforms is called by zig and by Python's wheels."""

    triple: str
    tag: str
    library: str
    faster: str = ""  # what processors the same source is compiled for once more, beside the oldest of the platform


TARGETS = {
    "linux-x64": Target("x86_64-linux-gnu.2.28", "manylinux_2_28_x86_64", "kernels.so", "avx2"),
    "linux-arm64": Target("aarch64-linux-gnu.2.28", "manylinux_2_28_aarch64", "kernels.so"),
    "windows-x64": Target("x86_64-windows-gnu", "win_amd64", "kernels.dll", "avx2"),
    "macos-x64": Target("x86_64-macos.11.0-none", "macosx_11_0_x86_64", "kernels.dylib", "avx2"),
    "macos-arm64": Target("aarch64-macos.11.0-none", "macosx_11_0_arm64", "kernels.dylib"),
}


class BuildError(RuntimeError):
    """The kernels cannot be built; its text is one line for a person, after what the compiler has printed."""


def host() -> str:
    """Name of this machine's platform, one of TARGETS; BuildError on any other."""
    system = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system(), platform.system())
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    if (name := f"{system}-{machine}") not in TARGETS:
        raise BuildError(f"no kernels for {name}: choose a platform of {', '.join(TARGETS)}")
    return name


def compile_library(target: Target, output: Path, feature: str = "") -> None:
    """Compile kernels.c for `target`, and processors with `feature`, into `output`; BuildError when that fails."""
    if CACHE.is_dir() and sum(file.stat().st_size for file in CACHE.rglob("*") if file.is_file()) > CACHE_LIMIT:
        shutil.rmtree(CACHE)
    cache = {"ZIG_GLOBAL_CACHE_DIR": str(CACHE), "ZIG_LOCAL_CACHE_DIR": str(CACHE)}
    cpu = f"-mcpu=baseline+{feature}" if feature else "-mcpu=baseline"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target.triple, cpu, *FLAGS]
    command += ["-o", str(output), str(SOURCE)]
    try:
        subprocess.run(command, env=os.environ | cache, check=True, stdout=sys.stderr)
    except subprocess.CalledProcessError as error:
        raise BuildError(f"{SOURCE.name} does not compile for {target.triple}") from error


def write_wheel(libraries: dict[str, bytes], target: Target, version: str, folder: Path) -> Path:
    """Write the wheel that holds `libraries`, by name, into `folder`; the same bytes for the same libraries."""
    info = f"{PACKAGE}-{version}.dist-info"
    files = {
        f"{PACKAGE}/__init__.py": (
            '# SPDX-License-Identifier: GPL-3.0-or-later\n"""The compiled kernels of Repoussé."""\n'
        ).encode(),
        **{f"{PACKAGE}/{name}": library for name, library in libraries.items()},
        f"{info}/METADATA": (
            f"Metadata-Version: 2.4\nName: {PACKAGE}\nVersion: {version}\n"
            "Summary: The compiled kernels of Repoussé\nLicense-Expression: GPL-3.0-or-later\n"
        ).encode(),
        f"{info}/WHEEL": (
            f"Wheel-Version: 1.0\nGenerator: {PACKAGE}\nRoot-Is-Purelib: false\nTag: py3-none-{target.tag}\n"
        ).encode(),
    }
    record = "".join(
        f"{name},sha256={base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b'=').decode()},{len(data)}\n"
        for name, data in files.items()
    )
    files[f"{info}/RECORD"] = (record + f"{info}/RECORD,,\n").encode()

    path = folder / f"{PACKAGE}-{version}-py3-none-{target.tag}.whl"
    temporary = path.with_suffix(f".{os.getpid()}.part")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)  # its date is fixed, 1980
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    temporary.replace(path)
    return path


def build(name: str, folder: Path) -> Path:
    """Build the wheel of platform `name` (a key of TARGETS) into `folder` and return its path."""
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
    folder.mkdir(parents=True, exist_ok=True)
    target = TARGETS[name]
    with tempfile.TemporaryDirectory() as scratch:
        libraries = {}
        for feature in dict.fromkeys(["", target.faster]):
            library = Path(scratch) / (f"{feature}-" * bool(feature) + target.library)
            compile_library(target, library, feature)
            libraries[library.name] = library.read_bytes()
        return write_wheel(libraries, target, version, folder)


def main() -> int:
    """Build what the command line asks for; 1 with one line on stderr when that fails."""
    parser = argparse.ArgumentParser(description="Compile the kernels into wheels.")
    parser.add_argument("--platform", nargs="+", choices=TARGETS, metavar="NAME", help=f"of {', '.join(TARGETS)}")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    options = parser.parse_args()
    try:
        for name in options.platform or [host()]:
            print(build(name, options.out), flush=True)
    except BuildError as error:
        print(f"build.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
