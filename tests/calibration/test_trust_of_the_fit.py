"""Trust numbers from the fit (halves, bound, more data, dropped parameters), the stars behind residuals, trust over time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from boresight.calibration.calibration import to_plain
from boresight.calibration.trust import innovations
from boresight.calibration.trust.efficiency import arc_length_rad, arc_sigma_map, efficiency, more_data
from boresight.calibration.trust.fitted_set import Unavailable, chosen
from boresight.calibration.trust.innovations import nis_over_time, whiteness
from boresight.calibration.trust.refits import NEEDED, drop_one, drop_one_sentence, two_halves
from boresight.calibration.trust.residuals import compute_star_residuals
from boresight.calibration.trust.stars import StarTable, _merged, star_table, stars
from boresight.estimation import batch
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.simulation.sensors import st16_sensor
from boresight.sky.guide_stars import phrases, star_flags
from tests.calibration.sets import case, field, simulated, unverified
from tests.effort import effort
from tests.estimation.fields import TRUTH


@pytest.mark.full
def test_two_halves_of_clean_sets_differ_as_their_covariances_say(sensor, catalogue):
    parts = [to_plain(two_halves(case(field(1000 + seed, frames=30), sensor, catalogue).ground)) for seed in range(60)]
    test = chi_square(sum(part["chi2"]["value"] for part in parts), 8 * 60)
    assert test.consistent
    assert sum(part["chi2"]["consistent"] for part in parts) >= 52
    np.testing.assert_allclose(np.std([part["difference_in_sigma"] for part in parts], axis=0), 1, atol=0.3)
    found, expected = (
        np.sqrt(np.mean([np.square(part["map"][key]) for part in parts]))
        for key in ("difference_arcsec", "expected_arcsec")
    )
    assert found == pytest.approx(expected, rel=0.15)


def test_halves_of_a_set_with_wrong_matches_in_a_part_of_it_disagree_and_some_cannot_stand_alone(sensor, catalogue):
    telemetry = field(1)
    telemetry.row_px[:24] += 30 * np.random.default_rng(1).normal(size=24)  # the first frame
    with unverified():
        part = to_plain(two_halves(case(telemetry, sensor, catalogue).ground))
    assert not part["chi2"]["consistent"]
    assert "disagree" in part["sentence"]
    one = case(field(2, frames=1, stars=30), sensor, catalogue).ground
    thin = case(field(3, frames=2, stars=4, exposures=1), sensor, catalogue, free=("f_m", "b2_per_m2")).ground
    with pytest.raises(Unavailable, match="One frame"):
        to_plain(two_halves(one))
    assert to_plain(two_halves(thin))["chi2"]["dof"] == 2


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
    part = to_plain(more_data(few.ground))
    frames = many.problem.arcs.n_frames - few.problem.arcs.n_frames
    foreseen = np.array(
        [np.interp(frames, part["further_frames"], np.square(sigma)) for sigma in part["sigma"].values()]
    )
    found = np.diag(many.estimate.P) * many.parameters.scale**2
    np.testing.assert_allclose(np.sqrt(foreseen / found), 1, atol=0.1)
    assert part["further_frames"][0] == 0


def test_a_filter_that_forgets_gains_nothing_from_more_data_and_its_predicted_sigma_is_met(sensor, catalogue):
    constant = to_plain(more_data(case(field(5), sensor, catalogue, method="sqrf").ground))
    drifting = to_plain(more_data(case(field(5), sensor, catalogue, method="sqrf", variant="q").ground))
    assert constant["sigma"]["f_m"][-1] < constant["sigma"]["f_m"][0] / 4
    assert drifting["sigma"]["f_m"][-1] > drifting["sigma"]["f_m"][0] * 0.6
    assert drifting["sigma"]["f_m"][-1] == pytest.approx(drifting["sigma"]["f_m"][-2], rel=1e-3)
    few, many = (case(field(6, frames=n), sensor, catalogue, method="sqrf", variant="q") for n in (40, 80))
    part = to_plain(more_data(few.ground))
    foreseen = [sigma[part["further_frames"].index(40)] for sigma in part["sigma"].values()]
    np.testing.assert_allclose(foreseen, np.sqrt(np.diag(many.estimate.P)) * many.parameters.scale, rtol=0.2)


def test_the_doubt_of_a_prediction_is_the_spread_of_predictions_from_other_sets(sensor, catalogue):
    parts = [to_plain(more_data(case(field(2000 + seed, frames=60), sensor, catalogue).ground)) for seed in range(30)]
    sigmas = np.log([[sigma[-1] for sigma in part["sigma"].values()] for part in parts])
    doubt = np.mean([list(part["relative_uncertainty"].values()) for part in parts], axis=0)
    assert np.mean(doubt / sigmas.std(axis=0)) == pytest.approx(1, abs=0.3)
    assert "1 sigma" in parts[0]["sentence"]


def test_holding_a_parameter_costs_what_a_fit_without_it_says(sensor, catalogue):
    judged = case(field(7), sensor, catalogue)
    entries = {entry["name"]: entry for entry in to_plain(drop_one(judged.ground))}
    for name in ("m0_px", "g_y"):
        others = tuple(other for other in sensor.free if other != name)
        without = case(field(7), sensor, catalogue, free=others).estimate
        again = batch.normal_equations(judged.ground.arcs, without.x, judged.parameters.free, judged.parameters.scale)
        assert entries[name]["settled"]
        assert entries[name]["chi2_increase"] == pytest.approx(again.chi2 - judged.estimate.chi2, rel=0.02)


def test_a_start_that_is_the_truth_is_called_needed_in_one_of_a_hundred(sensor, catalogue):
    knowing = replace(sensor, initial=TRUTH.copy())
    entries = [
        entry
        for seed in range(20)
        for entry in to_plain(drop_one(case(field(seed, frames=20), knowing, catalogue).ground))
    ]
    increases = np.array([entry["chi2_increase"] for entry in entries])
    assert np.mean(increases) == pytest.approx(
        1, abs=0.45
    )  # chi-square with one degree of freedom, parameters correlated
    assert np.mean(increases > NEEDED) < 0.05
    assert np.mean([entry["needed"] for entry in entries]) < 0.05


def test_on_a_large_set_the_increase_of_all_frames_is_told_from_some(sensor, catalogue):
    ground = case(field(8, frames=800, stars=6, exposures=1), sensor, catalogue).ground
    thinned = {entry.name: entry for entry in drop_one(ground)}
    small = case(field(8, frames=800, stars=6, exposures=1), sensor, catalogue, free=tuple(sensor.free[:-1]))
    again = batch.normal_equations(ground.arcs, small.estimate.x, ground.parameters.free, ground.parameters.scale)
    assert thinned["g_y"].frames_used == 200
    assert thinned["g_y"].chi2_increase == pytest.approx(again.chi2 - ground.estimate.chi2, rel=0.1)
    assert all(entry.needed for entry in thinned.values())
    assert f"{min(entry.chi2_increase for entry in thinned.values()):.3g}" in drop_one_sentence(
        ground, list(thinned.values())
    )


def test_a_batch_is_efficient_the_printed_cosine_is_not_and_the_bound_from_some_frames_is_that_of_all(
    catalogue, sensor
):
    best, cosine = (
        to_plain(efficiency(simulated(catalogue, 1, 60, error=error).ground)) for error in ("arclength", "cosine")
    )
    assert best["overall_ratio"] == pytest.approx(1, abs=0.02)
    assert all(ratio == pytest.approx(1, abs=0.03) for ratio in best["ratio"].values())
    assert cosine["overall_ratio"] > 1.1
    ground = case(field(9, frames=900, stars=5, exposures=1), sensor, catalogue).ground
    part = to_plain(efficiency(ground))
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
    part = to_plain(arc_sigma_map(wide))
    assert np.array(part["sigma_arcsec"]).shape == (len(part["row_px"]), len(part["col_px"]))


PIXEL_RAD = 2.2e-6 / 0.016


def _displaced(catalogue, star, east_rad):
    ra = catalogue.ra_rad.copy()
    place = catalogue.find_index(np.array([star]))[0]
    ra[place] += east_rad / np.cos(catalogue.dec_rad[place])
    return replace(catalogue, ra_rad=ra)


def _often_seen(telemetry, rank=0):
    star, counts = np.unique(telemetry.star_id[telemetry.star_id > 0], return_counts=True)
    return int(star[np.argsort(-counts)[rank]])


@pytest.mark.parametrize("parity", [1, -1])
def test_residuals_are_those_of_a_plain_search_for_the_best_attitude(parity, sensor, catalogue):
    telemetry = field(1, frames=10, stars=7, parity=parity)
    ground = case(telemetry, replace(sensor, parity=parity), catalogue).ground
    found = compute_star_residuals(ground)
    stars_of = slice(*found.arcs.star_start[3:5])
    s_i, row, col = found.arcs.s_i[stars_of], found.arcs.row_px[stars_of], found.arcs.col_px[stars_of]
    mirror = np.array([1.0, parity, 1.0])
    s_d = ground.problem.camera.directions(ground.x, row, col, ground.arcs.pitch) * mirror
    start = Rotation.align_vectors(s_d, s_i)[0]

    def misfit(turn):
        seen = (Rotation.from_rotvec(turn) * start).apply(s_i) * mirror
        p_row, p_col = ground.problem.camera.project(ground.x, seen, ground.arcs.pitch)
        return np.concatenate([row - p_row, col - p_col])

    best = least_squares(misfit, np.zeros(3), x_scale=1e-4, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found.r[stars_of].T.ravel(), best.fun, atol=1e-4)


def test_residuals_over_their_own_sigmas_have_unit_variance_however_few_stars(sensor, catalogue):
    for stars_in, seed in ((4, 1), (5, 2), (30, 3)):
        found = compute_star_residuals(case(field(seed, frames=100, stars=stars_in), sensor, catalogue).ground)
        n = found.z.size
        test = chi_square(float(np.sum(found.z**2)), n)
        spread = (test.upper - 1) * (2.0 if stars_in < 6 else 1.2)  # residuals of one exposure are correlated
        assert abs(test.mean - 1) < 1.5 * spread
        assert found.spread == pytest.approx(1, abs=0.06)


def test_no_star_of_twenty_clean_sets_is_suspect(catalogue):
    named = [
        star_table(ground, compute_star_residuals(ground)).suspect.sum()
        for ground in (simulated(catalogue, 1 + seed % 6, 60, seed).ground for seed in range(20))
    ]
    assert sum(named) == 0


@pytest.mark.parametrize("number", [1, 4, 6])
def test_a_star_displaced_by_a_pixel_is_found_alone_with_its_displacement(number, catalogue):
    star = _often_seen(simulated(catalogue, number, 100).telemetry)
    ground = simulated(catalogue, number, 100, sky=_displaced(catalogue, star, -PIXEL_RAD)).ground
    table = star_table(ground, compute_star_residuals(ground))
    worst = stars(ground, table)[0]
    assert table.star_id[table.suspect].tolist() == [star]
    assert worst.star_id == star
    assert worst.suspect
    assert worst.mean_residual_px == pytest.approx(1, abs=0.3)
    east, north = worst.east_north_arcsec  # from the catalogue's place to the true one
    sigma_east, sigma_north = worst.sigma_arcsec
    assert east == pytest.approx(np.degrees(PIXEL_RAD) * 3600, abs=4 * sigma_east + 1)
    assert north == pytest.approx(0, abs=4 * sigma_north + 1)


def test_three_displaced_stars_are_named_without_their_neighbours(catalogue):
    telemetry = simulated(catalogue, 2, 100).telemetry
    wrong = [_often_seen(telemetry, rank) for rank in (0, 3, 9)]
    sky = catalogue
    for star in wrong:
        sky = _displaced(sky, star, 1.5 * PIXEL_RAD)
    trust = simulated(catalogue, 2, 100, sky=sky).trust
    assert set(trust["suspects"]) == set(wrong)
    assert all(entry["suspect"] for entry in trust["stars"][:3])
    assert not any(entry["suspect"] for entry in trust["stars"][3:])
    assert f"3 of {trust['stars_in_all']} " in trust["stars_sentence"]


def test_understated_noise_makes_no_suspect_and_without_star_numbers_there_is_no_table(sensor, catalogue):
    trust = case(field(7), replace(sensor, centroid_sigma_px=0.2), catalogue).trust
    assert trust["suspects"] == []
    assert trust["residuals"]["spread"] == pytest.approx(0.437 / 0.2, rel=0.06)
    trust = case(replace(field(8), star_id=None), sensor, catalogue).trust
    assert trust["stars"] is None
    assert trust["unavailable"]["stars"].endswith("give star_id.")
    assert trust["residuals"]["star_id"] is None


def test_what_the_catalogue_says_against_a_star_stands_beside_it(catalogue):
    judged = simulated(catalogue, 1, 60)
    flagged = {entry["star_id"]: entry["flags"] for entry in judged.trust["stars"]}
    every = star_flags(catalogue, 5 * PIXEL_RAD)
    expected = {star: phrases(int(every[catalogue.find_index(np.array([star]))[0]])) for star in flagged}
    assert {star: flags for star, flags in flagged.items() if flags} == {
        star: said for star, said in expected.items() if said
    }
    assert {"unreliable astrometry", "double"} <= {flag for flags in flagged.values() for flag in flags}


def _table(star_id, z):
    n = len(star_id)
    pairs, ones = np.zeros((n, 2)), np.ones(n)
    star_id, counts = np.array(star_id), np.ones(n, np.int64)
    return StarTable(star_id, counts, pairs, pairs, np.array(z, float), ones, ones, ones, np.zeros(n, np.bool_))


def test_stars_that_have_a_residual_only_before_or_only_after_keep_what_is_known_of_them():
    before, after = _table([1, 2, 5], [1, 20, 3]), _table([1, 4], [0.5, 7])
    merged = _merged(before, after, np.array([False, True, False]))
    assert merged.star_id.tolist() == [1, 2, 4, 5]
    assert merged.z.tolist() == [0.5, 20, 7, 3]
    assert merged.suspect.tolist() == [False, True, False, False]
    assert merged.displacement_rad.shape == (4, 2)


#: Half a micrometre a degree over five degrees: a third of a typical sigma of the focal length.
DRIFT = {"focal_drift_m_per_c": 5e-7}


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_a_focal_length_that_follows_the_temperature_is_detected(number, catalogue):
    trust = simulated(catalogue, number, 200, changes=DRIFT).trust
    assert not trust["whiteness"]["white"]
    assert trust["whiteness"]["p_of_parameters"]["f_m"] < 1e-3
    assert "not white" in trust["whiteness"]["sentence"]
    assert trust["whiteness"]["autocorrelation"][0] > trust["whiteness"]["bound"]


def test_the_residual_grows_with_the_temperature_and_a_noisier_part_lies_outside_its_bounds(catalogue):
    part = simulated(catalogue, 1, 200, changes=DRIFT).trust["residual_against"]["temperature"]
    mean, sigma = np.array(part["mean_px"]), np.array(part["sigma_of_mean_px"])
    middle = (np.array(part["edges"])[1:] + np.array(part["edges"])[:-1]) / 2
    assert not part["even"]
    slope, slope_sigma = _line(middle, mean, sigma)
    # a longer focal length moves a star at 700 px by 700 x 5e-7 / 0.016 px a degree
    assert slope == pytest.approx(700 * 5e-7 / 0.016, abs=4 * slope_sigma + 0.008)
    good = simulated(catalogue, 1, 120).telemetry
    rng = np.random.default_rng(5)
    bad = good.frame >= 60
    good.row_px[bad] += 0.6 * rng.normal(size=bad.sum())
    part = case(good, st16_sensor(1), catalogue).trust["nis_over_time"]
    assert not part["consistent"]
    assert "are not in random order" in part["sentence"]
    outside = np.array(part["nis_per_dof"]) > np.array(part["upper"])
    assert outside[-50:].mean() > 3 * outside[:50].mean()


def _line(x, y, sigma):
    w = 1 / sigma**2
    x = x - np.sum(w * x) / w.sum()
    return np.sum(w * x * y) / np.sum(w * x * x), 1 / np.sqrt(np.sum(w * x * x))


@pytest.mark.full
def test_a_constant_camera_is_called_drifting_in_no_more_sets_than_the_level(sensor, catalogue):
    parts = [to_plain(whiteness(case(field(seed), sensor, catalogue).ground)) for seed in range(60)]
    assert sum(not part["white"] for part in parts) <= 4  # more of 60 at 2 % is a chance of 0.7 %
    of_one = np.array([part["p_of_parameters"]["f_m"] for part in parts])
    assert 0.3 < np.mean(of_one) < 0.7
    assert np.mean(of_one < 0.05) < 0.17


@pytest.mark.full
def test_a_good_batch_is_outside_its_bounds_as_often_as_chance_and_corrected_for_what_frames_decided(sensor, catalogue):
    sets = effort(6, 12)
    parts = [to_plain(nis_over_time(case(field(seed, frames=60), sensor, catalogue).ground)) for seed in range(sets)]
    share = np.mean([part["outside_share"] for part in parts])
    assert share == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / (60 * sets)))
    assert sum(part["consistent"] for part in parts) >= 0.75 * sets
    grounds = [case(field(seed, frames=3), sensor, catalogue).ground for seed in range(effort(8, 40))]
    ground = grounds[0]
    dof = ground.sums.dof
    assert ground.sums.leverage.sum() == pytest.approx(8, rel=1e-9)
    per_dof = [g.sums.chi2 / g.sums.dof for g in grounds]
    assert np.mean(per_dof) == pytest.approx(1, abs=4 * np.sqrt(2 / (3 * len(grounds) * dof.mean())))


def test_the_sums_of_frames_are_those_of_plain_numpy(sensor, catalogue):
    ground = case(field(3, frames=7), sensor, catalogue).ground
    starts, P = ground.arcs.frame_arcs[:-1], np.linalg.inv(ground.A)
    leverage = np.einsum("ni,ij,nj->n", ground.H, P, ground.H)
    np.testing.assert_allclose(ground.sums.chi2, np.add.reduceat(ground.e**2, starts), rtol=1e-12)
    np.testing.assert_allclose(ground.sums.scores, np.add.reduceat(ground.H * ground.e[:, None], starts), atol=1e-9)
    np.testing.assert_allclose(ground.sums.squares, np.add.reduceat(ground.H**2, starts), rtol=1e-12)
    np.testing.assert_allclose(ground.sums.leverage, np.add.reduceat(leverage, starts), rtol=1e-6)


def test_a_filter_shows_its_own_innovations_and_its_wandering_is_not_taken_for_drift_or_stars(catalogue):
    judged = simulated(catalogue, 1, 80, method="sqrf")
    history = judged.estimate.history
    part = judged.trust["nis_over_time"]
    assert part["frame"] == judged.estimate.updated.tolist()
    np.testing.assert_allclose(part["nis_per_dof"], history.nis / history.dof, rtol=1e-4)
    trust = simulated(catalogue, 1, 150, seed=2, method="sqrf", variant="q").trust
    assert trust["whiteness"]["white"]
    assert trust["suspects"] == []
    assert trust["efficiency"]["overall_ratio"] > 1.5
    assert "contain more information than the method used" in trust["efficiency"]["sentence"]


def test_an_outlier_of_a_long_series_is_shown_wherever_it_is():
    values = np.random.default_rng(2).chisquare(40, 30_000) / 40
    values[12_345], values[29_999] = 9.0, 0.01
    shown = innovations._thin(values)
    assert len(shown) <= innovations.MOST_POINTS
    assert {12_345, 29_999} <= set(shown)
    assert (np.diff(shown) > 0).all()
