# SPDX-License-Identifier: GPL-3.0-or-later
"""Run tests/blender inside a real Blender, on the extension as a user gets it: `run.py BLENDER [pytest's arguments]`.

The zip is built for this machine and installed by Blender's own command into a user folder made for the occasion.
pytest and hypothesis are lent to Blender's Python, whatever its version, from a folder of their own.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class StepError(RuntimeError):
    """A step before the tests failed; its text is one line for a person."""


def run(what: str, command: list[str], **options) -> str:
    """Standard output of a command; StepError when it fails."""
    done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, **options)
    if done.returncode:
        print(done.stdout, end="", file=sys.stderr)
        raise StepError(f"{what} failed")
    return done.stdout


def test_tools(blender: str) -> Path:
    """The folder with the pinned pytest and hypothesis for the Python of this Blender, filled where it is not yet."""
    expression = "import sys; print('python=%d.%d' % sys.version_info[:2])"
    said = run("starting Blender", [blender, "--background", "--python-expr", expression])
    version = re.search(r"^python=(\S+)", said, re.MULTILINE)[1]
    folder = ROOT / "build" / f"test-tools-{version}"
    if not folder.exists():
        pins = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
        wanted = [pin for pin in pins["dev"] if pin.startswith(("pytest==", "hypothesis=="))]
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted]
        install += ["--only-binary=:all:", "--python-version", version, "--constraint", ".ci/constraints.txt"]
        with tempfile.TemporaryDirectory(dir=ROOT / "build") as scratch:
            run(f"installing {' and '.join(wanted)}", [*install, "--target", f"{scratch}/tools"])
            Path(scratch, "tools").rename(folder)
    return folder


@contextmanager
def installed(blender: str) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder for the occasion, and the environment in which this Blender has the extension, as a user gets it.

    Raises StepError.
    """
    if shutil.which(blender) is None:
        raise StepError(f"there is no {blender}: say which Blender, as in BLENDER=PATH")
    with tempfile.TemporaryDirectory(prefix="repousse-blender-") as folder:
        run("the build", [sys.executable, ".ci/package.py", "--platforms", "host", "--out", folder])
        (extension,) = Path(folder).glob("*.zip")
        environment = os.environ | {"BLENDER_USER_RESOURCES": f"{folder}/user", "REPOUSSE_ZIP": str(extension)}
        install = ["--command", "extension", "install-file", "--repo", "user_default", "--enable", str(extension)]
        run("the installation", [blender, *install], env=environment)
        yield Path(folder), environment


def main() -> int:
    """Exit code of pytest inside Blender; 1 with one line on stderr when it does not come to that."""
    blender, arguments = sys.argv[1], sys.argv[2:] or ["tests/blender"]
    try:
        with installed(blender) as (_, environment):
            tools = test_tools(blender)
            # First on the path, for Blender's Python may have a pytest of another version.
            expression = (
                f"import sys; sys.path.insert(0, {str(tools)!r}); import pytest; "
                f"sys.exit(pytest.main(['-c', 'tests/pytest.ini', *{arguments!r}]))"
            )
            tests = [blender, "--background", "--python-exit-code", "1", "--python-expr", expression]
            return subprocess.run(tests, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL).returncode
    except StepError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
