"""What matching again finds, and what it does not believe, from every start; pooled over sensors so that shares mean something."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.calibration.matching.rematch import ground_covariance, matched_telemetry
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.statistics.consistency import chi_square
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.matching import LEFT_OUT, STARTS
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.sets import SENSORS, Score, Sky, sky


@pytest.fixture(scope="session")
def patterns(tmp_path_factory):
    return tmp_path_factory.mktemp("patterns")


@pytest.mark.parametrize(
    ("start", "least", "most_wrong"), [("ground", 0.97, 0.002), ("refined", 0.99, 0.001)], ids=["ground", "refined"]
)
def test_half_of_the_names_come_back_and_hardly_any_is_wrong(catalogue, start, least, most_wrong):
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 50, start=start)
        telemetry = field.blanked(0.5)
        score.count(field.match(telemetry), telemetry, field.true)
    assert score.sought > 2500
    assert score.recovered >= least
    assert score.wrong_share <= most_wrong


def test_from_quaternions_alone_the_sky_is_matched_though_names_are_missing_or_all_wrong(catalogue):
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 30)
        telemetry = replace(field.telemetry, star_id=None)
        matches = field.match(telemetry)
        assert set(matches.start[matches.valid]) <= {STARTS.index("quaternion"), STARTS.index("other exposure")}
        score.count(matches, replace(telemetry, star_id=np.zeros_like(field.true)), field.true)
    assert score.recovered >= 0.97
    assert score.wrong_share <= 0.002
    score = Score()
    for number in (3, 5):
        field = sky(catalogue, number, 30)
        wrong = np.random.default_rng(5).permutation(field.true)
        named = replace(field.telemetry, star_id=np.where(wrong == field.true, 0, wrong))
        score.count(field.match(named), replace(named, star_id=np.zeros_like(field.true)), field.true)
    assert score.recovered >= 0.95
    assert score.wrong_share <= 0.003


@pytest.mark.parametrize("number", [1, 4])
def test_a_frame_without_anything_is_found_from_its_neighbours(catalogue, number):
    field = sky(catalogue, number, 30)
    bare = np.isin(field.telemetry.frame, [0, 11, 12, 29])
    telemetry = replace(field.telemetry, star_id=np.where(bare, 0, field.true), quaternion=None)
    matches = field.match(telemetry)
    without = np.isin(matches.frame, [0, 11, 12, 29])
    assert matches.valid[without].all()
    assert STARTS.index("neighbouring frame") in matches.start[without]
    assert STARTS.index("lost in space") not in matches.start
    assert np.mean(matches.star_id[bare & (field.true > 0)] == field.true[bare & (field.true > 0)]) > 0.95


def test_with_neither_names_nor_attitudes_the_sky_is_recognised(catalogue, patterns):
    pytest.importorskip("tetra3rs", reason="the lost-in-space extra is not installed")
    score = Score()
    for number in SENSORS:
        field = sky(catalogue, number, 40)
        telemetry = replace(field.blanked(1.0), star_id=None)
        matches = field.match(telemetry, patterns)
        assert STARTS.index("lost in space") in matches.start
        score.count(matches, field.blanked(1.0), field.true)
    assert score.solved >= 0.97 * score.frames
    assert score.wrong_share <= 0.002


@pytest.mark.parametrize(("start", "most_kept"), [("ground", 0.02), ("refined", 0.01)], ids=["ground", "refined"])
@pytest.mark.parametrize("of", ["the same image", "the whole sky"])
def test_wrong_names_are_found_out(catalogue, start, most_kept, of):
    rng, kept, changed, score = np.random.default_rng(3), 0, 0, Score()
    for number in SENSORS:
        field = sky(catalogue, number, 30, start=start)
        named = field.true > 0
        given = field.true.copy()
        image = 2 * field.telemetry.frame + field.telemetry.exposure
        for row in np.flatnonzero(named & (rng.random(len(named)) < 0.1)):
            others = named & (image == image[row]) if of == "the same image" else named
            given[row] = rng.choice(field.true[others])
        wrong = given != field.true
        telemetry = replace(field.telemetry, star_id=given, quaternion=None)
        matches = field.match(telemetry)
        kept, changed = kept + (wrong & (matches.star_id == given)).sum(), changed + wrong.sum()
        score.count(matches, telemetry, field.true)
    assert changed > 250
    assert kept <= most_kept * changed
    assert score.wrong_share <= 0.002


def test_an_upright_image_gives_the_same_matches_and_attitudes(catalogue):
    field = sky(catalogue, 2, 20)
    telemetry = field.blanked(0.5)
    mirrored = replace(telemetry, col_px=field.sensor.columns - 1 - telemetry.col_px)
    x = field.x.copy()
    x[2], x[5] = field.sensor.columns - 1 - x[2], -x[5]
    right = field.match(telemetry)
    left = replace(field, sensor=replace(field.sensor, parity=-1, initial=x), x=x).match(mirrored)
    np.testing.assert_array_equal(left.star_id, right.star_id)
    np.testing.assert_allclose(left.quaternion, right.quaternion, atol=1e-9)
    np.testing.assert_allclose(left.attitude_covariance, right.attitude_covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("exposures", [1, 3])
def test_frames_of_one_exposure_and_of_three_are_matched_alike(catalogue, exposures):
    score = Score()
    for number in (1, 3, 6):
        field = sky(catalogue, number, 60 // exposures, exposures=exposures)
        telemetry = field.blanked(0.5)
        score.count(field.match(telemetry), telemetry, field.true)
    assert score.recovered >= 0.97
    assert score.wrong_share <= 0.003


@pytest.mark.parametrize("start", ["ground", "refined"])
def test_given_names_are_not_trimmed_where_the_centroid_noise_is_understated(catalogue, start):
    kept, named = 0, 0
    for number in SENSORS:
        field = sky(catalogue, number, 25, start=start)
        believed = replace(field, sensor=replace(field.sensor, centroid_sigma_px=0.2))
        matches = believed.match(replace(field.telemetry, sigma_px=None, quaternion=None))
        kept, named = kept + (matches.star_id == field.true)[field.true > 0].sum(), named + (field.true > 0).sum()
    assert kept >= 0.99 * named


def with_names(whole, named):
    ra, dec = (np.where(named, angle, np.nan) for angle in (whole.ra_rad, whole.dec_rad))
    return replace(whole, star_id=np.where(named, whole.star_id, 0), ra_rad=ra, dec_rad=dec, quaternion=None)


def test_without_times_the_given_names_stand_and_nothing_is_added(catalogue):
    field = sky(catalogue, 1, 15, start="refined")
    whole = matched_telemetry(field.telemetry, field.match(field.telemetry))
    half = np.random.default_rng(1).random(len(field.true)) < 0.5
    telemetry = replace(with_names(whole, half), time_utc=None)
    matches = field.match(telemetry)
    np.testing.assert_array_equal(matches.star_id[matches.star_id > 0], telemetry.star_id[matches.star_id > 0])
    rich = np.repeat(np.add.reduceat(telemetry.star_id > 0, matches.exposure_start[:-1], dtype=int) >= 4,
                     np.diff(matches.exposure_start))  # fmt: skip
    assert np.mean(matches.star_id[rich & (telemetry.star_id > 0)] > 0) > 0.99


def test_double_stars_are_left_out_when_asked_and_say_so(catalogue):
    field = sky(catalogue, 3, 20, start="refined")
    every, fewer = (field.match(field.blanked(0.5), leave_out_doubles=choice) for choice in (False, True))
    gone = (every.star_id > 0) & (fewer.star_id == 0)
    assert gone.any()
    np.testing.assert_array_equal(gone, (every.flags > 0) & (every.star_id > 0))
    assert (fewer.row_reason[gone] == LEFT_OUT).all()
    assert np.isnan(fewer.s_i[gone]).all()
    assert not (every.row_reason == LEFT_OUT).any()


def test_the_order_of_the_frames_does_not_matter_and_no_exposure_has_a_star_twice(catalogue):
    field = sky(catalogue, 5, 20)
    telemetry = field.blanked(0.3)
    order = np.argsort(-telemetry.frame, kind="stable")
    arrays = {name: value[order] for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)}
    backwards = replace(telemetry, **{**arrays, "frame": 19 - arrays["frame"]})
    forth, back = field.match(telemetry), field.match(backwards)
    np.testing.assert_array_equal(back.star_id, forth.star_id[order])
    np.testing.assert_array_equal(back.row_reason, forth.row_reason[order])
    field = sky(catalogue, 4, 40)
    for share in (0.0, 0.5, 0.9):
        matches = field.match(field.blanked(share))
        for first, last in zip(matches.exposure_start[:-1], matches.exposure_start[1:], strict=True):
            found = matches.star_id[first:last][matches.star_id[first:last] > 0]
            assert len(set(found)) == len(found)


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
    part = with_names(whole, named)
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
    part = with_names(whole, named)
    matches = field.match(part)
    np.testing.assert_array_equal((matches.star_id > 0) & ~named, False)
    assert np.sum(matches.star_id > 0) > 0.98 * named.sum()


def test_the_given_names_of_the_real_sky_are_kept(catalogue, real_sky):
    sensor, telemetry = read_sensor(real_sky / "esa.sensor.json"), read_telemetry(real_sky / "esa-5-frames.csv")
    matches = Sky(telemetry, sensor, catalogue, sensor.initial, ground_covariance(sensor, 10.0)).match(telemetry)
    named = telemetry.star_id > 0
    assert np.mean(matches.star_id[named] == telemetry.star_id[named]) >= 0.95
    assert matches.valid.all()
    assert (matches.row_reason[matches.star_id == 0] > 0).all()
