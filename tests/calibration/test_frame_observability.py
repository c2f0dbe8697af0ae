"""Single frames under each reference, and what each reference holds of the bound."""

import numpy as np
import orjson
import pytest
from scipy.spatial.transform import Rotation

from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Parameters
from boresight.calibration.evaluation import result_evaluation as frame_view
from boresight.calibration.evaluation.result_evaluation import MOST_FRAMES, MOST_SQUARES, frame_observability
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.filters.information import Frame
from boresight.estimation.singular_values import Selection, exposure, stacked
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from tests.calibration.judged import case, field
from tests.estimation.fields import COLUMNS, GROUND, NOISE_PX, PITCH, ROWS, SCALE
from tests.estimation.pinhole_fields import PINHOLE_SCALE, WU_COLUMNS, WU_PITCH, WU_ROWS, WU_TRUTH

CURVES = [*(f"model_{model}" for model in (1, 2, 3, 4)), *(f"sigma_{k}" for k in (1, 2, 3))]


def st16():
    return Sensor(
        name="ST16-T", rows=ROWS, columns=COLUMNS, pixel_pitch_m=PITCH, camera_model="inverted_wang", parity=1,
        centroid_sigma_px=NOISE_PX, initial=GROUND.copy(), typical_sigma=SCALE.copy(), free=INVERTED_WANG.parameter_names,
    )  # fmt: skip


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
    return Telemetry(
        frame=np.repeat(np.arange(frames), stars),
        exposure=np.zeros(n, np.int64),
        row_px=row + 0.2 * rng.normal(size=n),
        col_px=col + 0.2 * rng.normal(size=n),
        star_id=np.arange(1, n + 1),
        ra_rad=np.arctan2(s_i[:, 1], s_i[:, 0]),
        dec_rad=np.arcsin(s_i[:, 2]),
    )


@pytest.fixture(scope="module")
def judged(catalogue):
    return case(field(3, frames=25), st16(), catalogue)


@pytest.fixture(scope="module")
def seen(judged):
    return frame_observability(judged.problem, judged.parameters, judged.estimate)


def share_of(seen, reference):
    return next(entry["share"] for entry in seen["information"] if entry["reference"] == reference)


def test_every_frame_of_a_small_set_has_every_curve(seen):
    assert seen["frames_used"] == seen["frames"] == 25
    assert list(seen["minimum_singular_value"]) == CURVES
    assert {len(curve) for curve in seen["minimum_singular_value"].values()} == {25}


def test_the_curves_are_the_smallest_singular_values_of_the_plain_jacobian(judged, seen):
    arcs, x = judged.problem.whitened(judged.estimate.x), judged.estimate.x
    frame = Frame(arcs, 7, angular_sigma(judged.problem.camera, x, arcs))
    s, D = frame.directions(x)
    rows = []
    for first, last in zip(frame.star_start[:-1], frame.star_start[1:], strict=True):
        stars, selection = slice(first, last), Selection(4, (2, 3))
        taken = exposure(frame.s_i[stars], frame.sigma_rad[stars], selection)
        g = stacked(s[stars], taken.rows, selection)[1]
        rows.append(np.einsum("rnj,njp->rp", g, D[stars][:, :, judged.parameters.free]) * judged.parameters.scale)
    smallest = np.linalg.svd(np.concatenate(rows), compute_uv=False)[-1]
    assert seen["minimum_singular_value"]["model_4"][7] == pytest.approx(smallest, rel=1e-3)


def test_the_first_singular_value_is_the_least_observable_as_in_the_paper_s_figure_4(seen):
    first, second, third = (
        np.array(seen["minimum_singular_value"][f"sigma_{k}"], dtype=float) for k in (1, 2, 3)
    )  # fmt: skip
    assert np.nanmedian(first) < min(np.nanmedian(second), np.nanmedian(third))


def test_no_reference_holds_more_than_the_bound_and_arcs_hold_what_all_pairs_do(seen):
    shares = [entry["share"] for entry in seen["information"]]
    assert all(0 < share < 1.02 for share in shares)
    assert share_of(seen, "arcs") == pytest.approx(share_of(seen, "angular"), abs=0.005)
    assert share_of(seen, "arcs") > share_of(seen, "model_4")


def test_the_first_singular_value_adds_nothing_and_the_sentence_says_so(seen):
    assert share_of(seen, "sigma_123") == pytest.approx(share_of(seen, "model_4"), abs=0.005)
    assert "σ1 adds nothing to them" in seen["sentence"]


def test_a_single_value_holds_less_than_both(seen):
    assert max(share_of(seen, "sigma_2"), share_of(seen, "sigma_3")) < share_of(seen, "model_4")


def test_the_least_share_is_that_of_a_free_parameter_and_below_the_mean(judged, seen):
    names = judged.problem.camera.parameter_names
    for entry in seen["information"]:
        assert entry["least"] in names
        assert entry["least_share"] <= entry["share"]


def test_frames_with_fewer_rows_than_parameters_are_gaps(catalogue):
    few = case(field(5, frames=30, stars=5, exposures=1), st16(), catalogue)
    seen = frame_observability(few.problem, few.parameters, few.estimate)
    assert seen["minimum_singular_value"]["model_4"] == [None] * 30
    assert seen["minimum_singular_value"]["sigma_1"] == [None] * 30
    assert seen["information"]


def test_a_set_that_determines_too_little_has_no_shares_and_says_why(judged, catalogue):
    problem = build_problem(field(6, frames=1, stars=4, exposures=1), st16(), catalogue)
    seen = frame_observability(problem, judged.parameters, judged.estimate)
    assert seen["information"] == []
    assert "hold a parameter fixed" in seen["sentence"]


def test_fixed_parameters_are_left_out_of_all_of_it(judged, seen):
    one = Parameters(judged.parameters.free[:1], judged.parameters.scale[:1])
    alone = frame_observability(judged.problem, one, judged.estimate)
    assert {entry["least"] for entry in alone["information"]} == {"f_m"}
    assert alone["minimum_singular_value"]["model_4"][0] > seen["minimum_singular_value"]["model_4"][0]


@pytest.mark.parametrize(("frames", "stars"), [(400, 6), (120, 40)])
def test_large_sets_are_thinned_evenly_over_their_length(catalogue, frames, stars):
    problem = build_problem(field(8, frames=frames, stars=stars, exposures=1), st16(), catalogue)
    taken = np.flatnonzero(frame_view._taken(problem.arcs))
    assert taken[0] == 0
    assert taken[-1] == frames - 1
    assert len(taken) <= min(MOST_FRAMES, MOST_SQUARES / stars**2 + 1)
    assert np.diff(taken).max() <= np.diff(taken).min() + 1


def test_the_view_of_a_long_set_is_small(seen):
    assert len(orjson.dumps(seen)) / seen["frames_used"] * MOST_FRAMES < 30_000


def test_the_camera_of_the_paper_is_judged_alike(catalogue):
    few = case(pinhole_field(9), wu(), catalogue, method="svd")
    seen = frame_observability(few.problem, few.parameters, few.estimate)
    medians = {name: np.nanmedian(np.array(curve, float)) for name, curve in seen["minimum_singular_value"].items()}
    assert medians["sigma_1"] < min(medians["sigma_2"], medians["sigma_3"])
    assert 0.95 < share_of(seen, "arcs") < 1.02
    assert {entry["least"] for entry in seen["information"]} <= set(PINHOLE_RADIAL.parameter_names)


@pytest.mark.parametrize("method", ["batch", "svd", "angular"])
def test_a_calibration_carries_the_view_whatever_its_method(catalogue, method):
    settings = CalibrationSettings(method=method, match="given")
    found = calibrate(field(3, frames=12), st16(), catalogue, settings)
    assert found["frame_observability"]["frames"] == 12
    assert found["frame_observability"]["sentence"].startswith("Of the information in these centroids arcs keep ")
