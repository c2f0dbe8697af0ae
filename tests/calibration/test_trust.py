"""The trust object: every part for every method or the sentence that says why not, advice in order, residuals over the detector."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from boresight.calibration.calibration import Cause, Trust, parse_part, to_plain
from boresight.calibration.options import METHODS
from boresight.calibration.trust import cause_advice, trust_advice
from boresight.calibration.trust.field import (
    cell_edges,
    residual_distribution,
    residual_field,
    residual_outliers,
    two_sided,
)
from boresight.calibration.trust.fitted_set import nested, probability
from boresight.calibration.trust.innovations import deviates, worst_frames
from boresight.calibration.trust.residuals import OTHER_PARITY, compute_star_residuals
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.sets import Case, case, field, simulated, unverified


def advise(trust, causes=()):
    read = parse_part(Trust, trust, AssertionError)
    return [*cause_advice(read, causes), *trust_advice(read)]


PARTS = {
    "arc_sigma_map", "two_halves", "efficiency", "more_data", "drop_one", "nis_over_time", "whiteness", "stars",
    "residual_against", "residuals", "residual_field", "residual_distribution", "residual_outliers", "residual_spline",
    "worst_frames",
}  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_judged_from_every_side_and_a_clean_set_calls_for_nothing(method, catalogue):
    trust = simulated(catalogue, seed=4, method=method).trust
    assert trust["unavailable"] == {}
    assert all(trust[part] is not None for part in PARTS)
    json.dumps(trust, allow_nan=False)
    assert trust["two_halves"]["chi2"]["consistent"]
    assert trust["whiteness"]["white"]
    assert trust["nis_over_time"]["consistent"]
    assert trust["suspects"] == []
    assert trust["residual_field"]["even"]
    assert trust["residual_distribution"]["normal_tails"]
    assert trust["worst_frames"]["beyond"] <= trust["worst_frames"]["expected_beyond"] + 3
    assert all(trust["residual_against"][name]["even"] for name in ("radius", "magnitude", "temperature", "time"))
    # singular values leave out a number or two of each exposure, and say so by wider sigmas
    assert 0.97 < trust["efficiency"]["overall_ratio"] < (1.06 if method == "svd" else 1.03)
    assert {sentence.code for sentence in advise(trust)} <= {"drop_one"}


def test_a_reduced_set_is_judged_by_its_own_parameters_and_the_wrong_parity_found_though_arcs_fit(sensor, catalogue):
    trust = case(field(1), sensor, catalogue, free=("f_m", "b2_per_m2")).trust
    assert trust["two_halves"]["names"] == ["f_m", "b2_per_m2"]
    assert [entry["name"] for entry in trust["drop_one"]] == ["f_m", "b2_per_m2"]
    assert set(trust["more_data"]["sigma"]) == {"f_m", "b2_per_m2"}
    trust = case(field(4), replace(sensor, parity=-1), catalogue).trust
    assert trust["two_halves"]["chi2"]["consistent"]
    assert advise(trust)[0].code == "parity"
    assert OTHER_PARITY[1] in advise(trust)[0]
    assert trust["residuals"] is trust["stars"] is trust["residual_against"] is None


@pytest.mark.parametrize(("name", "absurd"), [("magnitude", 1e200), ("magnitude", 99.0), ("temperature_c", -999.0)])
def test_numbers_that_stand_for_no_measurement_leave_the_tests_of_the_others_as_they_are(name, absurd, catalogue):
    telemetry = simulated(catalogue, frames=40).telemetry
    values = getattr(telemetry, name).copy()
    values[telemetry.frame % 9 == 0] = np.nan
    absent = replace(telemetry, **{name: values})
    stated = replace(telemetry, **{name: np.where(np.isnan(values), absurd, values)})
    tests, others = (case(one, st16_sensor(1), catalogue).report.tests for one in (absent, stated))
    assert len(tests) > 20
    assert [(one.name, one.probability) for one in tests] == [(one.name, one.probability) for one in others]


def test_temperatures_of_which_none_is_known_are_as_none_given(catalogue):
    judged = simulated(catalogue, frames=40)
    without, unknown = (
        case(replace(judged.telemetry, temperature_c=values), st16_sensor(1), catalogue).report
        for values in (None, np.full(len(judged.telemetry), np.nan))
    )
    assert [one.name for one in without.tests] == [one.name for one in unknown.tests]


def test_a_model_that_does_not_fit_is_said_before_drift_and_stars(catalogue):
    judged = simulated(catalogue, seed=1, free=("f_m",)).report
    trust = to_plain(judged.trust)
    advice = advise(trust, judged.causes)
    assert set(trust["unavailable"]) == {"drop_one"}
    assert not trust["residual_against"]["radius"]["even"]
    assert judged.causes[0].name in {"radial", "lens", "tangential"}
    assert judged.causes[0].sentence in advice[0]
    assert "stars" not in {sentence.code for sentence in advice}
    assert "camera model" in trust["stars_sentence"]


def test_a_fit_that_leaves_a_direction_open_or_diverged_says_which_parts_that_costs(sensor, catalogue):
    flat = replace(sensor, initial=sensor.initial * np.array([1, 1, 1, 0, 0, 0, 0, 1.0]))
    held = case(field(2, frames=3, stars=4, exposures=1), flat, catalogue, max_iterations=1)
    open_fit = Case(**{**vars(held), "estimate": replace(held.estimate, status="rank_deficient")})
    trust = open_fit.trust
    lost = {"arc_sigma_map", "two_halves", "efficiency", "more_data", "drop_one"}
    assert lost <= set(trust["unavailable"])
    assert all(trust[part] is None for part in lost)
    assert trust["residuals"] is not None
    json.dumps(trust, allow_nan=False)
    fitted = case(field(3), sensor, catalogue)
    trust = Case(**{**vars(fitted), "estimate": replace(fitted.estimate, status="diverged")}).trust
    assert all(trust[part] is None for part in PARTS)
    assert set(trust["unavailable"]) == PARTS
    (why,) = set(trust["unavailable"].values())
    assert "diverged" in why
    assert advise(trust) == []


def test_drawings_stay_small_and_large_sets_are_thinned_and_say_so(sensor, catalogue):
    judged = case(field(5, frames=3000, stars=5, exposures=1), sensor, catalogue)
    judged.trust  # noqa: B018 - compiles kernels, which is no part of the time
    began = time.perf_counter()
    trust = judged.trust
    seconds = time.perf_counter() - began
    assert len(trust["residuals"]["row_px"]) == 2000
    assert len(trust["nis_over_time"]["frame"]) == 1000
    assert len(trust["stars"]) == 200
    assert trust["residuals"]["frames_used"] == 1500
    assert " 1500 frames " in trust["stars_sentence"]
    assert trust["efficiency"]["frames_used"] == 400
    assert " 400 frames " in trust["efficiency"]["sentence"]
    assert {entry["frames_used"] for entry in trust["drop_one"]} == {200}
    assert len(json.dumps(trust)) < 300_000
    assert seconds < 3


def test_five_real_frames_of_an_upright_image_are_judged(catalogue, real_sky):
    sensor, telemetry = read_sensor(real_sky / "esa.sensor.json"), read_telemetry(real_sky / "esa-5-frames.csv")
    trust = case(telemetry, sensor, catalogue).trust
    assert set(trust["unavailable"]) == {"whiteness", "residual_against.temperature", "residual_against.time"}
    assert 0.1 < trust["residuals"]["rms_px"] < 0.2
    assert trust["stars_in_all"] > 500
    assert trust["efficiency"]["overall_ratio"] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "size"),
    [
        ({}, {"frames": 1, "stars": 4}),
        ({}, {"frames": 1, "stars": 5, "exposures": 1}),
        ({}, {"frames": 2, "stars": 5}),
        ({}, {"frames": 20, "stars": 4, "exposures": 1}),
        ({"method": "sqrf"}, {"frames": 2, "stars": 5}),
        ({"method": "ekf", "variant": "q"}, {"frames": 1, "stars": 8}),
        ({"method": "ukf", "forgetting_factor": 0.9}, {"frames": 25, "stars": 6}),
        ({"robust": "huber"}, {"frames": 4, "stars": 6}),
        ({"error": "cosine"}, {"frames": 4, "stars": 6}),
    ],
    ids=str,
)
def test_the_thinnest_sets_have_every_part_or_its_reason(settings, size, sensor, catalogue):
    trust = case(field(2, **size), sensor, catalogue, **settings).trust
    assert {part for part in PARTS if trust[part] is None} == {name for name in trust["unavailable"] if "." not in name}
    json.dumps(trust, allow_nan=False)


QUANTITIES = ("radius", "magnitude", "temperature", "time")


@pytest.fixture(scope="module")
def clean(catalogue):
    return simulated(catalogue, seed=4).trust


def _spoiled(trust, **parts):
    return trust | {name: {**trust[name], **keys} if isinstance(keys, dict) else keys for name, keys in parts.items()}


def _dropped(trust, *needed):
    return [{**trust["drop_one"][0], "needed": value} for value in needed]


def test_a_clean_set_calls_for_nothing_nor_does_a_single_spare_parameter(clean):
    assert advise(clean) == []
    assert advise(_spoiled(clean, drop_one=_dropped(clean, False, True))) == []


def _cause(name, likelihood=1.0):
    return Cause(name=name, likelihood=likelihood, sentence=f"{name} it is.", remedy="Do so.", tests=["stars"])


def test_causes_come_first_in_their_order_with_their_share_and_what_they_leave_unsaid_after(clean):
    spoiled = _spoiled(
        clean,
        efficiency={"overall_ratio": 0.8, "sentence": "bound"},
        suspects=[4711],
        stars_sentence="stars",
        drop_one=_dropped(clean, False, False, True),
        drop_one_sentence="spare",
    )
    said = advise(spoiled, [_cause("places", 0.8), _cause("noise")])
    assert [sentence.code for sentence in said] == ["cause_places", "stars", "cause_noise", "efficiency", "drop_one"]
    assert "(80%)" in said[0]
    assert said[2].startswith("Also: ")


@pytest.mark.parametrize(("likelihood", "is_likely"), [(0.03, False), (0.49, False), (0.5, True), (0.9, True)])
def test_a_cause_at_less_than_even_odds_is_not_called_the_likeliest(clean, likelihood, is_likely):
    (said,) = advise(clean, [_cause("places", likelihood)])
    assert said.code == "cause_places"
    assert f"({likelihood:.0%})" in said
    assert said.startswith("Most likely cause") == is_likely


def test_a_start_that_is_the_truth_is_said_to_leave_little_to_estimate(catalogue):
    sensor = replace(st16_sensor(1), initial=st16_truth(1))
    advice = advise(case(simulated(catalogue, frames=40).telemetry, sensor, catalogue).trust)
    assert advice[-1].code == "drop_one"


def test_every_sentence_ends_and_names_no_code(sensor, catalogue):
    trust = case(field(1), sensor, catalogue).trust
    parts = [part["sentence"] for part in trust.values() if isinstance(part, dict) and "sentence" in part]
    bins = [part["sentence"] for part in trust["residual_against"].values() if part is not None]
    others = [trust["drop_one_sentence"], trust["stars_sentence"], *trust["unavailable"].values()]
    for sentence in [*parts, *bins, *others]:
        assert sentence.endswith(".")
        assert "_" not in sentence.replace("g_y", "")
        assert "nan" not in sentence
        assert "None" not in sentence.replace("None of", "")


@pytest.fixture(scope="module")
def judged(catalogue):
    ground = simulated(catalogue, 1, 120).ground
    return ground, compute_star_residuals(ground)


@pytest.fixture(scope="module")
def noisy(catalogue):
    clean = simulated(catalogue, 1, 80).telemetry
    rng, row_px = np.random.default_rng(5), clean.row_px.copy()
    of_17 = clean.frame == 17
    row_px[of_17] += 0.6 * rng.normal(size=of_17.sum())
    row_px[np.flatnonzero(clean.frame == 41)[2]] += 4.0
    with unverified():
        return case(replace(clean, row_px=row_px), simulated(catalogue, 1, 5).problem.sensor, catalogue).ground


def test_cells_hold_the_plain_means_of_their_stars(judged):
    ground, found = judged
    view = to_plain(residual_field(ground, found))
    i, j = 2, 3
    rows, cols = view["row_edges_px"], view["col_edges_px"]
    inside = (found.arcs.row_px >= rows[i]) & (found.arcs.row_px < rows[i + 1])
    inside &= (found.arcs.col_px >= cols[j]) & (found.arcs.col_px < cols[j + 1])
    sigma = found.arcs.sigma_px[inside] * np.sqrt(found.M[inside, 1, 1]) * max(found.spread, 1)
    after = view["after"]
    assert after["count"][i][j] == inside.sum() > 4
    assert after["mean_row_px"][i][j] == pytest.approx(found.r[inside, 0].mean(), rel=1e-3)
    assert after["sigma_col_px"][i][j] == pytest.approx(np.sqrt(np.sum(sigma**2)) / inside.sum(), rel=1e-3)
    assert after["rms_px"][i][j] == pytest.approx(np.sqrt(np.mean(found.r[inside] ** 2)), rel=1e-3)
    assert np.sum(after["count"]) == found.known.sum()


def test_a_distortion_that_is_not_fitted_is_a_pattern_and_a_good_fit_leaves_none(judged, catalogue):
    view = to_plain(residual_field(*judged))
    assert view["even"]
    assert view["before"]["p"] < 1e-6
    assert view["before"]["rms_in_all_px"] > 2 * view["after"]["rms_in_all_px"]
    ground = simulated(catalogue, 1, 120, free=("f_m",)).ground
    view = to_plain(residual_field(ground, compute_star_residuals(ground)))
    assert not view["even"]
    assert probability(view["after"]["p"]) in view["sentence"]


def test_patterns_are_called_so_in_about_one_clean_set_of_a_hundred(sensor, catalogue):
    p = [
        to_plain(residual_field(ground, compute_star_residuals(ground)))["after"]["p"]
        for ground in (case(field(seed, frames=30), sensor, catalogue).ground for seed in range(30))
    ]
    assert np.mean(np.array(p) < 0.01) <= 2 / 30
    assert stats.kstest(p, "uniform").pvalue > 1e-3 or np.mean(p) > 0.5  # the fit takes freedom out: p leans up


@pytest.mark.parametrize(
    ("rows", "columns", "stars"), [(1944, 2592, 3000), (2592, 1944, 3000), (500, 4000, 40), (9, 9, 0)]
)
def test_cells_cover_the_detector_and_are_nearly_square(rows, columns, stars):
    row_edges, col_edges = cell_edges(rows, columns, stars)
    assert (row_edges[0], row_edges[-1], col_edges[0], col_edges[-1]) == (-0.5, rows - 0.5, -0.5, columns - 0.5)
    assert np.diff(row_edges)[0] / np.diff(col_edges)[0] == pytest.approx(1, rel=0.8)


def test_the_distribution_is_that_of_the_residuals_over_their_sigmas(judged):
    view = to_plain(residual_distribution(*judged))
    z = judged[1].z[judged[1].known].ravel()
    assert view["count"] == len(z) == sum(view["after"]["counts"]) + view["after"]["below"] + view["after"]["above"]
    assert view["after"]["counts"] == np.histogram(z, np.arange(-6, 6.01, 0.25))[0].tolist()
    middle = view["normal"].index(1.0)
    assert view["quantile"][middle] == pytest.approx(np.quantile(z, stats.norm.cdf(1.0)), rel=1e-4)
    assert view["sigma"] == pytest.approx(1, abs=4 / np.sqrt(2 * len(z)))
    apart = np.abs(np.array(view["quantile"]) - view["normal"]) / view["sigma_of_quantile"]
    assert np.mean(apart < 3) > 0.9
    assert view["before"]["below"] + view["before"]["above"] > view["after"]["below"] + view["after"]["above"]


def test_tail_probabilities_and_deviates_are_the_exact_ones():
    for count, n, share in ((0, 1000, 0.0027), (3, 1000, 0.0027), (12, 1000, 0.0027)):
        low, high = stats.binom.cdf(count, n, share), stats.binom.sf(count - 1, n, share)
        assert two_sided(count, n, share) == pytest.approx(min(1, 2 * min(low, high)))
    for dof in (5.0, 20.0, 200.0):
        for p in (0.5, 0.01, 1e-4):
            assert stats.norm.sf(deviates(stats.chi2.isf(p, dof), np.array(dof))) == pytest.approx(p, rel=0.3)


def test_a_star_far_off_is_the_first_outlier_and_the_worst_frames_are_the_spoiled_ones(noisy):
    view = to_plain(residual_outliers(noisy, compute_star_residuals(noisy)))
    assert view["in_all"] >= 1
    assert view["frame"][0] == 41
    assert abs(view["d_row_px"][0]) == pytest.approx(4, abs=1)
    assert view["normalised"] == sorted(view["normalised"], reverse=True)
    view = to_plain(worst_frames(noisy))
    assert set(view["frame"][:2]) == {17, 41}
    assert view["deviation"][1] > 3 > view["deviation"][3]
    assert view["beyond"] >= 2
    k = int(np.flatnonzero(noisy.arcs.frame == 17)[0])
    place = view["frame"].index(17)
    chi2 = view["chi2_per_dof"][place] * view["dof"][place]
    assert chi2 == pytest.approx(float(noisy.sums.chi2[k]), rel=1e-3)


def test_a_hundredth_of_wrong_centroids_makes_heavy_tails_and_a_set_too_small_says_so(sensor, catalogue):
    clean, rng = field(3, frames=150), np.random.default_rng(6)  # so that a hundredth stands clear of the table's level
    wrong = clean.row_px + np.where(rng.uniform(size=len(clean)) < 0.01, 3.0, 0.0)
    with unverified():
        ground = case(replace(clean, row_px=wrong), sensor, catalogue).ground
    view = to_plain(residual_distribution(ground, compute_star_residuals(ground)))
    assert not view["normal_tails"]
    assert view["sentence"].endswith("some stars are wrong; check the outliers.")
    trust = case(field(2, frames=3, stars=4, exposures=1), sensor, catalogue, free=("f_m",)).trust
    assert trust["residual_distribution"] is None
    assert " 50 " in trust["unavailable"]["residual_distribution"]


def test_numbers_for_drawing_have_the_five_digits_that_text_would_give_them():
    rng = np.random.default_rng(1)
    values = rng.normal(size=4000) * 10.0 ** rng.uniform(-30, 30, 4000)
    values[:500] = (rng.integers(10**4, 10**5, 500) * 10 + 5) * 10.0 ** rng.integers(
        -12, 5, 500
    )  # halves of the last digit
    values[500:600] = rng.choice([np.nan, np.inf, 0.0, -0.0, 9.99995, 99999.5], 100)
    expected = [float(f"{one:.5g}") if np.isfinite(one) else None for one in values.tolist()]
    assert repr(nested(values)) == repr(expected)
    assert repr(nested(values.reshape(40, 100))) == repr([expected[k : k + 100] for k in range(0, 4000, 100)])
    assert repr(nested(values[495:505])) == repr(expected[495:505])
