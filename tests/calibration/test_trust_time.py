"""Trust over time: innovations, whiteness, and the residual against what may drive it."""

import numpy as np
import pytest

from boresight.calibration.trust import innovations
from boresight.calibration.trust.innovations import nis_over_time, whiteness
from boresight.simulation.sensors import st16_sensor
from tests.calibration.judged import case, field, simulated

#: Half a micrometre a degree over five degrees: a third of a typical sigma of the focal length.
DRIFT = {"focal_drift_m_per_c": 5e-7}


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_a_focal_length_that_follows_the_temperature_is_detected(number, catalogue):
    trust = simulated(catalogue, number, 200, changes=DRIFT).trust
    assert not trust["whiteness"]["white"]
    assert trust["whiteness"]["p_of_parameters"]["f_m"] < 1e-3
    assert trust["whiteness"]["sentence"].startswith("The residuals are not white over")
    assert trust["whiteness"]["autocorrelation"][0] > trust["whiteness"]["bound"]


def test_the_residual_grows_with_the_temperature_that_moves_the_focal_length(catalogue):
    part = simulated(catalogue, 1, 200, changes=DRIFT).trust["residual_against"]["temperature"]
    mean, sigma = np.array(part["mean_px"]), np.array(part["sigma_of_mean_px"])
    middle = (np.array(part["edges"])[1:] + np.array(part["edges"])[:-1]) / 2
    assert not part["even"]
    slope, slope_sigma = _line(middle, mean, sigma)
    # a longer focal length moves a star at 700 px by 700 x 5e-7 / 0.016 px a degree
    assert slope == pytest.approx(700 * 5e-7 / 0.016, abs=4 * slope_sigma + 0.008)


def _line(x, y, sigma):
    w = 1 / sigma**2
    x = x - np.sum(w * x) / w.sum()
    return np.sum(w * x * y) / np.sum(w * x * x), 1 / np.sqrt(np.sum(w * x * x))


def test_a_constant_camera_is_called_drifting_in_no_more_sets_than_the_level(sensor, catalogue):
    parts = [whiteness(case(field(seed), sensor, catalogue).ground) for seed in range(60)]
    assert sum(not part["white"] for part in parts) <= 4  # more of 60 at 2 % is a chance of 0.7 %
    of_one = np.array([part["p_of_parameters"]["f_m"] for part in parts])
    assert 0.3 < np.mean(of_one) < 0.7
    assert np.mean(of_one < 0.05) < 0.17


def test_the_share_outside_the_bounds_is_five_in_a_hundred_of_a_good_batch(sensor, catalogue):
    parts = [nis_over_time(case(field(seed, frames=60), sensor, catalogue).ground) for seed in range(12)]
    share = np.mean([part["outside_share"] for part in parts])
    assert share == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 720))
    assert sum(part["consistent"] for part in parts) >= 9


def test_a_batch_of_few_frames_is_corrected_for_what_each_frame_decided(sensor, catalogue):
    grounds = [case(field(seed, frames=3), sensor, catalogue).ground for seed in range(40)]
    ground = grounds[0]
    dof = ground.sums.dof
    assert ground.sums.leverage.sum() == pytest.approx(8, rel=1e-9)
    per_dof = [g.sums.chi2 / g.sums.dof for g in grounds]
    assert np.mean(per_dof) == pytest.approx(1, abs=4 * np.sqrt(2 / (120 * dof.mean())))


def test_the_sums_of_frames_are_those_of_plain_numpy(sensor, catalogue):
    ground = case(field(3, frames=7), sensor, catalogue).ground
    starts, P = ground.arcs.frame_arcs[:-1], np.linalg.inv(ground.A)
    leverage = np.einsum("ni,ij,nj->n", ground.H, P, ground.H)
    np.testing.assert_allclose(ground.sums.chi2, np.add.reduceat(ground.e**2, starts), rtol=1e-12)
    np.testing.assert_allclose(ground.sums.scores, np.add.reduceat(ground.H * ground.e[:, None], starts), atol=1e-9)
    np.testing.assert_allclose(ground.sums.squares, np.add.reduceat(ground.H**2, starts), rtol=1e-12)
    np.testing.assert_allclose(ground.sums.leverage, np.add.reduceat(leverage, starts), rtol=1e-6)


def test_a_part_of_the_set_that_is_noisier_lies_outside_its_bounds(catalogue):
    good = simulated(catalogue, 1, 120).telemetry
    rng = np.random.default_rng(5)
    bad = good.frame >= 90
    good.row_px[bad] += 0.6 * rng.normal(size=bad.sum())
    part = case(good, st16_sensor(1), catalogue).trust["nis_over_time"]
    assert not part["consistent"]
    assert "do not follow one another as by chance" in part["sentence"]
    outside = np.array(part["nis_per_dof"]) > np.array(part["upper"])
    assert outside[-25:].mean() > 3 * outside[:80].mean()


def test_a_filter_shows_its_own_innovations(catalogue):
    judged = simulated(catalogue, 1, 80, method="sqrf")
    history = judged.estimate.history
    part = judged.trust["nis_over_time"]
    assert part["frame"] == judged.estimate.updated.tolist()
    np.testing.assert_allclose(part["nis_per_dof"], history.nis / history.dof, rtol=1e-4)


def test_the_wandering_of_a_filter_with_process_noise_is_not_taken_for_drift_or_stars(catalogue):
    trust = simulated(catalogue, 1, 150, seed=2, method="sqrf", variant="q").trust
    assert trust["whiteness"]["white"]
    assert trust["suspects"] == []
    assert trust["efficiency"]["overall_ratio"] > 1.5
    assert "hold more than the method took" in trust["efficiency"]["sentence"]


def test_an_outlier_of_a_long_series_is_shown_wherever_it_is():
    values = np.random.default_rng(2).chisquare(40, 30_000) / 40
    values[12_345], values[29_999] = 9.0, 0.01
    shown = innovations._shown(values)
    assert len(shown) <= innovations.MOST_POINTS
    assert {12_345, 29_999} <= set(shown)
    assert (np.diff(shown) > 0).all()
