# SPDX-License-Identifier: GPL-3.0-or-later
"""Which kernels a test runs with."""

import importlib.util

import pytest


@pytest.fixture(params=["compiled", "numpy"])
def kernels(request, monkeypatch):
    """Run with the compiled kernels and again with their numpy twins."""
    if request.param == "compiled" and not importlib.util.find_spec("repousse_kernels"):
        pytest.skip("the compiled kernels are not installed")
    monkeypatch.setenv("REPOUSSE_KERNELS", "numpy" if request.param == "numpy" else "")
    return request.param
