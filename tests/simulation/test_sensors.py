"""The simulated ST-16 agrees with the published tables."""

import numpy as np
import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.errors import NotFoundError
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth


def test_the_principal_point_of_the_ground_calibration_is_half_the_detector_row_before_column():
    sensor = st16_sensor(1)
    assert (sensor.rows, sensor.columns) == (1944, 2592)
    assert CAMERA_MODELS[sensor.camera_model].principal_point(sensor.initial) == (972.0, 1296.0)


@pytest.mark.parametrize("number", SENSOR_NUMBERS)
def test_each_sensor_has_its_own_name_and_all_eight_parameters_free(number):
    sensor = st16_sensor(number)
    assert sensor.name == f"ST16-{number}"
    assert sensor.free == CAMERA_MODELS[sensor.camera_model].parameter_names


def test_the_truth_of_sensor_2_is_the_batch_result_of_table_vii_within_its_rounding():
    f_m, _, _, b4_per_m4, b2_per_m2, *_ = st16_truth(2)
    assert f_m == pytest.approx(16.031e-3, abs=0.5e-6)
    assert b2_per_m2 == pytest.approx(-2.152e3, abs=0.02e3)
    assert b4_per_m4 == pytest.approx(1.370e8, abs=0.05e8)


def test_the_truth_of_sensor_6_has_its_principal_point_294_pixels_off_in_columns():
    assert st16_truth(6)[2] - st16_sensor(6).initial[2] == pytest.approx(-9.81 * 30.0)


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


def test_centroid_noise_gives_the_arclength_rms_that_the_sensor_page_derives():
    sensor = st16_sensor(1)
    sigma_rad = np.sqrt(2.0) * sensor.centroid_sigma_px * sensor.pixel_pitch_m / sensor.initial[0]
    assert sigma_rad == pytest.approx(84.5e-6, abs=0.1e-6)


@pytest.mark.parametrize("number", [0, 7, -1])
def test_a_sensor_that_table_iii_does_not_have_is_refused_with_the_choice(number):
    with pytest.raises(NotFoundError, match="choose 1 to 6"):
        st16_sensor(number)
    with pytest.raises(NotFoundError, match="choose 1 to 6"):
        st16_truth(number)


def test_changing_a_returned_sensor_does_not_change_the_next_one():
    st16_sensor(1).initial[0] = 0.0
    st16_truth(1)[0] = 0.0
    assert st16_sensor(1).initial[0] == pytest.approx(16.095e-3)
