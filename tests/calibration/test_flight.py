"""What the flight code accepts, against a plain search, and what that makes of ground calibration and truth."""

from dataclasses import dataclass

import numpy as np
import pytest

from boresight.calibration.matching.flight_check import FLIGHT_REASONS, check_flight, compute_flight_tolerance
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.arcs import arclength
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import find_exposures
from tests.estimation.fields import GROUND, PITCH, TRUTH

SETTINGS = CalibrationSettings()


@dataclass(frozen=True)
class Given:
    s_i: np.ndarray
    exposure_start: np.ndarray
    frame: np.ndarray


def given(telemetry, catalogue=None):
    exposures = find_exposures(telemetry)
    s_i = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue
    )
    return Given(s_i, np.append(exposures.start, len(telemetry)), exposures.frame)


def plain_agreement(s_d, s_i, tolerance):
    kept = list(range(len(s_d)))
    while True:
        i, j = np.meshgrid(kept, kept, indexing="ij")
        excess = np.abs(arclength(s_d[i], s_d[j]) - arclength(s_i[i], s_i[j])) - tolerance
        np.fill_diagonal(excess, -1)
        counts, totals = (excess > 0).sum(1), np.where(excess > 0, excess, 0).sum(1)
        if not counts.any():
            return kept
        del kept[max(range(len(kept)), key=lambda k: (counts[k], totals[k], k))]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_compiled_check_equals_the_plain_search(telemetry_of, sensor, catalogue, seed, x):
    telemetry = telemetry_of(seed, frames=5)
    matches, tolerance = given(telemetry, catalogue), compute_flight_tolerance(sensor, SETTINGS)
    seen = check_flight(telemetry, sensor, matches, x, tolerance, 4)
    s_d = INVERTED_WANG.directions(x, telemetry.row_px, telemetry.col_px, PITCH)
    for first, last in zip(matches.exposure_start[:-1], matches.exposure_start[1:], strict=True):
        expected = plain_agreement(s_d[first:last], matches.s_i[first:last], tolerance)
        assert np.flatnonzero(seen.accepted[first:last]).tolist() == expected


def test_no_two_accepted_matches_disagree(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(1, frames=20)
    matches, tolerance = given(telemetry, catalogue), compute_flight_tolerance(sensor, SETTINGS)
    seen = check_flight(telemetry, sensor, matches, GROUND, tolerance, 4)
    s_d = INVERTED_WANG.directions(GROUND, telemetry.row_px, telemetry.col_px, PITCH)
    for first, last in zip(matches.exposure_start[:-1], matches.exposure_start[1:], strict=True):
        rows = first + np.flatnonzero(seen.accepted[first:last])
        i, j = np.triu_indices(len(rows), 1)
        error = arclength(s_d[rows[i]], s_d[rows[j]]) - arclength(matches.s_i[rows[i]], matches.s_i[rows[j]])
        assert np.all(np.abs(error) <= tolerance)


def test_a_wrong_match_is_dropped_and_costs_nothing_else(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(2, frames=10)
    matches = given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[::12] = s_i[6::12]  # the first detection of each exposure is called another star of it
    wrong = Given(s_i, matches.exposure_start, matches.frame)
    seen = check_flight(telemetry, sensor, wrong, TRUTH, compute_flight_tolerance(sensor, SETTINGS), 4)
    dropped = np.flatnonzero(~seen.accepted)
    assert set(dropped % 12) <= {0, 6}
    assert len(dropped) == 20
    assert seen.availability == 1
    assert seen.matched_stars == 20 * 11


@pytest.mark.parametrize(
    ("stars", "matched", "wrong", "reason"), [(12, 3, 0, 1), (12, 5, 2, 2), (12, 12, 4, 3), (12, 12, 3, 0)]
)
def test_every_reason_is_given_where_it_is_due(telemetry_of, sensor, catalogue, stars, matched, wrong, reason):
    telemetry = telemetry_of(3, frames=1, stars=stars, exposures=1)
    matches = given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[matched:] = np.nan
    s_i[:wrong] = np.random.default_rng(4).normal(size=(wrong, 3))
    s_i[:wrong] /= np.linalg.norm(s_i[:wrong], axis=1, keepdims=True)
    seen = check_flight(
        telemetry,
        sensor,
        Given(s_i, matches.exposure_start, matches.frame),
        TRUTH,
        compute_flight_tolerance(sensor, SETTINGS),
        4,
    )
    assert seen.accepted.sum() == matched - wrong
    assert seen.reason.tolist() == [reason]
    assert seen.valid_frames.tolist() == [reason == 0]
    assert seen.matched_stars == (matched - wrong if reason == 0 else 0)
    assert FLIGHT_REASONS[0] == "valid"


def test_a_frame_is_available_by_either_exposure_and_counts_the_stars_of_valid_ones(telemetry_of, sensor, catalogue):
    telemetry = telemetry_of(5, frames=3)
    matches = given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[3:12] = np.nan  # frame 0, exposure 0 keeps three
    s_i[24:48] = np.nan  # frame 1 keeps none
    seen = check_flight(
        telemetry,
        sensor,
        Given(s_i, matches.exposure_start, matches.frame),
        TRUTH,
        compute_flight_tolerance(sensor, SETTINGS),
        4,
    )
    assert seen.frames.tolist() == [0, 1, 2]
    assert seen.valid_frames.tolist() == [True, False, True]
    assert seen.matched_in_frame.tolist() == [12, 0, 24]
    assert seen.availability == pytest.approx(2 / 3)


def test_the_tolerance_is_five_sigmas_of_an_arc_or_what_is_asked_for(sensor):
    assert compute_flight_tolerance(sensor, SETTINGS) == pytest.approx(5 * 84.5e-6, rel=1e-3)
    assert compute_flight_tolerance(sensor, CalibrationSettings(flight_tolerance_urad=300.0)) == pytest.approx(300e-6)


@pytest.mark.parametrize("number", [3, 4])
def test_sensors_three_and_four_are_seldom_available_at_their_ground_calibration_and_nearly_always_at_the_truth(
    number, catalogue
):
    scenario = calibration_scenario(number)
    telemetry = simulate(scenario, np.random.default_rng(scenario.seed), catalogue)
    matches, tolerance = given(telemetry, catalogue), compute_flight_tolerance(scenario.sensor, SETTINGS)
    ground = check_flight(telemetry, scenario.sensor, matches, scenario.sensor.initial, tolerance, 4)
    truth = check_flight(telemetry, scenario.sensor, matches, scenario.truth, tolerance, 4)
    assert ground.availability < 0.4
    assert truth.availability > 0.95
    assert truth.accepted.sum() > 0.995 * np.isfinite(matches.s_i[:, 0]).sum()
