"""What a covariance means on the detector: radial difference, error of an arc, and difference of two estimates.

Radial difference
-----------------
The off-axis angle theta(r) follows from f, b2 and b4 together (E Figure 5). Between states x_0 and x at radius r from the
principal point, with t = tan theta,

    difference in pixels    (r / t(x_0)) (t(x) - t(x_0))
    difference in angle     atan t(x) - atan t(x_0)

and to first order their variance is g^T P g with g the gradient of t(x), since x_0 is given. The covariance's correlations
carry most of the information: f alone is poorly known, the curve is not.

Error of an arc
---------------
Between detector places i and j the arc phi has, through the parameters alone, the error dphi = g.dx and so the variance g^T P g,

    g = -(s_j . ds_i/dx + s_i . ds_j/dx) / sin phi,                                                  (E Eq 38)

which no bulk rotation enters: exactly what arcs can know. From a place, arcs of one length go out in eight azimuths; those that
end on the detector count, and the root mean square of their sigmas is the place's.

Difference of two estimates
---------------------------
Places on the detector have directions s_a and s_b under the two. Arcs do not see a common rotation, so the one that brings s_b
nearest to s_a is taken out first (Markley's solution of Wahba's problem, all places alike); the angle left is the difference.
For its expected size the rotation is taken out of the Jacobian too: J' = J - K (K^T K)^-1 K^T J over all places, K w = w x s, and
a place's mean square angle is tr(J' P J'^T) with P the covariance of x_a - x_b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.cameras import CameraModel
from boresight.estimation.attitude import attitudes


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


def displacement_px(
    camera: CameraModel, x: FloatArray, x_0: FloatArray, radius_px: FloatArray, pitch: float
) -> FloatArray:
    """Return how far a state bends the radius away from a pinhole with the focal length of x_0, (n_radii,) in pixels.

    A pinhole has the tangent r p / f_0 at the radius r. What the state has beyond that is brought to pixels by the plate
    scale of x_0, r / t_0, so that the displacements of two states differ by exactly `radial_difference`.
    """
    radius = np.asarray(radius_px, dtype=np.float64)
    t, _ = camera.radial_tangent(x, radius, pitch)
    t_0, _ = camera.radial_tangent(x_0, radius, pitch)
    ideal = radius / camera.focal_px(x_0, pitch)
    return np.asarray(radius / np.where(t_0 == 0, np.inf, t_0) * (t - ideal))


#: Azimuths in which arcs leave a place.
AZIMUTHS = 8


def arc_sigma(
    camera: CameraModel,
    x: FloatArray,
    P: FloatArray,
    places: tuple[FloatArray, FloatArray],
    length_rad: float,
    detector: tuple[int, int, float],
) -> FloatArray:
    """Error of arcs of one length that the covariance of the parameters causes.

    Parameters
    ----------
    x, P
        (n_parameters,) and (n_parameters, n_parameters), SI; zero rows for fixed parameters.
    places
        Row and column (n_places,) where the arcs begin, pixels.
    length_rad
        Their length.
    detector
        Rows, columns and pixel pitch in metres.

    Returns
    -------
    (n_places,) root mean square over the arcs that end on the detector, rad; NaN where none does.
    """
    pitch = detector[2]
    near, far, on = _arcs_from(camera, x, places, length_rad, detector)
    s_i, ds_i = camera.directions_and_jacobian(x, near[0], near[1], pitch)
    s_j, ds_j = camera.directions_and_jacobian(x, far[0], far[1], pitch)
    g = -(np.einsum("nk,nkp->np", s_j, ds_i) + np.einsum("nk,nkp->np", s_i, ds_j)) / np.sin(length_rad)
    variance = np.where(on, np.einsum("np,pq,nq->n", g, P, g), 0.0).reshape(-1, AZIMUTHS).sum(axis=1)
    counts = on.reshape(-1, AZIMUTHS).sum(axis=1)
    return np.asarray(np.sqrt(np.where(counts > 0, variance / np.maximum(counts, 1), np.nan)))


def _arcs_from(
    camera: CameraModel,
    x: FloatArray,
    places: tuple[FloatArray, FloatArray],
    length_rad: float,
    detector: tuple[int, int, float],
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray], NDArray[np.bool_]]:
    """Ends of the arcs from each place, (n_places x AZIMUTHS,) rows and columns, and which end on the detector."""
    rows, columns, pitch = detector
    s = camera.directions(x, *places, pitch)
    along_rows = np.cross(np.array([0.0, 1.0, 0.0]), s)
    along_rows /= np.linalg.norm(along_rows, axis=-1, keepdims=True)
    across = np.cross(s, along_rows)
    azimuth = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    tangent = along_rows[:, None] * np.cos(azimuth)[:, None] + across[:, None] * np.sin(azimuth)[:, None]
    ends = (np.cos(length_rad) * s[:, None] + np.sin(length_rad) * tangent).reshape(-1, 3)
    row, col = camera.project(x, ends, pitch)
    with np.errstate(invalid="ignore"):
        on = (np.abs(row - (rows - 1) / 2) <= rows / 2) & (np.abs(col - (columns - 1) / 2) <= columns / 2)
    near = (np.repeat(places[0], AZIMUTHS), np.repeat(places[1], AZIMUTHS))
    return near, (np.where(on, row, near[0]), np.where(on, col, near[1])), on


def difference_over_detector(
    camera: CameraModel, x_a: FloatArray, x_b: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float
) -> FloatArray:
    """Angle between the directions of each place under two states, a common rotation taken out, (n_places,) rad."""
    s_a, s_b = camera.directions(x_a, *places, pitch), camera.directions(x_b, *places, pitch)
    n = len(s_a)
    C = attitudes(np.array([0, n]), s_a, s_b, np.ones(n)).C[0]
    return np.asarray(np.linalg.norm(s_a - s_b @ C.T, axis=-1))


def expected_difference(
    camera: CameraModel, x: FloatArray, P: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float
) -> FloatArray:
    """Root mean square of that angle when the states differ with covariance P (n_parameters, n_parameters), (n_places,) rad."""
    s, J = camera.directions_and_jacobian(x, *places, pitch)
    K = np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1)
    rotation = np.linalg.solve(np.einsum("nka,nkb->ab", K, K), np.einsum("nka,nkp->ap", K, J))
    left = J - K @ rotation
    return np.asarray(np.sqrt(np.einsum("nkp,pq,nkq->n", left, P, left)))
