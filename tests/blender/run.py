# SPDX-License-Identifier: GPL-3.0-or-later
"""Run tests/blender inside a real Blender, on the extension as a user gets it: `run.py BLENDER [pytest's arguments]`.

The zip is built for this machine and installed by Blender's own command into a user folder made for the occasion.
Blender's Python need not have pytest: the environment's is lent to it.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LENT = (
    "pytest",
    "_pytest",
    "pluggy",
    "iniconfig",
    "packaging",
    "pygments",
)  # pytest, and what it needs: all pure Python


def lend_pytest(folder: Path) -> None:
    """Link pytest alone into `folder`: the rest of the environment is for another Python."""
    folder.mkdir()
    for name in LENT:
        origin = importlib.util.find_spec(name).origin
        (folder / name).symlink_to(Path(origin).parent)


def main() -> int:
    """Exit code of pytest inside Blender, or of the first step that fails before it."""
    blender, arguments = sys.argv[1], sys.argv[2:] or ["tests/blender"]
    if shutil.which(blender) is None:
        print(
            f"run.py: no program {blender}: name a Blender, as in make test-blender BLENDER=/path/to/blender",
            file=sys.stderr,
        )
        return 1
    with tempfile.TemporaryDirectory(prefix="repousse-blender-") as name:
        folder = Path(name)
        build = [sys.executable, ".ci/package.py", "--platforms", "host", "--out", str(folder)]
        if failed := subprocess.run(build, cwd=ROOT).returncode:
            return failed
        (extension,) = folder.glob("*.zip")
        lend_pytest(folder / "pytest")
        # The order matters: Blender's Python may have a pytest, of some version.
        expression = (
            f"import sys; sys.path.insert(0, {str(folder / 'pytest')!r}); import pytest; "
            f"sys.exit(pytest.main(['-c', 'tests/pytest.ini', *{arguments!r}]))"
        )
        environment = os.environ | {
            "BLENDER_USER_RESOURCES": str(folder / "user"),
            "REPOUSSE_ZIP": str(extension),
        }
        for step in (
            ["--command", "extension", "install-file", "--repo", "user_default", "--enable", str(extension)],
            ["--background", "--python-exit-code", "1", "--python-expr", expression],
        ):
            if failed := subprocess.run(
                [blender, *step], cwd=ROOT, env=environment, stdin=subprocess.DEVNULL
            ).returncode:
                return failed
    return 0


if __name__ == "__main__":
    sys.exit(main())
