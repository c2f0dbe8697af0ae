"""What a covariance means on the detector: the radial difference between two calibrations, with its band.

The off-axis angle theta(r) follows from f, b2 and b4 together (E Figure 5). Between states x_0 and x at radius r from the
principal point, with t = tan theta,

    difference in pixels    (r / t(x_0)) (t(x) - t(x_0))
    difference in angle     atan t(x) - atan t(x_0)

and to first order their variance is g^T P g with g the gradient of t(x), since x_0 is given. The covariance's correlations
carry most of the information: f alone is poorly known, the curve is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.estimation.cameras import CameraModel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RadialDifference:
    """Displacement along the radius between two states, with one-sigma; all (n_radii,)."""

    radius_px: FloatArray
    difference_px: FloatArray
    sigma_px: FloatArray
    difference_rad: FloatArray
    sigma_rad: FloatArray


def radial_difference(
    camera: CameraModel, x: FloatArray, x_0: FloatArray, P: FloatArray, radius_px: FloatArray, pitch: float
) -> RadialDifference:
    """Compare two states along the radius.

    Parameters
    ----------
    x, x_0
        (n_parameters,) the estimate and the reference, SI.
    P
        (n_parameters, n_parameters) covariance of x, zero rows for fixed parameters, SI.
    radius_px
        (n_radii,) distances from the principal point, pixels.
    pitch
        Pixel pitch, metres.
    """
    t, gradient = camera.radial_tangent(x, radius_px, pitch)
    t_0, _ = camera.radial_tangent(x_0, radius_px, pitch)
    sigma_t = np.sqrt(np.maximum(np.einsum("np,pq,nq->n", gradient, P, gradient), 0.0))
    per_tangent = np.asarray(radius_px) / np.where(t_0 == 0, np.inf, t_0)
    return RadialDifference(
        radius_px=np.asarray(radius_px),
        difference_px=per_tangent * (t - t_0),
        sigma_px=per_tangent * sigma_t,
        difference_rad=np.arctan(t) - np.arctan(t_0),
        sigma_rad=sigma_t / (1 + t * t),
    )
