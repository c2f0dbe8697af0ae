"""A camera file is OpenCV's camera to the last digit, or it is not there and says why."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.uplink.camera_files import camera_files
from tests.effort import effort
from tests.uplink.tables import INITIAL, sensor_of


def _matrix(text, name):
    body = text.split(f"{name}:", 1)[1]
    return np.array([float(number) for number in re.search(r"data: \[(.*?)\]", body)[1].split(",")])


def _opencv_projection(K, distortion, x, y, z):
    k1, k2, p1, p2, k3 = distortion
    a, b = x / z, y / z
    r2 = a**2 + b**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    c = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a**2)
    d = b * radial + p1 * (r2 + 2 * b**2) + 2 * p2 * a * b
    return K[0] * c + K[2], K[4] * d + K[5]


@settings(max_examples=effort(16, 80), deadline=None)
@given(
    st.floats(0.9, 1.1),
    st.floats(0.02, 0.2),
    st.floats(400, 600),
    st.floats(400, 600),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.sampled_from(["camera_opencv.yaml", "camera_info.yaml"]),
)
def test_opencv_s_own_formula_finds_the_same_pixels(s, f, u0, v0, k1, k2, name):
    parameters = dict(zip(INITIAL["pinhole_radial"], (s, f, u0, v0, k1, k2), strict=True))
    sensor = sensor_of()
    text = camera_files(sensor, parameters, "PS-FM1-1")[name].decode()
    random = np.random.default_rng(1)
    tangents = random.uniform(-0.15, 0.15, (2, 500))
    s_d = np.stack([*tangents, np.ones(500)], axis=-1)  # rows, columns, boresight
    row, column = CAMERA_MODELS["pinhole_radial"].project(
        np.array(list(parameters.values())), s_d, sensor.pixel_pitch_m
    )
    theirs = _opencv_projection(
        _matrix(text, "camera_matrix"), _matrix(text, "distortion_coefficients"), s_d[:, 1], s_d[:, 0], s_d[:, 2]
    )
    np.testing.assert_allclose(theirs, (column, row), rtol=0, atol=1e-9)


def test_sizes_and_the_projection_without_distortion_are_written_as_ros_reads_them():
    text = camera_files(sensor_of(), INITIAL["pinhole_radial"], "PS-FM 1-1")["camera_info.yaml"].decode()
    K, P = _matrix(text, "camera_matrix").reshape(3, 3), _matrix(text, "projection_matrix").reshape(3, 4)
    assert "camera_name: PS_FM_1_1\n" in text
    assert "image_width: 1024\n" in text
    assert "distortion_model: plumb_bob\n" in text
    np.testing.assert_array_equal(P, np.column_stack([K, np.zeros(3)]))


def test_numbers_with_an_exponent_are_numbers_in_yaml_too():
    parameters = INITIAL["pinhole_radial"] | {"k1": 1e-07, "k2": 2.5e-9}
    text = camera_files(sensor_of(), parameters, "x")["camera_opencv.yaml"].decode()
    yaml_float = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9]*([eE][-+][0-9]+)?")
    assert "[1.0e-07, 2.5e-09, 0.0, 0.0, 0.0]" in text
    assert all(yaml_float.fullmatch(word) for line in re.findall(r"data: \[(.*?)\]", text) for word in line.split(", "))


@pytest.mark.parametrize(
    ("model", "parity", "reason"),
    [
        ("inverted_wang", -1, "distorts from the detector to the sky"),
        ("inverted_wang", 1, "an approximation is another camera"),
        ("pinhole_radial", 1, "would be left-handed"),
    ],
)
def test_a_camera_that_is_none_of_theirs_is_refused_with_the_reason(model, parity, reason):
    files = camera_files(sensor_of(model, parity), INITIAL[model], "PS-FM1-1")
    assert list(files) == ["camera_files.txt"]
    assert files["camera_files.txt"].startswith(b"Refused")
    assert reason in files["camera_files.txt"].decode()
