"""The drift tests keep their false-alarm rate, see what they should, and agree with the naive forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.statistics.drift import Epoch, baseline_test, fit_line, mahalanobis, power, slope_test

K = 5
SCALE = np.array([5e-5, 50.0, 1e6, 50.0, 1e-3])  # as unlike as a camera's parameters are
ALPHA = 0.01
TRIALS = 4000


def _covariance(rng: np.random.Generator, sigmas: float) -> np.ndarray:
    A = rng.standard_normal((K, K)) + 2.0
    C = A @ A.T + 0.1 * np.eye(K)
    d = np.sqrt(np.diag(C))
    return C / np.outer(d, d) * np.outer(SCALE, SCALE) * sigmas**2


def _drawn(rng: np.random.Generator, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    L = np.linalg.cholesky(covariance / np.outer(SCALE, SCALE))
    return mean + SCALE * (L @ rng.standard_normal(K))


def _mission(rng: np.random.Generator, m: int, *, slope: float = 0.0, thermal: float = 0.0) -> list[Epoch]:
    found = []
    for t in np.sort(rng.uniform(0, 400, m)):
        T = 20 + 8 * np.sin(t / 30)
        C = _covariance(rng, 0.5 + rng.random())
        truth = SCALE * (slope * t + thermal * (T - 20))
        found.append(Epoch(float(t), _drawn(rng, truth, C), C, float(T)))
    return found


def _share(rejections: list[bool]) -> float:
    return float(np.mean(rejections))


def _within(alpha: float, trials: int) -> float:
    return 4 * float(np.sqrt(alpha * (1 - alpha) / trials))


def test_the_baseline_test_keeps_its_false_alarm_rate() -> None:
    rng = np.random.default_rng(7)
    P, B = _covariance(rng, 1.0), _covariance(rng, 0.3)
    found = [
        baseline_test(Epoch(9, _drawn(rng, SCALE, P), P), Epoch(0, _drawn(rng, SCALE, B), B), ALPHA).rejects
        for _ in range(TRIALS)
    ]
    assert abs(_share(found) - ALPHA) < _within(ALPHA, TRIALS)


def test_a_diagonal_covariance_would_not_keep_it() -> None:
    rng = np.random.default_rng(7)
    P = _covariance(rng, 1.0)
    diagonal = np.diag(np.diag(P))
    found = [
        baseline_test(
            Epoch(9, _drawn(rng, SCALE, P), diagonal), Epoch(0, _drawn(rng, SCALE, P), diagonal), ALPHA
        ).rejects
        for _ in range(TRIALS)
    ]
    assert _share(found) > 2 * ALPHA


@pytest.mark.parametrize("thermal", [0.0, 0.4])
def test_the_slope_test_raises_no_more_false_alarms_than_it_says(thermal: float) -> None:
    rng = np.random.default_rng(11)
    trials = 1000
    lines = [fit_line(_mission(rng, 8, thermal=thermal)) for _ in range(trials)]
    assert all(line is not None and line.thermal_per_c is not None for line in lines)
    assert _share([slope_test(line, ALPHA).rejects for line in lines]) < ALPHA + _within(ALPHA, trials)


def test_the_power_is_the_share_of_changes_that_are_seen() -> None:
    rng = np.random.default_rng(3)
    P = _covariance(rng, 1.0)
    change = 0.8 * SCALE * np.array([1, -1, 0.5, 0, 0])
    expected = power(change, P, ALPHA)
    base = Epoch(0, np.zeros(K), np.zeros((K, K)))
    seen = _share([baseline_test(Epoch(9, _drawn(rng, change, P), P), base, ALPHA).rejects for _ in range(TRIALS)])
    assert 0.1 < expected < 0.999
    assert abs(seen - expected) < _within(expected, TRIALS)


def test_a_drift_is_seen_and_its_slope_is_right_within_three_sigmas() -> None:
    rng = np.random.default_rng(5)
    line = fit_line(_mission(rng, 20, slope=0.02, thermal=0.4))
    assert slope_test(line).rejects
    sigma = np.sqrt(np.diag(line.slope_covariance))
    assert (np.abs(line.slope_per_d - 0.02 * SCALE) < 3.5 * sigma).all()
    assert (np.abs(line.thermal_per_c - 0.4 * SCALE) < 3.5 * np.sqrt(np.diag(line.thermal_covariance))).all()


def test_sigmas_that_are_too_small_are_widened_by_the_scatter() -> None:
    rng = np.random.default_rng(9)
    honest = _mission(rng, 30)
    bold = [Epoch(one.t_d, one.value, one.covariance / 25, one.temperature_c) for one in honest]
    line, true_line = fit_line(bold), fit_line(honest)
    assert line.inflation == pytest.approx(25, rel=0.3)
    np.testing.assert_allclose(
        np.sqrt(np.diag(line.slope_covariance) / np.diag(true_line.slope_covariance)), 1.0, rtol=0.3
    )


@given(st.integers(0, 2**32 - 1), st.integers(3, 7))
def test_the_line_is_that_of_the_stacked_normal_equations(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    epochs = [Epoch(one.t_d, one.value, one.covariance) for one in _mission(rng, m)]  # no temperatures
    t = np.array([one.t_d for one in epochs])
    if np.ptp(t) < 1:
        return
    X = np.concatenate([np.kron([1, (u - t.mean()) / 100], np.diag(SCALE)) for u in t])
    weight = np.zeros((m * K, m * K))
    for i, one in enumerate(epochs):
        weight[i * K : (i + 1) * K, i * K : (i + 1) * K] = np.linalg.inv(one.covariance)
    y = np.concatenate([one.value for one in epochs])
    naive = np.linalg.solve(X.T @ weight @ X, X.T @ weight @ y)[K:] * SCALE / 100
    line = fit_line(epochs)
    sigma = np.sqrt(np.diag(line.slope_covariance))
    assert (np.abs(line.slope_per_d - naive) < 1e-5 * sigma).all()


def test_what_cannot_be_tested_is_none_and_no_alarm() -> None:
    rng = np.random.default_rng(1)
    good = _mission(rng, 4)
    flat = np.ones((K, K))
    assert mahalanobis(np.ones(K), flat) is None
    assert mahalanobis(np.ones(K), np.full((K, K), np.nan)) is None
    assert fit_line(good[:2]) is None
    assert fit_line([Epoch(1.0, one.value, one.covariance) for one in good]) is None
    assert fit_line([Epoch(one.t_d, one.value, flat) for one in good]) is None
    assert baseline_test(Epoch(0, np.ones(K), flat), Epoch(0, np.ones(K), flat)) is None
    assert power(np.ones(K), flat) is None


def test_temperature_that_goes_with_time_is_not_told_from_it() -> None:
    rng = np.random.default_rng(2)
    locked = [Epoch(one.t_d, one.value, one.covariance, one.t_d / 10) for one in _mission(rng, 6)]
    line = fit_line(locked)
    assert line.thermal_per_c is None
