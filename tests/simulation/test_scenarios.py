"""A scenario file says what is simulated, a wrong one is refused by its key; the ST-16 agrees with the published tables."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.errors import NotFoundError, RefusedInputError
from boresight.simulation import scenes
from boresight.simulation.scenes import calibration_scenario, parse_scenario, scenario_document, validation_scenario
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth
from boresight.telemetry.sensors import sensor_document

made = st.builds(
    lambda make, number, frames, rate, seed: replace(make(number, frames), false_stars=rate, seed=seed),
    st.sampled_from([calibration_scenario, validation_scenario]),
    st.sampled_from(SENSOR_NUMBERS),
    st.integers(1, 1000),
    st.floats(0.0, 10.0),
    st.integers(0, 2**63 - 1),
)


def assert_same(first, second):
    for field in fields(first):
        ours, theirs = getattr(first, field.name), getattr(second, field.name)
        if field.name == "sensor":
            assert sensor_document(ours) == sensor_document(theirs)
        elif field.name == "orbit":
            assert ours.start_utc == theirs.start_utc
            for name in ("altitude_m", "inclination_rad", "node_hour"):
                assert getattr(ours, name) == pytest.approx(getattr(theirs, name))
        elif isinstance(ours, str):
            assert ours == theirs
        else:
            np.testing.assert_allclose(ours, theirs)


@given(made)
def test_a_document_reads_back_as_the_scenario_it_was_written_from(scenario):
    document = json.loads(json.dumps(scenario_document(scenario)))
    assert_same(parse_scenario(document), scenario)


def test_the_example_on_the_modules_page_is_the_first_calibration_set():
    page = scenes.__doc__
    example = parse_scenario(json.loads(page[page.index("{") : page.rindex("}") + 1]))
    assert_same(replace(example, truth=st16_truth(1), seed=100), calibration_scenario(1))
    np.testing.assert_allclose(example.truth[:2], st16_truth(1)[:2])


def test_a_sensor_document_is_its_own_truth_unless_one_is_given():
    document = sensor_document(st16_sensor(2)) | {"name": "mine", "centroid_sigma_px": 0.2}
    scenario = parse_scenario({"sensor": document})
    np.testing.assert_array_equal(scenario.truth, scenario.sensor.initial)
    assert scenario.centroid_sigma_px == 0.2
    changed = parse_scenario({"sensor": document, "truth": {"g_y": 1.001}})
    assert changed.truth[7] == 1.001


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"sensor": 7}, "sensor"),
        ({"sensor": True}, "sensor"),
        ({"sensor": "ST16-1"}, "sensor"),
        ({"colour": 1}, "colour"),
        ({"truth": {"k1": 0.1}}, "truth"),
        ({"truth": {"f_m": "long"}}, "f_m"),
        ({"truth": {"f_m": float("nan")}}, "f_m"),
        ({"orbit": {"altitude_km": 100}}, "altitude_km"),
        ({"orbit": {"period_s": 100}}, "orbit"),
        ({"motion": "tumbling"}, "motion"),
        ({"motion": ["nadir"]}, "motion"),
        ({"pointing_deg": 1e4}, "pointing_deg"),
        ({"start_utc": "tomorrow"}, "start_utc"),
        ({"start_utc": "NaT"}, "start_utc"),
        ({"start_utc": "1850-01-01T00:00:00Z"}, "start_utc"),
        ({"frames": 0}, "frames"),
        ({"frames": 2.5}, "frames"),
        ({"frames": True}, "frames"),
        ({"exposures": 11}, "exposures"),
        ({"magnitude_limit": float("inf")}, "magnitude_limit"),
        ({"centroid_sigma_px": 0}, "centroid_sigma_px"),
        ({"blanked_share": 1.5}, "blanked_share"),
        ({"false_stars": -1}, "false_stars"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_wrong_value_is_refused_by_the_name_of_its_key(change, named):
    with pytest.raises(RefusedInputError, match=named):
        parse_scenario({"sensor": 1} | change)


@pytest.mark.parametrize("document", [[], "nadir", None, {}])
def test_a_document_without_a_sensor_is_refused(document):
    with pytest.raises(RefusedInputError, match="sensor"):
        parse_scenario(document)


def test_the_ground_calibration_and_the_truths_are_those_of_the_published_tables():
    sensor = st16_sensor(1)
    assert (sensor.rows, sensor.columns) == (1944, 2592)
    assert CAMERA_MODELS[sensor.camera_model].principal_point(sensor.initial) == (972.0, 1296.0)
    sigma_rad = np.sqrt(2.0) * sensor.centroid_sigma_px * sensor.pixel_pitch_m / sensor.initial[0]
    assert sigma_rad == pytest.approx(84.5e-6, abs=0.1e-6)
    f_m, _, _, b4_per_m4, b2_per_m2, *_ = st16_truth(2)
    assert f_m == pytest.approx(16.031e-3, abs=0.5e-6)
    assert b2_per_m2 == pytest.approx(-2.152e3, abs=0.02e3)
    assert b4_per_m4 == pytest.approx(1.370e8, abs=0.05e8)
    assert st16_truth(6)[2] - st16_sensor(6).initial[2] == pytest.approx(-9.81 * 30.0)


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_each_sensor_has_its_own_name_all_eight_parameters_free_and_a_set_by_its_number_alone(number):
    st16_sensor(number).initial[0] = st16_truth(number)[0] = 0.0  # changing one does not change the next
    sensor = st16_sensor(number)
    assert (sensor.name, sensor.initial[0]) == (f"ST16-{number}", pytest.approx(16.095e-3))
    assert sensor.free == CAMERA_MODELS[sensor.camera_model].parameter_names
    assert_same(parse_scenario({"sensor": number}), calibration_scenario(number))


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_every_truth_is_plausible_and_maps_the_whole_detector(number):
    sensor, truth = st16_sensor(number), st16_truth(number)
    model = CAMERA_MODELS[sensor.camera_model]
    low, high = np.transpose(model.plausible)
    assert np.all((truth >= low) & (truth <= high))
    row_px, col_px = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1943, 25), np.linspace(0, 2591, 25)))
    s_d = model.directions(truth, row_px, col_px, sensor.pixel_pitch_m)
    again = model.project(truth, s_d, sensor.pixel_pitch_m)
    np.testing.assert_allclose(again, (row_px, col_px), atol=1e-6)


@pytest.mark.parametrize("number", [0, 7, -1])
def test_a_sensor_that_table_iii_does_not_have_is_refused_with_the_choice(number):
    with pytest.raises(NotFoundError, match="choose 1 to 6"):
        st16_sensor(number)
    with pytest.raises(NotFoundError, match="choose 1 to 6"):
        st16_truth(number)
