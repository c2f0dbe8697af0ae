"""The one function that calibrates: its document, its statuses, its refusals."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.errors import CancelledError, RefusedInputError
from boresight.estimation.statistics.consistency import nees
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.estimation.fields import SCALE, TRUTH

CONTRACT = {
    "schema", "sensor", "method", "variant", "camera_model", "free", "parameters", "sigma", "covariance", "status", "advice",
    "iterations", "frames", "exposures", "stars", "pairs", "rms_arc_rad", "chi2_per_dof", "nis", "observability", "validation",
    "history", "timing_s", "inputs",
}  # fmt: skip
REAL_SKY = Path(os.environ.get("BORESIGHT_REAL_SKY", Path(__file__).parents[3] / "shared/data/real-sky"))


def _error_over_sigma(document):
    P = np.array(document["covariance"]["matrix"])
    error = np.array([document["parameters"][name] for name in document["free"]]) - TRUTH
    return nees(error / SCALE, P / np.outer(SCALE, SCALE))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_writes_the_contracts_document_and_finds_the_truth(method, sensor, catalogue, telemetry_of):
    document = calibrate(
        telemetry_of(1, frames=80), sensor, catalogue, CalibrationSettings(method=method), validation=telemetry_of(2)
    )
    assert set(document) >= CONTRACT
    json.dumps(document, allow_nan=False)
    assert document["schema"] == "boresight.calibration/1"
    assert document["status"] == "converged"
    assert list(document["parameters"]) == list(document["sigma"]) == document["free"]
    assert document["pairs"] == 2 * document["stars"] - 3 * document["exposures"]
    assert _error_over_sigma(document) < 26  # the 99.9 % point of chi-square with 8 degrees of freedom
    assert document["rms_arc_rad"]["final"] < document["rms_arc_rad"]["initial"] / 3
    assert document["validation"]["rms_arc_rad"]["final"] < document["validation"]["rms_arc_rad"]["initial"] / 3
    assert document["chi2"]["consistent"]
    assert (document["history"] is None) == (method == "batch")
    assert (document["trace"] is None) == (method != "batch")


@pytest.mark.parametrize("method", METHODS)
def test_the_matrix_of_the_document_is_the_square_of_its_sigmas(method, sensor, catalogue, telemetry_of):
    document = calibrate(
        telemetry_of(3), sensor, catalogue, CalibrationSettings(method=method, free=("f_m", "b2_per_m2"))
    )
    assert document["covariance"]["names"] == document["free"] == ["f_m", "b2_per_m2"]
    sigmas = [document["sigma"][name] for name in document["free"]]
    np.testing.assert_allclose(np.sqrt(np.diag(document["covariance"]["matrix"])), sigmas, rtol=1e-12)
    assert document["sigma"]["m0_px"] is None
    assert document["parameters"]["m0_px"] == sensor.initial[1]


def test_a_history_follows_the_frames_with_its_bounds_and_both_rms(sensor, catalogue, telemetry_of):
    document = calibrate(telemetry_of(4), sensor, catalogue, CalibrationSettings(method="sqrf", variant="q"))
    history = document["history"]
    n = len(history["frame"])
    assert history["frame"][-1] == 39
    assert history["frame"] == sorted(history["frame"])
    assert np.array(history["parameters"]).shape == np.array(history["sigma"]).shape == (n, 8)
    assert [len(history[key]) for key in ("tail_rms_rad", "aggregate_rms_rad", "nis", "nis_dof")] == [n] * 4
    assert history["tail_rms_rad"][-1] == pytest.approx(document["rms_arc_rad"]["final"], rel=1e-9)
    np.testing.assert_allclose(history["parameters"][-1], list(document["parameters"].values()), rtol=1e-12)


def test_a_long_history_keeps_its_ends_and_stays_small(sensor, catalogue, telemetry_of):
    document = calibrate(
        telemetry_of(5, frames=2500, stars=5, exposures=1), sensor, catalogue, CalibrationSettings(method="sqrf")
    )
    assert len(document["history"]["frame"]) <= 1000
    assert document["history"]["frame"][-1] == 2499


def test_the_printed_filter_is_marked_over_confident(sensor, catalogue, telemetry_of):
    document = calibrate(
        telemetry_of(6, frames=80, stars=5), sensor, catalogue, CalibrationSettings(method="sqrf", linearisations=1)
    )
    assert any("as printed, makes the filter over-confident" in sentence for sentence in document["advice"])
    assert any("times the information that the data hold" in sentence for sentence in document["advice"])


def test_sets_with_fewer_than_four_stars_everywhere_are_too_few_and_nothing_is_estimated(
    sensor, catalogue, telemetry_of
):
    document = calibrate(telemetry_of(7, stars=3), sensor, catalogue, CalibrationSettings())
    assert document["status"] == "too_few_stars"
    assert set(document["sigma"].values()) == {None}
    assert "No exposure has 4 usable matched stars" in document["advice"][0]
    assert set(document) >= CONTRACT
    json.dumps(document, allow_nan=False)


def test_exposures_whose_stars_lie_on_one_line_are_left_out_and_counted(sensor, catalogue, telemetry_of):
    telemetry = telemetry_of(8, frames=3)
    line = np.linspace(-0.1, 0.1, len(telemetry))
    telemetry = replace(telemetry, ra_rad=line, dec_rad=np.zeros(len(telemetry)))
    document = calibrate(telemetry, sensor, catalogue, CalibrationSettings(match="given"))
    assert document["status"] == "too_few_stars"
    assert {"what": "exposures", "count": 6, "reason": "all usable stars on one line"} in document["left_out"]


def test_a_start_that_is_not_this_sensor_is_not_called_converged_with_small_sigmas(sensor, catalogue, telemetry_of):
    rng = np.random.default_rng(0)
    telemetry = telemetry_of(9)
    scrambled = replace(
        telemetry, ra_rad=rng.uniform(0, 6.28, len(telemetry)), dec_rad=rng.uniform(-1.5, 1.5, len(telemetry))
    )
    document = calibrate(scrambled, sensor, catalogue, CalibrationSettings())
    given_up = {"diverged", "max_iterations", "too_few_stars"}
    assert document["status"] in given_up or not document["chi2"]["consistent"]
    assert document["advice"]
    json.dumps(document, allow_nan=False)


def test_wrong_noise_is_said_with_the_sigma_that_would_fit(sensor, catalogue, telemetry_of):
    document = calibrate(telemetry_of(10), replace(sensor, centroid_sigma_px=0.2), catalogue, CalibrationSettings())
    sentence = next(sentence for sentence in document["advice"] if "centroid sigma of" in sentence)
    implied = float(sentence.split("centroid sigma of ")[1].split(" px")[0])
    assert implied == pytest.approx(0.437, rel=0.05)


def test_an_unknown_free_parameter_is_refused_with_the_names_there_are(sensor, catalogue, telemetry_of):
    with pytest.raises(RefusedInputError, match="'k1' is not one of the camera model inverted_wang: choose from f_m"):
        calibrate(telemetry_of(11), sensor, catalogue, CalibrationSettings(free=("k1",)))


@pytest.mark.parametrize("method", METHODS)
def test_a_cancel_stops_every_method(method, sensor, catalogue, telemetry_of):
    with pytest.raises(CancelledError):
        calibrate(telemetry_of(12), sensor, catalogue, CalibrationSettings(method=method), cancelled=lambda: True)


@pytest.mark.parametrize("method", METHODS)
def test_progress_carries_a_document_from_which_figures_can_draw(method, sensor, catalogue, telemetry_of, monkeypatch):
    heard = []
    monkeypatch.setattr("boresight.calibration.calibrate.REPORT_EVERY_S", 0.0)
    calibrate(telemetry_of(13), sensor, catalogue, CalibrationSettings(method=method), report=heard.append)
    assert heard
    assert 0 <= heard[0].fraction <= 1
    assert heard[0].partial["status"] == "running"
    json.dumps(heard[0].partial, allow_nan=False)


def test_a_filter_on_its_way_says_how_many_frames_it_has_taken_in(sensor, catalogue, telemetry_of):
    heard = []
    settings = CalibrationSettings(method="sqrf", replay_frames_per_s=30.0)
    calibrate(telemetry_of(13, frames=30), sensor, catalogue, settings, report=heard.append)
    for told in (one for one in heard if one.partial):
        if told.partial["status"] == "running":
            assert told.partial["frames_done"] == round(told.fraction * told.partial["frames"])


def test_a_replay_takes_frames_at_its_pace(sensor, catalogue, telemetry_of):
    document = calibrate(
        telemetry_of(14, frames=30), sensor, catalogue, CalibrationSettings(method="sqrf", replay_frames_per_s=100.0)
    )
    updates = len(document["history"]["frame"])
    assert document["timing_s"]["fit"] >= 0.9 * (updates - 1) / 100


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"method": "magic"}, "Setting 'method' is 'magic'; choose from batch"),
        ({"metod": "batch"}, "Setting 'metod' is unknown"),
        ({"linearisations": 0}, "give a whole number from 1 to 100"),
        ({"process_noise_sigma": float("nan")}, "give a number from 0 to 10"),
        ({"free": "f_m"}, "must be a list"),
        ({"minimum_stars": 3}, "from 4 to 1000"),
        ({"minimum_stars": True}, "from 4 to 1000"),
    ],
)
def test_settings_out_of_range_are_refused_in_one_sentence(document, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        CalibrationSettings.parse(document)


def test_settings_survive_their_document():
    settings = CalibrationSettings(method="sqrf", free=("f_m",), replay_frames_per_s=4.0)
    assert CalibrationSettings.parse(json.loads(json.dumps(settings.document()))) == settings


@pytest.mark.skipif(not REAL_SKY.is_dir(), reason="the real star fields are not here")
class TestRealSky:
    def _calibrate(self, catalogue, free, method="batch"):
        telemetry, sensor = read_telemetry(REAL_SKY / "esa-5-frames.csv"), read_sensor(REAL_SKY / "esa.sensor.json")
        return sensor, calibrate(telemetry, sensor, catalogue, CalibrationSettings(method=method, free=free))

    @pytest.mark.parametrize("method", METHODS)
    def test_the_focal_length_is_known_to_a_pixel_and_distortion_lowers_the_rms(self, catalogue, method):
        _, alone = self._calibrate(catalogue, ("f_m",), method)
        sensor, both = self._calibrate(catalogue, ("f_m", "b2_per_m2"), method)
        assert both["sigma"]["f_m"] / sensor.pixel_pitch_m < 1.0
        assert both["rms_arc_rad"]["final"] < alone["rms_arc_rad"]["final"]

    def test_all_eight_free_says_in_words_that_principal_point_and_tilt_are_weak(self, catalogue):
        _, document = self._calibrate(catalogue, None)
        said = " ".join(document["advice"])
        assert "n0 and a1 move together" in said
        assert "m0 and a2 move together" in said
        assert document["sigma"]["m0_px"] > 5
        assert document["sigma"]["n0_px"] > 5


def test_telemetry_of_another_camera_is_said_to_be_so_before_all_else(sensor, catalogue, telemetry_of):
    longer = TRUTH.copy()
    longer[0] *= 2
    document = calibrate(telemetry_of(15, truth=longer), sensor, catalogue, CalibrationSettings())
    assert document["status"] == "diverged" or "hardly comes from this sensor" in document["advice"][0]


def test_what_is_over_in_a_moment_makes_no_document_on_its_way(sensor, catalogue, telemetry_of, monkeypatch):
    heard = []
    monkeypatch.setattr("boresight.calibration.calibrate.REPORT_EVERY_S", 3600.0)
    calibrate(telemetry_of(13), sensor, catalogue, CalibrationSettings(), report=heard.append)
    assert heard == []
