"""The pinhole camera through the whole calibration: W's sensor over a simulated sky, and points beyond its turn."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration
from boresight.calibration.matching.rematch import rematch
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.chart import Trace
from boresight.figures.report import render_report
from boresight.simulation.scenes import parse_scenario, simulate
from tests.effort import few_of
from tests.refusals import has_code

TRUTH = {"s": 1.0, "f_m": 0.016, "u0_px": 970.0, "v0_px": 550.0, "k1": -0.5, "k2": 0.5}
SENSOR = {
    "name": "WU-1",
    "detector": {"rows": 1080, "columns": 1920, "pixel_pitch_m": 2.9e-6},
    "camera_model": "pinhole_radial",
    "parity": -1,
    "centroid_sigma_px": 0.2,
    "initial": {"s": 1.0, "f_m": 0.0155, "u0_px": 960.0, "v0_px": 540.0, "k1": 0.0, "k2": 0.0},
    "typical_sigma": {"s": 1e-3, "f_m": 1e-4, "u0_px": 10.0, "v0_px": 10.0, "k1": 0.1, "k2": 0.5},
    "magnitude_limit": 5.5,
}


@pytest.fixture(scope="module")
def scenario():
    return parse_scenario(
        {"sensor": SENSOR, "truth": TRUTH, "frames": 60, "exposures": 1, "magnitude_limit": 5.5, "seed": 3}
    )


@pytest.fixture(scope="module")
def telemetry(scenario, catalogue):
    return simulate(scenario, np.random.default_rng(scenario.seed), catalogue)


@pytest.fixture(scope="module")
def results(scenario, telemetry, catalogue):
    @cache
    def calibrated(method):
        settings = CalibrationSettings(method=method, match="rematch")
        return calibrate(telemetry, scenario.sensor, catalogue, settings).to_dict()

    return calibrated


@pytest.mark.full
@pytest.mark.parametrize("method", few_of(["batch", "sqrf", "ekf", "ukf"], 2))
def test_every_method_finds_the_truth_within_what_it_claims(results, method):
    result = results(method)
    assert result["status"] == "converged"
    for name, truth in TRUTH.items():
        assert abs(result["parameters"][name] - truth) < 4 * result["sigma"][name]
    assert result["nis"]["consistent"]
    assert 0.9 < result["chi2_per_dof"] < 1.1


def test_the_attitude_correction_every_part_of_trust_and_the_report_are_there(results):
    alignment = results("batch")["alignment"]
    # the principal point moved by ten pixels of 37 arcsec along either axis
    turned = np.hypot(*alignment["rotation_arcsec"][:2])
    assert turned == pytest.approx(np.hypot(10, 10) * 37.4, abs=4 * max(alignment["sigma_arcsec"]))
    assert results("batch")["trust"]["unavailable"] == {}
    page = render_report(parse_calibration(results("batch")))
    assert "pinhole_radial" in page
    assert all(name in page for name in TRUTH)


@pytest.mark.parametrize("name", sorted(FIGURES))
def test_every_figure_draws_it(results, name):
    if name == "shadow":
        pytest.skip("only a run that was matched by two sets of parameters has one")
    assert FIGURES[name].draw([Trace("WU-1", parse_calibration(results("batch")))]).data


def test_matches_are_found_without_any_given(scenario, telemetry, catalogue):
    unnamed = replace(telemetry, star_id=None)
    sensor = replace(
        scenario.sensor, magnitude_limit=6.5
    )  # half of the stars at its own limit are detected, and some beyond
    matches = rematch(unnamed, sensor, catalogue, scenario.truth, np.zeros((6, 6)), CalibrationSettings())
    known = telemetry.star_id > 0
    assert np.mean(matches.star_id[known] == telemetry.star_id[known]) > 0.98


@pytest.mark.full
@pytest.mark.parametrize("k1", [-1.0, -20.0])
def test_rows_that_have_no_direction_are_matched_with_nothing(scenario, telemetry, catalogue, k1):
    row_px, x = telemetry.row_px.copy(), scenario.truth.copy()
    row_px[3], x[4], x[5] = 9000.0, k1, 0.0  # at -1 the distortion turns back 2,100 px out, at -20 inside the detector
    matches = rematch(
        replace(telemetry, row_px=row_px, quaternion=None),
        scenario.sensor,
        catalogue,
        x,
        np.zeros((6, 6)),
        CalibrationSettings(),
    )
    s = CAMERA_MODELS["pinhole_radial"].directions(x, row_px, telemetry.col_px, scenario.sensor.pixel_pitch_m)
    blind = np.isnan(s[:, 0])
    assert blind[3]
    assert not matches.star_id[blind].any()


def test_a_truth_whose_distortion_turns_back_on_the_detector_is_refused():
    with pytest.raises(RefusedInputError, check=has_code("distortion-turns-back")):
        parse_scenario({"sensor": SENSOR, "truth": TRUTH | {"k1": -10.0}})


WIDE = np.array([1e-3, 1e-4, 10.0, 10.0, 0.1, 20.0])
FIELD = {"sensor": SENSOR, "truth": TRUTH, "frames": 30, "exposures": 1, "magnitude_limit": 5.5, "seed": 3}


@pytest.fixture(scope="module")
def short_scenario():
    return parse_scenario(FIELD)


@pytest.fixture(scope="module")
def short_telemetry(short_scenario, catalogue):
    return simulate(short_scenario, np.random.default_rng(short_scenario.seed), catalogue)


@pytest.fixture
def calibrated(short_scenario, short_telemetry, catalogue):
    def run(sigma, method="ukf", **chosen):
        sensor = replace(short_scenario.sensor, typical_sigma=sigma)
        return calibrate(
            short_telemetry, sensor, catalogue, CalibrationSettings(method=method, match="given", **chosen)
        ).to_dict()

    return run


@pytest.mark.full
def test_the_first_sentence_names_the_parameter_whose_spread_it_was_and_what_it_says_helps(calibrated):
    result = calibrated(WIDE, linearisations=1)
    assert result["status"] == "diverged"
    assert "states 2.4 sigmas away" in result["advice"][0]
    assert "where k2 makes the distortion fold back" in result["advice"][0]
    assert "Choose sqrf" in result["advice"][0]
    assert calibrated(WIDE, "sqrf", linearisations=1)["status"] == "converged"
    assert calibrated(WIDE)["status"] == "converged"
    assert calibrated(WIDE, linearisations=1, initial_sigma_scale=0.5)["status"] == "converged"
    assert calibrated(WIDE / 20, linearisations=1)["status"] == "converged"
