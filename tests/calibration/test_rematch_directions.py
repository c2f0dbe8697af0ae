"""Attitudes with honest covariances, directions that a file gives itself, and the real sky."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.calibration.matching.rematch import Rematcher, ground_covariance, matched_telemetry
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.statistics.consistency import chi_square
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.rematched import Sky, sky


def nees(matches, true):
    good = matches.valid
    theta = (Rotation.from_quat(matches.quaternion[good]) * Rotation.from_quat(true[good]).inv()).as_rotvec()
    return np.einsum("ni,nij,nj->n", theta, np.linalg.inv(matches.attitude_covariance[good]), theta)


def consistent(values):
    expected = chi_square(float(np.sum(values)), 3 * len(values))
    return expected.consistent


def test_attitude_errors_under_the_truth_are_those_of_the_centroid_noise(catalogue):
    field = sky(catalogue, 1, 120, start="refined")
    known = replace(field, P=1e-6 * field.P)
    matches = known.match(field.telemetry)
    values = nees(matches, field.telemetry.quaternion[matches.exposure_start[:-1]])
    assert len(values) > 200
    assert consistent(values)


def test_attitude_errors_under_wrong_parameters_are_those_that_their_covariance_foretells(catalogue):
    rng, scenario = np.random.default_rng(5), calibration_scenario(1, 1)
    sensor = scenario.sensor
    P, parts = ground_covariance(sensor, 2.0), []
    for k in range(150):
        orbit = replace(scenario.orbit, start_utc=scenario.orbit.start_utc + np.timedelta64(37 * k, "m"))
        truth = sensor.initial + np.sqrt(np.diag(P)) * rng.normal(size=8)
        drawn = replace(scenario, truth=truth, orbit=orbit, exposures=1, blanked_share=0.0)
        parts.append(replace(simulate(drawn, rng, catalogue), unknown={}))
        parts[-1].frame[:] = k
    arrays = [name for name, value in vars(parts[0]).items() if isinstance(value, np.ndarray)]
    telemetry = replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays})
    matches = Sky(telemetry, sensor, catalogue, sensor.initial, P).match(telemetry)
    values = nees(matches, telemetry.quaternion[matches.exposure_start[:-1]])
    assert len(values) > 130
    assert consistent(values)


def lifted(field, strength, rng):
    telemetry = matched_telemetry(field.telemetry, field.match(field.telemetry))
    named = telemetry.star_id > 0
    ra, dec, q = telemetry.ra_rad[named], telemetry.dec_rad[named], Rotation.from_quat(telemetry.quaternion[named])
    s = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    zenith = q.inv().apply(np.array([0.6, 0.4, np.sqrt(0.48)]))
    height = np.sum(s * zenith, axis=1)[:, None]
    s += strength * (zenith - height * s) / height
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    row, col = INVERTED_WANG.project(field.x, q.apply(s), field.sensor.pixel_pitch_m)
    arrays = {name: value.copy() for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)}
    arrays["row_px"][named] = row + 0.437 * rng.normal(size=len(row))
    arrays["col_px"][named] = col + 0.437 * rng.normal(size=len(row))
    arrays["ra_rad"][named], arrays["dec_rad"][named] = np.arctan2(s[:, 1], s[:, 0]), np.arcsin(s[:, 2])
    return replace(telemetry, **arrays)


def test_a_file_s_own_directions_are_kept_and_what_they_hold_is_carried_to_unnamed_stars(catalogue):
    field = sky(catalogue, 1, 30, start="refined")
    whole = lifted(field, 1e-3, np.random.default_rng(2))
    named = (whole.star_id > 0) & (np.random.default_rng(3).random(len(whole)) < 0.7)
    part = replace(
        whole, star_id=np.where(named, whole.star_id, 0), ra_rad=np.where(named, whole.ra_rad, np.nan),
        dec_rad=np.where(named, whole.dec_rad, np.nan), quaternion=None,
    )  # fmt: skip
    matches = field.match(part)
    kept = named & (matches.star_id == whole.star_id)
    again = matched_telemetry(part, matches)
    np.testing.assert_allclose(again.ra_rad[kept] % (2 * np.pi), whole.ra_rad[kept] % (2 * np.pi), atol=1e-9)
    assert kept.sum() > 0.98 * named.sum()
    rich = np.add.reduceat(named, matches.exposure_start[:-1], dtype=int) >= 6
    sought = np.repeat(rich, np.diff(matches.exposure_start)) & ~named & (whole.star_id > 0)
    assert sought.sum() > 80
    assert np.mean(matches.star_id[sought] == whole.star_id[sought]) > 0.95
    assert np.sum((matches.star_id > 0) & (matches.star_id != whole.star_id)) <= 2


def test_where_too_few_directions_tell_of_the_air_only_the_named_stars_stay(catalogue):
    field = sky(catalogue, 1, 20, start="refined")
    whole = lifted(field, 1e-3, np.random.default_rng(2))
    image = 2 * whole.frame + whole.exposure
    count = np.array([np.sum((whole.star_id[:row] > 0) & (image[:row] == image[row])) for row in range(len(whole))])
    named = (whole.star_id > 0) & (count < 5)
    part = replace(
        whole, star_id=np.where(named, whole.star_id, 0), ra_rad=np.where(named, whole.ra_rad, np.nan),
        dec_rad=np.where(named, whole.dec_rad, np.nan), quaternion=None,
    )  # fmt: skip
    matches = field.match(part)
    np.testing.assert_array_equal((matches.star_id > 0) & ~named, False)
    assert np.sum(matches.star_id > 0) > 0.98 * named.sum()


def test_the_given_names_of_the_real_sky_are_kept(catalogue):
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "real-sky"
    data = Path(os.environ.get("BORESIGHT_REAL_SKY", beside))
    if not (data / "esa-5-frames.csv").is_file():
        pytest.skip("the real star fields are not here; BORESIGHT_REAL_SKY says where they are")
    sensor, telemetry = read_sensor(data / "esa.sensor.json"), read_telemetry(data / "esa-5-frames.csv")
    matches = Rematcher(telemetry, sensor, catalogue, CalibrationSettings())(
        sensor.initial, ground_covariance(sensor, 10.0)
    )
    named = telemetry.star_id > 0
    assert np.mean(matches.star_id[named] == telemetry.star_id[named]) >= 0.95
    assert matches.valid.all()
    assert (matches.row_reason[matches.star_id == 0] > 0).all()
