"""Matching: what is found and not believed from every start, and fit, match, fit until it rests, with counts that add up."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import Change, CountChange, Evaluation, to_plain
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
from boresight.calibration.matching.rematch import (
    Rematcher,
    centroid_sigma_px,
    ground_covariance,
    matched_telemetry,
    pixel_rad,
)
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import MatchedRows
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.filters.history import start
from boresight.estimation.statistics.consistency import chi_square
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_truth
from boresight.sky.guide_stars import DOUBLE, UNRELIABLE, compute_pulls
from boresight.sky.matching import BLENDED, EXPOSURE_REASONS, LEFT_OUT, ROW_REASONS, STARTS
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.sets import SENSORS, Score, Sky, sky
from tests.effort import effort


@pytest.fixture(scope="session")
def patterns(tmp_path_factory):
    return tmp_path_factory.mktemp("patterns")


@pytest.mark.few(1)
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


@pytest.mark.full
def test_with_neither_names_nor_attitudes_the_sky_is_recognised(catalogue, patterns):
    score = Score()
    for number in effort((1, 4), SENSORS):
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


def test_stars_that_a_neighbour_draws_are_left_out_where_the_width_of_an_image_is_known_unless_they_are_to_be_kept(
    catalogue,
):
    field = sky(catalogue, 3, 20, start="refined")
    bare = field.blanked(0.5)
    wide = replace(bare, psf_sigma_px=np.full(len(bare), 4.0))
    every, fewer, kept = field.match(bare), field.match(wide), field.match(wide, blends="keep")
    np.testing.assert_array_equal(kept.star_id, every.star_id)
    assert not (every.row_reason == BLENDED).any()
    gone = (every.star_id > 0) & (fewer.star_id == 0)
    np.testing.assert_array_equal(gone, fewer.row_reason == BLENDED)
    pixel = pixel_rad(field.sensor, field.sensor.initial)
    place = catalogue.find_index(every.star_id[every.star_id > 0])
    pull_px = compute_pulls(catalogue, place, 4.0 * pixel) / pixel
    sigma_px = centroid_sigma_px(wide, field.sensor)[every.star_id > 0]
    assert 0 < gone.sum() < 0.5 * len(gone)
    np.testing.assert_array_equal(gone[every.star_id > 0], pull_px > 0.4 * sigma_px)
    assert view(field, wide, fewer)["flagged"]["blended"] == gone.sum()
    unknown = replace(bare, psf_sigma_px=np.full(len(bare), np.nan))
    np.testing.assert_array_equal(field.match(unknown).star_id, every.star_id)


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


def test_right_given_stars_stand_under_every_state_near_the_truth_and_none_is_added(field):
    sets = matched_set(field, field.blanked(0.4), match="given")
    first = sets.at_start()
    assert sets.is_given
    again = sets.at_covariance(field.x * 1.01, np.eye(8))
    assert again.problem is first.problem
    assert len(again.refused) == 0
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
        return calibrate(
            field.blanked(blanked), sensor or field.sensor, catalogue, CalibrationSettings(**settings)
        ).to_dict()

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
    matching = calibrate(field.blanked(0.2), field.sensor, catalogue, CalibrationSettings()).to_dict()["matching"]
    assert len(matching["cycles"]) == MOST_CYCLES
    assert not matching["rested"]


@pytest.mark.parametrize("number", [2, 6])
def test_matching_again_does_not_harm_a_set_whose_names_are_all_given(catalogue, number):
    field = sky(catalogue, number, 60)
    telemetry = field.blanked(0.0)
    given, again = (
        calibrate(telemetry, field.sensor, catalogue, CalibrationSettings(match=match)).to_dict()
        for match in ("given", "rematch")
    )
    for name, sigma in given["sigma"].items():
        assert abs(again["parameters"][name] - given["parameters"][name]) < 0.1 * sigma


def test_cycles_are_told_with_all_their_counts_and_the_most_frequent_phrase_first():
    ended = CyclesEnd(None, None, (Cycle(cycle=1, matched=10, rematched=12, changed=4, rms_arc_rad=None),))
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


EVALUATION = Evaluation(
    frames=1,
    availability=Change(initial=0.1),
    matched_stars=CountChange(initial=9, final=9),
    matched_star_ratio=None,
    rms_arc_rad=Change(),
    flight_tolerance_rad=4e-4,
)


class AtState:
    def __init__(self, x):
        self.x = x


def view(field, telemetry, matches):
    ended = CyclesEnd(
        Matched(None, (MatchedRange(MatchedRows(telemetry, matches, matches.star_id)),)), AtState(field.x)
    )
    return to_plain(matching_view(telemetry, field.sensor, ended, EVALUATION))


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
        "tolerance_rad": 4e-4,
        "availability": {"initial": 0.1, "final": None},
        "matched_stars": {"initial": 9, "final": 9},
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
