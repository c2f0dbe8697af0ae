"""Frames of real stars for timing the matching: two exposures of one sky, twelve stars each, half of them unnamed.

An attitude is drawn until the true camera shows `STARS` stars down to the ST-16's limit; the brightest of them are
detected, so undetected fainter ones stand between them as they do in flight. Centroids have the sensor's noise.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.simulation.sensors import ST16_MAGNITUDE_LIMIT
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue
from boresight.sky.guide_stars import guide_stars
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

STARS = 12
EXPOSURES_A_FRAME = 2
BLEND_RAD = 1e-3
TIME = np.datetime64("2026-10-01T00:00:00", "us")
SAMPLE_PERIOD_S = 40


def star_frames(
    frames: int, sensor: Sensor, truth: FloatArray, catalogue: Catalogue, rng: np.random.Generator
) -> Telemetry:
    """Return a set in which every star is named, with times and without attitudes.

    Parameters
    ----------
    truth
        (n_parameters,) the parameters the stars are imaged with, SI.
    """
    hip = guide_stars(catalogue, ST16_MAGNITUDE_LIMIT, BLEND_RAD).hip
    star = catalogue.index_of(hip)
    s_i = apparent_directions(catalogue, star, np.full(len(star), TIME), None)
    chosen = list[tuple[IntArray, FloatArray, FloatArray]]()
    while len(chosen) < frames:
        seen = _seen(sensor, truth, s_i, catalogue.magnitude[star], rng)
        if len(seen[0]) == STARS:
            chosen.append(seen)
    stars, row_px, col_px = (
        np.repeat(np.array(column), EXPOSURES_A_FRAME, axis=0) for column in zip(*chosen, strict=True)
    )
    return _telemetry(hip[stars].ravel(), np.stack([row_px, col_px]), sensor, rng)


def _seen(
    sensor: Sensor, truth: FloatArray, s_i: FloatArray, magnitude: FloatArray, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Brightest stars on the detector at one random attitude, at most `STARS`, and where they fall."""
    s_d = s_i @ Rotation.random(rng=rng).as_matrix().T
    ahead = np.flatnonzero(s_d[:, 2] > 0.9)
    row, col = CAMERA_MODELS[sensor.camera_model].project(truth, s_d[ahead], sensor.pixel_pitch_m)
    on = np.flatnonzero((row > 0) & (row < sensor.rows - 1) & (col > 0) & (col < sensor.columns - 1))
    brightest = on[np.argsort(magnitude[ahead[on]])[:STARS]]
    return ahead[brightest], row[brightest], col[brightest]


def _telemetry(star_id: IntArray, place_px: FloatArray, sensor: Sensor, rng: np.random.Generator) -> Telemetry:
    """Write a table of named stars; place_px (2, n_exposures, STARS)."""
    n_exposures = place_px.shape[1]
    row_px, col_px = (place_px + sensor.centroid_sigma_px * rng.normal(size=place_px.shape)).reshape(2, -1)
    frame = np.repeat(np.arange(n_exposures // EXPOSURES_A_FRAME), EXPOSURES_A_FRAME * STARS)
    return Telemetry(
        frame=frame,
        exposure=np.tile(np.repeat(np.arange(EXPOSURES_A_FRAME), STARS), n_exposures // EXPOSURES_A_FRAME),
        row_px=row_px,
        col_px=col_px,
        time_utc=TIME + frame * np.timedelta64(SAMPLE_PERIOD_S, "s"),
        star_id=star_id,
    )
