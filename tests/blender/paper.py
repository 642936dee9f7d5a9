# SPDX-License-Identifier: GPL-3.0-or-later
"""A layout on paper: panels and dialogs are drawn on it without a window, and whatever Blender would refuse fails.

Every call is checked against the description that Blender itself has of UILayout, of the properties that are shown and
of the operators and panels that are named.
"""

import inspect
import types
from dataclasses import dataclass, field

import bpy

FUNCTIONS = bpy.types.UILayout.bl_rna.functions
SETTINGS = bpy.types.UILayout.bl_rna.properties


@dataclass
class Call:
    """One call on a layout, with every argument by its name; ``asked`` is what was then set on an operator."""

    name: str
    given: dict
    asked: dict = field(default_factory=dict)


class Paper:
    """Stands in for a UILayout; ``calls`` are all that were made on it and on the layouts inside, in their order."""

    def __init__(self, calls=None):
        self.__dict__["calls"] = [] if calls is None else calls

    def __getattr__(self, name):
        if name not in FUNCTIONS:
            raise AttributeError(f"a layout has no {name}")
        return lambda *values, **named: self._call(FUNCTIONS[name], values, named)

    def __setattr__(self, name, value):
        assert name in SETTINGS, f"a layout has no {name}"
        _check_value(SETTINGS[name], value)

    def _call(self, function, values, named):
        taken = [p for p in function.parameters if not p.is_output]
        assert len(values) <= len(taken), f"{function.identifier} takes {len(taken)} arguments"
        given = {p.identifier: value for p, value in zip(taken, values, strict=False)}
        known = {p.identifier for p in taken}
        assert not set(named) - known, f"{function.identifier} takes no {set(named) - known}"
        assert not set(named) & set(given)
        given |= named
        for parameter in taken:
            if parameter.identifier in given:
                _check_value(parameter, given[parameter.identifier])
            else:
                assert not parameter.is_required, f"{function.identifier} needs {parameter.identifier}"
        call = Call(function.identifier, given)
        self.calls.append(call)
        _check_names(call)
        if function.identifier == "operator":
            return Asked(given["operator"], call.asked)
        outputs = [p for p in function.parameters if p.is_output]
        return Paper(self.calls) if outputs and outputs[0].fixed_type.identifier == "UILayout" else None

    @property
    def texts(self):
        """All that is written."""
        return [call.given["text"] for call in self.calls if call.given.get("text")]

    def shown(self, name):
        """The (data, property) pairs of a kind of call."""
        return [(call.given["data"], call.given["property"]) for call in self.calls if call.name == name]

    def operators(self):
        """What each operator's button sets, by the operator."""
        return {call.given["operator"]: call.asked for call in self.calls if call.name == "operator"}


class Asked:
    """Stands in for the properties of an operator's button."""

    def __init__(self, operator, asked):
        self.__dict__.update(rna=rna_of(operator), asked=asked)

    def __setattr__(self, name, value):
        assert name in self.rna.properties, f"{self.rna.identifier} has no {name}"
        _check_value(self.rna.properties[name], value)
        self.asked[name] = value


def rna_of(operator):
    """The description of an operator that is registered; raises KeyError where there is none."""
    group, _, name = operator.partition(".")
    return getattr(getattr(bpy.ops, group), name).get_rna_type()


def _check_value(described, value):
    if described.type == "ENUM":
        allowed = set(described.enum_items.keys())
        assert not allowed or set([value] if isinstance(value, str) else value) <= allowed, f"there is no {value!r}"
    kinds = {"STRING": str, "BOOLEAN": (bool, int), "INT": int, "FLOAT": (int, float)}
    if described.type in kinds and not getattr(described, "is_array", False):
        assert isinstance(value, kinds[described.type]), f"{described.identifier} is no {value!r}"


def _check_names(call):
    given = call.given
    if "property" in given:
        assert given["property"] in given["data"].bl_rna.properties, f"no property {given['property']}"
    if call.name == "prop_enum":
        assert given["value"] in given["data"].bl_rna.properties[given["property"]].enum_items
    if call.name == "prop_search":
        assert given["search_property"] in given["search_data"].bl_rna.properties
    if call.name == "template_list":
        assert hasattr(bpy.types, given["listtype_name"])
        assert given["propname"] in given["dataptr"].bl_rna.properties
        assert given["active_propname"] in given["active_dataptr"].bl_rna.properties
    for kind in "panel", "menu":
        if call.name in {"popover", "menu"} and kind in given:
            assert hasattr(bpy.types, given[kind]), f"no {kind} {given[kind]}"


class Drawn:
    """Stands in for an instance of a panel, list or operator ``kind`` that draws on ``layout``."""

    def __init__(self, kind, layout, **values):
        rna = rna_of(kind.bl_idname) if issubclass(kind, bpy.types.Operator) else kind.bl_rna
        name = getattr(kind, "bl_idname", kind.__name__)
        self.__dict__.update(values, kind=kind, layout=layout, bl_rna=rna, bl_idname=name)

    def __getattr__(self, name):
        found = getattr(self.kind, name)
        return types.MethodType(found, self) if inspect.isfunction(found) else found


def draw(kind, context=None, method="draw", **values):
    """What a class draws, on paper; ``values`` are what its properties have."""
    paper = Paper()
    getattr(Drawn(kind, paper, **values), method)(context or bpy.context)
    return paper
