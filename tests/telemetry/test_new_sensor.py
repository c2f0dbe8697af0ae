"""Sensors made of a few numbers: every camera's spread moves a corner star as said, every fault is told at once, data sheets."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.telemetry.data_sheets import ASKED, DATA_SHEETS, LensAndDetector
from boresight.telemetry.new_sensor import DISTORTED, describe_sensor, describe_typed
from boresight.telemetry.sensors import parse_sensor

PLAIN = LensAndDetector(rows=768, columns=1024, pixel_pitch_um=6.9, focal_length_mm=35.0)


def faults_of(make):
    with pytest.raises(RefusedInputError) as refusal:
        make()
    return [str(one) for one in refusal.value.faults]


def corner_shift(sensor, name):
    """How far one typical sigma of a parameter moves a star of the corner, pixels, by projecting it."""
    camera, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
    place = camera.parameter_names.index(name)
    corner = np.array([sensor.rows - 1.0]), np.array([sensor.columns - 1.0])
    s = camera.directions(sensor.initial, *corner, pitch)
    step = np.zeros(len(sensor.initial))
    step[place] = 1e-2 * sensor.typical_sigma[place]
    row, col = camera.project(sensor.initial + step, s, pitch)
    return 100 * math.hypot(float(row[0] - corner[0][0]), float(col[0] - corner[1][0]))


@pytest.mark.parametrize("camera", CAMERA_MODELS)
def test_a_radial_spread_moves_a_star_in_the_corner_by_what_it_says(camera):
    made = describe_sensor(LensAndDetector(**{**vars(PLAIN), "camera_model": camera}))
    model = CAMERA_MODELS[camera]
    wanted = DISTORTED * math.hypot(768, 1024) / 2
    for name, one in zip(model.parameter_names, model.parameters, strict=True):
        if one.role is Role.RADIAL:
            assert corner_shift(made.sensor, name) == pytest.approx(wanted, rel=0.02)
    assert len(made.sensor.free) == 4
    assert {f"typical_sigma.{name}" for name in model.parameter_names} <= set(made.reasons)
    again = parse_sensor(json.loads(json.dumps(made.document)))
    np.testing.assert_array_equal(again.initial, made.sensor.initial)


@pytest.mark.parametrize("camera", [one for one in CAMERA_MODELS.values() if one.usual], ids=lambda one: one.name)
def test_a_field_from_where_a_camera_says_that_it_is_usual_gets_it(camera):
    for past_deg, taken in ((0.5, True), (-0.5, False)):
        half_field = camera.usual.from_deg + past_deg
        if half_field > 0:
            focal_mm = 6.9e-3 * math.hypot(768, 1024) / 2 / math.tan(math.radians(half_field))
            made = describe_sensor(LensAndDetector(**{**vars(PLAIN), "focal_length_mm": focal_mm}))
            assert (made.sensor.camera_model == camera.name) == taken
            assert (camera.usual.reason in made.reasons["camera_model"]) == taken


@given(st.floats(3.0, 60.0), st.integers(64, 4096), st.integers(64, 4096))
def test_a_field_of_view_and_its_focal_length_make_the_same_sensor(view, rows, columns):
    by_view = describe_sensor(LensAndDetector(rows=rows, columns=columns, pixel_pitch_um=3.45, field_of_view_deg=view))
    focal_mm = 1e3 * by_view.sensor.initial[CAMERA_MODELS[by_view.sensor.camera_model].place(Role.FOCAL)]
    by_focal = describe_sensor(
        LensAndDetector(rows=rows, columns=columns, pixel_pitch_um=3.45, focal_length_mm=focal_mm)
    )
    np.testing.assert_allclose(by_view.sensor.initial, by_focal.sensor.initial, rtol=1e-12)
    assert math.degrees(2 * math.atan(max(rows, columns) * 3.45e-3 / 2 / focal_mm)) == pytest.approx(view)


def test_every_fault_is_told_at_once_with_what_was_probably_meant():
    told = faults_of(
        lambda: describe_sensor(LensAndDetector(rows=7, pixel_pitch_um=5000, camera_model="brown-conradi", parity=3))
    )
    assert len(told) == 6
    assert any("brown_conrady" in one for one in told)
    (unknown,) = faults_of(lambda: describe_sensor(LensAndDetector(sheet="Rasberry Pi HQ")))
    assert "Raspberry Pi HQ Camera" in unknown
    (both,) = faults_of(lambda: describe_sensor(LensAndDetector(**{**vars(PLAIN), "field_of_view_deg": 30.0})))
    assert "12" in both or "13" in both  # the focal length that 30 degrees would be
    assert len(faults_of(lambda: describe_typed({"rows": "many", "columns": "8.5", "latitude_deg": "100"}))) == 6


@pytest.mark.parametrize("text", ["nan", "inf", "1e400"])
def test_a_number_that_is_not_finite_is_no_size(text):
    typed = {"rows": text, "columns": "1024", "pixel_pitch_um": "6.9", "focal_length_mm": "35"}
    assert len(faults_of(lambda: describe_typed(typed))) == 1


@pytest.mark.parametrize("name", DATA_SHEETS)
def test_every_data_sheet_has_its_source_and_makes_a_sensor(name):
    sheet = DATA_SHEETS[name]
    assert len(sheet.source) > 10
    lens = {} if sheet.focal_length_mm else {"focal_length_mm": 25.0}
    made = describe_sensor(LensAndDetector(sheet=name.upper(), **lens))
    assert (made.sensor.rows, made.sensor.columns) == (sheet.rows, sheet.columns)
    assert sheet.source in made.reasons["detector"]


def test_what_is_typed_takes_the_place_of_the_data_sheet_and_a_comma_is_a_point():
    made = describe_typed(
        {"sheet": "st-16", "field_of_view_deg": "10,5", "parity": "1", "latitude_deg": "52,2", "longitude_deg": "4"}
    )
    assert made.sensor.parity == 1
    assert made.sensor.site.latitude_deg == 52.2
    assert made.sensor.initial[1] > 0.03
    assert ASKED["rows"].whole
