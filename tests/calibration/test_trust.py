"""The trust object as a whole: every part for every method, or the sentence that says why not."""

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boresight.calibration.options import METHODS
from boresight.calibration.trust import trust_advice
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.judged import Case, case, field, simulated

PARTS = {
    "arc_sigma_map", "two_halves", "efficiency", "more_data", "drop_one", "nis_over_time", "whiteness", "stars",
    "residual_against", "residuals", "residual_field", "residual_distribution", "residual_outliers", "worst_frames",
}  # fmt: skip
REAL_SKY = Path(os.environ.get("BORESIGHT_REAL_SKY", Path(__file__).parents[3] / "shared/data/real-sky"))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_judged_from_every_side_and_a_clean_set_calls_for_nothing(method, catalogue):
    trust = simulated(catalogue, seed=4, method=method).trust
    assert trust["unavailable"] == {}
    assert all(trust[part] is not None for part in PARTS)
    json.dumps(trust, allow_nan=False)
    assert trust["two_halves"]["chi2"]["consistent"]
    assert trust["whiteness"]["white"]
    assert trust["nis_over_time"]["consistent"]
    assert trust["suspects"] == []
    assert trust["residual_field"]["even"]
    assert trust["residual_distribution"]["normal_tails"]
    assert trust["worst_frames"]["beyond"] <= trust["worst_frames"]["expected_beyond"] + 3
    assert all(trust["residual_against"][name]["even"] for name in ("radius", "magnitude", "temperature", "time"))
    # singular values leave out a number or two of each exposure, and say so by wider sigmas
    assert 0.97 < trust["efficiency"]["overall_ratio"] < (1.06 if method == "svd" else 1.03)
    assert [sentence for sentence in trust_advice(trust) if "do not ask for" not in sentence] == []


def test_a_reduced_set_is_judged_by_its_own_parameters(sensor, catalogue):
    trust = case(field(1), sensor, catalogue, free=("f_m", "b2_per_m2")).trust
    assert trust["two_halves"]["names"] == ["f_m", "b2_per_m2"]
    assert [entry["name"] for entry in trust["drop_one"]] == ["f_m", "b2_per_m2"]
    assert set(trust["more_data"]["sigma"]) == {"f_m", "b2_per_m2"}


def test_a_model_that_does_not_fit_is_said_before_drift_and_stars(catalogue):
    trust = simulated(catalogue, seed=1, free=("f_m",)).trust
    advice = trust_advice(trust)
    assert trust["unavailable"] == {"drop_one": "Only one parameter is free, so there is no other to fit without it."}
    assert not trust["residual_against"]["radius"]["even"]
    assert advice[-1].startswith("A camera model that leaves a radial residual hides")
    assert not any("catalogue place" in sentence for sentence in advice)
    assert trust["stars_sentence"].endswith("free more parameters first.")


def test_a_fit_that_leaves_a_direction_open_says_which_parts_that_costs(sensor, catalogue):
    flat = replace(sensor, initial=sensor.initial * np.array([1, 1, 1, 0, 0, 0, 0, 1.0]))
    held = case(field(2, frames=3, stars=4, exposures=1), flat, catalogue, max_iterations=1)
    open_fit = Case(**{**vars(held), "estimate": replace(held.estimate, status="rank_deficient")})
    trust = open_fit.trust
    lost = {"arc_sigma_map", "two_halves", "efficiency", "more_data", "drop_one"}
    assert lost <= set(trust["unavailable"])
    assert all(trust[part] is None for part in lost)
    assert trust["residuals"] is not None
    json.dumps(trust, allow_nan=False)


def test_a_diverged_fit_has_no_part_and_one_reason(sensor, catalogue):
    fitted = case(field(3), sensor, catalogue)
    trust = Case(**{**vars(fitted), "estimate": replace(fitted.estimate, status="diverged")}).trust
    assert all(trust[part] is None for part in PARTS)
    assert set(trust["unavailable"]) == PARTS
    assert set(trust["unavailable"].values()) == {
        "The fit diverged, so there is no estimate to judge: free fewer parameters or start closer."
    }
    assert trust_advice(trust) == []


def test_the_wrong_parity_is_found_though_the_arcs_fit(sensor, catalogue):
    trust = case(field(4), replace(sensor, parity=-1), catalogue).trust
    assert trust["two_halves"]["chi2"]["consistent"]
    assert trust_advice(trust)[0].endswith("the sensor's parity is probably wrong; try +1.")
    assert trust["residuals"] is trust["stars"] is trust["residual_against"] is None


def test_drawings_stay_small_and_large_sets_are_thinned_and_say_so(sensor, catalogue):
    judged = case(field(5, frames=3000, stars=5, exposures=1), sensor, catalogue)
    judged.trust  # noqa: B018 - compiles kernels, which is no part of the time
    began = time.perf_counter()
    trust = judged.trust
    seconds = time.perf_counter() - began
    assert len(trust["residuals"]["row_px"]) == 2000
    assert len(trust["nis_over_time"]["frame"]) == 1000
    assert len(trust["stars"]) == 200
    assert trust["residuals"]["frames_used"] == 1500
    assert "1500 frames spaced evenly" in trust["stars_sentence"]
    assert trust["efficiency"]["frames_used"] == 400
    assert "from 400 frames spaced evenly over the set" in trust["efficiency"]["sentence"]
    assert {entry["frames_used"] for entry in trust["drop_one"]} == {200}
    assert len(json.dumps(trust)) < 300_000
    assert seconds < 3


@pytest.mark.skipif(not REAL_SKY.exists(), reason="the real frames are not here")
def test_five_real_frames_of_an_upright_image_are_judged(catalogue):
    sensor, telemetry = read_sensor(REAL_SKY / "esa.sensor.json"), read_telemetry(REAL_SKY / "esa-5-frames.csv")
    trust = case(telemetry, sensor, catalogue).trust
    assert set(trust["unavailable"]) == {"whiteness", "residual_against.temperature", "residual_against.time"}
    assert 0.1 < trust["residuals"]["rms_px"] < 0.2
    assert trust["stars_in_all"] > 500
    assert trust["efficiency"]["overall_ratio"] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "size"),
    [
        ({}, {"frames": 1, "stars": 4}),
        ({}, {"frames": 1, "stars": 5, "exposures": 1}),
        ({}, {"frames": 2, "stars": 5}),
        ({}, {"frames": 20, "stars": 4, "exposures": 1}),
        ({"method": "sqrf"}, {"frames": 2, "stars": 5}),
        ({"method": "ekf", "variant": "q"}, {"frames": 1, "stars": 8}),
        ({"method": "ukf", "forgetting_factor": 0.9}, {"frames": 25, "stars": 6}),
        ({"robust": "huber"}, {"frames": 4, "stars": 6}),
        ({"error": "cosine"}, {"frames": 4, "stars": 6}),
    ],
    ids=str,
)
def test_the_thinnest_sets_have_every_part_or_its_reason(settings, size, sensor, catalogue):
    trust = case(field(2, **size), sensor, catalogue, **settings).trust
    assert {part for part in PARTS if trust[part] is None} == {name for name in trust["unavailable"] if "." not in name}
    json.dumps(trust, allow_nan=False)
