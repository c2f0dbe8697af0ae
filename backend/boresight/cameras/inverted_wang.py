"""The ST-16 camera: Wang's model inverted, so that a pixel gives its ray without iteration (E Eqs 1-7).

With m, n the centroid, Delta the pixel pitch::

    u = Delta (m - m_0)              v = g_y Delta (n - n_0)                    Eq 1
    U = u f / (a_1 v + a_2 u + f)    V = v f / (a_1 v + a_2 u + f)              Eqs 2, 3
    rho^2 = U^2 + V^2                B = 1 + b_2 rho^2 + b_4 rho^4              Eqs 4, 5
    r = (B U, B V, f)                s = r / |r|                                Eqs 6, 7

g_y is an aspect factor between the axes; the text's "skew" is an erratum.

Derivatives (E Eqs 39-77). s depends on the pixel through (U, V) alone, so with M = d(B U, B V)/d(U, V),

    M = B I + (2 b_2 + 4 b_4 rho^2) [U; V] [U V],

every column is dr = (M d(U, V) + [U; V] dB|explicit, df). Writing dB that way is the erratum to Eqs 43, 48 ...: the
printed 1/rho is 0/0 for a star on the principal point.

Inverse projection. s fixes t = r_xy f / s_z = B(rho) (U, V), so rho solves rho (1 + b_2 rho^2 + b_4 rho^4) = |t| by Newton's
method on the branch through zero; then U, V give u, v through the linear relation u (f - a_2 U) - a_1 U v = f U and its twin.

Symbols are the notation page's; x = [f m_0 n_0 b_4 b_2 a_1 a_2 g_y] in SI (m, px, px, m^-4, m^-2, rad, rad, 1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from boresight.arrays import FloatArray
from boresight.cameras.model import CameraModel

KERNEL = 0
NEWTON_STEPS = 30


def _rays(x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float) -> tuple[FloatArray, ...]:
    """Return (u, v, D, U, V, rho2, B) of each pixel, D the denominator of Eqs 2 and 3; dtype follows x."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u = pitch * (np.asarray(row_px) - m0)
    v = g_y * pitch * (np.asarray(col_px) - n0)
    D = a1 * v + a2 * u + f
    U, V = u * f / D, v * f / D
    rho2 = U * U + V * V
    return u, v, D, U, V, rho2, 1 + rho2 * (b2 + rho2 * b4)


def directions(x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float) -> FloatArray:
    """Star directions of detector positions.

    Parameters
    ----------
    x
        (8,) parameters, SI. May be complex, for derivative checks.
    row_px, col_px
        (n,) centroids, pixels.
    pitch
        Pixel pitch, metres.

    Returns
    -------
    (n, 3) unit vectors in D.
    """
    _, _, _, U, V, _, B = _rays(x, row_px, col_px, pitch)
    r = np.stack([B * U, B * V, np.broadcast_to(x[0], U.shape)], axis=-1)
    return np.asarray(r / np.sqrt(np.sum(r * r, axis=-1, keepdims=True)))


def directions_and_jacobian(
    x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float
) -> tuple[FloatArray, FloatArray]:
    """Star directions and their derivatives.

    Returns
    -------
    s
        (n, 3) unit vectors in D.
    ds_dx
        (n, 3, 8) per parameter in SI.
    """
    f, _, n0, b4, b2, a1, a2, g_y = x
    u, v, D, U, V, rho2, B = _rays(x, row_px, col_px, pitch)
    slope = 2 * b2 + 4 * b4 * rho2
    zero, fd2 = np.zeros_like(U), f / D**2
    dn = pitch * (np.asarray(col_px) - n0)
    dU_du, dU_dv = fd2 * (a1 * v + f), -fd2 * a1 * u
    dV_du, dV_dv = -fd2 * a2 * v, fd2 * (a2 * u + f)
    tilt = (a1 * v + a2 * u) / D**2
    dU = [u * tilt, -pitch * dU_du, -g_y * pitch * dU_dv, zero, zero, -fd2 * u * v, -fd2 * u * u, dn * dU_dv]
    dV = [v * tilt, -pitch * dV_du, -g_y * pitch * dV_dv, zero, zero, -fd2 * v * v, -fd2 * v * u, dn * dV_dv]
    dB_explicit = [zero, zero, zero, rho2**2, rho2, zero, zero, zero]
    dr = np.empty((*U.shape, 3, 8))
    for p in range(8):
        dB = slope * (U * dU[p] + V * dV[p]) + dB_explicit[p]
        dr[..., 0, p] = B * dU[p] + U * dB
        dr[..., 1, p] = B * dV[p] + V * dB
        dr[..., 2, p] = 1.0 if p == 0 else 0.0
    r = np.stack([B * U, B * V, np.full_like(U, f)], axis=-1)
    length = np.sqrt(np.sum(r * r, axis=-1, keepdims=True))
    s = r / length
    along = np.einsum("...i,...ip->...p", s, dr)
    return s, (dr - s[..., :, None] * along[..., None, :]) / length[..., None]


def _undistorted_radius(reach: FloatArray, b2: float, b4: float) -> FloatArray:
    """Solve rho (1 + b2 rho^2 + b4 rho^4) = reach on the branch through zero; NaN where that branch turns back first."""
    rho = reach.copy()
    for _ in range(NEWTON_STEPS):
        rho2 = rho * rho
        slope = 1 + rho2 * (3 * b2 + 5 * b4 * rho2)
        rho = rho - (rho * (1 + rho2 * (b2 + b4 * rho2)) - reach) / slope
    rho2 = rho * rho
    solved = np.abs(rho * (1 + rho2 * (b2 + b4 * rho2)) - reach) <= 1e-13 + 1e-11 * reach
    rising = (1 + rho2 * (3 * b2 + 5 * b4 * rho2) > 0) & (rho >= 0)
    return np.where(solved & rising, rho, np.nan)


def project(x: FloatArray, s: FloatArray, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Detector positions of directions.

    Parameters
    ----------
    x
        (8,) parameters, SI.
    s
        (n, 3) directions in D, any positive length.
    pitch
        Pixel pitch, metres.

    Returns
    -------
    row_px, col_px
        (n,) pixels; NaN for a direction behind the sensor or beyond the radius where the distortion turns back.
    """
    f, m0, n0, b4, b2, a1, a2, g_y = x
    s = np.asarray(s, dtype=float)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ahead = s[..., 2] > 0
        tx, ty = (np.where(ahead, f * s[..., axis] / s[..., 2], np.nan) for axis in (0, 1))
        reach = np.hypot(tx, ty)
        rho = _undistorted_radius(reach, b2, b4)
        shrink = np.where(reach > 0, rho / np.where(reach > 0, reach, 1.0), 1.0)
        U, V = tx * shrink, ty * shrink
        # u (f - a2 U) - a1 U v = f U and v (f - a1 V) - a2 V u = f V, solved for (u, v)
        determinant = (f - a2 * U) * (f - a1 * V) - a1 * a2 * U * V
        u = f * U * f / determinant
        v = f * V * f / determinant
    return u / pitch + m0, v / (g_y * pitch) + n0


def principal_point(x: FloatArray) -> tuple[float, float]:
    """Row and column of the principal point, pixels."""
    return float(x[1]), float(x[2])


def radial_tangent(x: FloatArray, radius_px: ArrayLike, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Tangent of the off-axis angle at a radius, with f, b4 and b2 acting together as in E Figure 5.

    Returns
    -------
    tangent
        (n,) tan theta = B rho / f at rho = pitch * radius, decentring and aspect left out.
    gradient
        (n, 8) its derivatives in SI.
    """
    f, b4, b2 = x[0], x[3], x[4]
    rho = pitch * np.asarray(radius_px, dtype=float)
    B = 1 + rho**2 * (b2 + b4 * rho**2)
    gradient = np.zeros((*rho.shape, 8))
    gradient[..., 0], gradient[..., 3], gradient[..., 4] = -B * rho / f**2, rho**5 / f, rho**3 / f
    return B * rho / f, gradient


INVERTED_WANG = CameraModel(
    name="inverted_wang",
    kernel=KERNEL,
    parameter_names=("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y"),
    symbols=("f", "m0", "n0", "b4", "b2", "a1", "a2", "g_y"),
    units=("m", "px", "px", "m⁻⁴", "m⁻²", "rad", "rad", "1"),
    directions=directions,
    directions_and_jacobian=directions_and_jacobian,
    project=project,
    principal_point=principal_point,
    radial_tangent=radial_tangent,
    default_typical_sigma=(8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4),
    plausible=(
        (1e-4, 100.0),
        (-1e5, 1e5),
        (-1e5, 1e5),
        (-1e15, 1e15),
        (-1e8, 1e8),
        (-1.0, 1.0),
        (-1.0, 1.0),
        (0.5, 2.0),
    ),
)
