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
from boresight.kernels.centroids import linearise

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
    n, n_free = arcs.n_stars, len(free)
    inverse, J, K = np.empty((n, 2, 3)), np.empty((n, 2, n_free)), np.empty((n, 2, 3))
    N = np.empty((arcs.n_exposures, 3, 3))
    kept = np.ones(n, np.bool_) if kept is None else kept
    linearise(
        arcs.star_start,
        s,
        ds_dx,
        *_half_a_pixel_on(camera, x, arcs),
        arcs.sigma_px,
        kept,
        free,
        scale,
        inverse,
        J,
        K,
        N,
    )
    if np.isinf(N).any():
        raise np.linalg.LinAlgError("Expected stars that determine every attitude, received an exposure without")
    return CentroidRows(s, inverse, J, K, N)


def _half_a_pixel_on(camera: CameraModel, x: FloatArray, arcs: ArcSet) -> list[FloatArray]:
    """Directions (n_stars, 3) on both sides of each star along the rows, and along the columns: D is their difference."""
    steps = ((HALF_STEP_PX, 0.0), (-HALF_STEP_PX, 0.0), (0.0, HALF_STEP_PX), (0.0, -HALF_STEP_PX))
    return [camera.directions(x, arcs.row_px + down, arcs.col_px + right, arcs.pitch) for down, right in steps]
