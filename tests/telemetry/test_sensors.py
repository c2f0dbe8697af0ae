"""A sensor description is read whole or refused by its wrong fields; telemetry that does not fit it is left out or refused."""

import dataclasses
import functools
import json
import operator

import numpy as np
import pytest
from hypothesis import given, settings

from boresight import kernels
from boresight.calibration.parameter_file import parse_parameters
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.telemetry.declarations import DECLARATIONS, NOTHING_DECLARED, Declared, Readout
from boresight.telemetry.quality.detector import OffDetector, check_against_sensor
from boresight.telemetry.schema import select_rows
from boresight.telemetry.sensors import parse_sensor, read_described_camera, read_sensor, sensor_document
from tests.effort import effort
from tests.refusals import has_code
from tests.strategies import sensors
from tests.telemetry.troubles import calm_telemetry

SAME = ("name", "camera_model", "free", "rows", "columns", "pixel_pitch_m")


def refusal(document):
    with pytest.raises(RefusedInputError) as caught:
        parse_sensor(document)
    return str(caught.value)


def changed(document, path, value):
    *folders, key = path.split(".")
    place = functools.reduce(operator.getitem, folders, document)
    if value is ...:
        del place[key]
    else:
        place[key] = value
    return document


def test_a_right_description_is_read_in_the_models_order_from_a_file_too(document, tmp_path):
    path = tmp_path / "stk.sensor.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(document | {"comment": "from the clean room", "serial": 12}).encode())
    for sensor in (parse_sensor(document), read_sensor(path)):  # keys of other names are let pass
        assert (sensor.name, sensor.rows, sensor.columns, sensor.parity) == ("STK-1", 768, 1024, -1)
        assert sensor.initial.tolist() == [0.035, 383.5, 511.5, 0.0, 0.0, 0.0, 0.0, 1.0]
        assert sensor.typical_sigma.tolist() == [3e-4, 10.0, 10.0, 1e6, 100.0, 0.005, 0.005, 2e-4]
        assert (sensor.free, sensor.magnitude_limit) == (CAMERA_MODELS["inverted_wang"].parameter_names, None)
    assert parse_sensor({**document, "free": ["g_y", "f_m"]}).free == ("f_m", "g_y")
    with pytest.raises(RefusedInputError, check=has_code("no-such-file")):
        read_sensor(tmp_path / "none.json")


@pytest.mark.parametrize("model", CAMERA_MODELS)
def test_a_focal_length_may_be_given_in_pixels_by_its_name(document, model):
    camera, pitch = CAMERA_MODELS[model], document["detector"]["pixel_pitch_m"]
    x = dict(zip(camera.parameter_names, camera.plain(2000.0, 383.5, 511.5, pitch).tolist(), strict=True))
    spread = dict(zip(camera.parameter_names, camera.default_typical_sigma, strict=True))
    in_metres = document | {"camera_model": model, "initial": x, "typical_sigma": spread | {"f_m": 3 * pitch}}
    in_pixels = in_metres | {
        "initial": {"f_px" if name == "f_m" else name: 2000.0 if name == "f_m" else value for name, value in x.items()},
        "typical_sigma": {"f_px" if name == "f_m" else name: spread[name] if name != "f_m" else 3 for name in spread},
        "free": ["f_px", *camera.parameter_names[-1:]],
    }
    sensor, same = parse_sensor(in_metres), parse_sensor(in_pixels)
    np.testing.assert_array_equal(same.initial, sensor.initial)
    np.testing.assert_array_equal(same.typical_sigma, sensor.typical_sigma)
    assert set(same.free) == {"f_m", camera.parameter_names[-1]}
    np.testing.assert_array_equal(parse_parameters(in_pixels["initial"], sensor, "a file")[0], sensor.initial)
    assert "f_px" in refusal(in_pixels | {"initial": in_pixels["initial"] | {"f_m": 0.01}})


@pytest.mark.parametrize("model", CAMERA_MODELS)
def test_a_description_is_read_where_nothing_is_compiled_yet(document, model, monkeypatch):
    camera, pitch = CAMERA_MODELS[model], document["detector"]["pixel_pitch_m"]
    x = dict(zip(camera.parameter_names, camera.plain(2000.0, 383.5, 511.5, pitch).tolist(), strict=True))
    spread = dict(zip(camera.parameter_names, camera.default_typical_sigma, strict=True))
    monkeypatch.setattr(kernels, "rays", None)  # a console registers a sensor inside a write transaction
    assert parse_sensor(document | {"camera_model": model, "initial": x, "typical_sigma": spread}).camera_model == model


@settings(max_examples=effort(12, 60), deadline=None)
@given(sensor=sensors())
def test_a_sensor_survives_its_document_and_json(sensor):
    again = parse_sensor(json.loads(json.dumps(sensor_document(sensor))))
    np.testing.assert_array_equal(again.initial, sensor.initial)
    np.testing.assert_array_equal(again.typical_sigma, sensor.typical_sigma)
    assert sensor_document(again) == sensor_document(sensor)
    camera = read_described_camera(sensor_document(sensor))
    assert [getattr(camera, one) for one in SAME] == [getattr(sensor, one) for one in SAME]
    assert list(camera.initial.values()) == sensor.initial.tolist()


def test_all_parameters_are_free_where_a_stored_document_names_none(document):
    given = {name: value for name, value in document.items() if name != "free"}
    assert (
        read_described_camera(given).free == parse_sensor(given).free == CAMERA_MODELS["inverted_wang"].parameter_names
    )


def test_what_no_data_can_show_is_declared_by_words(document):
    assert (parse_sensor(document).readout, parse_sensor(document).declared) == (None, NOTHING_DECLARED)
    rolling = {"mode": "rolling", "line_time_s": -3.6e-5, "axis": "columns"}
    sensor = parse_sensor(document | {"readout": rolling, "declared": {"directions": "j2000"}})
    assert sensor.readout == Readout("rolling", -3.6e-5, "columns", corrected=False)
    assert sensor.readout.is_in_centroids
    assert sensor.declared == Declared(directions="j2000")
    corrected = parse_sensor(document | {"readout": {"mode": "rolling", "corrected": True}}).readout
    assert (corrected.line_time_s, corrected.is_in_centroids, corrected.axis) == (None, False, "rows")
    assert sensor_document(parse_sensor(document | {"readout": {"mode": "global"}}))["readout"] == {"mode": "global"}
    everything = {name: next(iter(one.words)) for name, one in DECLARATIONS.items()}
    assert sensor_document(parse_sensor(document | {"declared": everything}))["declared"] == everything


ROLLING_READOUT = {"mode": "rolling", "line_time_s": 3.6e-5}


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("readout", "rolling", "readout.mode is 'rolling': write global, or rolling"),
        ("readout", {"mode": "line"}, "readout.mode is 'line'"),
        ("readout", {"mode": ["global"]}, "readout.mode is ['global']"),
        ("readout", {"mode": "rolling"}, "readout.line_time_s is missing"),
        ("readout", {"mode": "global", "line_time_s": 1e-5}, "omit the others"),
        ("readout", ROLLING_READOUT | {"line_time_s": 0}, "readout.line_time_s is 0"),
        ("readout", ROLLING_READOUT | {"line_time_s": True}, "readout.line_time_s is True"),
        ("readout", ROLLING_READOUT | {"line_time_s": float("nan")}, "readout.line_time_s is nan"),
        ("readout", ROLLING_READOUT | {"line_time_s": 36}, "readout.line_time_s is 36"),
        ("readout", ROLLING_READOUT | {"line_time_s": 0.05}, "lines would take"),
        ("readout", ROLLING_READOUT | {"axis": "x"}, "readout.axis is 'x': write rows"),
        ("readout", ROLLING_READOUT | {"corrected": "no"}, "readout.corrected is 'no': write true"),
        ("readout", ROLLING_READOUT | {"line_times_s": 1}, "readout.line_times_s is not a field"),
        ("declared", ["apparent"], "declared is ['apparent']: write an object"),
        ("declared", {"directions": "J2000"}, "declared.directions is 'J2000': write apparent or j2000"),
        ("declared", {"refraction": None}, "declared.refraction is None"),
        ("declared", {"velocity": "given"}, "declared.velocity is not a field"),
        ("readouts", ROLLING_READOUT, "readouts is not a field: write readout"),
    ],
)
def test_a_wrong_declaration_is_named_in_one_sentence(document, field, value, words):
    assert words in refusal(document | {field: value})


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
        *(
            (key, ..., f"{key} is missing")
            for key in ("name", "detector", "camera_model", "parity", "centroid_sigma_px", "initial", "typical_sigma")
        ),
        ("name", "", "name is ''"),
        ("name", " STK", "printable characters"),
        ("name", "a" * 65, "1 to 64"),
        ("name", 7, "name is 7"),
        ("detector", [768, 1024], "detector is [768, 1024]"),
        ("detector.rows", 0, "detector.rows is 0"),
        ("detector.columns", 10.5, "whole number of pixels"),
        ("detector.pixel_pitch_m", 6.9, "check its unit"),
        ("camera_model", "fisheye", "inverted_wang or "),
        ("camera_model", ["inverted_wang"], "camera_model is"),
        ("parity", 0, "give 1 for a right-handed"),
        ("parity", True, "parity is True"),
        ("centroid_sigma_px", 0, "centroid_sigma_px is 0"),
        ("centroid_sigma_px", -0.1, "centroid_sigma_px is -0.1"),
        ("initial.k1", 0.1, "initial.k1 is not a parameter of inverted_wang"),
        ("typical_sigma.f_m", 0, "typical_sigma.f_m is 0"),
        ("typical_sigma.f_m", -1e-4, "typical_sigma.f_m is -0.0001"),
        ("typical_sigma.f_mm", 1, "typical_sigma.f_mm is not a parameter"),
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
        ("initial.n0_px", -3000, "far outside the detector"),
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
    assert "folds back before the corner at row -0.5, column -0.5" in refusal(document)


def test_every_wrong_field_is_listed(document):
    document["parity"], document["initial"]["f_m"] = 3, "x"
    with pytest.raises(RefusedInputError) as caught:
        parse_sensor(document)
    assert [fault.detail.split()[0] for fault in caught.value.faults] == ["parity", "initial.f_m"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b'{\n "name": x\n}', "row 2: this is not JSON"),
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


def test_the_real_sensor_is_read(real_sky):
    sensor = read_sensor(real_sky / "esa.sensor.json")
    assert (sensor.name, sensor.parity, sensor.centroid_sigma_px) == ("ESA-HF35XA", -1, 0.13)


HEADER = "frame,exposure,row_px,col_px,star_id\n"


def test_matched_stars_off_the_detector_are_refused_with_row_and_column_by_numbers_or_directions(read, sensor):
    telemetry = read(f"{HEADER}0,0,10,20,1\n0,0,769.6,20,2\n0,0,5,-2.51,3\n")
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(telemetry, sensor)
    assert [(fault.row, fault.column) for fault in caught.value.faults] == [(3, "row_px"), (4, "col_px")]
    assert "769.6 is outside the detector (−0.5 to 767.5): swap rows and columns" in str(caught.value)
    telemetry = read("frame,exposure,row_px,col_px,ra_deg,dec_deg\n0,0,9000,20,1,2\n0,0,9001,20,,\n")
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(telemetry, sensor)
    assert [fault.row for fault in caught.value.faults] == [2]


@pytest.mark.parametrize(
    "rows",
    ["0,0,10,20,1\n0,0,9000,20,\n", "0,0,769.4,-2.4,1\n", "0,0,-0.5,-0.5,1\n0,0,767.5,1023.5,2\n"],
    ids=["unmatched", "a star cut by the edge", "the edge of the outermost pixels"],
)
def test_what_is_unmatched_cut_by_the_edge_or_on_it_is_let_pass(read, sensor, rows):
    check_against_sensor(read(HEADER + rows), sensor)


def off_by(telemetry, count, px=5.0):
    rows = np.linspace(0, len(telemetry) - 1, count).round().astype(int)
    row_px = telemetry.row_px.copy()
    row_px[rows] = 767.5 + px
    return dataclasses.replace(telemetry, row_px=row_px), rows


def test_one_star_5_px_off_the_detector_is_left_out_with_its_row_and_distance(sensor):
    calm = calm_telemetry()
    moved, rows = off_by(calm, 1)
    off = check_against_sensor(moved, sensor).document()
    star = {"row": int(rows[0]) + 2, "frame": 0, "exposure": 0, "star_id": int(calm.star_id[0]), "off_px": 5.0}
    assert off == {"stars": 1, "farthest_px": 5.0, "rows": [star]}


@pytest.mark.parametrize("repeats", [1, 4], ids=["of a few", "of many"])
def test_a_set_is_refused_from_one_star_more_than_are_left_out(sensor, repeats):
    whole = calm_telemetry()
    arrays = {name: values for name, values in vars(whole).items() if isinstance(values, np.ndarray)}
    tiled = {name: np.tile(values, (repeats,) + (1,) * (values.ndim - 1)) for name, values in arrays.items()}
    whole = dataclasses.replace(whole, **tiled)
    most = max(3, len(whole) // 100)
    assert check_against_sensor(off_by(whole, most)[0], sensor).stars == most
    moved, rows = off_by(whole, most + 1)
    with pytest.raises(RefusedInputError) as caught:
        check_against_sensor(moved, sensor)
    assert [fault.row for fault in caught.value.faults] == (rows + 2).tolist()
    assert f"{most + 1} of its {len(whole):,} matched stars" in str(caught.value)


@pytest.mark.parametrize("count", [2, 60])
def test_what_is_left_out_or_refused_does_not_depend_on_the_parts_a_set_comes_in(sensor, count):
    moved, _ = off_by(calm_telemetry(), count)
    whole, parts = OffDetector(), OffDetector()
    whole.look_at(moved, sensor)
    for first in range(0, len(moved), 36):
        part = OffDetector()
        part.look_at(select_rows(moved, slice(first, first + 36)), sensor)
        parts.absorb(part)
    assert parts.document() == whole.document()
    assert parts.too_many == whole.too_many == (count == 60)
    if whole.too_many:
        said = []
        for off in (whole, parts):
            with pytest.raises(RefusedInputError) as caught:
                off.refuse()
            said.append((str(caught.value), caught.value.faults))
        assert said[0] == said[1]


@pytest.mark.parametrize(
    "wrong",
    [
        {"readout": {"mode": "z" * 100_000}},
        {"readout": {"mode": "rolling", "line_time_s": 1e-5, "axis": "z" * 100_000}},
        {"declared": {"directions": "z" * 100_000}},
        {"declared": {"z" * 100_000: "apparent"}},
        {"declared": "z" * 100_000},
        {"initial": "z" * 100_000},
    ],
)
def test_what_is_long_is_refused_in_a_short_sentence(document, wrong):
    with pytest.raises(RefusedInputError) as caught:
        parse_sensor({**document, **wrong})
    assert max(len(fault.detail) for fault in caught.value.faults) < 300
