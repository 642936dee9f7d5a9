# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels are called only when they fit, and what is used instead is said once."""

import logging

import numpy as np
import pytest

from repousse.core import DensityGrid, Material, Push, Regime, SphereTool, native


@pytest.fixture
def fresh():
    """The loader as it is in a new process, before and after."""
    native._load.cache_clear()
    yield
    native._load.cache_clear()


def pushes() -> bool:
    values = np.zeros((24, 24, 24), np.float32)
    values[12:] = 0.5
    push = Push(DensityGrid(values), SphereTool(4), Material(3.3, 0.05))
    return any(push.move_to((x, 12, 12)).regime is Regime.PLASTIC for x in np.arange(6.0, 14.0, 0.5))


@pytest.mark.skipif(not native.available(), reason="the compiled kernels are not here")
def test_library_of_another_layout_is_never_called(fresh, monkeypatch, caplog):
    monkeypatch.setattr(native, "FINGERPRINT", native.FINGERPRINT + 100)
    with caplog.at_level(logging.WARNING, logger="repousse"):
        assert not native.available() and native.name() == "numpy"
        assert pushes()
    (said,) = [record.getMessage() for record in caplog.records]
    assert "built from another version" in said and "\n" not in said


def test_missing_library_is_said_once(fresh, monkeypatch, caplog):
    monkeypatch.setattr(native, "_find", lambda: None)
    with caplog.at_level(logging.WARNING, logger="repousse"):
        assert pushes() and pushes() and not native.available()
    assert len(caplog.records) == 1 and "numpy kernels" in caplog.text


def test_environment_forces_the_fallback(fresh, monkeypatch):
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy")
    assert not native.available() and pushes()
