# SPDX-License-Identifier: GPL-3.0-or-later
"""Each press is computed once: a small file, with a fingerprint of the solver and the solid that made it."""

from __future__ import annotations

import hashlib
import os
from dataclasses import fields
from pathlib import Path

import numpy as np

from .case import CASES, DEPTHS
from .indentation import Indentation, joined
from .measures import Press
from .solid import Solid

HERE = Path(__file__).parent
FILES = HERE / "cache"
SOLVER = ("solid.py", "yielding.py", "mesh.py", "solver.py", "measures.py", "run.py")
"""Modules that a press depends on."""


def fingerprint(solid: Solid, size: float) -> str:
    """Of the solver's source and what it is asked: 16 hexadecimal digits."""
    digest = hashlib.sha256(repr((solid, size, DEPTHS)).encode())
    for module in SOLVER:
        digest.update((HERE / module).read_text(encoding="utf-8").encode())
    return digest.hexdigest()[:16]


def path_of(name: str, size: float) -> Path:
    return FILES / f"{name}_h{size:g}.npz"


def load(name: str) -> Indentation:
    """The truth of that name; what its files lack, or hold of another solver, is computed and kept.

    Raises
    ------
    ValueError
        When there is no such truth.
    """
    if name not in CASES:
        raise ValueError(f'there is no truth "{name}": choose from {", ".join(CASES)}')
    case = CASES[name]
    return joined(case, [pressed(name, size) for size in case.sizes])


def pressed(name: str, size: float) -> Press:
    """One mesh of a truth."""
    solid = CASES[name].solid
    path, made_by = path_of(name, size), fingerprint(solid, size)
    if path.exists() and stored_fingerprint(path) == made_by:
        return read(path)
    from .run import press  # it compiles for some seconds, which who reads a file need not wait for

    made = press(solid, size, label=f"{name}, h = {size:g}")
    write(path, made, made_by)
    return made


def stored_fingerprint(path: Path) -> str:
    with np.load(path) as file:
        return str(file["fingerprint"])


def read(path: Path) -> Press:
    with np.load(path) as file:
        kept = {field.name: file[field.name].astype(np.float64) for field in fields(Press)}
    return Press(**{name: value if value.ndim else float(value) for name, value in kept.items()})


def write(path: Path, made: Press, made_by: str) -> None:
    """In float32, the density in float16. The file is whole or not there."""
    kept = {"fingerprint": np.array(made_by)}
    for field in fields(Press):
        precision = np.float16 if field.name == "density" else np.float32
        kept[field.name] = np.asarray(getattr(made, field.name), precision)
    path.parent.mkdir(exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.part")
    with beside.open("wb") as file:
        np.savez_compressed(file, **kept)
    beside.replace(path)
