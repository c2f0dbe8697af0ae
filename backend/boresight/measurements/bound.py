"""The Cramér-Rao bound of a camera from star centroids: what no unbiased estimate of them can beat.

It knows nothing of arcs: it is the Fisher information of the centroids with each exposure's attitude as nuisance,

    I = sum over exposures of  J^T J - J^T K (K^T K)^-1 K^T J,     J = d(pixel)/dx / sigma,  K = d(pixel)/d(attitude) / sigma,

at the truth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import Sensor

FloatArray = NDArray[np.float64]

HALF_PX = 0.5


def cramer_rao(arcs: ArcSet, sensor: Sensor, truth: FloatArray) -> FloatArray:
    """Standard deviations (n_parameters,) that no unbiased estimate from these centroids can beat, SI."""
    camera = CAMERA_MODELS[sensor.camera_model]
    s, ds_dx = camera.directions_and_jacobian(truth, arcs.row_px, arcs.col_px, arcs.pitch)
    down, right = (
        camera.directions(truth, arcs.row_px + a, arcs.col_px + b, arcs.pitch)
        - camera.directions(truth, arcs.row_px - a, arcs.col_px - b, arcs.pitch)
        for a, b in ((HALF_PX, 0), (0, HALF_PX))
    )
    to_pixels = np.linalg.pinv(np.stack([down, right], axis=-1)) / arcs.sigma_px[:, None, None]
    J = -to_pixels @ ds_dx
    K = to_pixels @ np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1)
    information = np.zeros((J.shape[-1], J.shape[-1]))
    for first, last in zip(arcs.star_start[:-1], arcs.star_start[1:], strict=True):
        j, k = J[first:last].reshape(-1, J.shape[-1]), K[first:last].reshape(-1, 3)
        mixed = k.T @ j
        information += j.T @ j - mixed.T @ np.linalg.solve(k.T @ k, mixed)
    scale = sensor.typical_sigma
    return np.asarray(scale * np.sqrt(np.diag(np.linalg.inv(information * np.outer(scale, scale)))))
