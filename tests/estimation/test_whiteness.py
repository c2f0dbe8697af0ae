"""Tests of series: autocorrelation, runs and shares against plain forms, their levels and their power."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from boresight.estimation.statistics.consistency import ljung_box, runs_p_value, share_bounds


@given(st.integers(0, 10_000), st.integers(12, 60))
def test_autocorrelation_and_q_are_those_of_plain_sums(seed, n):
    y = np.random.default_rng(seed).normal(size=n)
    lags = n // 4
    test = ljung_box(y, lags)
    r = [sum(y[k] * y[k + lag] for k in range(n - lag)) / sum(y**2) for lag in range(1, lags + 1)]
    np.testing.assert_allclose(test.autocorrelation, r, atol=1e-12)
    assert test.value == pytest.approx(n * (n + 2) * sum(r[lag - 1] ** 2 / (n - lag) for lag in range(1, lags + 1)))
    assert test.dof == lags


def test_white_series_are_called_unlikely_as_often_as_the_level_says():
    rng = np.random.default_rng(1)
    p = np.array([ljung_box(rng.normal(size=200), 5).p for _ in range(2000)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.02)
    assert np.mean(p < 0.5) == pytest.approx(0.5, abs=0.05)


def test_a_slow_wave_below_the_noise_is_not_white():
    rng = np.random.default_rng(2)
    wave = 0.7 * np.sin(2 * np.pi * np.arange(300) / 100)
    assert ljung_box(wave + rng.normal(size=300), 5).p < 1e-4
    assert runs_p_value(wave + rng.normal(size=300)) < 0.05


def test_more_lags_than_values_are_a_mistake_of_the_caller():
    with pytest.raises(ValueError, match="Expected fewer lags than values, at least one; received 5 lags of 5 values"):
        ljung_box(np.ones(5), 5)


def test_runs_of_independent_values_are_unlikely_as_often_as_the_level_says():
    rng = np.random.default_rng(3)
    p = np.array([runs_p_value(rng.chisquare(8, size=100)) for _ in range(2000)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.02)


def test_one_run_up_and_one_down_is_no_chance_and_short_or_constant_series_say_nothing():
    assert runs_p_value(np.arange(40.0)) < 1e-6
    assert runs_p_value(np.arange(6.0)) == 1
    assert runs_p_value(np.ones(50)) == 1


@given(st.integers(1, 400), st.floats(0.01, 0.5))
def test_bounds_of_a_share_are_those_of_the_binomial_distribution(n, share):
    low, high = share_bounds(n, share)
    assert low * n == pytest.approx(binom.ppf(0.025, n, share), abs=1e-6)
    assert high * n == pytest.approx(binom.ppf(0.975, n, share), abs=1e-6)
