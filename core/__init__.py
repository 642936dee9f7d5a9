# SPDX-License-Identifier: GPL-3.0-or-later
"""The material: grids, tools, the elastoplastic law and its kernels. Knows neither Blender nor devices."""

from .grid import DensityGrid
from .history import History
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
    "History",
    "Material",
    "Push",
    "Regime",
    "Sample",
    "SphereTool",
    "Stroke",
    "SymmetricPush",
]
