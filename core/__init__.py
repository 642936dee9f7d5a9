# SPDX-License-Identifier: GPL-3.0-or-later
"""The material: grids, tools, the elastoplastic law and its kernels. Knows neither Blender nor devices."""

from .engine import Engine
from .grid import DensityGrid
from .hand import Hand
from .history import History
from .local_model import LocalModel
from .material import PRESETS, Material
from .plasticity import Regime
from .push import Contact, Push
from .stroke import Sample, Stroke
from .symmetry import SymmetricPush
from .tool import BoxTool, CapsuleTool, SphereTool

__all__ = [
    "PRESETS",
    "BoxTool",
    "CapsuleTool",
    "Contact",
    "DensityGrid",
    "Engine",
    "Hand",
    "History",
    "LocalModel",
    "Material",
    "Push",
    "Regime",
    "Sample",
    "SphereTool",
    "Stroke",
    "SymmetricPush",
]
