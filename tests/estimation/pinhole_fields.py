"""Star fields seen through the pinhole camera with radial distortion: the sensor of Wu et al. 2019 (W section 4.1)."""

from dataclasses import replace

import numpy as np

from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from tests.estimation.fields import arranged, rotation

WU_PITCH = 2.9e-6
WU_ROWS, WU_COLUMNS = 1080, 1920
#: W Table 1, in SI.
WU_TRUTH = np.array([1.0, 0.016, 970.0, 550.0, -0.5, 0.5])
PINHOLE_SCALE = np.array([1e-3, 3e-5, 10.0, 10.0, 0.02, 0.1])
#: The same lens in front of the detector of `fields`.
PINHOLE_GROUND = np.array([1.0, 0.016095, 1296.0, 972.0, -0.5, 0.5])
PINHOLE = PINHOLE_RADIAL


def wu_field(rng, frames=100, mean_stars=19.0, noise_px=0.2):
    starts, rows, cols, directions = [0], [], [], []
    for _ in range(frames):
        n = max(4, rng.poisson(mean_stars))
        row, col = rng.uniform(0, WU_ROWS - 1, n), rng.uniform(0, WU_COLUMNS - 1, n)
        directions.append(PINHOLE.directions(WU_TRUTH, row, col, WU_PITCH) @ rotation(rng))
        rows.append(row + noise_px * rng.normal(size=n))
        cols.append(col + noise_px * rng.normal(size=n))
        starts.append(starts[-1] + n)
    field = arranged(
        starts, np.arange(frames + 1), np.concatenate(rows), np.concatenate(cols), np.concatenate(directions), noise_px
    )
    return replace(field, model=PINHOLE.kernel, pitch=WU_PITCH)
