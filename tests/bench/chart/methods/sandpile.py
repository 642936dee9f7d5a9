# SPDX-License-Identifier: GPL-3.0-or-later
"""The undirected divisible sandpile, with the tool as an obstacle.

Rule: what exceeds a voxel's room goes in equal shares to the neighbours, but none into the tool: a random walk around
it that ends in the first room. The end does not depend on the order (Levine and Peres; arXiv 1903.06263).
Gets wrong: no direction at all, so a drag makes no bow wave in loose material; all room is near room, so below density
1 it packs a shell around the tool to 1 and nothing beyond; no yield, no elastic return; the rim's shape is that of a
potential flow. What it gets right is a rim, and mass.
"""

from tests.bench.chart.method import Method
from tests.bench.chart.methods.toppling import Toppled

METHODS = [Method("sandpile", "tool an obstacle", lambda scene: Toppled(scene, obstacle=True))]
