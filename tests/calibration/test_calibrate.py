"""The one function that calibrates: document, statuses, refusals, Huber's and cosine's views, stars off the detector, the trend."""

import json
import re
from dataclasses import fields, replace
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from boresight.calibration.advice_kinds import ADVICE_KINDS, CAUSE
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import (
    Calibration,
    ChiSquareTest,
    Covariance,
    Efficiency,
    InnovationTest,
    Inputs,
    Trust,
    Values,
    to_plain,
)
from boresight.calibration.estimate import Parameters, robust_view, run_batch
from boresight.calibration.matching.matched_frames import match_under_states
from boresight.calibration.options import METHODS, CalibrationSettings, StatedSettings
from boresight.calibration.problem import COLLINEAR_REASON, build_problem
from boresight.calibration.result import TrendEntry, trend_entry
from boresight.cameras import CAMERA_MODELS
from boresight.errors import CancelledError, RefusedInputError
from boresight.estimation import batch
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.observability import is_curved
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import read_sensor
from boresight.verdicts.verdict import make_verdict, make_verdict_marks
from tests.calibration.conftest import telemetry
from tests.calibration.sets import described, in_memory, lens_case, same_in_pieces, sky, written
from tests.estimation.fields import FREE, SCALE, TRUTH
from tests.refusals import has_code

CONTRACT = {
    "schema", "sensor", "method", "variant", "camera_model", "free", "parameters", "sigma", "covariance", "status", "advice",
    "iterations", "frames", "exposures", "stars", "pairs", "rms_arc_rad", "chi2_per_dof", "nis", "observability", "validation",
    "history", "timing_s", "inputs",
}  # fmt: skip


@pytest.mark.few(3)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_writes_the_contracts_document_and_finds_the_truth(method, calibrated, make_telemetry):
    document = calibrated(make_telemetry(1, frames=80), method=method, validation=make_telemetry(2))
    assert set(document) >= CONTRACT
    json.dumps(document, allow_nan=False)
    assert len(document["advice_codes"]) == len(document["advice"])
    assert all(code in ADVICE_KINDS or code.startswith(CAUSE) for code in document["advice_codes"])
    assert (document["schema"], document["status"]) == ("boresight.calibration/1", "converged")
    assert list(document["parameters"]) == list(document["sigma"]) == document["free"]
    assert document["pairs"] == 2 * document["stars"] - 3 * document["exposures"]
    error = (np.array([document["parameters"][name] for name in document["free"]]) - TRUTH) / SCALE
    P = np.array(document["covariance"]["matrix"]) / np.outer(SCALE, SCALE)
    assert nees(error, P) < 26  # the 99.9 % point of chi-square with 8 degrees of freedom
    for judged in (document, document["validation"]):
        assert judged["rms_arc_rad"]["final"] < judged["rms_arc_rad"]["initial"] / 3
    assert document["chi2"]["consistent"]
    assert (document["history"] is None) == (method == "batch") == (document["trace"] is not None)


@pytest.mark.full
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_covariance_that_does_not_hold_is_said_with_what_to_hold_and_that_mends_it(seed, catalogue):
    model = "inverted_wang_decentred"
    # with next to no distortion nothing tells tilt from a moved principal point
    found, truth = lens_case(catalogue, model, seed, share=0.01)
    error = (found.estimate.x - truth) / found.parameters.scale
    assert nees(error, found.estimate.P) > chi2.ppf(0.999, len(truth))
    # no rounding, and no way to a better minimum: the stars themselves find the truth as likely as they should
    arcs = found.problem.whitened(found.estimate.x)
    free, scale = found.parameters.free, found.parameters.scale
    here, there = (batch.normal_equations(arcs, x, free, scale).chi2 for x in (found.estimate.x, truth))
    assert there - here < chi2.ppf(0.999, len(truth))
    result = described(found)
    assert is_curved(result.observability.chi2_rise)
    assert "curved" in {mark.word for mark in make_verdict_marks(result)}
    assert make_verdict(result).level == "caution"
    assert trend_entry(result).left_out is not None
    runs, free = 0, CAMERA_MODELS[model].parameter_names
    symbols = dict(zip(free, CAMERA_MODELS[model].symbols, strict=True))
    while said := re.findall(
        r"The covariance is wrong along .*; hold (.*) fixed and run again", " ".join(result.advice)
    ):
        held = re.split(", | and ", said[0])
        assert set(held) <= set(symbols.values())
        free = tuple(name for name in free if symbols[name] not in held)
        result, runs = described(lens_case(catalogue, model, seed, share=0.01, free=free)[0]), runs + 1
    assert runs in {1, 2}
    assert not is_curved(result.observability.chi2_rise)


@pytest.mark.few(3)
@pytest.mark.parametrize("method", METHODS)
def test_the_matrix_of_the_document_is_the_square_of_its_sigmas(method, sensor, calibrated, make_telemetry):
    document = calibrated(make_telemetry(3), method=method, free=("f_m", "b2_per_m2"))
    assert document["covariance"]["names"] == document["free"] == ["f_m", "b2_per_m2"]
    sigmas = [document["sigma"][name] for name in document["free"]]
    np.testing.assert_allclose(np.sqrt(np.diag(document["covariance"]["matrix"])), sigmas, rtol=1e-12)
    assert (document["sigma"]["m0_px"], document["parameters"]["m0_px"]) == (None, sensor.initial[1])


def test_a_history_follows_the_frames_with_bounds_and_both_rms_and_a_long_one_stays_small(calibrated, make_telemetry):
    document = calibrated(make_telemetry(4), method="sqrf", variant="q")
    history = document["history"]
    n = len(history["frame"])
    assert history["frame"][-1] == 39
    assert history["frame"] == sorted(history["frame"])
    assert np.array(history["parameters"]).shape == np.array(history["sigma"]).shape == (n, 8)
    assert [len(history[key]) for key in ("tail_rms_rad", "aggregate_rms_rad", "nis", "nis_dof")] == [n] * 4
    assert history["tail_rms_rad"][-1] == pytest.approx(document["rms_arc_rad"]["final"], rel=1e-9)
    np.testing.assert_allclose(history["parameters"][-1], list(document["parameters"].values()), rtol=1e-12)
    kept = calibrated(make_telemetry(5, frames=2500, stars=5, exposures=1), method="sqrf")["history"]["frame"]
    assert len(kept) <= 1000
    assert kept[-1] == 2499


def test_over_confidence_and_wrong_noise_are_said_with_the_sigma_that_would_fit(calibrated, make_telemetry, sensor):
    codes = calibrated(make_telemetry(6, frames=80, stars=5), method="sqrf", linearisations=1)["advice_codes"]
    assert {"distant_start", "overclaim"} <= set(codes)
    document = calibrated(make_telemetry(10), replace(sensor, centroid_sigma_px=0.2))
    assert document["advice_codes"][0] == "cause_noise"
    assert float(document["advice"][0].split()[4]) == pytest.approx(0.437 / 0.2, rel=0.05)


def test_too_few_stars_and_stars_on_one_line_leave_nothing_estimated_and_are_counted(calibrated, make_telemetry):
    document = calibrated(make_telemetry(7, stars=3))
    assert document["status"] == "too_few_stars"
    assert set(document["sigma"].values()) == {None}
    (sentence,) = (
        said for said, code in zip(document["advice"], document["advice_codes"], strict=True) if code == "too_few_stars"
    )
    assert " 4 " in sentence
    assert set(document) >= CONTRACT
    json.dumps(document, allow_nan=False)
    telemetry = make_telemetry(8, frames=3)
    line = np.linspace(-0.1, 0.1, len(telemetry))
    document = calibrated(replace(telemetry, ra_rad=line, dec_rad=np.zeros(len(telemetry))), match="given")
    assert document["status"] == "too_few_stars"
    assert {"what": "exposures", "count": 6, "reason": COLLINEAR_REASON} in document["left_out"]


def test_a_start_or_telemetry_that_is_not_this_sensor_is_said_to_be_so_and_not_called_converged(
    calibrated, make_telemetry
):
    rng, telemetry = np.random.default_rng(0), make_telemetry(9)
    ra, dec = rng.uniform(0, 6.28, len(telemetry)), rng.uniform(-1.5, 1.5, len(telemetry))
    document = calibrated(replace(telemetry, ra_rad=ra, dec_rad=dec))
    given_up = {"diverged", "max_iterations", "too_few_stars"}
    assert document["status"] in given_up or not document["chi2"]["consistent"]
    assert document["advice"]
    json.dumps(document, allow_nan=False)
    document = calibrated(make_telemetry(15, truth=TRUTH * np.where(np.arange(8) == 0, 2, 1)))
    assert document["status"] == "diverged" or "large_change" in document["advice_codes"]


def test_an_unknown_free_parameter_is_refused_with_the_names_there_are(sensor, catalogue, make_telemetry):
    with pytest.raises(RefusedInputError, match=r"'k1'.*inverted_wang.*f_m", check=has_code("unknown-parameter")):
        calibrate(make_telemetry(11), sensor, catalogue, CalibrationSettings(free=("k1",))).to_dict()


@pytest.mark.parametrize("method", METHODS)
def test_a_cancel_stops_every_method(method, sensor, catalogue, make_telemetry):
    with pytest.raises(CancelledError):
        calibrate(
            make_telemetry(12), sensor, catalogue, CalibrationSettings(method=method), cancelled=lambda: True
        ).to_dict()


@pytest.mark.parametrize("part", ["minima.look_for_minima", "trust.fit_best", "trust._judge_stars", "trust._tested"])
def test_a_cancel_stops_a_filter_that_is_searched_and_judged(part, sensor, catalogue, make_telemetry, monkeypatch):
    begun, name = [], f"boresight.calibration.{part}"
    computed = resolve_name(name)

    def begin(*given, **named):
        begun.append(1)
        return computed(*given, **named)

    monkeypatch.setattr(name, begin)
    with pytest.raises(CancelledError):
        calibrate(
            make_telemetry(12), sensor, catalogue, CalibrationSettings(method="sqrf"), cancelled=lambda: bool(begun)
        )
    assert begun == [1]


@pytest.mark.few(3)
@pytest.mark.parametrize("method", METHODS)
def test_progress_carries_a_document_from_which_figures_can_draw(method, calibrated, make_telemetry, monkeypatch):
    heard = []
    monkeypatch.setattr("boresight.calibration.calibrate.REPORT_EVERY_S", 0.0)
    calibrated(make_telemetry(13), method=method, report=heard.append)
    assert 0 <= heard[0].fraction <= 1
    assert heard[0].partial.status == "running"
    json.dumps(heard[0].partial.to_dict(), allow_nan=False)


def test_a_filter_on_its_way_says_how_many_frames_it_has_taken_in_at_its_pace(calibrated, make_telemetry):
    heard = []
    calibrated(make_telemetry(13, frames=30), method="sqrf", replay_frames_per_s=30.0, report=heard.append)
    for told in (one for one in heard if one.partial):
        if told.partial.status == "running":
            assert told.partial.frames_done == round(told.fraction * told.partial.frames)
    document = calibrated(make_telemetry(14, frames=30), method="sqrf", replay_frames_per_s=100.0)
    assert document["timing_s"]["fit"] >= 0.9 * (len(document["history"]["frame"]) - 1) / 100


@pytest.fixture
def real_calibrated(real_sky, catalogue):
    telemetry, sensor = read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json")
    return lambda free, method="batch": in_memory(telemetry, sensor, catalogue, method=method, free=free)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_the_real_focal_length_is_known_to_a_pixel_and_distortion_lowers_the_rms(real_calibrated, real_sky, method):
    alone, both = (real_calibrated(free, method) for free in (("f_m",), ("f_m", "b2_per_m2")))
    assert both["sigma"]["f_m"] / read_sensor(real_sky / "esa.sensor.json").pixel_pitch_m < 1.0
    assert both["rms_arc_rad"]["final"] < alone["rms_arc_rad"]["final"]


def test_with_all_eight_free_the_real_sky_says_in_words_that_principal_point_and_tilt_are_weak(real_calibrated):
    document = real_calibrated(None)
    said = " ".join(document["advice"])
    assert "n0 and a1 move together" in said
    assert "m0 and a2 move together" in said
    assert min(document["sigma"]["m0_px"], document["sigma"]["n0_px"]) > 5


def test_what_is_over_in_a_moment_makes_no_document_on_its_way(calibrated, make_telemetry, monkeypatch):
    heard = []
    monkeypatch.setattr("boresight.calibration.calibrate.REPORT_EVERY_S", 3600.0)
    calibrated(make_telemetry(13), report=heard.append)
    assert heard == []


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


def test_on_clean_data_the_view_says_that_least_squares_agrees_and_without_sigma_there_is_no_shift(
    sensor, catalogue, make_telemetry
):
    estimate, sigma = _estimate(make_telemetry(1, frames=60), sensor, catalogue, robust="huber")
    view = to_plain(robust_view(estimate.robust, NAMES, sigma))
    assert view["share"] == pytest.approx(view["expected_share"], abs=0.02)
    assert view["downweighted"] == round(view["share"] * estimate.robust.judged)
    assert max(map(abs, view["shift_in_sigma"].values())) < 1
    assert "agrees" in view["sentence"]
    estimate, sigma = _estimate(make_telemetry(3), sensor, catalogue, robust="huber")
    sigma[0] = np.nan
    assert to_plain(robust_view(estimate.robust, NAMES, sigma))["shift_in_sigma"]["f_m"] is None


def test_with_wrong_stars_the_view_shows_where_least_squares_would_have_ended(sensor, catalogue, make_telemetry):
    telemetry = _with_wrong_stars(make_telemetry(2, frames=60), 0.03)
    estimate, sigma = _estimate(telemetry, sensor, catalogue, robust="huber")
    plain, _ = _estimate(telemetry, sensor, catalogue)
    view = to_plain(robust_view(estimate.robust, NAMES, sigma))
    assert view["share"] > view["expected_share"] + 0.05
    without = np.array(list(view["parameters_without"].values()))
    np.testing.assert_allclose((without - plain.x) / sigma, 0, atol=0.1)  # weights are taken at the robust estimate
    assert np.abs((estimate.x - TRUTH) / sigma).max() < 4 < np.abs((without - TRUTH) / sigma).max()
    assert "check for wrong matches" in view["sentence"]


def test_the_cosine_error_gives_sigmas_that_hold_and_says_what_it_costs(sensor, catalogue, make_telemetry):
    estimate, sigma = _estimate(make_telemetry(4, frames=60), sensor, catalogue, error="cosine")
    _, of_arcs = _estimate(make_telemetry(4, frames=60), sensor, catalogue)
    assert estimate.status == "converged"
    assert np.abs((estimate.x - TRUTH) / sigma).max() < 4
    assert (sigma > of_arcs).all()
    (remark,) = estimate.remarks
    cost = np.exp(np.mean(np.log(sigma / of_arcs)))
    assert f"give sigmas {cost:.2f} times smaller" in remark
    assert "not valid" in remark
    arcs = build_problem(make_telemetry(4, frames=60), sensor, catalogue).whitened(estimate.x)
    assert estimate.chi2 == pytest.approx(batch.normal_equations(arcs, estimate.x, FREE, SCALE).chi2)


#: Rows of the sets below that are moved off.
MOVED = (17, 101)
PARTS = ("parameters", "sigma", "chi2", "frames", "exposures", "stars", "pairs", "rms_arc_rad", "evaluation")


def moved(whole, sensor, px=5.0):
    col_px = whole.col_px.copy()
    col_px[list(MOVED)] = sensor.columns - 0.5 + px
    return replace(whole, col_px=col_px)


def without(whole):
    kept = np.delete(np.arange(len(whole)), MOVED)
    arrays = {item.name: getattr(whole, item.name) for item in fields(Telemetry)}
    return replace(whole, **{name: value[kept] for name, value in arrays.items() if isinstance(value, np.ndarray)})


@pytest.mark.parametrize("px", [1.0, 5.0, 3000.0])
def test_given_matches_give_the_calibration_of_the_set_without_the_row(px, sensor, catalogue):
    whole = telemetry(8, frames=30)
    left = in_memory(moved(whole, sensor, px), sensor, catalogue, match="given")
    without_row = in_memory(without(whole), sensor, catalogue, match="given")
    for name in PARTS:
        assert left[name] == without_row[name], name
    assert left["left_out"] == [{"what": "stars", "count": 2, "reason": "centroid outside the detector"}]
    assert left["stars_off_detector"]["stars"] == 2
    assert [star["row"] for star in left["stars_off_detector"]["rows"]] == [row + 2 for row in MOVED]
    told = left["advice_codes"].count("off_detector")
    assert told == (px > 2.0)  # an image that the edge cuts is no fault


def test_stars_matched_again_are_those_of_the_set_without_the_row(catalogue):
    field = sky(catalogue, frames=12)
    whole = field.blanked(0.3)
    shifted = moved(whole, field.sensor)
    found, expected = field.match(shifted), field.match(without(whole))
    rest = np.delete(np.arange(len(whole)), MOVED)
    assert found.star_id[list(MOVED)].tolist() == [0, 0]
    np.testing.assert_array_equal(found.star_id[rest], expected.star_id)
    np.testing.assert_array_equal(found.quaternion, expected.quaternion)


@pytest.mark.parametrize("match", ["given", "rematch"])
def test_flight_scores_are_those_of_the_set_without_the_row(match, catalogue):
    field = sky(catalogue, frames=12)
    settings, states = CalibrationSettings(match=match), [(field.x, field.P)]
    (found,) = match_under_states(moved(field.telemetry, field.sensor), field.sensor, catalogue, states, settings)
    (expected,) = match_under_states(without(field.telemetry), field.sensor, catalogue, states, settings)
    assert not found.taken()[list(MOVED)].any()
    assert found.view.matched_stars == expected.view.matched_stars
    np.testing.assert_array_equal(found.view.valid, expected.view.valid)


@pytest.mark.parametrize("rows_a_group", [100, 10_000], ids=["read apart", "read from its start"])
def test_a_file_in_pieces_leaves_out_the_same_rows(rows_a_group, sensor, catalogue, tmp_path):
    path, whole = written(moved(telemetry(8, frames=30), sensor), tmp_path, rows_a_group)
    choices = {"match": "given", "validation": whole}
    one = same_in_pieces(path, whole, sensor, catalogue, 4, **choices)
    assert one["stars_off_detector"]["stars"] == 2
    assert one["advice_codes"].count("off_detector") == 2  # of the set, and of the validation set


RESULT = Calibration(
    camera_model="inverted_wang",
    status="converged",
    parameters=Values({"f_m": 0.016, "g_y": 1.0}),
    covariance=Covariance(names=["f_m"], matrix=[[4e-12]]),
    chi2=ChiSquareTest(dof=100, lower=0.9, upper=1.1, consistent=True),
    chi2_per_dof=1.05,
    inputs=Inputs(settings=StatedSettings(linearisations=6)),
)


def keep_entry(**changed: Any) -> TrendEntry:
    entry = trend_entry(replace(RESULT, **changed))
    assert entry is not None
    return entry


def innovations(mean: float) -> InnovationTest:
    return InnovationTest(mean=mean, dof=100, lower=0.8, upper=1.2, consistent=False)


def claimed_over_bound(ratio: float) -> Trust:
    claimed = Efficiency(
        names=[], cramer_rao_sigma=Values(), ratio=Values(), overall_ratio=ratio, frames_used=1, sentence=""
    )
    return Trust(efficiency=claimed)


def test_an_honest_covariance_is_kept_as_it_is_and_nothing_estimated_is_nothing_to_keep() -> None:
    kept = keep_entry()
    assert (kept.covariance, kept.variance_factor, kept.said, kept.left_out) == ([[4e-12]], 1.0, None, None)
    assert trend_entry(replace(RESULT, covariance=Covariance())) is None
    assert trend_entry(Calibration(status="running")) is None


@pytest.mark.parametrize(
    ("changed", "factor", "word"),
    [
        ({"chi2_per_dof": 4.0}, 4.0, "chi-square"),
        ({"nis": innovations(2.25)}, 2.25, "innovations"),
        ({"trust": claimed_over_bound(0.5)}, 4.0, "Cramér-Rao"),
        ({"chi2_per_dof": 2.0, "nis": innovations(9.0)}, 9.0, "innovations"),
    ],
)
def test_a_covariance_that_is_too_small_is_widened_by_the_worst_sign_of_it(
    changed: dict[str, Any], factor: float, word: str
) -> None:
    entry = keep_entry(**changed)
    assert entry.variance_factor == pytest.approx(factor)
    assert entry.covariance[0][0] == pytest.approx(4e-12 * factor)
    assert word in (entry.said or "")


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"status": "max_iterations"}, "max iterations"),
        ({"variant": "q"}, "process noise"),
        ({"variant": "no-refit"}, "matches used only"),
        ({"variant": "no-q", "inputs": Inputs(settings=StatedSettings(linearisations=1))}, "over-confident"),
        ({"variant": "no-q", "inputs": Inputs(settings=StatedSettings(forgetting_factor=0.99))}, "forgetting"),
    ],
)
def test_what_no_factor_makes_comparable_is_left_out(changed: dict[str, Any], why: str) -> None:
    assert why in (keep_entry(**changed).left_out or "")


@pytest.mark.parametrize("match", ["given", "rematch"])
def test_stars_left_out_by_number_say_nothing(match, calibrated, make_telemetry):
    measured = make_telemetry(1, frames=40)
    hip, sightings = np.unique(measured.star_id[measured.star_id > 0], return_counts=True)
    out = hip[np.argsort(-sightings)[:3]].tolist()
    gone = np.isin(measured.star_id, out)
    moved = replace(measured, row_px=np.where(gone, measured.row_px + 0.3, measured.row_px))  # what they say is wrong
    said, unsaid = (calibrated(one, match=match, leave_out_stars=out) for one in (moved, measured))
    assert said["parameters"] == pytest.approx(unsaid["parameters"], rel=1e-12)
    assert said["stars"] == unsaid["stars"] <= calibrated(measured, match=match)["stars"] - gone.sum() // 2
