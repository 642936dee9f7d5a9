# SPDX-License-Identifier: GPL-3.0-or-later
"""Which kernels a test runs with, and that it leaves no thread behind."""

import importlib.util
import sys

import pytest

from .threads import names


@pytest.fixture(params=["compiled", "numpy"])
def kernels(request, monkeypatch):
    """Run with the compiled kernels and again with their numpy twins."""
    if request.param == "compiled" and not importlib.util.find_spec("repousse_kernels"):
        pytest.skip("the compiled kernels are not installed")
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy" if request.param == "numpy" else "")
    return request.param


@pytest.fixture
def nothing_left():
    """No thread of an engine and no switch interval survives the test."""
    interval = sys.getswitchinterval()
    yield
    assert names() == []
    assert sys.getswitchinterval() == interval
