# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests in a Blender with a window: README.md says how they are written and run."""
