"""Thinning keeps the extremes, whatever the data."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from boresight.figures.style.thinning import POINT_LIMIT, keep_extremes

SERIES = arrays.arrays(
    np.float64, st.integers(1, 5000), elements=st.floats(-1e9, 1e9) | st.just(np.nan), fill=st.floats(-1, 1)
)


@given(SERIES, st.integers(10, 400))
def test_the_extremes_and_the_ends_are_kept(values, limit):
    kept = keep_extremes([values], limit)
    assert kept[0] == 0
    assert kept[-1] == len(values) - 1
    assert np.all(np.diff(kept) > 0)
    if np.isfinite(values).any():
        assert np.nanmin(values[kept]) == np.nanmin(values)
        assert np.nanmax(values[kept]) == np.nanmax(values)


@given(SERIES, SERIES, st.integers(20, 400))
def test_about_as_many_points_are_kept_as_asked(one, other, limit):
    n_points = min(len(one), len(other))
    kept = keep_extremes([one[:n_points], other[:n_points]], limit)
    assert len(kept) <= max(limit, 4) + 2


def test_a_single_spike_among_a_million_points_is_kept():
    values = np.zeros(1_000_000)
    values[654_321] = 1.0
    kept = keep_extremes([values])
    assert 654_321 in kept
    assert len(kept) <= POINT_LIMIT + 2


def test_a_short_series_is_left_whole():
    assert np.array_equal(keep_extremes([np.arange(100.0)]), np.arange(100))
