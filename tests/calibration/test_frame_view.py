"""One frame of a run: residuals are those of trust, predictions an independent projection, attitudes scatter as they claim."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.calibration.calibrate import calibrate
from boresight.calibration.frame_view import frame_view, pointing, read_run_states
from boresight.calibration.matching.rematch import rematch
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.trust.residuals import compute_star_residuals
from boresight.cameras import CAMERA_MODELS
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.schema import select_rows
from tests.calibration.judged import case, field
from tests.estimation.fields import TRUTH


def reader(telemetry, frame):
    def read(neighbours):
        first = np.searchsorted(telemetry.frame, frame - neighbours)
        last = np.searchsorted(telemetry.frame, frame + neighbours, side="right")
        own = slice(*(np.searchsorted(telemetry.frame, [frame, frame + 1]) - first).tolist())
        return select_rows(telemetry, slice(int(first), int(last))), own

    return read


def view_of(telemetry, sensor, catalogue, result, frame, **settings):
    states = read_run_states(result, sensor, CalibrationSettings(**{"match": "given", **settings}))
    return frame_view(states, reader(telemetry, frame), catalogue)


def rows_under(view, name):
    return [(exposure, star) for exposure in view["exposures"] for star in exposure["stars"] if star[name] is not None]


@pytest.mark.parametrize("parity", [1, -1])
def test_residuals_of_a_frame_are_those_that_trust_takes_of_the_set(parity, sensor, catalogue):
    telemetry, sensor = field(1, frames=12, parity=parity), replace(sensor, parity=parity)
    result = calibrate(telemetry, sensor, catalogue, CalibrationSettings(match="given"))
    found = compute_star_residuals(case(telemetry, sensor, catalogue).ground)
    view = view_of(telemetry, sensor, catalogue, result, 5)
    of_frame = found.arcs.source_row[found.frame == 5]
    order = np.argsort(of_frame)
    stars = [star["new"] for _, star in rows_under(view, "new")]
    np.testing.assert_allclose([star["d_px"] for star in stars], found.r[found.frame == 5][order], atol=1e-6)
    np.testing.assert_allclose([star["normalised"] for star in stars], found.z[found.frame == 5][order], atol=1e-4)


@pytest.mark.parametrize("parity", [1, -1])
def test_at_the_true_parameters_residuals_over_their_sigmas_are_the_centroid_noise(parity, sensor, catalogue):
    telemetry, sensor = field(2, frames=60, parity=parity), replace(sensor, parity=parity, initial=np.asarray(TRUTH))
    views = [view_of(telemetry, sensor, catalogue, {}, frame) for frame in range(60)]
    z = np.array([star["old"]["normalised"] for view in views for _, star in rows_under(view, "old")])
    assert np.mean(z**2) == pytest.approx(1, abs=4 * np.sqrt(2 / z.size))
    chi2 = [attitude["old"]["chi2"] for view in views for attitude in (e["attitude"] for e in view["exposures"])]
    assert np.mean(chi2) == pytest.approx(2 * 12 - 3, rel=0.06)
    assert views[0]["why_no_new"].startswith("The run has no parameters")


@pytest.mark.parametrize("parity", [1, -1])
def test_a_predicted_position_is_the_projection_of_the_star_by_the_printed_quaternion(parity, sensor, catalogue):
    telemetry, sensor = field(3, frames=2, parity=parity), replace(sensor, parity=parity, initial=np.asarray(TRUTH))
    s_i = np.column_stack(
        [np.cos(telemetry.dec_rad) * np.cos(telemetry.ra_rad), np.cos(telemetry.dec_rad) * np.sin(telemetry.ra_rad),
         np.sin(telemetry.dec_rad)]
    )  # fmt: skip
    view = view_of(telemetry, sensor, catalogue, {}, 0)
    for exposure, star in rows_under(view, "old"):
        row = star["row"]
        seen = Rotation.from_quat(exposure["attitude"]["old"]["quaternion"]).apply(s_i[row]) * [1, parity, 1]
        direction = CAMERA_MODELS["inverted_wang"].directions(
            sensor.initial, np.array([star["old"]["row_px"]]), np.array([star["old"]["col_px"]]), sensor.pixel_pitch_m
        )[0]
        np.testing.assert_allclose(direction, seen, atol=2e-9)  # 1e-5 px
        measured = np.array([telemetry.row_px[row], telemetry.col_px[row]])
        np.testing.assert_allclose(measured - star["old"]["d_px"], [star["old"]["row_px"], star["old"]["col_px"]])
        apart = np.hypot(*star["old"]["d_arcsec"])
        assert star["old"]["apart_arcsec"] == pytest.approx(apart, rel=0.05)  # axes of a pixel are nearly square


def test_the_attitudes_of_a_frame_scatter_about_the_truth_as_their_sigmas_say(catalogue):
    telemetry = simulate(calibration_scenario(1, 60), np.random.default_rng(4), catalogue)
    sensor = replace(st16_sensor(1), initial=st16_truth(1))
    views = [view_of(telemetry, sensor, catalogue, {}, int(frame)) for frame in np.unique(telemetry.frame)]
    turns = [
        np.array(e["attitude"]["old"]["from_telemetry_arcsec"]) / e["attitude"]["old"]["sigma_arcsec"]
        for view in views for e in view["exposures"] if e["attitude"]["old"]
    ]  # fmt: skip
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(1, rel=0.15)


def test_pointing_is_the_boresight_and_the_position_angle_of_the_rows():
    ra, dec, roll = np.radians([40.0, -35.0, 110.0])
    z = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    step = 1e-6  # go a little north and a little east in angles, not in tangents
    north = np.array([np.cos(dec + step) * np.cos(ra), np.cos(dec + step) * np.sin(ra), np.sin(dec + step)]) - z
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    x = np.cos(roll) * north / step + np.sin(roll) * east
    said = pointing(np.stack([x, np.cross(z, x), z]))
    assert list(said.values()) == pytest.approx([40.0, -35.0, 110.0], abs=1e-4)


def test_a_frame_matched_alone_has_the_stars_that_the_whole_set_gives_it(catalogue):
    telemetry = simulate(calibration_scenario(2, 40), np.random.default_rng(5), catalogue)
    settings, sensor = CalibrationSettings(), st16_sensor(2)
    result = calibrate(telemetry, sensor, catalogue, settings)
    states = read_run_states(result, sensor, settings)
    P = np.diag((settings.initial_sigma_scale * sensor.typical_sigma) ** 2)
    P[np.ix_(states.parameters.free, states.parameters.free)] = states.P * np.outer(
        states.parameters.scale, states.parameters.scale
    )
    whole = rematch(telemetry, sensor, catalogue, states.new.x, P, settings)
    for frame in (0, 7, 39):
        view = frame_view(states, reader(telemetry, frame), catalogue)
        alone = [star["star_id"] or 0 for exposure in view["exposures"] for star in exposure["stars"]]
        assert alone == whole.star_id[telemetry.frame == frame].tolist()
        assert all(star["fate"] == "used" for _, star in rows_under(view, "new") if star["star_id"])


def test_a_wrong_name_in_the_file_is_rejected_and_its_star_shown_far_away(catalogue):
    telemetry = simulate(calibration_scenario(1, 20), np.random.default_rng(6), catalogue)
    star_id = telemetry.star_id.copy()
    rows = np.flatnonzero((telemetry.frame == 3) & (telemetry.exposure == 0) & (star_id > 0))
    star_id[rows[0]] = star_id[rows[1]]
    wrong = replace(telemetry, star_id=star_id)
    result = calibrate(wrong, st16_sensor(1), catalogue, CalibrationSettings())
    view = view_of(wrong, st16_sensor(1), catalogue, result, 3, match="rematch")
    star = view["exposures"][0]["stars"][int(rows[0] - np.flatnonzero(telemetry.frame == 3)[0])]
    assert star["given_star_id"] == star_id[rows[1]]
    assert star["star_id"] == telemetry.star_id[rows[0]]  # found again under its true name
    assert star["fate"] == "used"


def test_a_detection_whose_star_is_not_there_is_rejected_with_how_far_away_it_is(catalogue):
    telemetry = simulate(calibration_scenario(1, 20), np.random.default_rng(6), catalogue)
    rows = np.flatnonzero((telemetry.frame == 3) & (telemetry.exposure == 0) & (telemetry.star_id > 0))
    row_px = telemetry.row_px.copy()
    row_px[rows[0]] += 30 if row_px[rows[0]] < 900 else -30
    wrong = replace(telemetry, row_px=row_px)
    result = calibrate(wrong, st16_sensor(1), catalogue, CalibrationSettings())
    view = view_of(wrong, st16_sensor(1), catalogue, result, 3, match="rematch")
    star = view["exposures"][0]["stars"][int(rows[0] - np.flatnonzero(telemetry.frame == 3)[0])]
    assert (star["fate"], star["star_id"]) == ("rejected", None)
    assert star["reason"]
    assert abs(star["new"]["d_px"][0]) == pytest.approx(30, abs=2)
    assert abs(star["new"]["normalised"][0]) > 20


def test_an_exposure_with_one_star_says_why_it_has_no_attitude(sensor, catalogue):
    telemetry = field(7, frames=3, exposures=1)
    star_id = np.where((telemetry.frame == 1) & (np.arange(len(telemetry)) % 12 > 0), 0, telemetry.star_id)
    view = view_of(replace(telemetry, star_id=star_id), sensor, catalogue, {}, 1)
    exposure = view["exposures"][0]
    assert exposure["attitude"] == {"old": None, "new": None}
    assert exposure["why_no_attitude"].startswith("1 of its detections is matched and an attitude needs 2")
    assert [star["fate"] for star in exposure["stars"]] == ["left out"] + ["unmatched"] * 11


def test_undetected_stars_are_bright_stars_of_the_field_without_a_detection(catalogue):
    telemetry = simulate(calibration_scenario(1, 20), np.random.default_rng(8), catalogue)
    rows = np.flatnonzero((telemetry.frame == 2) & (telemetry.exposure == 0))
    brightest = rows[np.argmin(telemetry.magnitude[rows])]
    kept = np.arange(len(telemetry)) != brightest
    without = rows_of_mask(telemetry, kept)
    result = calibrate(telemetry, st16_sensor(1), catalogue, CalibrationSettings())
    view = view_of(without, st16_sensor(1), catalogue, result, 2, match="rematch")
    missed = {star["star_id"]: star for star in view["exposures"][0]["undetected"]}
    lost = missed[int(telemetry.star_id[brightest])]
    assert np.hypot(lost["row_px"] - telemetry.row_px[brightest], lost["col_px"] - telemetry.col_px[brightest]) < 2


def rows_of_mask(telemetry, kept):
    arrays = {name: value[kept] for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)}
    return replace(telemetry, **arrays)
