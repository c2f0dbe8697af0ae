"""Small files and sensors that the tests of telemetry share."""

import os
from pathlib import Path

import pytest

from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.sensors import parse_sensor


@pytest.fixture(scope="session")
def real_sky():
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "real-sky"
    folder = Path(os.environ.get("BORESIGHT_REAL_SKY", beside))
    if not folder.is_dir():
        pytest.skip("the real star fields are not here; BORESIGHT_REAL_SKY says where they are")
    return folder


@pytest.fixture
def read(tmp_path):
    def read_content(content, name="pass.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_telemetry(path)

    return read_content


@pytest.fixture
def document():
    return {
        "name": "STK-1",
        "detector": {"rows": 768, "columns": 1024, "pixel_pitch_m": 6.9e-6},
        "camera_model": "inverted_wang",
        "parity": -1,
        "centroid_sigma_px": 0.13,
        "initial": {
            "f_m": 0.035,
            "m0_px": 383.5,
            "n0_px": 511.5,
            "b4_per_m4": 0,
            "b2_per_m2": 0,
            "a1_rad": 0,
            "a2_rad": 0,
            "g_y": 1.0,
        },
        "typical_sigma": {
            "f_m": 3e-4,
            "m0_px": 10,
            "n0_px": 10,
            "b4_per_m4": 1e6,
            "b2_per_m2": 100.0,
            "a1_rad": 0.005,
            "a2_rad": 0.005,
            "g_y": 2e-4,
        },
    }


@pytest.fixture
def sensor(document):
    return parse_sensor(document)
