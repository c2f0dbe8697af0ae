"""The arcs on which two states are compared are the same whether their order is found anew or kept where it was known."""

import numpy as np
import pytest

from boresight.calibration.evaluation.evaluate import evaluate_matched_frames
from boresight.calibration.matching.matched_frames import common_arcs, match_under_states
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from tests.estimation.fields import TRUTH

GIVEN = CalibrationSettings(match="given")


@pytest.fixture
def seen(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(21, frames=30)
    telemetry.row_px[::170] += 40.0
    states = [(sensor.initial, None), (TRUTH, None)]
    return (
        telemetry,
        build_problem(telemetry, sensor, catalogue).arcs,
        match_under_states(telemetry, sensor, catalogue, states, GIVEN),
    )


def test_every_star_is_in_one_of_the_sets_in_the_same_order(seen, sensor):
    telemetry, ordered, (_, final) = seen
    anew = common_arcs(telemetry, sensor, final, 4)
    kept = common_arcs(telemetry, sensor, final, 4, ordered)
    assert len(kept) == 2
    assert sum(arcs.n_exposures for arcs in kept) == anew[0].n_exposures
    runs = sorted(run for arcs in kept for run in _exposures(arcs))
    assert runs == sorted(_exposures(anew[0]))


def _exposures(arcs):
    return [rows.tolist() for rows in np.split(arcs.source_row, arcs.star_start[1:-1])]


def test_the_scores_are_those_of_arcs_ordered_anew(seen, sensor):
    telemetry, ordered, (initial, final) = seen
    anew = evaluate_matched_frames(telemetry, sensor, initial, final, GIVEN, np.random.default_rng(1))
    kept = evaluate_matched_frames(telemetry, sensor, initial, final, GIVEN, np.random.default_rng(1), ordered)
    assert kept["common_pairs"] == anew["common_pairs"]
    assert kept["stars"] == anew["stars"]
    assert kept["rms_arc_rad"] == pytest.approx(anew["rms_arc_rad"], rel=1e-9)
    assert kept["rms_ratio"] == pytest.approx(anew["rms_ratio"], rel=1e-9)
