"""How far a calibrated camera puts a star from where it falls, in pixels over the detector, whatever its parameters are called.

Peers have camera models of their own, so their parameters cannot be set beside ours one by one. What a camera says of a pixel is a
direction, and an attitude is estimated with every exposure: so the directions d^ of a grid of pixels under the estimate are turned
by the one rotation that brings them nearest to the true ones d (Wahba, even weights), and what is left is projected by the truth,

    error = project(truth, C d^) - pixel.

That is what a star tracker with this calibration would have wrong, noise apart. Corners stand for themselves: they err most.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation.cameras.model import corners
from boresight.measurements.views import Views

#: Unit directions (n, 3) of pixels (n,), (n,).
Directions = Callable[[FloatArray, FloatArray], FloatArray]

GRID_ROWS, GRID_COLUMNS = 13, 17


def grid(views: Views) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of a grid over the detector, edges included, with the four corners last, (n + 4,) each, pixels."""
    sensor = views.sensor
    row, col = np.meshgrid(
        np.linspace(-0.5, sensor.rows - 0.5, GRID_ROWS),
        np.linspace(-0.5, sensor.columns - 0.5, GRID_COLUMNS),
        indexing="ij",
    )
    corner_row, corner_col = corners(sensor.rows, sensor.columns)
    return np.concatenate([row.ravel(), corner_row]), np.concatenate([col.ravel(), corner_col])


def detector_errors(directions: Directions, views: Views) -> tuple[float, float]:
    """Root mean square error over the detector and the worst corner's, pixels; infinite where the estimate sees nothing."""
    row, col = grid(views)
    found = directions(row, col)
    if not np.isfinite(found).all():
        return np.inf, np.inf
    pitch = views.sensor.pixel_pitch_m
    true = views.camera.directions(views.truth, row, col, pitch)
    again = views.camera.project(views.truth, found @ nearest_rotation(found, true).T, pitch)
    error = np.hypot(again[0] - row, again[1] - col)
    error = np.where(np.isfinite(error), error, np.inf)
    return float(np.sqrt(np.mean(error[:-4] ** 2))), float(error[-4:].max())


def nearest_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Rotation C (3, 3) that brings unit vectors a (n, 3) nearest to b (n, 3), by Wahba's problem with even weights."""
    U, _, Vt = np.linalg.svd(b.T @ a)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt)
