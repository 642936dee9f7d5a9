# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart from end to end, small; and that a method that fails is a line that says so."""

import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.bench.chart import page, scenes, words
from tests.bench.chart.__main__ import main
from tests.bench.chart.drawing import Panel
from tests.bench.chart.measure import Request, measure, press
from tests.bench.chart.method import Method
from tests.bench.chart.pareto import dominates, front
from tests.bench.chart.rows import COLUMNS, Row
from tests.bench.chart.run import Point, tried
from tests.bench.chart.trials import TRIALS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Three methods against one truth; the folder that it leaves."""
    out = tmp_path_factory.mktemp("chart")
    done = subprocess.run(
        [sys.executable, "-m", "tests.bench.chart", "--quick", "--out", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return out


def test_the_table(quick):
    with (quick / "speed_accuracy.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert tuple(lines[0]) == COLUMNS
    assert ",".join(COLUMNS) == (
        "method,setting,truth,ms_p50,ms_p99,err_mass,err_density_l1,err_density_w1,err_force,err_pileup,err_direction,mb"
    )
    by_name = {line["method"]: line for line in lines}
    assert set(by_name) == {"carve", "sweep", "coarse sweep"}
    for line in lines:
        assert line["truth"] == "column"
        assert 0.0 < float(line["ms_p50"]) <= float(line["ms_p99"])
        assert 0.0 < float(line["mb"]) < 1000.0
        assert line["err_pileup"] == line["err_direction"] == ""
        assert all(0.0 <= float(line[name]) < 100.0 for name in COLUMNS if name.startswith("err_") and line[name])
    sweep, carve, coarse = (by_name[name] for name in ("sweep", "carve", "coarse sweep"))
    assert float(sweep["err_mass"]) < 1e-7 < 0.1 < float(carve["err_mass"])
    assert float(coarse["err_mass"]) < 1e-7
    assert float(sweep["err_force"]) < 0.01 < 0.1 < float(carve["err_force"])
    assert float(sweep["err_density_l1"]) < 0.01 < float(coarse["err_density_l1"]) < float(carve["err_density_l1"])
    points = [(float(line["ms_p50"]), float(line["err_density_l1"])) for line in lines]
    best = front(points)
    assert lines.index(sweep) in best  # nothing is nearer to the law, so nothing can dominate it
    assert all(any(dominates(points[j], p) for j in best) for i, p in enumerate(points) if i not in best)


def test_the_pictures_and_the_words(quick):
    assert (quick / "speed_accuracy.png").read_bytes().startswith(b"\x89PNG")
    said = (quick / "summary.md").read_text(encoding="utf-8")
    assert "sweep, compiled is off by 0.1" in said
    assert "| carve | remove only |" in said
    with (quick / "growth.csv").open(encoding="utf-8", newline="") as file:
        beside = list(csv.DictReader(file))
    assert {line["method"] for line in beside if line["figure"] == "start-up"} == {"carve", "sweep", "coarse sweep"}
    bends = [float(line["value"]) for line in beside if line["figure"] == "yield depth" and line["method"] == "sweep"]
    assert len(bends) == 1 and bends[0] < 0.01  # DESIGN 7: each row of the law within 1 %


def test_an_unknown_name_is_refused(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--only", "carve,sweeep"])
    assert ended.value.code == 2
    assert '--only: there is no "sweeep"' in capsys.readouterr().err


SCENE = scenes.press(12, 8, 6, 3.0, 1.5, 0.5, 0.1)


class Failing:
    """Feels its depth for two steps, and then ends by an error."""

    density = SCENE.density

    def __init__(self, scene):
        self.steps = 0

    def move_to(self, position):
        self.steps += 1
        if self.steps > 2:
            raise ValueError("no more")
        return float(self.steps)


def test_a_method_that_raises_says_where():
    start_up, ms, force, density, failure = press(Method("failing", "always", Failing), SCENE, 10.0)
    assert failure == "step 3: no more"
    assert len(ms) == len(force) == 2 and start_up >= 0.0 and density.shape == SCENE.density.shape


def test_a_method_that_runs_out_of_its_budget_says_so():
    _, ms, _, _, failure = press(Method("failing", "always", Failing), SCENE, -1.0)
    assert not ms and failure == f"stopped after -1 s, at step 0 of {len(SCENE.path)}"


def test_a_method_that_dies_is_a_line_that_says_so():
    outcome = measure(Request("carve", "carve", "no such setting"), SCENE)
    assert outcome.failure.startswith("died (1): ") and math.isnan(outcome.p50)
    row = tried(Point("no_such_module", "gone", "never"), TRIALS["column"], None)
    assert row.cells()[0] == "gone" and row.cells()[1].startswith("never (died (1): ModuleNotFoundError")
    assert row.cells()[3:] == [""] * 9


def test_a_process_gives_what_the_method_gives_here():
    from tests.bench.chart.methods.carve import METHODS

    _, _, force, density, _ = press(METHODS[0], SCENE, 10.0)
    outcome = measure(Request("carve", "carve", "remove only", repeated=0.0), SCENE)
    assert outcome.failure == "" and len(outcome.ms) == len(SCENE.path)
    np.testing.assert_array_equal(outcome.density, density)
    np.testing.assert_array_equal(outcome.force, force)


def row(method, ms, error, setting="compiled", failure="", press=1.0):
    errors = {} if failure else {"err_force": error}
    return Row(method, setting, "foam-500", ms, 2.0 * ms, 1.0, 1.0, press, errors, failure)


def test_what_dominates_the_sweep_is_said():
    panel = Panel("foam-500", "err_force", "foam", "force")
    rows = [row("sweep", 1.0, 0.10), row("both", 0.5, 0.05), row("nearer", 9.0, 0.02), row("faster", 0.1, 0.5)]
    rows += [row("same", 1.1, 0.11), row("hardly nearer", 5.0, 0.095), row("gone", 0.1, 0.0, failure="died")]
    verdict = words.judge(rows, panel)
    names = [[r.method for r in found] for found in (verdict.both, verdict.nearer, verdict.faster)]
    assert names == [["both"], ["nearer"], ["faster"]]
    said = words.sentence(rows, panel)
    assert "Dominated by both, compiled (5 % at 1/2 of its time)." in said
    assert "No other method dominates it" in words.sentence([row("sweep", 1.0, 0.1), row("same", 1.1, 0.11)], panel)


def test_a_ratio_is_of_whole_presses_that_got_through():
    rows = [row("recursive", 1.0, 0.1, "literal", press=3000.0), row("sweep", 1.0, 0.1, press=2.0)]
    assert words.ratio(rows, ("recursive", "literal"), ("sweep", "compiled"), "foam-500") == 1500.0
    rows[0] = row("recursive", 1.0, 0.1, "literal", "stopped", 3000.0)
    assert math.isnan(words.ratio(rows, ("recursive", "literal"), ("sweep", "compiled"), "foam-500"))


def test_the_page_keeps_what_is_around_the_tables(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(f"before\n{page.BEGIN}\nold\n{page.END}\nafter\n", encoding="utf-8")
    page.rewrite(path, "new")
    assert path.read_text(encoding="utf-8") == f"before\n{page.BEGIN}\n\nnew\n\n{page.END}\nafter\n"
    path.write_text("no marks", encoding="utf-8")
    with pytest.raises(ValueError, match="there must be one line"):
        page.rewrite(path, "new")
    assert page.BEGIN in (ROOT / "tests" / "bench" / "README.md").read_text(encoding="utf-8")
