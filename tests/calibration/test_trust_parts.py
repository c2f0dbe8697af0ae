"""Trust numbers that follow from the fit: halves, bound, more data, parameters dropped, arcs about the detector."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.trust.efficiency import arc_length_rad, arc_sigma_map, efficiency, more_data
from boresight.calibration.trust.fitted_set import Unavailable, chosen
from boresight.calibration.trust.refits import NEEDED, drop_one, drop_one_sentence, two_halves
from boresight.estimation import batch
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.cramer_rao import centroid_rows
from tests.calibration.judged import case, field, simulated
from tests.estimation.fields import TRUTH


def test_two_halves_of_clean_sets_differ_as_their_covariances_say(sensor, catalogue):
    parts = [two_halves(case(field(1000 + seed, frames=30), sensor, catalogue).ground) for seed in range(60)]
    test = chi_square(sum(part["chi2"]["value"] for part in parts), 8 * 60)
    assert test.consistent
    assert sum(part["chi2"]["consistent"] for part in parts) >= 52
    np.testing.assert_allclose(np.std([part["difference_in_sigma"] for part in parts], axis=0), 1, atol=0.3)
    found, expected = (
        np.sqrt(np.mean([np.square(part["map"][key]) for part in parts]))
        for key in ("difference_arcsec", "expected_arcsec")
    )
    assert found == pytest.approx(expected, rel=0.15)


def test_halves_of_a_set_with_wrong_matches_in_a_part_of_it_disagree(sensor, catalogue):
    telemetry = field(1)
    telemetry.row_px[:24] += 30 * np.random.default_rng(1).normal(size=24)  # the first frame
    part = two_halves(case(telemetry, sensor, catalogue).ground)
    assert not part["chi2"]["consistent"]
    assert "disagree by more than their sigmas allow" in part["sentence"]


def test_halves_that_cannot_stand_alone_are_said_to_be_so(sensor, catalogue):
    one = case(field(2, frames=1, stars=30), sensor, catalogue).ground
    thin = case(field(3, frames=2, stars=4, exposures=1), sensor, catalogue, free=("f_m", "b2_per_m2")).ground
    with pytest.raises(Unavailable, match="One frame has no halves: add frames"):
        two_halves(one)
    assert two_halves(thin)["chi2"]["dof"] == 2


def test_chosen_frames_hold_the_information_of_those_frames(sensor, catalogue):
    ground = case(field(4, frames=9), sensor, catalogue).ground
    taken = np.array([0, 1, 1, 0, 0, 1, 0, 0, 1], bool)
    whole = batch.normal_equations(
        chosen(ground.arcs, taken), ground.x, ground.parameters.free, ground.parameters.scale
    )
    parts = [
        batch.normal_equations(ground.arcs.frames(k, k + 1), ground.x, ground.parameters.free, ground.parameters.scale)
        for k in np.flatnonzero(taken)
    ]
    np.testing.assert_allclose(whole.A, sum(part.A for part in parts), rtol=1e-10)
    np.testing.assert_allclose(whole.b, sum(part.b for part in parts), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("number", [1, 5])
def test_predicted_sigmas_are_those_of_the_set_with_the_further_frames(number, catalogue):
    few, many = (simulated(catalogue, number, frames, seed=1) for frames in (200, 400))
    part = more_data(few.ground)
    frames = many.problem.arcs.n_frames - few.problem.arcs.n_frames
    foreseen = np.array(
        [np.interp(frames, part["further_frames"], np.square(sigma)) for sigma in part["sigma"].values()]
    )
    found = np.diag(many.estimate.P) * many.parameters.scale**2
    np.testing.assert_allclose(np.sqrt(foreseen / found), 1, atol=0.1)
    assert part["further_frames"][0] == 0


def test_a_filter_that_forgets_is_told_that_more_data_buys_nothing(sensor, catalogue):
    constant = more_data(case(field(5), sensor, catalogue, method="sqrf").ground)
    drifting = more_data(case(field(5), sensor, catalogue, method="sqrf", variant="q").ground)
    assert constant["sigma"]["f_m"][-1] < constant["sigma"]["f_m"][0] / 4
    assert drifting["sigma"]["f_m"][-1] > drifting["sigma"]["f_m"][0] * 0.6
    assert drifting["sigma"]["f_m"][-1] == pytest.approx(drifting["sigma"]["f_m"][-2], rel=1e-3)


def test_the_doubt_of_a_prediction_is_the_spread_of_predictions_from_other_sets(sensor, catalogue):
    parts = [more_data(case(field(2000 + seed, frames=60), sensor, catalogue).ground) for seed in range(30)]
    sigmas = np.log([[sigma[-1] for sigma in part["sigma"].values()] for part in parts])
    doubt = np.mean([list(part["relative_uncertainty"].values()) for part in parts], axis=0)
    assert np.mean(doubt / sigmas.std(axis=0)) == pytest.approx(1, abs=0.3)
    assert "1 sigma" in parts[0]["sentence"]


def test_predicted_sigma_of_a_filter_with_process_noise_is_met_by_running_it(sensor, catalogue):
    few, many = (case(field(6, frames=n), sensor, catalogue, method="sqrf", variant="q") for n in (40, 80))
    part = more_data(few.ground)
    foreseen = [sigma[part["further_frames"].index(40)] for sigma in part["sigma"].values()]
    np.testing.assert_allclose(foreseen, np.sqrt(np.diag(many.estimate.P)) * many.parameters.scale, rtol=0.2)


def test_holding_a_parameter_costs_what_a_fit_without_it_says(sensor, catalogue):
    judged = case(field(7), sensor, catalogue)
    entries = {entry["name"]: entry for entry in drop_one(judged.ground)}
    for name in ("m0_px", "g_y"):
        others = tuple(other for other in sensor.free if other != name)
        without = case(field(7), sensor, catalogue, free=others).estimate
        again = batch.normal_equations(judged.ground.arcs, without.x, judged.parameters.free, judged.parameters.scale)
        assert entries[name]["settled"]
        assert entries[name]["chi2_increase"] == pytest.approx(again.chi2 - judged.estimate.chi2, rel=0.02)


def test_a_start_that_is_the_truth_is_called_needed_in_one_of_a_hundred(sensor, catalogue):
    knowing = replace(sensor, initial=TRUTH.copy())
    entries = [
        entry for seed in range(20) for entry in drop_one(case(field(seed, frames=20), knowing, catalogue).ground)
    ]
    increases = np.array([entry["chi2_increase"] for entry in entries])
    assert np.mean(increases) == pytest.approx(
        1, abs=0.45
    )  # chi-square with one degree of freedom, parameters correlated
    assert np.mean(increases > NEEDED) < 0.05
    assert np.mean([entry["needed"] for entry in entries]) < 0.05


def test_on_a_large_set_the_increase_of_all_frames_is_told_from_some(sensor, catalogue):
    ground = case(field(8, frames=800, stars=6, exposures=1), sensor, catalogue).ground
    thinned = {entry["name"]: entry for entry in drop_one(ground)}
    small = case(field(8, frames=800, stars=6, exposures=1), sensor, catalogue, free=tuple(sensor.free[:-1]))
    again = batch.normal_equations(ground.arcs, small.estimate.x, ground.parameters.free, ground.parameters.scale)
    assert thinned["g_y"]["frames_used"] == 200
    assert thinned["g_y"]["chi2_increase"] == pytest.approx(again.chi2 - ground.estimate.chi2, rel=0.1)
    assert "ask for every free parameter" in drop_one_sentence(ground, list(thinned.values()))


def test_a_batch_is_efficient_and_the_printed_cosine_is_not(catalogue):
    best, cosine = (efficiency(simulated(catalogue, 1, 60, error=error).ground) for error in ("arclength", "cosine"))
    assert best["overall_ratio"] == pytest.approx(1, abs=0.02)
    assert all(ratio == pytest.approx(1, abs=0.03) for ratio in best["ratio"].values())
    assert cosine["overall_ratio"] > 1.1


def test_the_bound_from_some_frames_is_that_of_all(sensor, catalogue):
    ground = case(field(9, frames=900, stars=5, exposures=1), sensor, catalogue).ground
    part = efficiency(ground)
    free, scale = ground.parameters.free, ground.parameters.scale
    held = centroid_rows(ground.problem.camera, ground.x, ground.arcs, free, scale).information
    sigma = np.sqrt(np.diag(np.linalg.inv(held))) * ground.parameters.scale
    assert part["frames_used"] == 400
    np.testing.assert_allclose(list(part["cramer_rao_sigma"].values()), sigma, rtol=0.02)


def test_a_narrow_field_gets_arcs_of_a_quarter_of_its_side(sensor, catalogue):
    wide = case(field(10), sensor, catalogue).ground
    narrow = replace(sensor, rows=800, columns=900)
    assert np.degrees(arc_length_rad(sensor, wide.estimate.x)) == pytest.approx(5)
    assert np.degrees(arc_length_rad(narrow, wide.estimate.x)) == pytest.approx(
        np.degrees(800 * 2.2e-6 / 0.016) / 4, rel=0.05
    )
    part = arc_sigma_map(wide)
    assert np.array(part["sigma_arcsec"]).shape == (len(part["row_px"]), len(part["col_px"]))
