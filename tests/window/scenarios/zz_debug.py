# SPDX-License-Identifier: GPL-3.0-or-later
import bpy, sys
import numpy as np
from ..clay import new_slab
from ..scenario import Steps, scenario
from ..sculpting import ready, stroke
from ..window import Window

@scenario()
def zz_debug(window: Window) -> Steps:
    volume = new_slab(window)
    mod=sys.modules['bl_ext.user_default.repousse.ui.live_view']
    ses=sys.modules['bl_ext.user_default.repousse.operators.session']
    def tell(tag):
        s=ses.live(); v=mod._view
        print('DBG',tag,s and s.shown_uid, volume.session_uid, volume.visible_get(), v and (v.marches, v.texture.shape, v.texture.uploads, v.texture.patches), s and s.auto_level, mod.level_of(volume.data), file=sys.stderr)
        if v and v._pictures:
            p=next(iter(v._pictures.values())); print('DBG pic', p.shows[0].level, p.shows[0].width, p.shows[0].give, file=sys.stderr)
    yield from ready(window)
    tell('ready')
    yield from window.picture('zz1')
    yield from stroke(window, (-0.45, 0.0, 0.0), (0.45, 0.0, 0.0), moves=20)
    tell('after')
    yield from window.drawn()
    tell('drawn')
    yield from window.picture()
    assert 0
