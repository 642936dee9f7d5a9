# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files of a session stay, for how long, and that nothing grows without bound."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import bpy
import pytest

from repousse.core.formats import read_volume
from repousse.operators import handlers, revisions, session
from repousse.operators.processes import is_alive

from .sculpting import in_file, new_clay, same, stroke, the

wheel_only = pytest.mark.skipif(not bpy.app.module, reason="starts Blender as a Python module")


@pytest.fixture(autouse=True)
def closed():
    yield
    session.close_session()


@pytest.fixture
def clay():
    return new_clay(name="Clay")


@pytest.fixture
def undo_steps():
    """Set how far undo goes."""
    edit = bpy.context.preferences.edit
    former = edit.undo_steps

    def choose(steps):
        edit.undo_steps = steps

    yield choose
    edit.undo_steps = former


@pytest.fixture
def autosave():
    """Where Blender saves an unnamed file of this process by itself; written by calling it."""
    path = Path(bpy.app.tempdir).parent / f"{os.getpid()}_autosave.blend"
    clock = iter(range(1, 100))

    def write():
        path.write_bytes(b"")
        os.utime(path, (0, next(clock)))  # each at another time, however fast the test is
        return path

    yield write
    path.unlink(missing_ok=True)


def files():
    return {path.name for path in revisions.folder().iterdir()}


def current():
    return {path.name for path in revisions.shown()}


@pytest.mark.parametrize("steps", [3, 10])
def test_undo_finds_every_file_that_it_reaches(clay, undo_steps, steps):
    undo_steps(steps)
    states = [in_file(clay)] + [stroke(the("Clay"), seed) for seed in range(2 * steps + 3)]
    assert steps + 1 <= len(files()) <= steps + 2
    back = 0
    while bpy.ops.ed.undo.poll():
        bpy.ops.ed.undo()
        back += 1
        assert same(in_file(the("Clay")), states[-1 - back])
        assert same(session.live().grid.density, states[-1 - back])
    assert back >= steps
    for number in range(back):
        bpy.ops.ed.redo()
        assert same(in_file(the("Clay")), states[len(states) - back + number])


def test_what_was_undone_goes_when_a_stroke_takes_its_place(clay, undo_steps):
    undo_steps(20)
    for seed in range(8):
        stroke(the("Clay"), seed)
    for _ in range(5):
        bpy.ops.ed.undo()
    kept = current()
    assert len(files()) == 9
    states = [in_file(the("Clay")), stroke(the("Clay"), 99)]
    assert len(files()) == 5 and kept <= files()
    bpy.ops.ed.undo()
    assert same(in_file(the("Clay")), states[0])
    for _ in range(3):
        bpy.ops.ed.undo()
        assert in_file(the("Clay")).size
    for _ in range(4):
        bpy.ops.ed.redo()
    assert same(in_file(the("Clay")), states[1])


def test_each_of_several_volumes_keeps_what_undo_reaches(clay, undo_steps):
    undo_steps(6)
    new_clay(name="Other")
    states = []
    for seed in range(20):
        name = "Clay" if seed % 5 == 0 else "Other"
        stroke(the(name), seed)
        states.append((in_file(the("Clay")), in_file(the("Other"))))
    assert len(files()) <= 6 + 2 + 2
    for clay_then, other_then in reversed(states[-6:-1]):
        bpy.ops.ed.undo()
        assert same(in_file(the("Clay")), clay_then) and same(in_file(the("Other")), other_then)


def test_a_removed_volume_comes_back_with_its_voxels(clay, undo_steps):
    undo_steps(8)
    other = new_clay(name="Other")
    density = stroke(other, 1)
    bpy.data.volumes.remove(the("Other").data)
    bpy.ops.ed.undo_push(message="Delete")
    for seed in range(4):
        stroke(the("Clay"), seed)
    for _ in range(5):
        bpy.ops.ed.undo()
    assert same(in_file(the("Other")), density)


def test_a_removed_volume_comes_back_although_others_were_undone(clay, undo_steps):
    """What was undone and sculpted over is another volume's; the removed one's strokes lie before that."""
    undo_steps(30)
    stroke(clay, 0)
    new_clay(name="Other")
    for seed in range(5):
        density = stroke(the("Other"), seed)
    bpy.data.volumes.remove(the("Other").data)
    bpy.ops.ed.undo_push(message="Delete")
    for seed in range(2):
        stroke(the("Clay"), seed)
    for _ in range(2):
        bpy.ops.ed.undo()
    stroke(the("Clay"), 9)
    for _ in range(2):
        bpy.ops.ed.undo()
    assert same(in_file(the("Other")), density)


def open_files():
    return len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 0


def memory():
    """Bytes that this process has had in memory at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def test_a_hundred_strokes_are_bounded(clay, undo_steps):
    """Files, disk, memory, open files and threads."""
    undo_steps(5)
    system = bpy.context.preferences.system
    former, system.memory_cache_limit = system.memory_cache_limit, 8  # MB: Blender keeps what it has read
    try:
        for seed in range(40):
            stroke(the("Clay"), seed)
        handles, threads, before = open_files(), threading.active_count(), memory()
        disk = sum(path.stat().st_size for path in revisions.folder().iterdir())
        for seed in range(100):
            stroke(the("Clay"), seed)
    finally:
        system.memory_cache_limit = former
    assert len(files()) <= 7
    assert (open_files(), threading.active_count()) == (handles, threads)
    assert sum(path.stat().st_size for path in revisions.folder().iterdir()) < 2 * disk
    assert memory() - before < 100 * session.live().grid.density.nbytes


def test_what_an_autosave_shows_stays_until_the_next(clay, undo_steps, autosave):
    undo_steps(1)
    stroke(clay, 0)
    shown = []
    for _ in range(2):
        autosave()
        shown.append(current())
        for seed in range(5):
            stroke(the("Clay"), seed)
        assert shown[-1] <= files()
        assert len(files()) <= 4
    assert not shown[0] & files()


def test_an_autosave_before_undo_shows_what_was_then(clay, undo_steps, autosave):
    undo_steps(2)
    stroke(clay, 0)
    autosave()
    shown = current()
    bpy.ops.ed.undo()
    for seed in range(5):
        stroke(the("Clay"), seed)
    assert shown <= files()


def test_an_autosave_survives_loading_another_file(clay, autosave):
    stroke(clay, 0)
    autosave()
    shown = current()
    stroke(the("Clay"), 1)
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    assert files() == shown


def test_autosaves_of_other_processes_do_not_count(clay, undo_steps, tmp_path):
    undo_steps(1)
    stroke(clay, 0)
    shown = current()
    other = Path(bpy.app.tempdir).parent / f"9{os.getpid()}_autosave.blend"
    other.write_bytes(b"")
    try:
        for seed in range(5):
            stroke(the("Clay"), seed)
    finally:
        other.unlink()
    assert not shown & files()


def test_loading_another_file_leaves_only_what_it_shows(clay, tmp_path):
    stroke(clay, 0)
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    assert files() == set()
    stroke(new_clay(), 1)
    assert len(files()) == 2


def test_startup_file_keeps_what_it_shows(clay):
    """It is saved with an empty path, and nothing lies beside it."""
    stroke(clay, 0)
    shown = current()
    handlers.before_save("")
    handlers.after_save("")
    stroke(the("Clay"), 1)
    bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    assert files() == shown


def test_folders_of_processes_that_are_no_more_go_after_a_week(clay, monkeypatch):
    gone = subprocess.Popen([sys.executable if bpy.app.module else "true", "-c", ""])
    gone.wait()
    root = revisions.root()
    old = time.time() - 8 * 24 * 3600
    made = {
        "old": root / f"{gone.pid}-old",
        "young": root / f"{gone.pid}-young",
        "alive": root / f"{os.getppid()}-alive",
        "shown": root / f"{gone.pid}-shown",
        "foreign": root / "notes",
    }
    for name, folder in made.items():
        folder.mkdir()
        (folder / "x.vdb").write_bytes(b"")
        if name != "young":
            os.utime(folder, (old, old))
    former = revisions.folder()
    volume = bpy.data.volumes.new("Shown")
    volume.filepath = str(made["shown"] / "x.vdb")
    revisions._made_folder.cache_clear()  # as in a process that makes its first revision
    try:
        made_anew = revisions.folder()
        assert {name for name, folder in made.items() if folder.exists()} == {"young", "alive", "shown", "foreign"}
        assert made_anew != former and former.exists()
        assert made_anew.name.startswith(f"{os.getpid()}-")
    finally:
        for folder in (*made.values(), former):
            shutil.rmtree(folder, ignore_errors=True)


def test_which_processes_are_alive():
    assert is_alive(os.getpid()) and is_alive(os.getppid())
    gone = subprocess.Popen([sys.executable if bpy.app.module else "true", "-c", ""])
    assert is_alive(gone.pid)  # at least until somebody has asked how it ended
    gone.wait()
    assert not is_alive(gone.pid)
    assert not is_alive(1 << 40)


def child(tmp_path, ending):
    """Run a Blender of its own that makes three strokes, and return its folder of revisions and its last words."""
    script = textwrap.dedent(
        f"""
        import os, signal, sys
        from pathlib import Path
        import bpy
        import addon_utils
        addon_utils.enable({revisions.__package__.rpartition(".")[0]!r}, default_set=True)
        from importlib import import_module
        package = {revisions.__package__!r}
        session, revisions = (import_module(f"{{package}}.{{name}}") for name in ("session", "revisions"))
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
        bpy.ops.repousse.new_clay_block(resolution=16)
        obj = bpy.context.object

        def stroke(depth):
            live = session.open_session(obj)
            live.grid.density[:depth] = 0.5
            live.commit(obj, [((0, 0, 0), (depth, 16, 16))])

        stroke(1)
        stroke(2)
        blend = Path(bpy.app.tempdir).parent / f"{{os.getpid()}}_autosave.blend"
        handlers = list(bpy.app.handlers.save_pre), list(bpy.app.handlers.save_post)
        bpy.app.handlers.save_pre.clear(), bpy.app.handlers.save_post.clear()
        bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, relative_remap=False)
        bpy.app.handlers.save_pre.extend(handlers[0]), bpy.app.handlers.save_post.extend(handlers[1])
        bpy.context.preferences.edit.undo_steps = 1
        for depth in range(3, 8):
            stroke(depth)
        print("FOLDER", revisions.folder(), flush=True)
        print("CURRENT", Path(obj.data.filepath).name, flush=True)
        print("AUTOSAVE", blend, flush=True)
        {ending}
        """
    )
    path = tmp_path / "child.py"
    path.write_text(script, encoding="utf-8")
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True)
    said = dict(line.split(" ", 1) for line in done.stdout.splitlines() if line.isprintable() and " " in line)
    assert "FOLDER" in said, done.stderr
    return done, said


@wheel_only
def test_after_kill_the_autosave_shows_the_sculpture(tmp_path):
    done, said = child(tmp_path, "os.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode == -signal.SIGKILL
    try:
        bpy.ops.wm.open_mainfile(filepath=said["AUTOSAVE"])
        [volume] = bpy.data.volumes
        density = read_volume(revisions.path_of(volume)).density
        assert (density[:2] == 0.5).all() and (density[2:] == 1.0).all()
        live = session.open_session(bpy.data.objects[0])
        assert same(live.grid.density, density)
        live.grid.density[:] = 0.25
        live.commit(bpy.data.objects[0], None)
        assert Path(volume.filepath).parent == revisions.folder() != Path(said["FOLDER"])
        assert Path(said["FOLDER"], said["CURRENT"]).exists()  # another process's files are not ours to remove
    finally:
        Path(said["AUTOSAVE"]).unlink()


@wheel_only
@pytest.mark.parametrize("ending", ["", "bpy.ops.wm.quit_blender()"])
def test_a_clean_end_leaves_what_is_current(tmp_path, ending):
    done, said = child(tmp_path, ending)
    Path(said["AUTOSAVE"]).unlink(missing_ok=True)
    assert [path.name for path in Path(said["FOLDER"]).iterdir()] == [said["CURRENT"]]
    assert done.stderr == ""


@wheel_only
def test_a_stroke_does_not_keep_blender_from_ending(tmp_path):
    ending = """
        core = import_module(package.replace("operators", "core"))
        live = session.live()
        live.engine = core.Engine(core.Push(live.grid, core.SphereTool(4.0), core.Material()))
        live.engine.start()
        live.engine.feed(core.Sample(0.0, (8.0, 8.0, 14.0)))
        del live
    """
    done, said = child(tmp_path, ending.strip())
    Path(said["AUTOSAVE"]).unlink(missing_ok=True)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in Path(said["FOLDER"]).iterdir()] == [said["CURRENT"]]
    assert done.stderr == ""
