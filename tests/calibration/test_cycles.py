"""Fit, match, fit: when it rests, how often it runs, what it counts, and that it never harms."""

import itertools

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.matching import matched
from boresight.calibration.matching.match_report import MOST_CYCLES, Cycle, CyclesEnd, cycles_view
from boresight.calibration.options import CalibrationSettings
from boresight.simulation.sensors import st16_truth
from tests.calibration.rematched import sky


@pytest.fixture(scope="module")
def run(catalogue):
    def calibrated(number=4, blanked=0.3, frames=60, sensor=None, **settings):
        field = sky(catalogue, number, frames)
        return calibrate(field.blanked(blanked), sensor or field.sensor, catalogue, CalibrationSettings(**settings))

    return calibrated


def test_the_batch_rests_when_its_result_changes_no_match(run):
    matching = run()["matching"]
    assert matching["rested"]
    assert matching["cycles"][-1]["changed"] == 0
    assert all(cycle["changed"] > 0 for cycle in matching["cycles"][:-1])


def test_each_cycle_is_fitted_to_what_the_one_before_it_matched(run):
    cycles = run(match_rule="flight")["matching"]["cycles"]
    assert [cycle["cycle"] for cycle in cycles] == list(range(1, len(cycles) + 1))
    for before, after in itertools.pairwise(cycles):
        assert after["matched"] == before["rematched"]
        assert before["changed"] >= abs(before["rematched"] - before["matched"])


def test_from_the_flight_rule_matches_grow_cycle_by_cycle_and_three_are_the_most(run):
    matching = run(match_rule="flight")["matching"]
    counts = [cycle["matched"] for cycle in matching["cycles"]]
    assert 2 <= len(counts) <= MOST_CYCLES == 3
    assert counts == sorted(counts)
    assert counts[-1] > 1.2 * counts[0]


def test_the_statistical_rule_needs_no_growth_for_it_matches_nearly_all_at_once(run):
    cycles = run(match_rule="statistical")["matching"]["cycles"]
    assert cycles[0]["matched"] > 0.97 * cycles[-1]["rematched"]


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


def test_stars_without_names_make_the_estimate_as_sure_as_if_all_were_named(run):
    half, all_named = run(1, 0.5), run(1, 0.0)
    halved = run(1, 0.5, match="given")
    ratio = [np.mean([run_["sigma"][p] / all_named["sigma"][p] for p in all_named["sigma"]]) for run_ in (half, halved)]
    assert ratio[0] < 1.02
    assert ratio[1] > 1.3
    truth = dict(zip(half["parameters"], st16_truth(1), strict=True))
    assert max(abs(half["parameters"][p] - truth[p]) / half["sigma"][p] for p in truth) < 4


def test_given_matches_stand_where_nothing_is_matched_again(run):
    assert run(match="given")["matching"] is None


def test_cycles_are_told_with_all_their_counts():
    ended = CyclesEnd(None, None, (Cycle(1, 10, 12, 4, None),))
    assert cycles_view(ended) == [{"cycle": 1, "matched": 10, "rematched": 12, "changed": 4, "rms_arc_rad": None}]


# Filters.


def test_a_filter_that_matches_with_its_latest_state_ends_with_more_stars_than_the_baseline_gives(run):
    documents = [run(method="sqrf", match_rule="flight", match_parameters=choice) for choice in ("latest", "baseline")]
    latest, baseline = documents
    assert latest["stars"] > 1.2 * baseline["stars"]
    assert latest["matching"]["cycles"][0]["matched"] == baseline["stars"]
    assert baseline["matching"]["cycles"] == []
    assert max(latest["sigma"][p] / baseline["sigma"][p] for p in latest["sigma"]) < 1.0


def test_no_refit_keeps_to_the_baseline_s_matches_whatever_is_asked(run):
    no_refit = run(method="sqrf", variant="no-refit", match_rule="flight", match_parameters="latest")
    baseline = run(method="sqrf", variant="q", match_rule="flight", match_parameters="baseline")
    assert no_refit["stars"] == baseline["stars"]
    assert no_refit["parameters"] == baseline["parameters"]
