"""Single frames of a run, their attitudes and what each reference holds of the bound; the attitude correction of a calibration."""

import re
import time
from dataclasses import replace

import numpy as np
import orjson
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import Calibration, to_plain
from boresight.calibration.estimate import Parameters
from boresight.calibration.evaluation import result_evaluation as observabilities
from boresight.calibration.evaluation.alignment import (
    ARCSEC_PER_RAD,
    MeanRotation,
    align,
    alignment_view,
    sensitivity,
    sentence,
)
from boresight.calibration.evaluation.result_evaluation import MOST_FRAMES, MOST_SQUARES, frame_observability
from boresight.calibration.frame_view import frame_view, pointing, read_run_states
from boresight.calibration.matching.rematch import rematch
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, build_problem
from boresight.calibration.trust.residuals import compute_star_residuals
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation import batch, singular_values
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.attitude import (
    attitudes,
    mean_rotation,
    to_matrix,
    to_quaternion,
    turns_from,
    vector_to_quaternion,
)
from boresight.estimation.filters.information import Frame
from boresight.estimation.singular_values import Selection
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.schema import select_rows
from boresight.telemetry.sensors import Sensor
from tests.calibration.sets import case, field, measured, st16
from tests.effort import effort
from tests.estimation.fields import (
    FREE,
    GROUND,
    NOISE_PX,
    PINHOLE_SCALE,
    PITCH,
    SCALE,
    TRUTH,
    WU_COLUMNS,
    WU_PITCH,
    WU_ROWS,
    WU_TRUTH,
    star_field,
)


def reader(telemetry, frame):
    def read(neighbours):
        first = np.searchsorted(telemetry.frame, frame - neighbours)
        last = np.searchsorted(telemetry.frame, frame + neighbours, side="right")
        own = slice(*(np.searchsorted(telemetry.frame, [frame, frame + 1]) - first).tolist())
        return select_rows(telemetry, slice(int(first), int(last))), own

    return read


NOTHING = Calibration(status="running")


def make_view(telemetry, sensor, catalogue, result, frame, **settings):
    states = read_run_states(result, sensor, CalibrationSettings(**{"match": "given", **settings}))
    return frame_view(states, reader(telemetry, frame), catalogue)


def rows_under(view, name):
    return [(exposure, star) for exposure in view["exposures"] for star in exposure["stars"] if star[name] is not None]


@pytest.mark.parametrize("parity", [1, -1])
def test_residuals_of_a_frame_are_those_that_trust_takes_of_the_set(parity, sensor, catalogue):
    telemetry, sensor = field(1, frames=12, parity=parity), replace(sensor, parity=parity)
    result = calibrate(telemetry, sensor, catalogue, CalibrationSettings(match="given"))
    found = compute_star_residuals(case(telemetry, sensor, catalogue).ground)
    view = make_view(telemetry, sensor, catalogue, result, 5)
    of_frame = found.arcs.source_row[found.frame == 5]
    order = np.argsort(of_frame)
    stars = [star["new"] for _, star in rows_under(view, "new")]
    np.testing.assert_allclose([star["d_px"] for star in stars], found.r[found.frame == 5][order], atol=1e-6)
    np.testing.assert_allclose([star["normalised"] for star in stars], found.z[found.frame == 5][order], atol=1e-4)


@pytest.mark.parametrize("parity", [1, -1])
def test_at_the_true_parameters_residuals_over_their_sigmas_are_the_centroid_noise(parity, sensor, catalogue):
    telemetry, sensor = field(2, frames=60, parity=parity), replace(sensor, parity=parity, initial=np.asarray(TRUTH))
    views = [make_view(telemetry, sensor, catalogue, NOTHING, frame) for frame in range(60)]
    z = np.array([star["old"]["normalised"] for view in views for _, star in rows_under(view, "old")])
    assert np.mean(z**2) == pytest.approx(1, abs=4 * np.sqrt(2 / z.size))
    chi2 = [attitude["old"]["chi2"] for view in views for attitude in (e["attitude"] for e in view["exposures"])]
    assert np.mean(chi2) == pytest.approx(2 * 12 - 3, rel=0.06)
    assert views[0]["why_no_new"]


@pytest.mark.parametrize("parity", [1, -1])
def test_a_predicted_position_is_the_projection_of_the_star_by_the_printed_quaternion(parity, sensor, catalogue):
    telemetry, sensor = field(3, frames=2, parity=parity), replace(sensor, parity=parity, initial=np.asarray(TRUTH))
    s_i = np.column_stack(
        [np.cos(telemetry.dec_rad) * np.cos(telemetry.ra_rad), np.cos(telemetry.dec_rad) * np.sin(telemetry.ra_rad),
         np.sin(telemetry.dec_rad)]
    )  # fmt: skip
    view = make_view(telemetry, sensor, catalogue, NOTHING, 0)
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
    views = [make_view(telemetry, sensor, catalogue, NOTHING, int(frame)) for frame in np.unique(telemetry.frame)]
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
    view = make_view(wrong, st16_sensor(1), catalogue, result, 3, match="rematch")
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
    view = make_view(wrong, st16_sensor(1), catalogue, result, 3, match="rematch")
    star = view["exposures"][0]["stars"][int(rows[0] - np.flatnonzero(telemetry.frame == 3)[0])]
    assert (star["fate"], star["star_id"]) == ("rejected", None)
    assert star["reason"]
    assert abs(star["new"]["d_px"][0]) == pytest.approx(30, abs=2)
    assert abs(star["new"]["normalised"][0]) > 20


def test_an_exposure_with_one_star_says_why_it_has_no_attitude(sensor, catalogue):
    telemetry = field(7, frames=3, exposures=1)
    star_id = np.where((telemetry.frame == 1) & (np.arange(len(telemetry)) % 12 > 0), 0, telemetry.star_id)
    view = make_view(replace(telemetry, star_id=star_id), sensor, catalogue, NOTHING, 1)
    exposure = view["exposures"][0]
    assert exposure["attitude"] == {"old": None, "new": None}
    assert re.findall(r"\d+", exposure["why_no_attitude"])[:2] == ["1", "2"]
    assert [star["fate"] for star in exposure["stars"]] == ["left out"] + ["unmatched"] * 11


def test_undetected_stars_are_bright_stars_of_the_field_without_a_detection(catalogue):
    telemetry = simulate(calibration_scenario(1, 20), np.random.default_rng(8), catalogue)
    rows = np.flatnonzero((telemetry.frame == 2) & (telemetry.exposure == 0))
    brightest = rows[np.argmin(telemetry.magnitude[rows])]
    kept = np.arange(len(telemetry)) != brightest
    without = rows_of_mask(telemetry, kept)
    result = calibrate(telemetry, st16_sensor(1), catalogue, CalibrationSettings())
    view = make_view(without, st16_sensor(1), catalogue, result, 2, match="rematch")
    missed = {star["star_id"]: star for star in view["exposures"][0]["undetected"]}
    lost = missed[int(telemetry.star_id[brightest])]
    assert np.hypot(lost["row_px"] - telemetry.row_px[brightest], lost["col_px"] - telemetry.col_px[brightest]) < 2


def rows_of_mask(telemetry, kept):
    arrays = {name: value[kept] for name, value in vars(telemetry).items() if isinstance(value, np.ndarray)}
    return replace(telemetry, **arrays)


CURVES = [*(f"model_{model}" for model in (1, 2, 3, 4)), *(f"sigma_{k}" for k in (1, 2, 3))]


def wu():
    return Sensor(
        name="WU", rows=WU_ROWS, columns=WU_COLUMNS, pixel_pitch_m=WU_PITCH, camera_model="pinhole_radial", parity=1,
        centroid_sigma_px=0.2, initial=WU_TRUTH.copy(), typical_sigma=PINHOLE_SCALE.copy(),
        free=PINHOLE_RADIAL.parameter_names,
    )  # fmt: skip


def pinhole_field(seed, frames=20, stars=19):
    rng, n = np.random.default_rng(seed), frames * stars
    row, col = rng.uniform(0, WU_ROWS - 1, n), rng.uniform(0, WU_COLUMNS - 1, n)
    s_d = PINHOLE_RADIAL.directions(WU_TRUTH, row, col, WU_PITCH)
    turns = Rotation.random(frames, rng=rng).as_matrix()
    s_i = np.einsum("eij,eni->enj", turns, s_d.reshape(frames, stars, 3)).reshape(n, 3)
    return measured(rng, s_i, (row, col), 0.2, frames)


@pytest.fixture(scope="module")
def judged(catalogue):
    return case(field(3, frames=25), st16(), catalogue)


@pytest.fixture(scope="module")
def seen(judged):
    return to_plain(frame_observability(judged.problem, judged.parameters, judged.estimate))


def compute_share(seen, reference):
    return next(entry["share"] for entry in seen["information"] if entry["reference"] == reference)


def test_the_curves_are_the_smallest_singular_values_of_the_plain_jacobian_of_every_frame(seen, judged):
    assert seen["frames_used"] == seen["frames"] == 25
    assert list(seen["minimum_singular_value"]) == CURVES
    assert {len(curve) for curve in seen["minimum_singular_value"].values()} == {25}
    arcs, x = judged.problem.whitened(judged.estimate.x), judged.estimate.x
    frame = Frame(arcs, 7, angular_sigma(judged.problem.camera, x, arcs))
    s, D = frame.directions(x)
    rows = []
    for first, last in zip(frame.star_start[:-1], frame.star_start[1:], strict=True):
        stars, selection = slice(first, last), Selection(4, (2, 3))
        taken = singular_values.exposure(frame.s_i[stars], frame.sigma_rad[stars], selection)
        g = singular_values.stacked(s[stars], taken.rows, selection)[1]
        rows.append(np.einsum("rnj,njp->rp", g, D[stars][:, :, judged.parameters.free]) * judged.parameters.scale)
    smallest = np.linalg.svd(np.concatenate(rows), compute_uv=False)[-1]
    assert seen["minimum_singular_value"]["model_4"][7] == pytest.approx(smallest, rel=1e-3)
    first, second, third = (
        np.array(seen["minimum_singular_value"][f"sigma_{k}"], dtype=float) for k in (1, 2, 3)
    )  # fmt: skip
    assert np.nanmedian(first) < min(np.nanmedian(second), np.nanmedian(third))


def test_no_reference_holds_more_than_the_bound_arcs_all_and_the_first_singular_value_adds_nothing(seen, judged):
    shares = [entry["share"] for entry in seen["information"]]
    assert all(0 < share < 1.02 for share in shares)
    assert compute_share(seen, "arcs") == pytest.approx(compute_share(seen, "angular"), abs=0.005)
    assert compute_share(seen, "arcs") > compute_share(seen, "model_4")
    assert compute_share(seen, "sigma_123") == pytest.approx(compute_share(seen, "model_4"), abs=0.005)
    assert "σ1 adds nothing" in seen["sentence"]
    assert max(compute_share(seen, "sigma_2"), compute_share(seen, "sigma_3")) < compute_share(seen, "model_4")
    names = judged.problem.camera.parameter_names
    for entry in seen["information"]:
        assert entry["least"] in names
        assert entry["least_share"] <= entry["share"]
    assert len(orjson.dumps(seen)) / seen["frames_used"] * MOST_FRAMES < 30_000


def test_frames_with_fewer_rows_than_parameters_are_gaps_and_sets_that_determine_too_little_say_why(catalogue, judged):
    few = case(field(5, frames=30, stars=5, exposures=1), st16(), catalogue)
    seen = to_plain(frame_observability(few.problem, few.parameters, few.estimate))
    assert seen["minimum_singular_value"]["model_4"] == [None] * 30
    assert seen["minimum_singular_value"]["sigma_1"] == [None] * 30
    assert seen["information"]
    problem = build_problem(field(6, frames=1, stars=4, exposures=1), st16(), catalogue)
    seen = to_plain(frame_observability(problem, judged.parameters, judged.estimate))
    assert seen["information"] == []
    assert not re.search(r"\d", seen["sentence"])  # no share: there is no bound


def test_fixed_parameters_are_left_out_of_all_of_it(judged, seen):
    one = Parameters(judged.parameters.free[:1], judged.parameters.scale[:1])
    alone = to_plain(frame_observability(judged.problem, one, judged.estimate))
    assert {entry["least"] for entry in alone["information"]} == {"f_m"}
    assert alone["minimum_singular_value"]["model_4"][0] > seen["minimum_singular_value"]["model_4"][0]


@pytest.mark.parametrize(("frames", "stars"), [(400, 6), (120, 40)])
def test_large_sets_are_thinned_evenly_over_their_length(catalogue, frames, stars):
    problem = build_problem(field(8, frames=frames, stars=stars, exposures=1), st16(), catalogue)
    taken = np.flatnonzero(observabilities._taken(problem.arcs))
    assert taken[0] == 0
    assert taken[-1] == frames - 1
    assert len(taken) <= min(MOST_FRAMES, MOST_SQUARES / stars**2 + 1)
    assert np.diff(taken).max() <= np.diff(taken).min() + 1


@pytest.mark.full
def test_the_camera_of_the_paper_is_judged_alike(catalogue):
    few = case(pinhole_field(9), wu(), catalogue, method="svd")
    seen = to_plain(frame_observability(few.problem, few.parameters, few.estimate))
    medians = {name: np.nanmedian(np.array(curve, float)) for name, curve in seen["minimum_singular_value"].items()}
    assert medians["sigma_1"] < min(medians["sigma_2"], medians["sigma_3"])
    assert 0.95 < compute_share(seen, "arcs") < 1.02
    assert {entry["least"] for entry in seen["information"]} <= set(PINHOLE_RADIAL.parameter_names)


@pytest.mark.parametrize("method", ["batch", "svd", "angular"])
def test_a_calibration_carries_the_view_whatever_its_method(catalogue, method):
    settings = CalibrationSettings(method=method, match="given")
    found = calibrate(field(3, frames=12), st16(), catalogue, settings).to_dict()
    assert found["frame_observability"]["frames"] == 12
    shares = {entry["reference"]: entry["share"] for entry in found["frame_observability"]["information"]}
    assert f" {100 * shares['arcs']:.0f} %" in found["frame_observability"]["sentence"]


KNOWN = np.zeros((8, 8))


@pytest.fixture
def make_frame_problem(sensor):
    def problem(seed, frames=40, noise_px=NOISE_PX, parity=1):
        arcs = star_field(np.random.default_rng(seed), frames=frames, noise_px=noise_px)
        arcs = arcs if parity == 1 else replace(arcs, s_i=arcs.s_i * [1, -1, 1])
        return Problem(replace(sensor, parity=parity), arcs, None, frames, ())

    return problem


@pytest.fixture
def population(make_frame_problem):
    return align(make_frame_problem(1, 4000, 0.0), GROUND, TRUTH, KNOWN)


def attitudes_under(problem, x):
    arcs = problem.arcs
    s_d = INVERTED_WANG.directions(x, arcs.row_px, arcs.col_px, PITCH)
    sigma = angular_sigma(INVERTED_WANG, GROUND, arcs)
    return attitudes(arcs.star_start, s_d, arcs.s_i, sigma, problem.sensor.parity)


@pytest.mark.parametrize("parity", [1, -1])
def test_with_the_update_of_c_sd_the_sensor_attitude_stays_on_average(make_frame_problem, parity):
    problem = make_frame_problem(2, parity=parity)
    found = align(problem, GROUND, TRUTH, KNOWN)
    old, new = attitudes_under(problem, GROUND), attitudes_under(problem, TRUTH)
    C_sd_old = to_matrix(np.array([0.1, -0.3, 0.2, 0.9]))
    C_sd_new = C_sd_old @ found.c_sd_update
    moved = to_quaternion((C_sd_new @ new.C) @ np.swapaxes(C_sd_old @ old.C, 1, 2))
    weights = 1 / np.trace(new.covariance, axis1=1, axis2=2)
    left = turns_from(np.array([0.0, 0, 0, 1]), mean_rotation(moved, weights)[None])[0]
    assert np.linalg.norm(found.rotation) * ARCSEC_PER_RAD > 5000
    assert np.linalg.norm(left) * ARCSEC_PER_RAD < 1e-5


@pytest.mark.parametrize("parity", [1, -1])
def test_a_shift_of_the_principal_point_turns_about_the_axis_it_must(make_frame_problem, parity):
    shifted = TRUTH.copy()
    shifted[1] -= 10.0
    theta = align(make_frame_problem(3, parity=parity), TRUTH, shifted, KNOWN).rotation
    assert theta[1] == pytest.approx(10.0 * PITCH / TRUTH[0], rel=0.05)
    assert abs(theta[0]) < 0.02 * theta[1]


def test_the_sensitivity_is_what_differences_of_attitudes_show(make_frame_problem):
    problem = make_frame_problem(4, 150)
    J = sensitivity(problem, TRUTH, angular_sigma(INVERTED_WANG, TRUTH, problem.arcs))
    for p in range(8):
        step = 1e-2 * SCALE[p] * np.eye(8)[p]
        difference = align(problem, TRUTH - step, TRUTH + step, KNOWN).rotation / 2e-2
        # the weights of the differences move a little with the state
        np.testing.assert_allclose(J[:, p] * SCALE[p], difference, atol=1e-3 * np.abs(J * SCALE).max())


def test_the_turn_between_ground_and_estimate_is_as_uncertain_as_it_says(make_frame_problem, population):
    nees, runs = [], effort(30, 120)
    for seed in range(100, 100 + runs):
        problem = make_frame_problem(seed)
        fit = batch.fit(problem.whitened(TRUTH), TRUTH, FREE, SCALE)
        found = align(problem, GROUND, fit.x, np.linalg.inv(fit.A) * np.outer(SCALE, SCALE))
        error = turns_from(population.quaternion, found.quaternion[None])[0]
        nees.append(error @ np.linalg.solve(found.covariance, error))
    # ten stretches give the scatter's part of the covariance nine degrees of freedom, hence the wider upper bound
    assert chi2.ppf(0.005, 3 * runs) < np.sum(nees) < 1.25 * chi2.ppf(0.995, 3 * runs)


def test_the_mean_of_a_set_scatters_as_it_says(make_frame_problem, population):
    sets = effort(75, 300)
    found = [align(make_frame_problem(seed), GROUND, TRUTH, KNOWN) for seed in range(400, 400 + sets)]
    errors = np.array([turns_from(population.quaternion, one.quaternion[None])[0] for one in found])
    claimed = np.mean([one.covariance_of_mean for one in found], axis=0)
    whiten = np.linalg.inv(np.linalg.cholesky(claimed))
    np.testing.assert_allclose(whiten @ np.cov(errors.T) @ whiten.T, np.eye(3), atol=0.3 * (300 / sets) ** 0.5)
    assert np.mean([one.consistent for one in found]) > 0.95


def test_frames_that_share_their_stars_are_not_counted_as_independent(make_frame_problem):
    alone = make_frame_problem(5, 20)
    arcs = alone.arcs
    stars = np.concatenate([np.tile(np.arange(*arcs.star_start[[2 * k, 2 * k + 2]]), 8) for k in range(20)])
    counts = np.concatenate([np.tile(np.diff(arcs.star_start)[2 * k : 2 * k + 2], 8) for k in range(20)])
    arrays = {name: getattr(arcs, name)[stars] for name in ("row_px", "col_px", "sigma_px", "s_i", "source_row")}
    held = replace(
        arcs, **arrays, frame=np.arange(160), frame_start=np.arange(0, 321, 2), star_start=np.append(0, counts.cumsum())
    )
    long = align(replace(alone, arcs=held), GROUND, TRUTH, KNOWN)
    np.testing.assert_allclose(
        long.covariance_of_mean, align(alone, GROUND, TRUTH, KNOWN).covariance_of_mean, rtol=1e-6, atol=1e-18
    )


def test_a_set_whose_second_half_turns_otherwise_is_not_consistent(make_frame_problem):
    problem = make_frame_problem(6, 100, 0.01)
    arcs = problem.arcs
    moved = replace(arcs, row_px=arcs.row_px.copy())
    late = np.arange(len(arcs.row_px)) > len(arcs.row_px) // 2
    moved.row_px[late] = 0.3 * arcs.row_px[late]  # another part of the detector, where the distortion turns otherwise
    assert not align(replace(problem, arcs=moved), GROUND, TRUTH, KNOWN).consistent


def test_the_same_parameters_turn_nothing_and_one_frame_has_no_scatter_and_so_no_alignment(make_frame_problem):
    view = to_plain(alignment_view(make_frame_problem(7), TRUTH, TRUTH, KNOWN))
    assert np.abs(view["rotation_arcsec"]).max() < 1e-6
    assert view["consistent"]
    assert "C_SD can stay" in view["sentence"]
    np.testing.assert_allclose(view["c_sd_update"], np.eye(3), atol=1e-12)
    assert to_plain(alignment_view(make_frame_problem(8, 1), GROUND, TRUTH, KNOWN)) is None


def test_the_view_holds_the_numbers_that_its_sentence_says_and_open_sigmas_where_parameters_are_undetermined(
    make_frame_problem,
):
    problem = make_frame_problem(9)
    view = to_plain(alignment_view(problem, GROUND, TRUTH, np.diag((0.1 * SCALE) ** 2)))
    assert view["frames"] == 40
    np.testing.assert_allclose(to_matrix(np.array(view["quaternion"])).T, view["c_sd_update"], atol=1e-15)
    assert (np.array(view["sigma_arcsec"]) > view["sigma_of_mean_arcsec"]).all()
    assert f"{np.linalg.norm(view['rotation_arcsec']):,.1f}" in view["sentence"]
    assert "right-multiply C_SD" in view["sentence"]
    view = to_plain(alignment_view(make_frame_problem(10), GROUND, TRUTH, np.full((8, 8), np.nan)))
    assert view["sigma_arcsec"] == [None] * 3
    assert "(one sigma)" not in view["sentence"]


@pytest.mark.parametrize(
    ("theta", "words"),
    [
        ([0.0, -1e-3, 0.0], "206.3 ± 2.1 arcsec about −y (the columns axis)"),
        ([1e-3, 1e-3, 0.0], "291.7 ± 2.1 arcsec about (0.71, 0.71, 0.00) in x, y, z of the detector"),
        ([-0.9965e-3, 0.0, 0.0836e-3], "206.3 ± 2.1 arcsec about −x (the rows axis)"),  # 4.8° away
        ([-0.9515e-3, -0.3076e-3, 0.0], "206.3 ± 2.1 arcsec about (-0.95, -0.31, 0.00)"),  # 18° away
    ],
)
def test_the_axis_is_named(theta, words):
    P = np.eye(3) * 1e-10
    found = MeanRotation(vector_to_quaternion(np.array(theta)), P, P, 1e-4, 1e-4, 30, consistent=True)
    assert words in sentence(found)


def test_twenty_thousand_frames_take_well_under_a_second(make_frame_problem):
    problem = make_frame_problem(11, 20)
    arcs = problem.arcs
    arrays = {name: np.concatenate([getattr(arcs, name)] * 1000) for name in ("row_px", "col_px", "sigma_px", "s_i")}
    starts = np.append(0, np.tile(np.diff(arcs.star_start), 1000).cumsum())
    many = replace(arcs, **arrays, frame=np.arange(20_000), frame_start=np.arange(0, 40_001, 2), star_start=starts)
    began = time.process_time()
    align(replace(problem, arcs=many), GROUND, TRUTH, KNOWN)
    assert time.process_time() - began < 2.0  # 0.5 s on a free core; twice two threads may be counted
