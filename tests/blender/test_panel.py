# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels, drawn on paper; their words; and the plots in them, by their pixels."""

import ast
import inspect
import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from repousse.core import PRESETS, Regime, SphereTool, Stroke
from repousse.core.histogram import BINS, histogram
from repousse.core.material import largest_yield_ratio
from repousse.core.quality import QUALITIES, Auto
from repousse.operators import session as sessions
from repousse.operators import strokes
from repousse.ui import plots, tool
from repousse.ui.live_view import cannot_show
from repousse.ui.stress_panel import REGIMES

from .paper import draw, rna_of

ADDON = "bl_ext.user_default.repousse"
SOURCES = [path for part in ("operators", "ui") for path in (Path(__file__).resolve().parents[2] / part).glob("*.py")]
WHITE = (1.0, 1.0, 1.0)


def ours(kind):
    """The registered classes of this add-on under one of Blender's."""
    found, left = [], [kind]
    while left:
        subclasses = left.pop().__subclasses__()
        left += subclasses
        found += [made for made in subclasses if made.__module__.startswith(f"{ADDON}.") and made.is_registered]
    return sorted(set(found), key=lambda made: made.__name__)


def panels():
    return [kind for kind in ours(bpy.types.Panel) if getattr(kind, "poll", lambda _: True)(bpy.context)]


def shown():
    """What each panel that is there draws, by its name."""
    return {kind.__name__: draw(kind) for kind in panels()}


@pytest.fixture(autouse=True)
def view():
    """Where the panels are: the sidebar of a 3D view."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    with bpy.context.temp_override(window=window, area=area):
        yield area.spaces.active


@pytest.fixture
def block():
    bpy.ops.repousse.new_clay_block(resolution=16, size=1.6)
    return bpy.context.object


@pytest.fixture
def session(block):
    yield sessions.open_session(block)
    sessions.close_session()


@pytest.fixture
def icons(monkeypatch):
    """Icons with numbers: without a window Blender gives none."""
    plot = plots.Plot
    monkeypatch.setattr(plots, "Plot", lambda icon=0, across=0.0, up=0.0: plot(7, across, up))
    plots._slots.clear()
    plots._previews.clear()


def test_every_setting_can_be_reached_from_the_panel(block):
    settings = bpy.context.scene.repousse
    settings.quality = "auto"
    reached = {name for paper in shown().values() for data, name in paper.shown("prop") if data == settings}
    assert reached == set(type(settings).__annotations__)


def test_the_panel_is_there_before_there_is_a_volume():
    assert {kind.__name__ for kind in panels()} >= {"REPOUSSE_PT_volume", "REPOUSSE_PT_material", "REPOUSSE_PT_brush"}
    papers = shown()
    assert "REPOUSSE_PT_strokes" not in papers and "REPOUSSE_PT_view" not in papers
    bpy.context.scene.repousse.material = "snow"
    buttons = draw(bpy.types.REPOUSSE_PT_volume).operators()
    for verb in "repousse.new_clay_block", "repousse.mesh_to_clay":
        assert buttons[verb] == {"material": "snow", "density": pytest.approx(PRESETS["snow"].density)}
    assert {"repousse.import_volume", "repousse.export_vdb", "repousse.replay_stroke"} <= set(buttons)


def test_the_material_is_told_as_changed_and_as_too_strong_to_yield():
    settings = bpy.context.scene.repousse
    settings.material = "clay"
    calm = draw(bpy.types.REPOUSSE_PT_material).texts
    settings.yield_ratio = 0.3
    changed = draw(bpy.types.REPOUSSE_PT_material).texts
    assert set(changed) - set(calm) == {"Changed from what was chosen"}
    settings.material = "clay"
    settings.force_exponent = 0.75
    paper = draw(bpy.types.REPOUSSE_PT_material)
    assert set(paper.texts) - set(calm) == {"Changed from what was chosen"}
    assert "force_exponent" in [call.given["property"] for call in paper.calls if call.name == "prop"]
    bound = largest_yield_ratio(SphereTool(12.0))
    settings.yield_ratio = bound * 0.97
    assert not any("yields for certain" in text for text in draw(bpy.types.REPOUSSE_PT_material).texts)
    settings.yield_ratio = bound * 1.03
    [told] = (text for text in draw(bpy.types.REPOUSSE_PT_material).texts if "yields for certain" in text)
    assert f"{bound:.2f}" in told


def test_memory_is_told_for_what_is_there(block):
    told = draw(bpy.types.REPOUSSE_PT_volume).texts
    assert "16 x 16 x 16 voxels" in told
    block.data.repousse.shape = (256, 256, 256)
    [line] = (text for text in draw(bpy.types.REPOUSSE_PT_volume).texts if "MiB" in text)
    whole, clay, view, history = (float(number) for number in re.findall(r"[\d.]+", line))
    assert clay == 128.0  # two float32 of 256^3
    assert whole == pytest.approx(clay + view + history)


def test_the_level_is_found_until_it_is_set_by_hand_and_then_again(session):
    session.auto_level = level = 0.375
    told = bpy.context.object.data.repousse
    paper = draw(bpy.types.REPOUSSE_PT_view)
    assert f"Automatic: {level:.2f}" in paper.texts
    assert (told, "level") not in paper.shown("prop")
    assert paper.operators()["repousse.automatic_level"] == {"automatic": False}
    bpy.ops.repousse.automatic_level(automatic=False)
    assert told.level == pytest.approx(level)  # begins where it was
    told.level = 0.2
    paper = draw(bpy.types.REPOUSSE_PT_view)
    assert (told, "level") in paper.shown("prop")
    assert paper.operators()["repousse.automatic_level"] == {"automatic": True}
    bpy.ops.repousse.automatic_level(automatic=True)
    assert not told.is_property_set("level")


def test_a_view_that_cannot_show_the_live_volume_says_so(block, view):
    told = draw(bpy.types.REPOUSSE_PT_view).texts
    view.overlay.show_overlays, view.shading.type = False, "MATERIAL"
    assert [*draw(bpy.types.REPOUSSE_PT_view).texts[:1], *told] == [cannot_show(view), *told]


def test_a_volume_that_cannot_be_sculpted_says_why(block, monkeypatch):
    monkeypatch.setattr(tool, "_refused", (("key",), "Clay: is linked from another file: make it local first"))
    assert draw(bpy.types.REPOUSSE_PT_stress).texts == ["Clay: is linked from another file: make it local first"]


def test_the_stress_is_told_while_a_stroke_runs_and_after_it(session):
    assert "No stroke yet" in draw(bpy.types.REPOUSSE_PT_stress).texts
    contact = SimpleNamespace(regime=Regime.PLASTIC, stress=1.25, yield_stress=1.5)
    session.engine = SimpleNamespace(contact=contact, trace=[(0.0, 0.0, 1.0)], choice=None, cancel=lambda: None)
    texts = draw(bpy.types.REPOUSSE_PT_stress).texts
    assert REGIMES[Regime.PLASTIC] in texts and "Stress 1.250 N" in texts and "Yields at 1.500 N" in texts
    session.engine, session.last_trace = None, [(0.0, 0.0, 1.0), (3.0, 0.75, 0.5)]
    texts = draw(bpy.types.REPOUSSE_PT_stress).texts
    assert "End of the last stroke" in texts and "Stress 0.750 N" in texts and "Yields at 0.500 N" in texts
    assert set(REGIMES) == set(Regime)


def test_what_auto_chose_is_told_with_its_reason(session):
    auto = Auto(8.0, 0.05)
    for _ in range(3):
        auto.learn(QUALITIES["exact"], "saturated", 0.005)
    choice = auto.choose("saturated", 32.0, 1.0)
    contact = SimpleNamespace(regime=Regime.PLASTIC, stress=1.25, yield_stress=1.5)
    session.engine = SimpleNamespace(contact=contact, trace=[], choice=choice, cancel=lambda: None)
    wanted = "Balanced: 7.5 of 8 ms, exact would take 10.0; error up to 0.2 of 5 %"
    assert wanted in draw(bpy.types.REPOUSSE_PT_stress).texts
    session.engine, session.last_trace = None, [(0.0, 0.0, 1.0)]
    assert wanted not in draw(bpy.types.REPOUSSE_PT_stress).texts
    session.last_choice = choice
    assert wanted in draw(bpy.types.REPOUSSE_PT_stress).texts


def test_what_auto_goes_by_is_asked_only_for_auto():
    settings = bpy.context.scene.repousse
    for name in (*QUALITIES, "auto"):
        settings.quality = name
        seen = {told for data, told in draw(bpy.types.REPOUSSE_PT_brush).shown("prop") if data == settings}
        assert ({"frame_budget", "error_bound"} <= seen) == (name == "auto") and "quality" in seen
    settings.frame_budget, settings.error_bound = 4.0, 10.0
    chosen = settings.chosen_quality
    assert (chosen.frame_budget, chosen.error_bound) == (4.0, pytest.approx(0.1))
    settings.quality = "draft"
    assert settings.chosen_quality == "draft"


def test_another_volume_is_not_told_the_stress_or_the_level_of_this_one(session):
    session.last_trace = [(0.0, 0.0, 1.0), (3.0, 0.75, 0.5)]
    bpy.ops.repousse.new_clay_block(resolution=8)
    assert draw(bpy.types.REPOUSSE_PT_stress).texts == ["Choose the tool to sculpt this volume"]
    assert "Automatic" in draw(bpy.types.REPOUSSE_PT_view).texts


def test_drawing_takes_as_long_for_any_volume_and_any_number_of_strokes(session, icons, monkeypatch):
    """No file is read, no voxel looked at, no plot made; and many strokes take as many calls as two."""
    session.last_trace = [(float(n), float(n), 1.0) for n in range(3)]
    stroke = Stroke.line((8, 8, 20), (8, 8, 15), tool=SphereTool(3.0))
    for _ in range(2):
        strokes.keep(stroke, bpy.context.object.data)
    shown(), plots.make_wanted()
    calls = {name: len(paper.calls) for name, paper in shown().items()}
    for _ in range(60):
        strokes.keep(stroke, bpy.context.object.data)
    session.last_trace = [(float(n), float(n), 1.0) for n in range(5000)]

    def refuse(*_, **__):
        raise AssertionError("drawing must not do this")

    monkeypatch.setattr("builtins.open", refuse)
    monkeypatch.setattr(Path, "open", refuse)
    for name in "histogram_picture", "stress_picture":
        monkeypatch.setattr(plots, name, refuse)
    monkeypatch.setattr(type(session), "grid", None)
    assert {name: len(paper.calls) for name, paper in shown().items()} == calls
    assert bpy.app.timers.is_registered(plots.make_wanted)


def test_plots_are_made_when_what_they_show_has_changed_and_only_then(session, icons, monkeypatch):
    made = []
    picture = plots.stress_picture
    monkeypatch.setattr(plots, "stress_picture", lambda trace, ink: made.append(len(trace)) or picture(trace, ink))
    session.last_trace = [(0.0, 0.0, 1.0), (4.0, 2.5, 1.5)]
    assert not draw(bpy.types.REPOUSSE_PT_stress).operators() and made == []
    plots.make_wanted()
    paper = draw(bpy.types.REPOUSSE_PT_stress)
    assert [call.given["icon_value"] for call in paper.calls if call.name == "template_icon"] == [7]
    assert "Up to 2.500 N, over 4.0 voxels of depth" in paper.texts
    plots.make_wanted()
    assert made == [2]
    session.last_trace.append((4.5, 2.5, 1.5))  # it grows while a stroke runs
    draw(bpy.types.REPOUSSE_PT_stress), plots.make_wanted()
    session.last_trace[-1] = 4.5, 2.0, 1.5  # another stroke, as long and where that one was in memory
    draw(bpy.types.REPOUSSE_PT_stress), plots.make_wanted()
    assert made == [2, 3, 3]
    drawn = np.array(plots._slots["stress"].preview.image_pixels_float).reshape(plots.SIDE, plots.SIDE, 4)
    expected = picture(session.last_trace, plots._ink())[0]
    assert drawn[..., 3] == pytest.approx(expected[..., 3], abs=1 / 255)
    assert drawn[..., :3] == pytest.approx(expected[..., :3] * expected[..., 3:], abs=1 / 255)


def test_the_histogram_is_that_of_the_file_and_follows_undo():
    bpy.ops.repousse.new_clay_block(resolution=16, material="foam")
    told = bpy.context.object.data.repousse
    density = PRESETS["foam"].density
    expected = np.zeros(BINS)
    expected[int(np.ceil(density * BINS)) - 1] = 16**3
    assert list(told.histogram) == list(expected)
    assert list(histogram(np.full((4, 4, 4), 0.0, np.float32))) == [0.0] * BINS
    whole = np.linspace(0.0, 1.0, 200**3, dtype=np.float32).reshape(200, 200, 200)
    assert histogram(whole).sum() == pytest.approx(200**3, rel=0.02)  # every voxel is stood for
    assert histogram(whole) == pytest.approx(np.full(BINS, 200**3 / BINS), rel=0.1)


def where(picture, colour):
    """(rows, columns) of the pixels of a colour."""
    return np.nonzero((np.abs(picture[..., :3] - colour).max(axis=2) < 0.02) & (picture[..., 3] > 0.9))


def test_stress_picture_has_the_stress_over_its_depth_and_the_yield_line():
    trace = [(0.1 * n, 0.02 * n, 1.5) for n in range(101)]
    picture, across, up = plots.stress_picture(trace, WHITE)
    assert (across, up) == (pytest.approx(10.0), pytest.approx(2.0))
    inner = plots.SIDE - 1 - 2 * plots.MARGIN
    rows, columns = where(picture, plots.STRESS)
    assert np.abs(rows - columns).max() <= 3  # a straight line from corner to corner
    assert (columns.min(), columns.max()) == (pytest.approx(plots.MARGIN, abs=3), pytest.approx(245, abs=3))
    rows, columns = where(picture, plots.YIELD)
    assert np.abs(rows - (plots.MARGIN + 0.75 * inner)).max() <= 2
    assert columns.max() - columns.min() > 0.9 * inner


def test_stress_picture_shows_a_retreat_as_a_loop():
    """Out and back: at one depth there are two stresses (paper figure 1)."""
    trace = [(n, n, 20.0) for n in np.linspace(0, 10, 50)] + [
        (n, 4 * (n - 7.5), 20.0) for n in np.linspace(10, 7.5, 50)
    ]
    picture, _, _ = plots.stress_picture(trace, WHITE)
    rows, columns = where(picture, plots.STRESS)
    at = round(plots.MARGIN + 0.85 * (plots.SIDE - 1 - 2 * plots.MARGIN))
    rows = np.unique(rows[columns == at])
    assert np.count_nonzero(np.diff(rows) > 3) == 1


@pytest.mark.parametrize("trace", [[], [(1.0, 1.0, 1.0)], [(2.0, 0.0, 0.0)] * 5])
def test_stress_picture_of_nearly_nothing_is_two_axes(trace):
    picture, _, _ = plots.stress_picture(trace, WHITE)
    assert picture.shape == (plots.SIDE, plots.SIDE, 4) and np.isfinite(picture).all()
    assert len(where(picture, plots.STRESS)[0]) < 100


def test_histogram_picture_greys_what_is_not_seen_and_stands_higher_where_there_is_more():
    counts = np.zeros(BINS)
    counts[[4, 20, 28]] = 1000, 10, 1000
    picture = plots.histogram_picture(counts, 0.5, WHITE)
    (hidden_rows, hidden), (seen_rows, seen) = where(picture, plots.HIDDEN), where(picture, plots.STRESS)
    middle = plots.SIDE / 2
    assert hidden.max() < middle < seen.min()
    few, many = (seen_rows[np.abs(seen - (10 + 236 * (n + 0.5) / BINS)) < 3].max() for n in (20, 28))
    assert plots.MARGIN < few < many == hidden_rows.max()
    assert (picture[plots.MARGIN : -plots.MARGIN, int(middle), :3] == 1.0).all()  # where the level is
    assert not where(plots.histogram_picture(np.zeros(BINS), 0.5, WHITE), plots.STRESS)[0].size


def test_the_plots_go_with_the_add_on(session):
    session.last_trace = [(0.0, 0.0, 1.0), (4.0, 2.5, 1.5)]
    shown()
    former = plots._previews
    assert len(former) == 2 and bpy.app.timers.is_registered(plots.make_wanted)
    plots.unregister()
    try:
        assert len(former) == 0 and not bpy.app.timers.is_registered(plots.make_wanted)
    finally:
        plots.register()


UNITS = re.compile(
    r"metre|millisecond|newton|pixel|voxel|per cent|radii|of its radius|from 0|0 to 1|file's units|counted from",
    re.IGNORECASE,
)


def described():
    """(name, property) of every property of our groups, preferences and operators that an artist can see."""
    for kind in [*ours(bpy.types.PropertyGroup), *ours(bpy.types.AddonPreferences), *ours(bpy.types.Operator)]:
        rna = rna_of(kind.bl_idname) if issubclass(kind, bpy.types.Operator) else kind.bl_rna
        own = [inspect.get_annotations(base) for base in kind.__mro__ if base.__module__.startswith(ADDON)]
        for name in sorted(set().union(*own) & set(rna.properties.keys())):
            if not rna.properties[name].is_hidden:
                yield f"{kind.__name__}.{name}", rna.properties[name]


def test_every_property_has_a_tooltip_with_its_unit():
    named = dict(described())
    assert len(named) > 40
    assert [name for name, made in named.items() if not made.description.strip()] == []
    numbers = {name: made for name, made in named.items() if made.type in {"INT", "FLOAT"}}
    assert [name for name, made in numbers.items() if not UNITS.search(made.description)] == []
    chosen = [(name, item) for name, made in named.items() if made.type == "ENUM" for item in made.enum_items]
    assert [(name, item.identifier) for name, item in chosen if not item.description] == []
    assert [made.bl_idname for made in ours(bpy.types.Operator) if not rna_of(made.bl_idname).description] == []


def test_every_label_can_be_translated():
    """What is written is a literal, or is put together by pgettext from literals and then not translated again."""
    seen = 0
    for path in SOURCES:
        for call in (
            node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
        ):
            named = {keyword.arg: keyword.value for keyword in call.keywords}
            where = f"{path.name}:{call.lineno}"
            function = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
            if function in {"label", "prop", "operator", "menu", "popover"} and "text" in named:
                seen += 1
                whole = isinstance(named["text"], ast.Constant)
                told = isinstance(named.get("translate"), ast.Constant) and named["translate"].value is False
                assert whole or (told and not isinstance(named["text"], ast.JoinedStr)), where
            if function in {"say", "pgettext_iface"}:
                assert not isinstance(call.args[0], (ast.JoinedStr, ast.BinOp)), where
    assert seen > 30


def test_every_named_operator_is_registered_with_its_undo():
    """What changes data can be undone; what only writes files, or only looks, makes no step."""
    undone = {kind.bl_idname: "UNDO" in getattr(kind, "bl_options", ()) for kind in ours(bpy.types.Operator)}
    looks = {"repousse.export_vdb", "repousse.save_strokes", "repousse.add_material_preset", "repousse.hover"}
    arm = {name for name in undone if name.startswith("repousse.arm_")}  # a device and preferences: no data of the file
    assert {name for name, undo in undone.items() if not undo} <= looks | arm
    assert all(rna_of(name) for name in undone)
