# SPDX-License-Identifier: GPL-3.0-or-later
"""The structures of kernels.c, field by field. The numpy twins read and write them as well."""

from ctypes import POINTER, Structure, c_double, c_float, c_int64, c_uint8, c_void_p, sizeof

ABI_VERSION = 3
"""Must equal ABI_VERSION in kernels.c: raised when a field changes its meaning."""

CLUSTERS = 9
MAX_POINTS = CLUSTERS**3
LATTICE = 40
SIGHT_CELL, CELL_BYTES = 3.0, 64


class ShapeState(Structure):
    """Shape of kernels.c."""

    _fields_ = [("half_size", c_double * 3), ("half_axis", c_double * 3), ("radius", c_double), ("ball", c_int64)]


class ToolState(Structure):
    """Tool of kernels.c."""

    _fields_ = [("volume", ShapeState), ("surroundings", ShapeState), ("centre", c_double * 3)]


class GridState(Structure):
    """Grid of kernels.c."""

    _fields_ = [
        ("density", POINTER(c_float)),
        ("shape", c_int64 * 3),
        ("states", POINTER(c_uint8)),
        ("kept", POINTER(c_uint8)),
        ("images", POINTER(c_float)),
        ("bricks", POINTER(c_int64)),
        ("entries", POINTER(c_int64)),
        ("kept_count", POINTER(c_int64)),
        ("image_count", POINTER(c_int64)),
    ]


class Estimate(Structure):
    """M_t, M_s in voxels' worth, and grad M_t in voxels' worth per voxel of the tool's travel; voxels read for it."""

    _fields_ = [("tool_mass", c_double), ("reach_mass", c_double), ("gradient", c_double * 3), ("read", c_int64)]


class Emptied(Structure):
    """What left the tool, voxel by voxel: indices and box in (a, b, c) order, masses in voxels' worth."""

    _fields_ = [
        ("axis", c_int64),
        ("buffer", POINTER(c_float)),
        ("low", c_int64 * 3),
        ("n", c_int64 * 3),
        ("first", c_int64 * 3),
        ("last", c_int64 * 3),
        ("mass", c_double),
        ("tool_loss", c_double),
        ("reach_loss", c_double),
        ("occupied", c_void_p),
        ("carry", c_double),
    ]


class Sweep(Structure):
    """A sweep under way: flux and window in (b, c), and what it has done so far in voxels' worth."""

    _fields_ = [
        ("direction", c_double * 3),
        ("limit", c_double),
        ("weights", c_float * 9),
        ("shift", c_int64 * 2),
        ("border", c_int64),
        ("hole", c_int64),
        ("leap_shift", c_int64 * 2),
        ("leap_weights", c_float * 9),
        ("far", c_double),
        ("flux", POINTER(c_float)),
        ("next", POINTER(c_float)),
        ("row", POINTER(c_float)),
        ("slab", POINTER(c_float)),
        ("window", c_int64 * 4),
        ("origin", c_int64 * 2),
        ("stride", c_int64),
        ("plane", c_int64),
        ("spread_done", c_int64),
        ("needs", c_int64 * 6),
        ("laid", c_double),
        ("reach_gain", c_double),
        ("mass_out", c_double),
        ("surplus", c_double),
        ("planes", c_int64),
        ("visited", c_int64),
        ("read", c_int64),
        ("dirty", c_int64 * 6),
    ]


class Sources(Structure):
    """Clusters of emptied material: mean positions (voxels) and masses; the contact radius in voxels."""

    _fields_ = [
        ("x", c_double * MAX_POINTS),
        ("y", c_double * MAX_POINTS),
        ("z", c_double * MAX_POINTS),
        ("mass", c_double * MAX_POINTS),
        ("count", c_int64),
        ("contact_radius", c_double),
    ]


class Rim(Structure):
    """The free surface that can take material, and the rules by which it is found."""

    _fields_ = [
        ("index", POINTER(c_int64)),
        ("weight", POINTER(c_float)),
        ("spill_index", POINTER(c_int64)),
        ("spill", POINTER(c_float)),
        ("capacity", c_int64),
        ("count", c_int64),
        ("spilling", c_int64),
        ("zeros", POINTER(c_float)),
        ("lattice", POINTER(c_float)),
        ("cells", c_void_p),
        ("direction", c_double * 3),
        ("wake", c_double),
        ("tool_gain", c_double),
        ("reach_gain", c_double),
        ("dirty", c_int64 * 6),
        ("hats", c_int64),
        ("asked", c_int64),
        ("sights", c_int64),
    ]


class RecursionState(Structure):
    """Recursion of kernels.c."""

    _fields_ = [
        ("voxels", POINTER(c_int64)),
        ("count", c_int64),
        ("offsets", c_int64 * 78),
        ("weights", c_double * 26),
        ("forward", c_int64),
        ("wall", c_int64),
        ("budget", c_int64),
        ("calls", c_int64),
        ("kappa", c_double),
        ("relaxed", c_double),
        ("smallest", c_double),
        ("emptied", c_double),
        ("mass_out", c_double),
        ("aside", c_double),
    ]


_WEIGHTS = {
    ShapeState: 1,
    ToolState: 3,
    GridState: 5,
    Estimate: 7,
    Emptied: 11,
    Sweep: 13,
    Sources: 17,
    Rim: 19,
    RecursionState: 23,
}

FINGERPRINT = ABI_VERSION + 100 * sum(weight * sizeof(structure) for structure, weight in _WEIGHTS.items())
"""What `repousse_abi` of a library that fits returns: a library whose structures differ in size is never called."""
