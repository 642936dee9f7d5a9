# SPDX-License-Identifier: GPL-3.0-or-later
"""Percentiles of what was counted in bins are those of the times themselves, to a bin."""

from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from repousse.device.measure import Parts, count, percentiles

WIDTH = 1e-5


@given(st.lists(st.floats(0.0, 0.02), min_size=1, max_size=300), st.sampled_from([0.5, 0.9, 0.99, 0.999]))
def test_a_percentile_is_in_its_bin(times, share):
    """At most this share of the times is shorter than the bin, and at least this share not longer."""
    bins = [0] * 2100
    for time in times:
        count(bins, WIDTH, time)
    (edge,) = percentiles(bins, WIDTH, (share,))
    assert sum(time <= edge + 1e-12 for time in times) >= share * len(times)
    assert sum(time < edge - WIDTH - 1e-12 for time in times) <= share * len(times)


def test_too_long_for_all_bins_counts_in_the_last_and_too_short_in_the_first():
    bins = memoryview(array("I", bytes(40)))
    for time in (1.0, 1e9, -1.0):
        count(bins, WIDTH, time)
    assert list(bins) == [1, *[0] * 8, 2]


def test_without_counts_there_is_no_percentile():
    assert percentiles([0, 0], WIDTH, (0.5, 0.99)) == (0.0, 0.0)


def test_parts_are_means_since_the_last_time():
    parts = Parts(("read", "write"))
    parts.add((10.0, 10.5, 12.5))
    parts.add((20.0, 20.1, 20.2))
    assert parts.take() == pytest.approx({"read": 0.3, "write": 1.05})
    parts.add((0.0, 1.0, 3.0))
    assert parts.take() == {"read": 1.0, "write": 2.0}
    assert parts.take() == {"read": 0.0, "write": 0.0}
