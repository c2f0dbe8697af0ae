"""The residual spline of a calibration: who takes up what a model leaves, its sentence in the advice, its JSON, every method."""

from dataclasses import replace

import numpy as np
import orjson
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import ResidualSpline, parse_part, to_plain
from boresight.calibration.conversion import converted
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.calibration.residual_spline import read_residual_spline
from boresight.calibration.trust.residual_spline import find_residual_spline
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation import residual_spline as splines
from boresight.telemetry.sensors import Sensor
from tests.calibration.sets import case, measured
from tests.effort import effort
from tests.estimation.fields import rotation
from tests.refusals import has_code

ROWS, COLUMNS, PITCH, NOISE_PX = 1536, 2048, 2.2e-6, 0.1
F_M = 6000 * PITCH
TANGENTIAL = np.array([1.0002, F_M, 1030.0, 760.0, -0.1, 0.1, 3.5e-4, -2.5e-4, 0.0])
SYMMETRIC = TANGENTIAL * np.array([1, 1, 1, 1, 1, 1, 0, 0, 0])


def sensor_of(camera_model, initial, free=None):
    camera = CAMERA_MODELS[camera_model]
    return Sensor(
        name="T", rows=ROWS, columns=COLUMNS, pixel_pitch_m=PITCH, camera_model=camera_model, parity=1,
        centroid_sigma_px=NOISE_PX, initial=np.asarray(initial, dtype=float), typical_sigma=np.array(camera.default_typical_sigma),
        free=free or camera.parameter_names,
    )  # fmt: skip


def seen_by(camera_model, truth, seed, frames=60, stars=16, parity=1):
    rng = np.random.default_rng(seed)
    camera, n = CAMERA_MODELS[camera_model], frames * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s_d = camera.directions(truth, row, col, PITCH) * np.array([1, parity, 1])
    s_i = np.concatenate([part @ rotation(rng) for part in np.split(s_d, frames)])
    return measured(rng, s_i, (row, col), NOISE_PX, frames)


def judged(telemetry, sensor, catalogue, **settings):
    return case(telemetry, sensor, catalogue, **settings).trust


@pytest.mark.full
@pytest.mark.parametrize("method", METHODS)
def test_what_a_radial_model_leaves_of_a_tangential_lens_is_said_with_the_model_that_has_it(method, catalogue):
    telemetry = seen_by("brown_conrady", TANGENTIAL, 3, parity=-1)
    sensor = replace(sensor_of("pinhole_radial", SYMMETRIC[:6]), parity=-1)
    document = calibrate(telemetry, sensor, catalogue, CalibrationSettings(method=method, match="given")).to_dict()
    part = document["trust"]["residual_spline"]
    assert part["structure"]
    assert part["test"]["p"] < 1e-6
    assert part["sentence"] in document["advice"]
    asked = {one["camera_model"]: one["p"] for one in part["explained_by"]}
    assert set(asked) >= {"brown_conrady", "inverted_wang_decentred", "kannala_brandt"}
    assert asked["brown_conrady"] > 0.01 > asked["kannala_brandt"]
    assert "p1" in part["explained_by"][[*asked].index("brown_conrady")]["more"]
    assert 0.05 < part["largest"]["size_px"] < 0.6
    assert part["largest"]["sigma_px"] < part["largest"]["size_px"] / 3


def test_with_its_own_model_the_lens_leaves_nothing_and_nobody_is_asked(catalogue):
    found = judged(seen_by("brown_conrady", TANGENTIAL, 4), sensor_of("brown_conrady", SYMMETRIC), catalogue)
    part = found["residual_spline"]
    assert not part["structure"]
    assert part["explained_by"] == []
    assert 0 < part["at_most_px"] < NOISE_PX


def test_a_held_parameter_that_would_take_it_up_is_named_before_another_model(catalogue):
    sensor = sensor_of("brown_conrady", SYMMETRIC, free=("f_m", "u0_px", "v0_px", "k1", "k2"))
    found = case(seen_by("brown_conrady", TANGENTIAL, 5), sensor, catalogue).ground
    spline = find_residual_spline(found)
    assert spline.structure
    assert spline.remedy.camera_model == "brown_conrady"
    assert set(spline.remedy.more) == {"s", "p1", "p2", "k3"}


def test_the_json_reads_back_and_has_the_surface_s_values(catalogue):
    telemetry, sensor = seen_by("brown_conrady", TANGENTIAL, 6), sensor_of("pinhole_radial", SYMMETRIC[:6])
    spline = find_residual_spline(case(telemetry, sensor, catalogue).ground)
    described = spline.describe()
    read = parse_part(ResidualSpline, orjson.loads(orjson.dumps(to_plain(described))), AssertionError)
    assert read == described
    again = read_residual_spline(read)
    assert again.describe() == described
    assert (again.surface.row, again.surface.col) == (spline.surface.row, spline.surface.col)
    row, col = (at.ravel() for at in np.meshgrid(spline.row_px, spline.col_px, indexing="ij"))
    np.testing.assert_allclose(again.surface(row, col), spline.displacement_px.reshape(2, -1).T, atol=1e-6)


def test_which_model_is_named_is_right_as_often_as_the_test_promises(catalogue):
    n, named = effort(4, 100), []
    for seed in range(n):
        telemetry = seen_by("brown_conrady", TANGENTIAL, [7, seed])
        spline = find_residual_spline(case(telemetry, sensor_of("pinhole_radial", SYMMETRIC[:6]), catalogue).ground)
        p = {one.camera_model: one.p for one in spline.explained_by}
        named.append(p["brown_conrady"] >= 0.01)
        assert p["kannala_brandt"] < 0.01  # radial, so it must not be
    assert sum(named) >= n - 1 - 3 * np.sqrt(0.01 * n)


def test_another_model_follows_the_camera_with_what_it_leaves_and_comes_nearer_to_the_lens(catalogue):
    telemetry, sensor = seen_by("brown_conrady", TANGENTIAL, 8, frames=200), sensor_of("pinhole_radial", SYMMETRIC[:6])
    document = calibrate(telemetry, sensor, catalogue, CalibrationSettings(match="given")).to_dict()
    row, col = (at.ravel() for at in np.meshgrid(np.linspace(60, ROWS - 61, 9), np.linspace(60, COLUMNS - 61, 11)))

    def away(camera_model, parameters):
        """Pixels, rms over the detector, by which a camera misses the lens under the best rotation."""
        x = np.array([parameters[name] for name in CAMERA_MODELS[camera_model].parameter_names])
        rows = splines.find_pixel_rows(CAMERA_MODELS[camera_model], x, PITCH, row, col)
        lens = splines.find_pixel_rows(CAMERA_MODELS["brown_conrady"], TANGENTIAL, PITCH, row, col)
        d = np.einsum("nij,nj->ni", rows.slope, rows.tangents - lens.tangents).ravel()
        K = rows.K.reshape(-1, 3)
        return np.sqrt(np.mean((d - K @ np.linalg.lstsq(K, d)[0]) ** 2))

    plain = converted(document, sensor, "c.json", "brown_conrady")
    both = converted(document, sensor, "c.json", "brown_conrady", 0.5, with_residual=True)
    assert away("brown_conrady", both["parameters"]) < 0.6 * away("brown_conrady", plain["parameters"])
    told = both["conversion"]["residual"]
    assert told["max_px"] > told["max_sigma_px"]
    assert 0 < told["max_sigma_px"] < 0.2
    assert "residual" not in plain["conversion"]
    assert abs(both["parameters"]["p1"] - TANGENTIAL[6]) < 0.4 * TANGENTIAL[6]


def test_what_has_no_residual_beyond_its_noise_is_not_converted_with_one(catalogue):
    sensor = sensor_of("brown_conrady", SYMMETRIC)
    document = calibrate(
        seen_by("brown_conrady", TANGENTIAL, 9), sensor, catalogue, CalibrationSettings(match="given")
    ).to_dict()
    with pytest.raises(RefusedInputError, check=has_code("no-residual-spline")):
        converted(document, sensor, "c.json", "pinhole_radial", 1.0, with_residual=True)
