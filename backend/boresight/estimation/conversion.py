"""Parameters of one camera model written in another, where the two can say the same.

`inverted_wang` gives the tangent of a ray as a polynomial of the place on the detector, `pinhole_radial` the place as a polynomial
of the tangent. With R = rho / f (the focal lengths below) the one is the inverse series of the other::

    r = R (1 + b_2 f^2 R^2 + b_4 f^4 R^4)          R = r (1 + k_1 r^2 + k_2 r^4)
    k_1 = -b_2 f^2      k_2 = 3 k_1^2 - b_4 f^4    up to a term in R^7

and neither series ends where the other does. Exact is only the lens without distortion, and without the decentring a_1, a_2, which
`pinhole_radial` has not: both then scale rows by 1 / f and columns by g_y / f, so

    s = 1 / g_y     f_pinhole = f / g_y     u_0 = n_0     v_0 = m_0.

So the start is that of the series, and where it is not exact the target is fitted to the source's directions over a grid of the
detector by Gauss and Newton. What is left is the misfit, which comes with the answer; how much of it may be is for
`calibration.conversion` to say. Directions in D are kept as they are: a rotation, which arcs cannot see, would be a change of C_SD.

The covariance follows by the derivative of the fit, with J the derivatives of all directions: dx' = (J'^T J')^-1 J'^T J dx. What
the target cannot express, (J - J' dx'/dx) dx, is lost; its largest size over the detector comes with the answer. A value or a
sigma that moves no star by a millionth of a pixel is rounding, and is given as nought, such as the decentring of a straight lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import CameraModel

#: What counts as rounding, pixels.
EXACT_PX = 1e-6
GRID = 21
ITERATIONS = 12

#: Why the two models do not always say the same.
REASON = (
    "the one model's radial polynomial runs from the detector to the sky, the other's from the sky to the detector, and only "
    "inverted_wang has decentring"
)


@dataclass(frozen=True)
class Conversion:
    """Parameters in the target model.

    Parameters
    ----------
    x
        (n_parameters,) SI, in the target's order.
    P
        (n_parameters, n_parameters) their covariance, or None where none was given.
    misfit_px, rms_px
        Largest, and root mean square, distance over the detector between where the two models see a star; infinite where the
        target sees none.
    misfit_rad, rms_rad
        The same as angles between the two directions of a pixel.
    lost_sigma_px
        Largest one-sigma over the detector of that part of the given covariance which the target cannot express; 0 without one.
    """

    x: FloatArray
    P: FloatArray | None
    misfit_px: float
    rms_px: float
    misfit_rad: float
    rms_rad: float
    lost_sigma_px: float


def convert(
    x: FloatArray, source: str, target: str, detector: tuple[int, int, float], *, P: FloatArray | None = None
) -> Conversion:
    """Write parameters of one camera model in another, as closely as that can say them.

    Parameters
    ----------
    x
        (n_parameters,) of the source, SI.
    source, target
        Names in `CAMERA_MODELS`.
    detector
        Rows, columns, and pixel pitch in metres.
    P
        (n_parameters, n_parameters) covariance of x.
    """
    if source == target:
        return Conversion(x.copy(), None if P is None else P.copy(), 0.0, 0.0, 0.0, 0.0, 0.0)
    seen, meant = CAMERA_MODELS[source], CAMERA_MODELS[target]
    places, pitch = _grid(detector), detector[2]
    s, J = seen.directions_and_jacobian(x, *places, pitch)
    pixel = np.sqrt(seen.solid_angle(x, *places, pitch))
    y = _SERIES[source, target](x)
    if not np.max(_angles(meant, y, places, pitch, s) / pixel) <= EXACT_PX:
        y = _fit(meant, y, places, pitch, s)
    J_target = meant.directions_and_jacobian(y, *places, pitch)[1]
    reach_px = np.max(np.linalg.norm(J_target, axis=1) / pixel[:, None], axis=0)
    y = np.where(np.abs(y) * reach_px < EXACT_PX, 0.0, y)
    away = _angles(meant, y, places, pitch, s)
    carried, lost = None, 0.0
    if P is not None and np.isfinite(away).all():
        carried, lost = _carried(J_target, J, P, pixel)
        known = np.sqrt(np.maximum(np.diag(carried), 0.0)) * reach_px >= EXACT_PX
        carried = carried * np.outer(known, known)
    return Conversion(y, carried, *_sizes(away / pixel), *_sizes(away), lost)


def _grid(detector: tuple[int, int, float]) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of an even grid over the detector, edges included, (GRID^2,) each."""
    rows, columns, _ = detector
    row, col = np.meshgrid(np.linspace(-0.5, rows - 0.5, GRID), np.linspace(-0.5, columns - 0.5, GRID), indexing="ij")
    return row.ravel(), col.ravel()


def _angles(
    camera: CameraModel, y: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float, s: FloatArray
) -> FloatArray:
    """Angle between the camera's directions and s, (n,) rad; infinite where it has none."""
    away = np.linalg.norm(camera.directions(y, *places, pitch) - s, axis=-1)
    return np.asarray(np.where(np.isfinite(away), away, np.inf))


def _sizes(away: FloatArray) -> tuple[float, float]:
    """Largest and root mean square of distances."""
    return float(away.max()), float(np.sqrt(np.mean(away**2)))


def _fit(
    camera: CameraModel, start: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float, s: FloatArray
) -> FloatArray:
    """Least squares of directions over the grid from a start; the best state on the way."""
    y, best, least = start, start, np.inf
    for _ in range(ITERATIONS):
        at, J = camera.directions_and_jacobian(y, *places, pitch)
        cost = float(np.sum((at - s) ** 2))
        if not cost < least:  # NaN, or no better: rounding, or a step too far
            break
        best, least = y, cost
        y = y - _solved(J, (at - s)[..., None])[:, 0]
    return best


def _solved(J: FloatArray, change: FloatArray) -> FloatArray:
    """Least-squares (n_parameters, k) of stacked changes of directions (n, 3, k), columns of J scaled first."""
    flat = J.reshape(-1, J.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    size = np.where(size > 0, size, 1.0)
    answer = np.linalg.lstsq(flat / size, change.reshape(len(flat), -1), rcond=1e-13)[0]
    return np.asarray(answer / size[:, None])


def _carried(J_target: FloatArray, J: FloatArray, P: FloatArray, pixel: FloatArray) -> tuple[FloatArray, float]:
    """Covariance in the target, and the largest sigma in pixels of what it cannot express."""
    D = _solved(J_target, J)
    rest = J - J_target @ D
    variance = np.einsum("nip,pq,niq->n", rest, P, rest)
    return D @ P @ D.T, float(np.sqrt(np.max(np.maximum(variance, 0.0) / pixel**2)))


def _pinhole_of_wang(x: FloatArray) -> FloatArray:
    """Start of `pinhole_radial` from [f m0 n0 b4 b2 a1 a2 g_y]; k2 by the inverse series."""
    f, m0, n0, b4, b2, _, _, g_y = x
    k1 = -b2 * f**2
    return np.array([1 / g_y, f / g_y, n0, m0, k1, 3 * k1**2 - b4 * f**4])


def _wang_of_pinhole(x: FloatArray) -> FloatArray:
    """Start of `inverted_wang` from [s f u0 v0 k1 k2]."""
    s, f_pinhole, u0, v0, k1, k2 = x
    f = f_pinhole / s
    return np.array([f, v0, u0, (3 * k1**2 - k2) / f**4, -k1 / f**2, 0.0, 0.0, 1 / s])


_SERIES: dict[tuple[str, str], Callable[[FloatArray], FloatArray]] = {
    ("inverted_wang", "pinhole_radial"): _pinhole_of_wang,
    ("pinhole_radial", "inverted_wang"): _wang_of_pinhole,
}
