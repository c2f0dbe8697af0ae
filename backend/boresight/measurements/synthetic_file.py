"""A telemetry file of any length, written in constant memory: two exposures of twelve stars a frame, each with its direction.

Stars fall uniformly on an ST-16 with the parameters of E Table III's first sensor, 0.437 px of noise, every exposure at an attitude
of its own. Chunk k is drawn from the seed (seed, k), so that a longer file begins with the rows of a shorter one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from scipy.spatial.transform import Rotation

from boresight.estimation.cameras import CAMERA_MODELS
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.writers import ROW_GROUP

STARS, EXPOSURES = 12, 2
#: Frames drawn at a time.
CHUNK = 4096


def write_synthetic(path: Path, frames: int, seed: int = 1) -> None:
    """Write a Parquet file of so many frames."""
    with arrow_parquet.ParquetWriter(path, _rows(0, 0, seed).schema, compression="snappy") as writer:
        for first in range(0, frames, CHUNK):
            writer.write_table(_rows(first, min(CHUNK, frames - first), seed), row_group_size=ROW_GROUP)


def _rows(first: int, frames: int, seed: int) -> pa.Table:
    """Draw the rows of so many frames from number `first` on."""
    rng = np.random.default_rng([seed, first // CHUNK])
    sensor, exposures = st16_sensor(1), frames * EXPOSURES
    n = exposures * STARS
    row, col = rng.uniform(0, sensor.rows - 1, n), rng.uniform(0, sensor.columns - 1, n)
    s_d = CAMERA_MODELS[sensor.camera_model].directions(st16_truth(1), row, col, sensor.pixel_pitch_m)
    turns = Rotation.random(exposures, rng=rng).as_matrix() if exposures else np.empty((0, 3, 3))
    s_i = (s_d.reshape(exposures, STARS, 3) @ turns).reshape(n, 3)
    noise = sensor.centroid_sigma_px * rng.normal(size=(2, n))
    return pa.table(
        {
            "frame": np.repeat(np.arange(first, first + frames), EXPOSURES * STARS),
            "exposure": np.tile(np.repeat(np.arange(EXPOSURES), STARS), frames),
            "row_px": row + noise[0],
            "col_px": col + noise[1],
            "ra_deg": np.degrees(np.arctan2(s_i[:, 1], s_i[:, 0])) % 360,
            "dec_deg": np.degrees(np.arcsin(np.clip(s_i[:, 2], -1, 1))),
        }
    )
