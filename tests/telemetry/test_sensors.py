"""A sensor description is read whole or refused with the names of the wrong fields."""

import json

import numpy as np
import pytest
from hypothesis import given, settings

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import parse_sensor, read_sensor, sensor_document
from tests.effort import effort
from tests.strategies import sensors


def refusal(document):
    with pytest.raises(RefusedInputError) as caught:
        parse_sensor(document)
    return str(caught.value)


def changed(document, path, value):
    *folders, key = path.split(".")
    place = document
    for folder in folders:
        place = place[folder]
    if value is ...:
        del place[key]
    else:
        place[key] = value
    return document


def test_a_right_description_is_read_in_the_models_order(document):
    sensor = parse_sensor(document)
    assert (sensor.rows, sensor.columns, sensor.parity) == (768, 1024, -1)
    assert sensor.initial.tolist() == [0.035, 383.5, 511.5, 0.0, 0.0, 0.0, 0.0, 1.0]
    assert sensor.typical_sigma.tolist() == [3e-4, 10.0, 10.0, 1e6, 100.0, 0.005, 0.005, 2e-4]
    assert sensor.free == CAMERA_MODELS["inverted_wang"].parameter_names
    assert sensor.magnitude_limit is None


def test_free_names_are_put_in_the_models_order(document):
    assert parse_sensor({**document, "free": ["g_y", "f_m"]}).free == ("f_m", "g_y")


def test_keys_of_other_names_are_let_pass(document):
    assert parse_sensor({**document, "comment": "from the clean room", "serial": 12}).name == "STK-1"


@settings(max_examples=effort(12, 60), deadline=None)
@given(sensor=sensors())
def test_a_sensor_survives_its_document_and_json(sensor):
    again = parse_sensor(json.loads(json.dumps(sensor_document(sensor))))
    np.testing.assert_array_equal(again.initial, sensor.initial)
    np.testing.assert_array_equal(again.typical_sigma, sensor.typical_sigma)
    assert sensor_document(again) == sensor_document(sensor)


@pytest.mark.parametrize(
    "key", ["name", "detector", "camera_model", "parity", "centroid_sigma_px", "initial", "typical_sigma"]
)
def test_a_missing_key_is_named(document, key):
    assert f"{key} is missing" in refusal(changed(document, key, ...))


@pytest.mark.parametrize(
    "path",
    ["detector.rows", "detector.pixel_pitch_m", "initial.f_m", "initial.g_y", "typical_sigma.b4_per_m4"],
)
@pytest.mark.parametrize(
    ("value", "words"),
    [
        (..., "is missing"),
        (None, "is missing"),
        ("16", "is '16': give a number"),
        (True, "is True: give a number"),
        (float("nan"), "is nan: give a finite number"),
        (float("inf"), "is inf: give a finite number"),
        (-1e30, "check its unit"),
        (10**400, "check its unit"),
    ],
)
def test_a_wrong_number_is_named(document, path, value, words):
    message = refusal(changed(document, path, value))
    assert path in message
    assert words in message


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("name", "", "name is ''"),
        ("name", " STK", "printable characters"),
        ("name", "a" * 65, "1 to 64"),
        ("name", 7, "name is 7"),
        ("detector", [768, 1024], "detector is [768, 1024]"),
        ("detector.rows", 0, "detector.rows is 0"),
        ("detector.columns", 10.5, "whole number of pixels"),
        ("detector.pixel_pitch_m", 6.9, "check its unit"),
        ("camera_model", "fisheye", "choose inverted_wang"),
        ("camera_model", ["inverted_wang"], "camera_model is"),
        ("parity", 0, "give 1 for a right-handed"),
        ("parity", True, "parity is True"),
        ("centroid_sigma_px", 0, "centroid_sigma_px is 0"),
        ("centroid_sigma_px", -0.1, "centroid_sigma_px is -0.1"),
        ("initial.k1", 0.1, "initial.k1 is no parameter of inverted_wang"),
        ("typical_sigma.f_m", 0, "typical_sigma.f_m is 0"),
        ("typical_sigma.f_m", -1e-4, "typical_sigma.f_m is -0.0001"),
        ("typical_sigma.f_mm", 1, "typical_sigma.f_mm is no parameter"),
        ("free", [], "free is []"),
        ("free", "f_m", "free is 'f_m'"),
        ("free", ["f_m", "k1"], "free names 'k1'"),
        ("free", [["f_m"]], "free names ['f_m']"),
        ("magnitude_limit", "6", "magnitude_limit is '6'"),
        ("magnitude_limit", 99, "magnitude_limit is 99"),
        ("magnitude_limits", 6, "magnitude_limits is not a field: write magnitude_limit"),
        ("initial.f_m", 35.0, "field of view of 0.0144 degrees"),
        ("initial.b2_per_m2", 9e7, "field of view of 179 degrees"),
        ("initial.m0_px", 9e4, "principal point at row 90000"),
        ("initial.n0_px", -3000, "far off the detector"),
    ],
)
def test_a_wrong_field_is_named_with_what_to_do(document, path, value, words):
    assert words in refusal(changed(document, path, value))


def test_a_distortion_that_turns_back_on_the_detector_is_named_with_the_blind_corner(document):
    document["camera_model"] = "pinhole_radial"
    rows, columns = document["detector"]["rows"], document["detector"]["columns"]
    middle = {"u0_px": columns / 2, "v0_px": rows / 2}
    document["initial"] = {"s": 1.0, "f_m": document["initial"]["f_m"], **middle, "k1": 0.0, "k2": 0.0}
    document["typical_sigma"] = {"s": 1e-3, "f_m": 1e-4, "u0_px": 10.0, "v0_px": 10.0, "k1": 0.1, "k2": 0.5}
    document.pop("free", None)
    assert parse_sensor(document).camera_model == "pinhole_radial"
    document["initial"]["k1"] = -1e3
    assert "turns back before the corner at row -0.5, column -0.5" in refusal(document)


def test_every_wrong_field_is_listed(document):
    document["parity"], document["initial"]["f_m"] = 3, "x"
    with pytest.raises(RefusedInputError) as caught:
        parse_sensor(document)
    assert [fault.detail.split()[0] for fault in caught.value.faults] == ["parity", "initial.f_m"]


def test_a_sensor_file_is_read(document, tmp_path):
    path = tmp_path / "stk.sensor.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(document).encode())
    assert read_sensor(path).name == "STK-1"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b'{\n "name": "x",\n}', "row 3: this is not JSON"),
        (b"[1]", "is not a sensor file"),
        (b"[" * 100_000, "not JSON"),
        (b'{"name": "\xe9"}', "not UTF-8"),
        (b"{}", "name is missing"),
    ],
)
def test_a_file_that_is_no_sensor_file_is_refused_by_name(tmp_path, content, words):
    path = tmp_path / "stk.sensor.json"
    path.write_bytes(content)
    with pytest.raises(RefusedInputError) as caught:
        read_sensor(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith("stk.sensor.json")


def test_a_missing_sensor_file_is_refused(tmp_path):
    with pytest.raises(RefusedInputError, match="does not exist"):
        read_sensor(tmp_path / "none.json")


def test_the_real_sensor_is_read(real_sky):
    sensor = read_sensor(real_sky / "esa.sensor.json")
    assert (sensor.name, sensor.parity, sensor.centroid_sigma_px) == ("ESA-HF35XA", -1, 0.13)
