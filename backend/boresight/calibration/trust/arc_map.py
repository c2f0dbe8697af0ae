"""How well an arc is known about the detector, from the parameters' covariance alone.

`estimation.uncertainty.arc_sigma` derives it. The length is 5 degrees, or a quarter of the shorter side where the field is narrower
than 10: long enough that focal length and distortion show, short enough that most places have arcs on all sides. Centroid noise is
not in it: this is what the calibration itself adds to every arc that the sensor will measure at that place.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.trust.ground import ARCSEC, Ground, Unavailable, grid, nested
from boresight.estimation.arcs import arclength
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.estimation.uncertainty import arc_sigma
from boresight.telemetry.sensors import Sensor

ARC_DEG = 5.0
ROWS, COLUMNS = 13, 17


def arc_length_rad(sensor: Sensor, x: FloatArray) -> float:
    """Length of the map's arcs on a sensor with parameters x (n_parameters,)."""
    middle_row, middle_col = (sensor.rows - 1) / 2, (sensor.columns - 1) / 2
    row = np.array([0.0, sensor.rows - 1.0, middle_row, middle_row])
    col = np.array([middle_col, middle_col, 0.0, sensor.columns - 1.0])
    s = CAMERA_MODELS[sensor.camera_model].directions(x, row, col, sensor.pixel_pitch_m)
    shorter = float(arclength(s[[0, 2]], s[[1, 3]]).min())
    return float(np.radians(ARC_DEG) if shorter >= 2 * np.radians(ARC_DEG) else shorter / 4)


def field_arc_sigma(sensor: Sensor, x: FloatArray, P: FloatArray) -> tuple[FloatArray, float]:
    """Error of arcs over the detector.

    Parameters
    ----------
    x, P
        (n_parameters,) and (n_parameters, n_parameters), SI; zero rows for fixed parameters.

    Returns
    -------
    (ROWS, COLUMNS) sigma of arcs that begin at places spread over the detector, rad; and the arcs' length, rad.
    """
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    places = (np.repeat(row, COLUMNS), np.tile(col, ROWS))
    length = arc_length_rad(sensor, x)
    detector = (sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    sigma = arc_sigma(CAMERA_MODELS[sensor.camera_model], x, P, places, length, detector)
    return sigma.reshape(ROWS, COLUMNS), length


def arc_sigma_map(ground: Ground) -> dict[str, Any]:
    """The map, with the length of its arcs and a sentence."""
    if not ground.determined:
        raise Unavailable(
            "The data leave a direction of the parameters open, so arcs have no bounded error: hold it fixed."
        )
    sensor = ground.problem.sensor
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    sigma, length = field_arc_sigma(sensor, ground.estimate.x, ground.full_covariance(ground.estimate.P))
    if not np.isfinite(sigma).any():
        raise Unavailable("At these parameters no arc of the detector has a bounded error: look at sensor and matches.")
    sigma_arcsec = ARCSEC * sigma
    best, worst, degrees = np.nanmin(sigma_arcsec), np.nanmax(sigma_arcsec), np.degrees(length)
    return {
        "row_px": nested(row),
        "col_px": nested(col),
        "sigma_arcsec": nested(sigma_arcsec),
        "arc_deg": float(degrees),
        "sentence": (
            f"From the parameters alone an arc of {degrees:.2g}° is known to {best:.2g} arcsec at the best place of the "
            f"detector and to {worst:.2g} arcsec at the worst (1 sigma)."
        ),
    }
