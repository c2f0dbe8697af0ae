"""Small simulated telemetry with its own directions, and a sensor for it."""

import numpy as np
import pytest

from boresight.cameras.inverted_wang import INVERTED_WANG
from tests.calibration.sets import in_memory, measured, st16
from tests.estimation.fields import COLUMNS, NOISE_PX, PITCH, ROWS, TRUTH, rotation


@pytest.fixture
def sensor():
    return st16()


@pytest.fixture
def calibrated(sensor, catalogue):
    return lambda whole, sensor=sensor, **choices: in_memory(whole, sensor, catalogue, **choices)


@pytest.fixture
def make_telemetry():
    return telemetry


def telemetry(seed, frames=40, stars=12, truth=TRUTH, noise_px=NOISE_PX, exposures=2):
    rng = np.random.default_rng(seed)
    n = frames * exposures * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s_d = INVERTED_WANG.directions(truth, row, col, PITCH).reshape(-1, stars, 3)
    s_i = np.concatenate([block @ rotation(rng) for block in s_d])
    return measured(rng, s_i, (row, col), noise_px, frames, exposures)
