"""Two states judged on one set: on the same pairs, with intervals that hold, and with the reasons of frames that fail."""

from dataclasses import replace

import numpy as np
import orjson
import pytest

from boresight.calibration.evaluation.evaluate import evaluate_parameters
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.simulation.scenes import calibration_scenario, simulate
from tests.estimation.fields import GROUND, NOISE_PX, PITCH, TRUTH

GIVEN, ANEW = CalibrationSettings(match="given"), CalibrationSettings(match="rematch")
KEYS = {
    "schema", "frames", "availability", "matched_star_ratio", "rms_arc_rad", "common_pairs", "matched_stars",
    "flight_tolerance_rad", "intervals", "reasons",
}  # fmt: skip
CLOSE = GROUND + 0.7 * (TRUTH - GROUND)


@pytest.fixture(scope="module")
def halves(catalogue):
    scenario = replace(calibration_scenario(3), frames=40, blanked_share=0.5)
    return scenario.sensor, simulate(scenario, np.random.default_rng(1), catalogue), scenario.truth


def test_the_document_is_the_contracts_and_plain_json(telemetry_of, sensor, catalogue):
    found = evaluate_parameters(telemetry_of(1), sensor, catalogue, GROUND, TRUTH, GIVEN, rng=np.random.default_rng(0))
    assert set(found) >= KEYS
    assert orjson.loads(orjson.dumps(found)) == found
    assert found["schema"] == "boresight.evaluation/1"
    assert found["frames"] == 40
    assert found["flight_tolerance_rad"] == pytest.approx(5 * 84.5e-6, rel=1e-3)


def test_a_state_beside_itself_gains_nothing(telemetry_of, sensor, catalogue):
    found = evaluate_parameters(telemetry_of(1), sensor, catalogue, TRUTH, TRUTH, GIVEN, rng=np.random.default_rng(0))
    assert found["matched_star_ratio"] == found["rms_ratio"] == 1
    assert found["intervals"]["matched_star_ratio"] == found["intervals"]["rms_ratio"] == [1, 1]
    assert found["availability"]["initial"] == found["availability"]["final"] == 1
    assert found["reasons"] == {"initial": {}, "final": {}}


def test_every_frame_that_is_not_available_has_its_reason(telemetry_of, sensor, catalogue):
    found = evaluate_parameters(telemetry_of(2), sensor, catalogue, GROUND, TRUTH, GIVEN)
    for side in ("initial", "final"):
        failed = round((1 - found["availability"][side]) * found["frames"])
        assert sum(found["reasons"][side].values()) == failed
    assert found["availability"]["initial"] < 0.5 < found["availability"]["final"]


def test_both_states_are_judged_on_the_pairs_of_the_larger_set_whichever_side_it_is_on(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(3)
    there = evaluate_parameters(telemetry, sensor, catalogue, CLOSE, TRUTH, GIVEN)
    back = evaluate_parameters(telemetry, sensor, catalogue, TRUTH, CLOSE, GIVEN)
    assert there["matched_star_ratio"] > 1
    assert there["common_pairs"] == back["common_pairs"] == 2 * len(telemetry) - 3 * 80
    assert there["rms_arc_rad"]["initial"] == back["rms_arc_rad"]["final"]
    assert there["matched_star_ratio"] == pytest.approx(1 / back["matched_star_ratio"])


def test_the_rms_is_the_plain_root_mean_square_of_the_arcs(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(4, frames=1, exposures=1)
    s_i = np.column_stack([
        np.cos(telemetry.dec_rad) * np.cos(telemetry.ra_rad),
        np.cos(telemetry.dec_rad) * np.sin(telemetry.ra_rad),
        np.sin(telemetry.dec_rad),
    ])  # fmt: skip
    places, _ = arcsets.order(np.array([0, 12]), s_i)
    i, j = places[arcsets.pairs(12)].T
    found = evaluate_parameters(telemetry, sensor, catalogue, GROUND, TRUTH, GIVEN)
    for side, x in (("initial", GROUND), ("final", TRUTH)):
        s_d = INVERTED_WANG.directions(x, telemetry.row_px, telemetry.col_px, PITCH)
        errors = arcsets.arclength(s_d[i], s_d[j]) - arcsets.arclength(s_i[i], s_i[j])
        assert found["rms_arc_rad"][side] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)


def test_the_interval_of_the_rms_holds_what_the_centroid_noise_says(telemetry_of, sensor, catalogue):
    row, col = np.meshgrid(np.arange(0, sensor.rows, 8.0), np.arange(0, sensor.columns, 8.0))
    pixel = INVERTED_WANG.solid_angle(TRUTH, row.ravel(), col.ravel(), PITCH)
    # the arc's ends have different variances each way, but an arc over the field sees them all; their mean is the solid angle's
    expected = np.sqrt(2 * NOISE_PX**2 * pixel.mean())
    rng, hits = np.random.default_rng(9), 0
    for seed in range(60):
        found = evaluate_parameters(
            telemetry_of(100 + seed, frames=30), sensor, catalogue, TRUTH, TRUTH, GIVEN, rng=rng
        )
        low, high = found["intervals"]["rms_arc_rad"]["final"]
        hits += low <= expected <= high
    assert hits >= 51


def test_half_the_stars_come_back_by_matching_anew_and_sensor_three_becomes_available(halves, catalogue):
    sensor, telemetry, truth = halves
    P = np.diag((0.05 * sensor.typical_sigma) ** 2)
    states = (telemetry, sensor, catalogue, sensor.initial, truth)
    given = evaluate_parameters(*states, GIVEN, None, P)
    anew = evaluate_parameters(*states, ANEW, None, P, rng=np.random.default_rng(0))
    assert anew["availability"]["initial"] < 0.6
    assert anew["availability"]["final"] > 0.95
    assert anew["matched_stars"]["final"] > 1.8 * given["matched_stars"]["final"]
    low, high = anew["intervals"]["availability"]["initial"]
    assert low <= anew["availability"]["initial"] <= high


def test_states_under_which_nothing_is_accepted_have_no_rms_and_no_ratio(telemetry_of, sensor, catalogue):
    longer = TRUTH.copy()
    longer[0] *= 2
    found = evaluate_parameters(telemetry_of(5), sensor, catalogue, longer, longer, GIVEN, rng=np.random.default_rng(0))
    assert found["availability"] == {"initial": 0, "final": 0}
    assert found["matched_star_ratio"] is None
    assert found["rms_arc_rad"] == {"initial": None, "final": None}
    assert found["common_pairs"] == 0
    assert orjson.loads(orjson.dumps(found)) == found


def test_without_a_generator_there_are_scores_and_no_intervals(telemetry_of, sensor, catalogue):
    found = evaluate_parameters(telemetry_of(6), sensor, catalogue, GROUND, TRUTH, GIVEN)
    assert found["intervals"]["availability"]["final"] == [None, None]
    assert found["availability"]["final"] == 1
