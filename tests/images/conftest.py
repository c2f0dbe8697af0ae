"""Images of a small mirrored camera on a hard night, with their truth, and as files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.images import HARD, OPTICS, make_night
from boresight.simulation.images import simulate_images
from boresight.telemetry.sensors import parse_sensor, sensor_document
from tests.images.files import write_fits

SIZE = 480, 640


def small_night(frames):
    """A quarter of the benchmark's detector, so that a test takes tenths of a second."""
    night = make_night(frames)
    truth = night.truth.copy()
    truth[2:4] = 330.0, 232.0
    document = sensor_document(night.sensor)
    document["detector"] = {"rows": SIZE[0], "columns": SIZE[1], "pixel_pitch_m": 7.5e-6}
    document["initial"] |= {"u0_px": 320.0, "v0_px": 240.0}
    return replace(night, sensor=parse_sensor(document), truth=truth)


@pytest.fixture(scope="session")
def night():
    return small_night(6)


@pytest.fixture(scope="session")
def clean_images(night, catalogue):
    return list(simulate_images(night, OPTICS, np.random.default_rng(1), catalogue))


@pytest.fixture(scope="session")
def hard_images(night, catalogue):
    optics = replace(HARD, hot_share=1e-4, dead_share=5e-5, trails=1.0)
    return list(simulate_images(night, optics, np.random.default_rng(2), catalogue))


@pytest.fixture(scope="session")
def folder(night, hard_images, tmp_path_factory):
    place = tmp_path_factory.mktemp("night")
    (place / "camera.json").write_text(json.dumps(sensor_document(night.sensor)))
    for image in hard_images:
        write_fits(place / f"night-{image.frame:02d}.fits", image)
    return place
