"""Small files and sensors that the tests of telemetry share."""

import pytest

from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import parse_sensor


@pytest.fixture
def read(tmp_path):
    def read_content(content, name="pass.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_telemetry(path)

    return read_content


@pytest.fixture
def document():
    names = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
    return {
        "name": "STK-1",
        "detector": {"rows": 768, "columns": 1024, "pixel_pitch_m": 6.9e-6},
        "camera_model": "inverted_wang",
        "parity": -1,
        "centroid_sigma_px": 0.13,
        "initial": dict(zip(names, (0.035, 383.5, 511.5, 0, 0, 0, 0, 1.0), strict=True)),
        "typical_sigma": dict(zip(names, (3e-4, 10, 10, 1e6, 100.0, 0.005, 0.005, 2e-4), strict=True)),
    }


@pytest.fixture
def sensor(document):
    return parse_sensor(document)
