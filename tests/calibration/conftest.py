"""Small simulated telemetry with its own directions, and a sensor for it."""

import numpy as np
import pytest

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from tests.estimation.fields import COLUMNS, GROUND, NOISE_PX, PITCH, ROWS, SCALE, TRUTH, rotation


@pytest.fixture
def sensor():
    return Sensor(
        name="ST16-T", rows=ROWS, columns=COLUMNS, pixel_pitch_m=PITCH, camera_model="inverted_wang", parity=1,
        centroid_sigma_px=NOISE_PX, initial=GROUND.copy(), typical_sigma=SCALE.copy(), free=INVERTED_WANG.parameter_names,
    )  # fmt: skip


@pytest.fixture
def telemetry_of():
    return telemetry


def telemetry(seed, frames=40, stars=12, truth=TRUTH, noise_px=NOISE_PX, exposures=2):
    rng = np.random.default_rng(seed)
    n = frames * exposures * stars
    row, col = rng.uniform(0, ROWS - 1, n), rng.uniform(0, COLUMNS - 1, n)
    s_d = INVERTED_WANG.directions(truth, row, col, PITCH).reshape(-1, stars, 3)
    s_i = np.concatenate([block @ rotation(rng) for block in s_d])
    return Telemetry(
        frame=np.repeat(np.arange(frames), exposures * stars),
        exposure=np.tile(np.repeat(np.arange(exposures), stars), frames),
        row_px=row + noise_px * rng.normal(size=n),
        col_px=col + noise_px * rng.normal(size=n),
        star_id=np.arange(1, n + 1),
        ra_rad=np.arctan2(s_i[:, 1], s_i[:, 0]),
        dec_rad=np.arcsin(s_i[:, 2]),
    )
