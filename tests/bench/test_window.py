# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast a stroke by mouse is in a Blender with a window: BLENDER, else ../shared/tools/blender, else left out."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.blender.run import ROOT, installed
from tests.window.run import Session, play_all

MILLISECONDS = {
    "stroke start": 100.0,
    "press to stroke": None,
    "event to texture": 40.0,
    "patch": None,
    "frame, no stroke": None,
    "frame, in a stroke": None,
    "commit": None,
    "stroke end": None,
    "longest solve": None,
}
"""Medians, and what is asked of them."""
STROKE_END = 150.0
"""Asked of a commit at 256³."""
COLLISIONS = 300.0
"""Asked in Hz, while Blender redraws."""


@pytest.fixture(scope="module")
def measured():
    """What the scenarios tell, by their names."""
    asked = os.environ.get("BLENDER", "")
    brought = Path(ROOT / "../shared/tools/blender").resolve()
    blender = shutil.which(asked) if asked else None
    blender = blender or (str(brought) if brought.exists() else None)
    if blender is None:
        pytest.skip("there is no Blender with a window: say which, as in make bench BLENDER=PATH")
    with installed(blender) as (folder, environment):
        outcomes = list(play_all(Session(blender, folder, environment), ["*"], "figures"))
    errors = [f"{outcome.name}: {outcome.error}" for outcome in outcomes if outcome.error]
    assert not errors, "\n".join(errors)
    return {outcome.name: outcome.figures for outcome in outcomes}


@pytest.mark.parametrize("size", [128, 256])
def test_stroke_in_a_window(figures, measured, size):
    found = measured[f"speed_{size}"]
    section = f"window, {size}³"
    for what, limit in MILLISECONDS.items():
        if what == "commit" and size == 256:
            limit = STROKE_END
        figures.add(section, what, {"": found[what]}, "ms", {"": limit} if limit else None)
    limits = {"": COLLISIONS}
    figures.add(section, "collisions while Blender redraws", {"": found["collisions"]}, "Hz", limits, at_least=True)
