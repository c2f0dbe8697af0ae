"""Two trackers on one simulated body, and a tracker with a reference: the rotation, what it depends on, its gates and its JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import boresight as bs
from boresight.calibration.alignment.result import compute_json_schema, parse_alignment
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.settings import read_settings
from boresight.simulation import scenes
from boresight.sky.catalogue import load_catalogue
from boresight.verdicts.gates.alignment import ALIGNMENT_GATES, judge_alignment, parse_alignment_profile

ARCSEC = np.radians(1 / 3600)
TURN = np.radians([20.0, 60.0, -30.0])
SLOPE = np.array([12.0, -8.0, 5.0])
PUBLISHED = Path(__file__).resolve().parents[2] / "docs" / "alignment.schema.json"
FRAMES = 50


@pytest.fixture(scope="module")
def trackers():
    """Telemetry of two trackers that turn against each other with temperature, and their calibrations."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    a, b = (scenes.calibration_scenario(number, FRAMES) for number in (1, 2))
    exposures = scenes.expose(a)
    angles = (exposures.temperature_c - 20.0)[:, None] * SLOPE * ARCSEC
    mounted = (Rotation.from_rotvec(angles) * Rotation.from_rotvec(TURN)).as_matrix()
    of_b = replace(exposures, attitude=mounted @ exposures.attitude)
    sets = [
        scenes.simulate(one, np.random.default_rng(seed), catalogue, seen)
        for seed, one, seen in ((0, a, exposures), (1, b, of_b))
    ]
    cals = [bs.calibrate(one, each.sensor, progress=False) for one, each in zip(sets, (a, b), strict=True)]
    return sets, [a.sensor, b.sensor], cals


@pytest.fixture(scope="module")
def found(trackers):
    sets, sensors, cals = trackers
    return bs.align(
        *sets, sensor_a=sensors[0], sensor_b=sensors[1], parameters_a=cals[0], parameters_b=cals[1], progress=False
    )


def test_two_trackers_give_their_rotation_and_its_change_with_temperature(found):
    q, P = found.at(20.0)
    error = Rotation.from_matrix(to_matrix(q) @ Rotation.from_rotvec(TURN).as_matrix().T).as_rotvec()
    assert chi2.sf(error @ np.linalg.solve(P, error), 3) > 0.001
    (term,) = found.terms
    assert (term.name, term.unit, found.temperature_of) == ("temperature", "°C", "a")
    z = (np.array(term.value_arcsec) - SLOPE) / term.sigma_arcsec
    assert np.abs(z).max() < 4
    assert found.pairs == found.pairs_used
    assert [one.needed for one in found.tests] == [True, False, False]
    # the cameras' own error turns a frame by far more than the pairs are apart
    assert max(found.to_load.sigma_arcsec) < 10
    assert min(found.sigma_arcsec) > 50


def test_the_rotation_to_load_leads_from_one_reported_attitude_to_the_other(trackers, found):
    """Both solved with the parameters that are loaded: the mean of C_b C_a^T, within its sigma."""
    sets, sensors, cals = trackers
    reported = []
    for telemetry, sensor, cal in zip(sets, sensors, cals, strict=True):
        exposures = bs.match(telemetry, sensor, parameters=cal, progress=False).to_dict()["exposures"]
        reported.append({(one["frame"], one["exposure"]): one["quaternion"] for one in exposures if one["quaternion"]})
    both = sorted(reported[0].keys() & reported[1].keys())
    a, b = (Rotation.from_quat([one[key] for key in both]) for one in reported)
    mean = (b * a.inv()).mean()
    at = found.reference_temperature_c  # the mean of the pairs, where the slope cancels
    assert abs(at - 20.0) < 5
    away = (Rotation.from_quat(found.to_load.quaternion) * mean.inv()).as_rotvec() / ARCSEC
    assert (np.abs(away) < 3 * np.array(found.to_load.sigma_arcsec)).all()


def test_a_reference_gives_c_sd(trackers):
    """The reference is the true attitude with 2 arcsec of noise, of a frame turned by a known mounting."""
    (telemetry, _), (sensor, _), (cal, _) = trackers
    rng = np.random.default_rng(7)
    C_sd = Rotation.from_rotvec([0.3, -0.2, 1.0])
    first = np.unique(telemetry.time_utc, return_index=True)[1]
    true = C_sd * Rotation.from_quat(telemetry.quaternion[first])
    noisy = (Rotation.from_rotvec(2 * ARCSEC * rng.normal(size=(len(first), 3))) * true).as_quat()
    table = {"time_utc": telemetry.time_utc[first], **{f"q_{axis}": noisy[:, k] for k, axis in enumerate("xyzw")}}
    table["sigma_arcsec"] = np.full(len(first), 2.0)
    found = bs.align(telemetry, sensor_a=sensor, parameters_a=cal, reference=table, progress=False)
    error = (Rotation.from_matrix(found.c_sd) * C_sd.inv()).as_rotvec()
    P = np.array(found.covariance_rad2)[:3, :3]
    assert chi2.sf(error @ np.linalg.solve(P, error), 3) > 0.001
    assert found.b.parameters == "reference"
    # an error that all of the reference share stays whole
    biased = bs.align(
        telemetry, sensor_a=sensor, parameters_a=cal, reference=table, reference_bias_arcsec=500.0, progress=False
    )
    np.testing.assert_allclose(np.hypot(found.sigma_arcsec, 500.0), biased.sigma_arcsec, rtol=0.01)


def test_conventions_of_a_reference_are_those_of_a_mapping_profile(trackers):
    (telemetry, _), (sensor, _), (cal, _) = trackers
    first = np.unique(telemetry.time_utc, return_index=True)[1]
    x, y, z, w = Rotation.from_quat(telemetry.quaternion[first]).inv().as_quat().T
    table = {"when": telemetry.time_utc[first], "a": w, "b": x, "c": y, "d": z}
    profile = {
        "schema": "boresight.import-profile/1", "name": "gyro", "time": {"column": "when"}, "frames": {"by": "time"},
        "quaternion": {"columns": ["a", "b", "c", "d"], "order": "wxyz", "sense": "detector_to_icrs"},
    }  # fmt: skip
    found, own = (
        bs.align(telemetry, sensor_a=sensor, parameters_a=cal, progress=False, **one)
        for one in ({"reference": table, "reference_profile": profile}, {"reference": telemetry})
    )
    np.testing.assert_allclose(found.quaternion, own.quaternion, atol=1e-9)


def test_its_json_is_of_the_published_schema_and_comes_back(found, tmp_path):
    assert json.loads(PUBLISHED.read_text()) == json.loads(json.dumps(compute_json_schema()))
    found.save(tmp_path / "alignment.json")
    document = json.loads((tmp_path / "alignment.json").read_text())
    Draft202012Validator(compute_json_schema()).validate(document)
    assert parse_alignment(document).quaternion == found.quaternion
    assert document["gate_report"]["verdict"] == found.verdict
    assert len(found.to_frame("pyarrow")) == found.pairs


def test_gates_judge_what_they_ask(found):
    def status(alignment, **limits):
        profile = parse_alignment_profile(
            {"gates": [{"name": name.replace("_", "-"), **one} for name, one in limits.items()]}
        )
        return {one.name: one.status for one in judge_alignment(alignment, profile).gates}

    assert set(status(found)) == set(ALIGNMENT_GATES)
    sound = status(found)
    assert (sound["pairs"], sound["angles"], sound["temperature-trend"], sound["cameras"]) == ("PASS",) * 4
    assert status(found, angles={"limit": 1.0, "marginal": 0.5})["angles"] == "FAIL"
    assert status(replace(found, pairs_used=2))["pairs"] == "FAIL"
    assert status(replace(found, pairs_used=10))["pairs"] == "MARGINAL"
    assert status(replace(found, test=replace(found.test, ratio=20.0)))["pair-scatter"] == "FAIL"
    unmodelled = replace(found, terms=[], tests=[replace(found.tests[0], p=1e-6)])
    assert status(unmodelled)["temperature-trend"] == "FAIL"
    unknown = replace(found, terms=[], tests=[])
    assert status(unknown)["temperature-trend"] == "NO-DATA"
    for known, answer in (("typical", "MARGINAL"), ("none", "FAIL")):
        assert status(replace(found, a=replace(found.a, parameters=known)))["cameras"] == answer


def test_a_trend_that_was_not_asked_for_fails_its_gate(trackers):
    sets, sensors, cals = trackers
    found = bs.align(
        *sets, sensor_a=sensors[0], sensor_b=sensors[1], parameters_a=cals[0], parameters_b=cals[1], temperature=0,
        progress=False,
    )  # fmt: skip
    assert found.terms == []
    assert {one.name: one.status for one in found.report.gates}["temperature-trend"] == "FAIL"
    assert found.verdict == "FAIL"


def test_the_figure_draws_every_pair_and_the_line_of_the_alignment(found):
    figure = found.draw()
    assert [trace.name for trace in figure.data] == ["pairs", "alignment"] * 6
    over_time, line, over_warmth = figure.data[0], figure.data[3], figure.data[2]
    assert len(over_time.x) == len(over_warmth.x) == found.pairs
    np.testing.assert_allclose(over_warmth.x, found.residuals.temperature_c)
    slope = np.polyfit(line.x, line.y, 1)[0]
    assert slope == pytest.approx(found.terms[0].value_arcsec[0], rel=1e-3)
    assert over_time.error_y.array.min() > 0
    wrong = replace(found, residuals=replace(found.residuals, kept=[False, *found.residuals.kept[1:]]))
    assert [trace.name for trace in wrong.draw().data][:3] == ["pairs", "left out", "alignment"]


def test_what_cannot_be_aligned_is_refused(trackers):
    (a, b), (first, second), _ = trackers
    later = replace(b, time_utc=b.time_utc + np.timedelta64(1, "D"))
    for wrong in (
        {},
        {"b": b},
        {"b": b, "sensor_b": second, "reference": a},
        {"b": later, "sensor_b": second},
        {"b": replace(b, time_utc=None), "sensor_b": second},
        {"b": b, "sensor_b": second, "tolerance_s": -1.0},
        {"b": b, "sensor_b": second, "temperature_of": "c"},
        {"b": b, "sensor_b": second, "tolerance": 1.0},
        {"reference": a, "reference_sigma_arcsec": 0.0},
    ):
        with pytest.raises(RefusedInputError):
            bs.align(a, wrong.pop("b", None), sensor_a=first, progress=False, **wrong)
