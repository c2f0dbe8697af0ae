"""What the number format on board does to the camera: the same star, seen with and without rounding.

At each place p of a grid over the detector, corners included, the camera has a direction s(x, p). The parameters x' that the
table holds give that place another direction, and that direction another place:

    angle = 2 asin(|s(x', p) - s(x, p)| / 2)        shift = |project(x', s(x, p)) - project(x, s(x, p))|

Both are taken whole, a common rotation included, because the star tracker on board knows no other camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from boresight.cameras import CameraModel
from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import Sensor

PLACES = 41
ARCSEC_PER_RAD = 3600 * 180 / math.pi


def quantisation_effect(
    camera_model: CameraModel, sensor: Sensor, parameters: Mapping[str, float], quantised: Mapping[str, float]
) -> dict[str, float]:
    """Return the greatest shift over the detector, `max_px` pixels and `max_arcsec` seconds of arc.

    `parameters`, `quantised`: Every parameter of the camera model before and after the table, SI.
    """
    row, col = np.meshgrid(
        np.linspace(-0.5, sensor.rows - 0.5, PLACES), np.linspace(-0.5, sensor.columns - 0.5, PLACES), indexing="ij"
    )
    names, pitch = camera_model.parameter_names, sensor.pixel_pitch_m
    exact, rounded = (np.array([values[name] for name in names], float) for values in (parameters, quantised))
    with np.errstate(all="ignore"):
        s = camera_model.directions(exact, row.ravel(), col.ravel(), pitch)
        seen = camera_model.directions(rounded, row.ravel(), col.ravel(), pitch)
        rows, cols = camera_model.project(exact, s, pitch)
        moved_rows, moved_cols = camera_model.project(rounded, s, pitch)
    angle = 2 * np.arcsin(np.minimum(np.linalg.norm(seen - s, axis=-1) / 2, 1.0))
    shift = np.hypot(moved_rows - rows, moved_cols - cols)
    if not (np.isfinite(angle).all() and np.isfinite(shift).all()):
        raise RefusedInputError(
            "The numbers that the table can hold make a camera without directions for a part of the detector: "
            "give its fields more digits."
        )
    return {"max_px": float(shift.max()), "max_arcsec": float(angle.max() * ARCSEC_PER_RAD)}
