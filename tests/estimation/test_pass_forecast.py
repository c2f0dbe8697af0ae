"""What passes forecast of the next, against dense Gaussian conditioning, and how often it is told wrong."""

import numpy as np
import pytest

from boresight.estimation.pass_forecast import FEWEST, OPEN, PassForecaster
from boresight.estimation.statistics.drift import Epoch
from tests.effort import effort

P = np.array([[1.0, 0.6], [0.6, 2.0]]) * 0.01
L = np.linalg.cholesky(P)


def draw(rng, passes, mean=lambda _t, _T: np.zeros(2)):
    t, T = np.sort(rng.uniform(0.0, 300.0, passes)), 15.0 + 8.0 * rng.standard_normal(passes)
    return [Epoch(a, mean(a, b) + L @ rng.standard_normal(2), P, b) for a, b in zip(t, T, strict=True)]


def condition(model, kept, at):
    """Mean and covariance of the parameters at `at` given all that were kept, by one dense solution, in sigmas of a pass."""
    every = [*kept, at]
    V, t = np.array([model.columns.make_row(one) for one in every]), np.array([one.t_d for one in every])
    K, m = len(every), V.shape[1]
    A = np.hstack([np.ones((K, 1)), V])
    walked = np.minimum.outer(t, t) - t[0]
    prior = np.kron(OPEN**2 * A @ A.T, np.eye(2)) + np.kron(walked, np.diag(model.q**2))
    assert m == 3
    seen = slice(0, 2 * (K - 1))
    noise = np.kron(np.eye(K - 1), P / np.outer(model.scale, model.scale))
    gain = np.linalg.solve(prior[seen, seen] + noise, prior[seen, -2:]).T
    z = np.concatenate([(one.value - model.origin) / model.scale for one in kept])
    return gain @ z, prior[-2:, -2:] - gain @ prior[seen, -2:]


def test_the_forecast_is_that_of_dense_conditioning_on_all_passes():
    passes = draw(np.random.default_rng(3), 30, lambda t, T: np.array([0.01 * T, 0.002 * t]))
    forecaster = PassForecaster(1e-9)
    for one in passes[:-1]:
        forecaster.follow(one)
    model = forecaster._model
    found = forecaster.follow(passes[-1])
    mean, covariance = condition(model, passes[:-1], passes[-1])
    sigma = np.sqrt(np.diag(covariance))
    assert np.abs((found.forecast.value - model.origin) / model.scale - mean).max() < 1e-5 * sigma.min()
    assert found.forecast.covariance / np.outer(model.scale, model.scale) == pytest.approx(covariance, rel=1e-5)


@pytest.mark.full
def test_false_jumps_are_as_many_as_the_level_says_at_most_and_come_by_themselves():
    rng, alpha, passes, trials = np.random.default_rng(11), 0.02, 80, effort(20, 60)
    told = []
    for _ in range(trials):
        forecaster = PassForecaster(alpha)
        told.append(sum(forecaster.follow(one).is_outside for one in draw(rng, passes)))
    expected = alpha * (passes - FEWEST)
    assert 0.3 * expected < np.mean(told) < expected + 4.0 * np.sqrt(expected / trials)
    assert np.var(told) < 1.6 * np.mean(told)  # binomial, where a reference of one pass makes bursts


def test_a_step_is_outside_once_and_an_outlier_is_left_out():
    rng = np.random.default_rng(5)
    still = draw(rng, 40)
    for moved, after in ((slice(25, None), 3.0), (slice(25, 26), 0.0)):
        passes = [
            Epoch(one.t_d, one.value + 3.0 * (k in range(*moved.indices(40))), P, one.temperature_c)
            for k, one in enumerate(still)
        ]
        forecaster = PassForecaster(1e-4)
        found = [forecaster.follow(one) for one in passes]
        assert [k for k, one in enumerate(found) if one.is_outside] == [25]
        assert np.abs(found[-1].state_at(15.0).value - after).max() < 0.3


def test_there_is_no_forecast_of_few_passes_or_without_the_temperature_that_others_have():
    passes = draw(np.random.default_rng(2), FEWEST + 2)
    forecaster = PassForecaster(0.001)
    found = [forecaster.follow(one) for one in passes]
    assert [one.forecast is None for one in found] == [True] * FEWEST + [False] * 2
    cold = Epoch(301.0, passes[0].value, P)
    assert forecaster.follow(cold).test is None
    with pytest.raises(np.linalg.LinAlgError):
        forecaster.follow(Epoch(302.0, passes[0].value, np.ones((2, 2)), 15.0))
