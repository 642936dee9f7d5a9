# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tool feels: regime, stress and yield stress, and their course over the depth of the last stroke."""

from __future__ import annotations

import bpy

from ..core import Regime
from ..operators.session import Session, live
from ..operators.volumes import active_volume
from . import tool
from .panel import OfVolume
from .plots import stress_plot

PLOT_SCALE = 8.0
REGIMES = {
    Regime.NONE: "No contact",
    Regime.ELASTIC: "Elastic: springs back",
    Regime.PLASTIC: "Plastic: yields",
    Regime.UNLOADING: "Unloading",
}


class REPOUSSE_PT_stress(OfVolume, bpy.types.Panel):
    bl_label = "Stress"
    bl_parent_id = "REPOUSSE_PT_volume"
    bl_order = 4

    def draw(self, context):
        session = live()
        if session is None or session.volume_uid != active_volume(context).data.session_uid:
            say = bpy.app.translations.pgettext_iface
            text = tool.refusal() or say("Choose the tool to sculpt this volume")
            self.layout.label(text=text, translate=False)
            return
        _draw_felt(self.layout.column(align=True), session)
        trace = session.last_trace if session.engine is None else session.engine.trace
        plot = stress_plot(trace)
        if trace and plot.icon and plot.up > 0.0:
            self.layout.template_icon(plot.icon, scale=PLOT_SCALE)
            say = bpy.app.translations.pgettext_iface
            text = say("Up to {:.3f} N, over {:.1f} voxels of depth").format(plot.up, plot.across)
            legend = self.layout.column(align=True)
            legend.label(text=text, translate=False)
            legend.label(text="Orange: stress. Blue: where it yields")


def _draw_felt(column: bpy.types.UILayout, session: Session) -> None:
    """The newest numbers of the stroke that runs, else the last ones of that before."""
    say = bpy.app.translations.pgettext_iface
    if session.engine is not None:
        contact = session.engine.contact
        regime, stress, yield_stress = say(REGIMES[contact.regime]), contact.stress, contact.yield_stress
    elif session.last_trace:
        regime, (_, stress, yield_stress) = say("End of the last stroke"), session.last_trace[-1]
    else:
        column.label(text="No stroke yet")
        return
    column.label(text=regime, translate=False)
    column.label(text=say("Stress {:.3f} N").format(stress), translate=False)
    column.label(text=say("Yields at {:.3f} N").format(yield_stress), translate=False)
    choice = session.last_choice if session.engine is None else session.engine.choice
    if choice is not None:
        why = say(choice.words).format(**choice.numbers)
        name = say(choice.quality.name.capitalize())
        column.label(text=say("{}: {}").format(name, why), translate=False)


def register():
    bpy.utils.register_class(REPOUSSE_PT_stress)


def unregister():
    bpy.utils.unregister_class(REPOUSSE_PT_stress)
