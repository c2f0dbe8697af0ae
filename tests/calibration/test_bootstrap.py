"""Intervals from resampled frames: they hold the truth as often as they say, also where neighbours are alike."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri

from boresight.calibration.evaluation import bootstrap


def frames_that_fail(rng, n, correlation, share):
    steps = rng.normal(size=n + 100) * np.sqrt(1 - correlation**2)
    state = np.empty(n + 100)
    state[0] = rng.normal()
    for i in range(1, n + 100):
        state[i] = correlation * state[i - 1] + steps[i]
    return (state[100:] < ndtri(share)).astype(float)


def covered(rng, correlation, share, *, blocks, sets=300, n=200):
    hits = 0
    for _ in range(sets):
        series = frames_that_fail(rng, n, correlation, share)
        length = bootstrap.block_length(series) if blocks else 1
        shares = bootstrap.resampled_sums(series[:, None], length, rng, 400)[:, 0] / (-(-n // length) * length)
        low, high = bootstrap.share_interval(series.mean(), shares, n / length)
        hits += low <= share <= high
    return hits / sets


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("share", [0.2, 0.95])
def test_intervals_of_blocks_hold_the_truth_about_as_often_as_they_say(correlation, share):
    assert covered(np.random.default_rng(5), correlation, share, blocks=True) > 0.87


def test_intervals_of_single_frames_would_not_where_neighbours_are_alike():
    assert covered(np.random.default_rng(6), 0.8, 0.2, blocks=False) < 0.75


def test_independent_frames_are_drawn_one_by_one_and_alike_ones_in_runs():
    rng = np.random.default_rng(7)
    lengths = [
        np.median([bootstrap.block_length(frames_that_fail(rng, 400, correlation, 0.5)) for _ in range(20)])
        for correlation in (0.0, 0.8)
    ]
    assert lengths[0] == 1
    assert 5 < lengths[1] < 40


def test_long_sets_are_drawn_in_longer_blocks_and_their_spread_stays():
    rng = np.random.default_rng(10)
    values = rng.normal(size=(20_000, 1))
    sums = bootstrap.resampled_sums(np.column_stack([values, np.ones(20_000)]), 1, rng, 2000)
    assert (sums[:, 0] / sums[:, 1]).std() == pytest.approx(values.std() / np.sqrt(20_000), rel=0.08)


@given(n=st.integers(1, 60), length=st.integers(1, 20), seed=st.integers(0, 1000))
def test_resampled_sums_are_sums_of_whole_blocks(n, length, seed):
    length = min(n, length)
    ones = np.ones((n, 2))
    sums = bootstrap.resampled_sums(ones, length, np.random.default_rng(seed), 7)
    np.testing.assert_allclose(sums, np.full((7, 2), -(-n // length) * length))


def test_the_resampled_mean_is_unbiased_and_has_the_spread_of_the_mean():
    rng = np.random.default_rng(8)
    values = rng.normal(size=(300, 1))
    means = bootstrap.resampled_sums(values, 1, rng, 4000)[:, 0] / 300
    assert means.mean() == pytest.approx(values.mean(), abs=4 * values.std() / np.sqrt(300 * 4000))
    assert means.std() == pytest.approx(values.std() / np.sqrt(300), rel=0.05)


def test_a_share_without_exceptions_still_has_an_interval():
    low, high = bootstrap.share_interval(1.0, np.ones(100), 200)
    assert high == 1
    assert low == pytest.approx(0.981, abs=1e-3)  # Wilson's score interval, 200 of 200


def test_an_end_that_is_not_finite_is_null_and_the_other_stands():
    scores = np.concatenate([np.linspace(1, 2, 900), np.full(100, np.inf)])
    low, high = bootstrap.interval(1.5, scores, 200)
    assert low == pytest.approx(1.03, abs=0.02)
    assert high is None


@pytest.mark.parametrize("series", [np.ones(50), np.array([1.0]), np.array([1.0, 0.0])])
def test_a_series_that_does_not_vary_or_hardly_exists_has_blocks_of_one(series):
    assert bootstrap.block_length(series) == 1
