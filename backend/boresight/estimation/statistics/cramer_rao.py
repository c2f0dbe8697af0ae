"""The Cramer-Rao bound: what the centroids hold, whatever the estimator makes of them.

It knows nothing of arcs. A centroid p of a star with catalogue direction s_i is modelled as p(x, C) = projection of C s_i, with
the attitude C of each exposure a nuisance. Directions come from pixels without iteration, so with D = ds/dp (3, 2), and D^+ its
left inverse on the tangent plane, the residual r = centroid - p has

    dr/dx = D^+ ds/dx                   dr/dw = -D^+ (w x s_d)         w a small rotation about the axes of D

Divided by the centroid's sigma and the typical sigmas these are J (2, n_free) and K (2, 3) a star. Attitude is eliminated
exposure by exposure (Schur complement),

    J' = J - K N sum K^T J,   N = (sum K^T K)^-1,          information = sum over all stars of J'^T J',

and no unbiased estimator has a covariance smaller than its inverse (Kay, "Fundamentals of Statistical Signal Processing", 1993,
3). The same rows give the leverage of a star: of its own error the share M = I - K N K^T - J' P J'^T is left in its residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.estimation.arcs import ArcSet

#: Half the step of the central difference over a pixel; its error is its square times curvature, 1e-8 of D.
HALF_STEP_PX = 0.5


@dataclass(frozen=True)
class CentroidRows:
    """Linearised centroids of a set, whitened by sigma_px.

    Parameters
    ----------
    s_d
        (n_stars, 3) measured directions in D.
    inverse
        (n_stars, 2, 3) D^+, pixels a radian.
    J
        (n_stars, 2, n_free) J', attitude eliminated, in typical sigmas.
    K
        (n_stars, 2, 3) derivative by the attitude.
    N
        (n_exposures, 3, 3) attitude covariance at known parameters, rad^2.
    """

    s_d: FloatArray
    inverse: FloatArray
    J: FloatArray
    K: FloatArray
    N: FloatArray

    @property
    def information(self) -> FloatArray:
        """Fisher information of the free parameters (n_free, n_free) in typical sigmas."""
        flat = self.J.reshape(-1, self.J.shape[-1])
        return np.asarray(flat.T @ flat)


def centroid_rows(
    camera: CameraModel,
    x: FloatArray,
    arcs: ArcSet,
    free: IntArray,
    scale: FloatArray,
    kept: NDArray[np.bool_] | None = None,
) -> CentroidRows:
    """Linearise the centroids at a state.

    Parameters
    ----------
    x
        (n_parameters,) SI.
    free, scale
        (n_free,) places and typical sigmas of the free parameters.
    kept
        (n_stars,) stars that the attitudes rest on; all when None. Each exposure must keep two.
    """
    s, ds_dx = camera.directions_and_jacobian(x, arcs.row_px, arcs.col_px, arcs.pitch)
    inverse = _left_inverse(_pixel_steps(camera, x, arcs))
    weight = 1 / arcs.sigma_px[:, None, None]
    J = weight * (inverse @ (ds_dx[:, :, free] * scale))
    K = weight * -(inverse @ np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1))
    share = np.ones(len(s)) if kept is None else kept.astype(float)
    held = K * share[:, None, None]
    N = np.asarray(np.linalg.inv(sums(held.transpose(0, 2, 1) @ K, arcs.star_start)), dtype=np.float64)
    turn = N @ sums(held.transpose(0, 2, 1) @ J, arcs.star_start)
    return CentroidRows(s, inverse, J - K @ each(turn, arcs.star_start), K, N)


def sums(values: FloatArray, start: IntArray) -> FloatArray:
    """Sums of (n_stars, ...) over runs that all hold something, (n_runs, ...)."""
    return np.asarray(np.add.reduceat(values, start[:-1], axis=0))


def each(values: FloatArray, start: IntArray) -> FloatArray:
    """Values of runs (n_runs, ...) given to each of their members, (n_stars, ...)."""
    return np.repeat(values, np.diff(start), axis=0)


def _pixel_steps(camera: CameraModel, x: FloatArray, arcs: ArcSet) -> FloatArray:
    """D = ds/dp of each star, (n_stars, 3, 2), by central difference over one pixel."""
    steps = [
        camera.directions(x, arcs.row_px + a, arcs.col_px + b, arcs.pitch)
        - camera.directions(x, arcs.row_px - a, arcs.col_px - b, arcs.pitch)
        for a, b in ((HALF_STEP_PX, 0.0), (0.0, HALF_STEP_PX))
    ]
    return np.stack(steps, axis=-1)


def _left_inverse(D: FloatArray) -> FloatArray:
    """(D^T D)^-1 D^T of (n, 3, 2), written out for two columns."""
    a, b, c = (np.sum(D[..., i] * D[..., j], axis=-1) for i, j in ((0, 0), (0, 1), (1, 1)))
    first = c[:, None] * D[..., 0] - b[:, None] * D[..., 1]
    second = a[:, None] * D[..., 1] - b[:, None] * D[..., 0]
    return np.asarray(np.stack([first, second], axis=1) / (a * c - b * b)[:, None, None])
