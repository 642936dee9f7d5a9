# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials by name: the built-in ones set every number, and the artist's own are kept where Blender keeps presets."""

from pathlib import Path

import bpy
import pytest

from repousse.core import PRESETS, Material
from repousse.core.material import EXPONENTS
from repousse.ui.presets import SUBDIR

from .paper import draw

NUMBERS = ("full_force", "yield_ratio", "force_exponent", "density", "use_band", "band")
OWN = {"full_force": 7.5, "yield_ratio": 0.21, "force_exponent": 0.75, "density": 0.77, "use_band": True, "band": 1.75}
MENU = "REPOUSSE_PT_material_presets"


@pytest.fixture
def settings():
    return bpy.context.scene.repousse


@pytest.fixture
def folder():
    """Where Blender puts the presets of a user; empty before and after."""
    folder = Path(bpy.utils.user_resource("SCRIPTS", path=f"presets/{SUBDIR}"))
    yield folder
    for path in folder.glob("*.py"):
        path.unlink()


def numbers(settings):
    return {name: getattr(settings, name) for name in NUMBERS}


@pytest.mark.parametrize("name", PRESETS)
def test_a_built_in_material_sets_every_number(settings, name):
    for number, value in OWN.items():
        setattr(settings, number, value)
    settings.material = name
    preset = PRESETS[name]
    expected = {"full_force": preset.material.full_force, "yield_ratio": preset.material.yield_ratio}
    expected |= {"force_exponent": 1.0}  # the paper's law
    expected |= {"density": preset.density, "use_band": preset.band is not None}
    found = numbers(settings)
    assert {number: found[number] for number in expected} == pytest.approx(expected)
    if preset.band is not None:
        assert found["band"] == pytest.approx(preset.band)


def test_an_own_preset_brings_back_all_its_numbers(settings, folder):
    settings.material = "wax"
    for number, value in OWN.items():
        setattr(settings, number, value)
    assert bpy.ops.repousse.add_material_preset(name="River mud") == {"FINISHED"}
    [path] = folder.glob("*.py")
    assert path.stem == "River_mud"
    settings.material = "snow"
    settings.use_band = False
    assert bpy.ops.script.execute_preset(filepath=str(path), menu_idname=MENU) == {"FINISHED"}
    assert settings.material == "wax"
    assert numbers(settings) == pytest.approx(OWN)


def test_an_own_preset_from_before_the_exponent_loads_with_the_papers(settings, folder):
    settings.material = "wax"
    settings.full_force = 7.5
    bpy.ops.repousse.add_material_preset(name="Old")
    [path] = folder.glob("*.py")
    kept = [line for line in path.read_text().splitlines() if "force_exponent" not in line]
    assert len(kept) == len(path.read_text().splitlines()) - 1
    path.write_text("\n".join(kept) + "\n")
    settings.force_exponent = 0.5
    assert bpy.ops.script.execute_preset(filepath=str(path), menu_idname=MENU) == {"FINISHED"}
    assert (settings.full_force, settings.force_exponent) == (7.5, 1.0)


def test_the_exponent_is_the_materials_and_keeps_within_its_range(settings):
    settings.material = "clay"
    assert settings.is_preset() and settings.clay == Material(settings.full_force, settings.yield_ratio, 1.0)
    settings.force_exponent = 0.75
    assert not settings.is_preset() and settings.clay.exponent == 0.75
    for asked, given in ((0.0, EXPONENTS[0]), (9.0, EXPONENTS[1])):
        settings.force_exponent = asked
        assert settings.clay.exponent == given
    settings.material = "clay"
    assert settings.is_preset() and settings.force_exponent == 1.0


def test_the_popover_offers_the_built_in_materials_then_the_own_ones(settings, folder):
    def offered():
        paper = draw(getattr(bpy.types, MENU))
        return [call.given["value"] for call in paper.calls if call.name == "prop_enum"], paper.operators()

    built_in, operators = offered()
    assert built_in == list(PRESETS) and "script.execute_preset" not in operators
    assert "repousse.add_material_preset" in operators
    bpy.ops.repousse.add_material_preset(name="Mine")
    built_in, operators = offered()
    assert built_in == list(PRESETS)
    assert Path(operators["script.execute_preset"]["filepath"]) == folder / "Mine.py"
    assert "repousse.add_material_preset" in operators


def test_an_own_preset_can_be_removed_again(folder):
    bpy.ops.repousse.add_material_preset(name="Mine")
    assert bpy.ops.repousse.add_material_preset(name="Mine", remove_name=True) == {"FINISHED"}
    assert not list(folder.glob("*.py"))
