# SPDX-License-Identifier: GPL-3.0-or-later
"""Every hard case of tests/bench/stability/cases meets its marks. Each mark is there, with its reason."""

import pytest

from tests.bench.stability.hard_cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_hard_case(name):
    figures = list(CASES[name]())
    assert figures
    missed = [str(figure) for figure in figures if not figure.passes]
    assert not missed, "\n".join(missed)
