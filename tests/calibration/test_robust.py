"""What the choices of the batch put beside its numbers: Huber's effect, and what the cosine error costs."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.estimate import Parameters, robust_view, run_batch
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.estimation import batch
from tests.estimation.fields import FREE, SCALE, TRUTH

NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")


def _estimate(telemetry, sensor, catalogue, **chosen):
    settings = CalibrationSettings.parse(chosen)
    problem = build_problem(telemetry, sensor, catalogue)
    estimate = run_batch(problem, Parameters(FREE, SCALE), settings, lambda *_: None, lambda: False)
    return estimate, SCALE * np.sqrt(np.diag(estimate.P))


def _with_wrong_stars(telemetry, share):
    rng = np.random.default_rng(99)
    wrong = rng.uniform(size=len(telemetry)) < share
    return replace(telemetry, row_px=telemetry.row_px + 15.0 * wrong * rng.normal(size=len(telemetry)))


def test_on_clean_data_the_view_says_that_least_squares_agrees(sensor, catalogue, telemetry_of):
    estimate, sigma = _estimate(telemetry_of(1, frames=60), sensor, catalogue, robust="huber")
    view = robust_view(estimate.robust, NAMES, sigma)
    assert view["share"] == pytest.approx(view["expected_share"], abs=0.02)
    assert view["downweighted"] == round(view["share"] * estimate.robust.arcs)
    assert max(map(abs, view["shift_in_sigma"].values())) < 1
    assert "least squares agrees" in view["sentence"]


def test_with_wrong_stars_the_view_shows_where_least_squares_would_have_ended(sensor, catalogue, telemetry_of):
    telemetry = _with_wrong_stars(telemetry_of(2, frames=60), 0.03)
    estimate, sigma = _estimate(telemetry, sensor, catalogue, robust="huber")
    plain, _ = _estimate(telemetry, sensor, catalogue)
    view = robust_view(estimate.robust, NAMES, sigma)
    assert view["share"] > view["expected_share"] + 0.05
    without = np.array(list(view["parameters_without"].values()))
    np.testing.assert_allclose((without - plain.x) / sigma, 0, atol=0.1)  # weights are taken at the robust estimate
    assert np.abs((estimate.x - TRUTH) / sigma).max() < 4 < np.abs((without - TRUTH) / sigma).max()
    assert "look for wrong matches" in view["sentence"]


def test_a_parameter_without_sigma_has_no_shift(sensor, catalogue, telemetry_of):
    estimate, sigma = _estimate(telemetry_of(3), sensor, catalogue, robust="huber")
    sigma[0] = np.nan
    assert robust_view(estimate.robust, NAMES, sigma)["shift_in_sigma"]["f_m"] is None


def test_the_cosine_error_gives_sigmas_that_hold_and_says_what_it_costs(sensor, catalogue, telemetry_of):
    estimate, sigma = _estimate(telemetry_of(4, frames=60), sensor, catalogue, error="cosine")
    _, of_arcs = _estimate(telemetry_of(4, frames=60), sensor, catalogue)
    assert estimate.status == "converged"
    assert np.abs((estimate.x - TRUTH) / sigma).max() < 4
    assert (sigma > of_arcs).all()
    (remark,) = estimate.remarks
    cost = np.exp(np.mean(np.log(sigma / of_arcs)))
    assert f"give sigmas {cost:.2f} times smaller" in remark
    assert "not valid" in remark
    assert estimate.chi2 == pytest.approx(_chi2(telemetry_of(4, frames=60), sensor, catalogue, estimate.x))


def _chi2(telemetry, sensor, catalogue, x):
    arcs = build_problem(telemetry, sensor, catalogue).whitened(x)
    return batch.normal_equations(arcs, x, FREE, SCALE).chi2
