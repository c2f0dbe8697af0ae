"""Fit, match, fit: what is matched under a state, when it rests, what the flight rule keeps, and counts that add up."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Parameters, run_batch
from boresight.calibration.matching import matched
from boresight.calibration.matching.match_report import (
    MOST_CYCLES,
    Cycle,
    CyclesEnd,
    counted,
    matching_view,
)
from boresight.calibration.matching.matched import Dataset, Matched, MatchedRange
from boresight.calibration.matching.matched_frames import read_given_matches
from boresight.calibration.matching.rematch import Rematcher
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import MatchedRows
from boresight.estimation.filters.history import start
from boresight.simulation.sensors import st16_truth
from boresight.sky.guide_stars import DOUBLE, UNRELIABLE
from boresight.sky.matching import EXPOSURE_REASONS, ROW_REASONS, STARTS
from tests.calibration.sets import sky

ALL = np.arange(8)


@pytest.fixture(scope="module")
def field(catalogue):
    return sky(catalogue, 4, 24)


def matched_set(field, telemetry, free=ALL, **settings):
    parameters = Parameters(free, field.sensor.typical_sigma[free])
    return Dataset(telemetry, field.sensor, field.catalogue, parameters, CalibrationSettings(**settings), None)


def fitted(field, sets, free=ALL):
    problem = sets.at_start().problem
    parameters = Parameters(free, field.sensor.typical_sigma[free])
    return run_batch(problem, parameters, CalibrationSettings(), lambda *_: None, lambda: False), problem


def asked(monkeypatch):
    calls, real = [], Rematcher.__call__

    def listening(self, x, P, frames=slice(None), noise=1.0):
        calls.append((x, P, noise))
        return real(self, x, P, frames, noise)

    monkeypatch.setattr(Rematcher, "__call__", listening)
    return calls


def test_given_matches_stand_under_every_state(field):
    sets = matched_set(field, field.blanked(0.4), match="given")
    first = sets.at_start()
    assert sets.stands
    assert sets.at_covariance(field.x * 1.01, np.eye(8)) is first
    assert first.problem.arcs.n_stars <= (field.blanked(0.4).star_id > 0).sum()


def test_at_the_start_parameters_are_as_sure_as_the_ground_calibration_and_those_held_fixed_stay_so(field, monkeypatch):
    calls = asked(monkeypatch)
    matched_set(field, field.blanked(0.4), initial_sigma_scale=7.0).at_start()
    np.testing.assert_allclose(calls[0][1], np.diag((7.0 * field.sensor.typical_sigma) ** 2))
    free = np.array([0, 3, 4])
    sets = matched_set(field, field.blanked(0.4), free)
    sets.at_covariance(field.x, 0.01 * np.eye(3))
    variance = np.diag(calls[-1][1]) / field.sensor.typical_sigma**2
    np.testing.assert_allclose(variance[free], 0.01)
    np.testing.assert_allclose(np.delete(variance, free), 100.0)


def test_residuals_larger_than_claimed_widen_noise_and_covariance_alike(field, monkeypatch):
    telemetry = replace(field.blanked(0.2), sigma_px=None)
    sets = matched_set(replace(field, sensor=replace(field.sensor, centroid_sigma_px=0.2)), telemetry)
    estimate, problem = fitted(field, sets)
    calls = asked(monkeypatch)
    sets.at(estimate, problem)
    (_, P, noise), scale = calls[0], field.sensor.typical_sigma
    assert noise == pytest.approx(0.437 / 0.2, rel=0.1)
    held = np.linalg.inv(estimate.A + np.eye(8) / 100)
    np.testing.assert_allclose(P / np.outer(scale, scale), noise**2 * held, rtol=1e-9)


def test_residuals_as_claimed_widen_hardly_anything_and_smaller_ones_nothing(field, monkeypatch):
    sets = matched_set(field, field.blanked(0.2))
    estimate, problem = fitted(field, sets)
    calls = asked(monkeypatch)
    sets.at(estimate, problem)
    sets.at(replace(estimate, chi2=0.1 * estimate.chi2), problem)
    assert calls[0][2] == pytest.approx(1.0, abs=0.1)
    assert calls[1][2] == 1.0


def test_the_flight_rule_keeps_fewer_stars_at_the_ground_than_the_statistical_and_as_many_when_refined(
    field, catalogue
):
    for sky_, low, high in ((field, 0.0, 0.6), (sky(catalogue, 4, 24, start="refined"), 0.97, 1.0)):
        counts = []
        for rule in ("flight", "statistical"):
            sets = matched_set(sky_, sky_.blanked(0.2), match_rule=rule)
            matched = sets.at_covariance(sky_.x, sky_.P / np.outer(*[sky_.sensor.typical_sigma] * 2))
            counts.append(matched.problem.arcs.n_stars)
            # what was matched before the check is kept for the record
            assert (matched.matches.star_id > 0).sum() >= (matched.telemetry.star_id > 0).sum()
        assert low <= counts[0] / counts[1] <= high


def test_frames_matched_one_by_one_are_those_of_the_whole_set(field):
    sets = matched_set(field, field.blanked(0.3))
    frames, state = sets.frames(), start(field.sensor.initial, 8, 10.0)
    parts = [frames.arcs(k, k + 1, state) for k in range(frames.n_frames)]
    whole = sets.at_start().problem.arcs
    assert sum(part.n_stars for part in parts) == whole.n_stars
    np.testing.assert_allclose(np.concatenate([part.s_i for part in parts]), whole.s_i)
    np.testing.assert_array_equal(np.concatenate([part.frame for part in parts]), whole.frame)


@pytest.fixture(scope="module")
def run(catalogue):
    def calibrated(number=4, blanked=0.3, frames=60, sensor=None, **settings):
        field = sky(catalogue, number, frames)
        return calibrate(field.blanked(blanked), sensor or field.sensor, catalogue, CalibrationSettings(**settings))

    return calibrated


def test_the_batch_rests_when_its_result_changes_no_match_and_given_matches_stand(run):
    matching = run()["matching"]
    assert matching["rested"]
    assert matching["cycles"][-1]["changed"] == 0
    assert all(cycle["changed"] > 0 for cycle in matching["cycles"][:-1])
    assert run(match="given")["matching"] is None


def test_from_the_flight_rule_matches_grow_cycle_by_cycle_each_fitted_to_what_the_one_before_matched(run):
    cycles = run(match_rule="flight")["matching"]["cycles"]
    assert [cycle["cycle"] for cycle in cycles] == list(range(1, len(cycles) + 1))
    for before, after in itertools.pairwise(cycles):
        assert after["matched"] == before["rematched"]
        assert before["changed"] >= abs(before["rematched"] - before["matched"])
    matching = run(match_rule="flight")["matching"]
    counts = [cycle["matched"] for cycle in matching["cycles"]]
    assert 2 <= len(counts) <= MOST_CYCLES == 3
    assert counts == sorted(counts)
    assert counts[-1] > 1.2 * counts[0]


def test_the_statistical_rule_matches_nearly_all_at_once_and_unnamed_stars_make_it_as_sure_as_named_ones(run):
    cycles = run(match_rule="statistical")["matching"]["cycles"]
    assert cycles[0]["matched"] > 0.97 * cycles[-1]["rematched"]
    half, all_named = run(1, 0.5), run(1, 0.0)
    halved = run(1, 0.5, match="given")
    ratio = [np.mean([run_["sigma"][p] / all_named["sigma"][p] for p in all_named["sigma"]]) for run_ in (half, halved)]
    assert ratio[0] < 1.02
    assert ratio[1] > 1.3
    truth = dict(zip(half["parameters"], st16_truth(1), strict=True))
    assert max(abs(half["parameters"][p] - truth[p]) / half["sigma"][p] for p in truth) < 4


def test_matches_that_do_not_rest_end_after_three_cycles(catalogue, monkeypatch):
    field, gone = sky(catalogue, 1, 20), []
    real = matched.Dataset.at

    def restless(self, estimate, problem):
        again = real(self, estimate, problem)
        gone.append(len(gone))
        again.telemetry.star_id[np.flatnonzero(again.telemetry.star_id)[len(gone)]] = 0
        return again

    monkeypatch.setattr(matched.Dataset, "at", restless)
    matching = calibrate(field.blanked(0.2), field.sensor, catalogue, CalibrationSettings())["matching"]
    assert len(matching["cycles"]) == MOST_CYCLES
    assert not matching["rested"]


@pytest.mark.parametrize("number", [2, 6])
def test_matching_again_does_not_harm_a_set_whose_names_are_all_given(catalogue, number):
    field = sky(catalogue, number, 60)
    telemetry = field.blanked(0.0)
    given, again = (
        calibrate(telemetry, field.sensor, catalogue, CalibrationSettings(match=match))
        for match in ("given", "rematch")
    )
    for name, sigma in given["sigma"].items():
        assert abs(again["parameters"][name] - given["parameters"][name]) < 0.1 * sigma


def test_cycles_are_told_with_all_their_counts_and_the_most_frequent_phrase_first():
    ended = CyclesEnd(None, None, (Cycle(1, 10, 12, 4, None),))
    assert [vars(cycle) for cycle in ended.cycles] == [
        {"cycle": 1, "matched": 10, "rematched": 12, "changed": 4, "rms_arc_rad": None}
    ]
    assert list(counted(np.array([1, 0, 1], np.int8), ("a", "b")).items()) == [("b", 2), ("a", 1)]


# Filters.


def test_a_filter_matches_with_its_latest_state_or_the_baseline_s_and_no_refit_with_the_baseline_s_only(run):
    documents = [run(method="sqrf", match_rule="flight", match_parameters=choice) for choice in ("latest", "baseline")]
    latest, baseline = documents
    assert latest["stars"] > 1.2 * baseline["stars"]
    assert latest["matching"]["cycles"][0]["matched"] == baseline["stars"]
    assert baseline["matching"]["cycles"] == []
    assert max(latest["sigma"][p] / baseline["sigma"][p] for p in latest["sigma"]) < 1.0
    no_refit = run(method="sqrf", variant="no-refit", match_rule="flight", match_parameters="latest")
    baseline = run(method="sqrf", variant="q", match_rule="flight", match_parameters="baseline")
    assert no_refit["stars"] == baseline["stars"]
    assert no_refit["parameters"] == baseline["parameters"]


EVALUATION = {"flight_tolerance_rad": 4e-4, "availability": {"initial": 0.1}, "matched_stars": {"initial": 9}}


class AtState:
    def __init__(self, x):
        self.x = x


def view(field, telemetry, matches):
    ended = CyclesEnd(
        Matched(None, (MatchedRange(MatchedRows(telemetry, matches, matches.star_id)),)), AtState(field.x)
    )
    return matching_view(telemetry, field.sensor, ended, EVALUATION)


def test_every_count_adds_up(field):
    telemetry = field.blanked(0.5)
    wrong = telemetry.star_id.copy()
    named = np.flatnonzero(wrong)
    wrong[named[:5]] = np.roll(wrong[named[:5]], 1)
    telemetry = replace(telemetry, star_id=wrong)
    matches = field.match(telemetry)
    shown = view(field, telemetry, matches)
    assert shown["given"] == shown["kept"] + shown["removed"] == (wrong > 0).sum()
    assert shown["matched"] == shown["kept"] + shown["renamed"] + shown["added"] == (matches.star_id > 0).sum()
    assert shown["removed"] >= 1
    assert sum(shown["row_reasons"].values()) == len(telemetry) - shown["matched"]
    assert sum(shown["removed_reasons"].values()) == shown["removed"] - shown["renamed"]
    assert sum(shown["starts"].values()) == sum(shown["exposure_reasons"].values()) == 2 * 24
    assert set(shown["row_reasons"]) <= set(ROW_REASONS[1:])
    assert set(shown["starts"]) <= set(STARTS)
    assert set(shown["exposure_reasons"]) <= set(EXPOSURE_REASONS)
    json.dumps(shown, allow_nan=False)


def test_flight_scores_tolerances_and_flagged_stars_are_shown(field):
    shown = view(field, field.telemetry, field.match(field.telemetry))
    assert shown["flight"] == {
        "tolerance_rad": 4e-4, "availability": {"initial": 0.1}, "matched_stars": {"initial": 9},
    }  # fmt: skip
    # no gate is narrower than its own centroid noise
    assert 4.5 * 0.437 * 0.95 < shown["tolerance_px"]["median"] <= shown["tolerance_px"]["p95"]
    matches = field.match(field.blanked(0.5), leave_out_doubles=True)
    flagged = view(field, field.blanked(0.5), matches)["flagged"]
    assert flagged["doubles"] == (matches.flags & DOUBLE > 0).sum()
    assert flagged["unreliable"] == (matches.flags & UNRELIABLE > 0).sum()
    assert max(flagged["doubles"], flagged["unreliable"]) <= flagged["left_out"]
    assert flagged["left_out"] <= flagged["doubles"] + flagged["unreliable"]


def test_given_matches_have_no_view_and_where_nothing_is_matched_there_are_nulls(field, catalogue):
    bare = replace(field.telemetry, star_id=None, quaternion=None, time_utc=None)
    shown = view(field, bare, field.match(bare))
    assert shown["matched"] == shown["given"] == 0
    assert shown["tolerance_px"] == {"median": None, "p95": None}
    assert shown["row_reasons"] == {ROW_REASONS[5]: len(bare)}
    assert view(field, field.telemetry, read_given_matches(field.telemetry, field.sensor, catalogue)) is None
