"""The pinhole camera with radial distortion of Wu et al. 2019, whose rays need an iteration (W Eqs 1-8).

The model runs from the sky to the detector. W's camera frame has X along u, the columns, Y along v, the rows, and Z along the
boresight. With X, Y, Z a direction, D_u the width of a pixel and D_v = s D_u its height (W Eqs 1-4)::

    u - u_0 = f_u X / Z     f_u = f / D_u           v - v_0 = f_v Y / Z     f_v = f / (s D_u)
    r^2 = (u - u_0)^2 / f_u^2 + (v - v_0)^2 / f_v^2 = (X^2 + Y^2) / Z^2                          Eq 7
    u_d - u_0 = (u - u_0) B     v_d - v_0 = (v - v_0) B     B = 1 + k_1 r^2 + k_2 r^4            Eqs 5, 6

Erratum to Eq 6, which prints u and v for (u - u_0) and (v - v_0): the distortion is radial about the principal point. r is a
tangent, so k_1 and k_2 have no unit.

Frame. Our D has x along rows and y along columns, so s_d = (Y, X, Z) / |.|: the two axes of W's frame change places, which is a
reflection. W's frame is right-handed where rows run down an image that is seen upright, and then D is left-handed, `parity` -1;
the notation page's rule for attitudes holds for this model as for every other. u is `col_px`, v is `row_px`, D_u is the pitch
Delta, and the centre of the top-left pixel is (0, 0) here too.

Rays. A centroid gives what the distortion made of the tangents, and the ray that undoes it, without a division by B::

    p = (v_d - v_0) s Delta / f     q = (u_d - u_0) Delta / f     R^2 = p^2 + q^2
    r (1 + k_1 r^2 + k_2 r^4) = R   solved for r on the branch that rises from zero
    ray (p, q, B(r))                s_d = ray / |ray|

The slope of that equation, T = 1 + 3 k_1 r^2 + 5 k_2 r^4, first falls to zero at r_turn; beyond R_turn = r_turn B(r_turn) no ray
reaches the detector on this branch, and the answer is NaN. Newton's method is held in [0, r_turn] by halving.

Derivatives. r dB = dR - B dr and T dr = dR - r (r^2 dk_1 + r^4 dk_2) leave, with no 0/0 on the principal point,

    dB = (2 k_1 + 4 k_2 r^2) / (B T) (p dp + q dq) + (B / T) (r^2 dk_1 + r^4 dk_2).

|det[ray, d ray/dp, d ray/dq]| = B - (2 k_1 + 4 k_2 r^2) R^2 / (B T) = B^2 / T, because T = B + 2 k_1 r^2 + 4 k_2 r^4 and R = r B;
so a pixel covers B^2 / T s Delta^2 / f^2 / |ray|^3.

x = [s f u_0 v_0 k_1 k_2] in SI (1, m, px, px, 1, 1). W Table 1 gives the typical sigmas, its f in millimetres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from boresight.arrays import FloatArray
from boresight.cameras.model import CameraModel

KERNEL = 1
NEWTON_STEPS = 60
#: Share of R that the last step may be: its error is the square of that.
SETTLED = 1e-11
#: Newton steps taken from the root in the dtype of x: only the equation decides where they end, so a complex step passes through.
LAST_STEPS = 3


def turning_radius(k1: float, k2: float) -> float:
    """Tangent r at which the slope T first falls to zero, infinite where it never does short of a millionth off 90 degrees."""
    inside = 2.25 * k1 * k1 - 5 * k2
    denominator = np.sqrt(inside) - 1.5 * k1 if inside >= 0 else 0.0
    return float(1 / np.sqrt(denominator)) if denominator > 1e-12 else np.inf


def _reach(r: FloatArray, k1: float, k2: float) -> FloatArray:
    """R = r B(r)."""
    r2 = r * r
    return np.asarray(r * (1 + r2 * (k1 + k2 * r2)))


def _newton_step(r: FloatArray, reach: FloatArray, k1: float, k2: float) -> FloatArray:
    """How far Newton's method moves from r, against the sign: (r B - R) / T."""
    r2 = r * r
    return np.asarray((_reach(r, k1, k2) - reach) / (1 + r2 * (3 * k1 + 5 * k2 * r2)))


def _undistorted_radius(reach: FloatArray, k1: float, k2: float) -> FloatArray:
    """Solve r B(r) = R, (n,), on the branch through zero; NaN beyond its turn. Complex where an argument is."""
    fixed, c1, c2 = np.real(reach), np.real(k1), np.real(k2)
    turn = turning_radius(c1, c2)
    most = _reach(np.asarray(turn), c1, c2) if np.isfinite(turn) else np.inf
    within = fixed < most
    goal = np.where(within, fixed, 0.0)
    low, high, r = np.zeros_like(goal), np.full_like(goal, turn), np.minimum(goal, 0.99 * turn)
    for _ in range(NEWTON_STEPS):
        short = _reach(r, c1, c2) <= goal
        low, high = np.where(short, r, low), np.where(short, high, r)
        moved = r - _newton_step(r, goal, c1, c2)
        inside = (moved >= low) & (moved <= high)
        settled = inside & (np.abs(moved - r) <= SETTLED * goal)
        r = np.where(inside, moved, 0.5 * (low + high))
        if settled.all():
            break
    root = np.where(within, r, np.nan)
    for _ in range(LAST_STEPS):
        root = root - _newton_step(root, reach, k1, k2)
    return np.asarray(root)


def _rays(x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float) -> tuple[FloatArray, ...]:
    """Return (p, q, r, B) of each pixel; dtype follows x."""
    s, f, u0, v0, k1, k2 = x
    p = (np.asarray(row_px) - v0) * s * pitch / f
    q = (np.asarray(col_px) - u0) * pitch / f
    r = _undistorted_radius(np.sqrt(p * p + q * q), k1, k2)
    return p, q, r, 1 + r * r * (k1 + k2 * r * r)


def directions(x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float) -> FloatArray:
    """Star directions of detector positions.

    Parameters
    ----------
    x
        (6,) parameters, SI. May be complex, for derivative checks.
    row_px, col_px
        (n,) centroids, pixels.
    pitch
        Width of a pixel D_u, metres.

    Returns
    -------
    (n, 3) unit vectors in D; NaN where the distortion has turned back before the place.
    """
    p, q, _, B = _rays(x, row_px, col_px, pitch)
    ray = np.stack([p, q, B], axis=-1)
    return np.asarray(ray / np.sqrt(np.sum(ray * ray, axis=-1, keepdims=True)))


def directions_and_jacobian(
    x: FloatArray, row_px: ArrayLike, col_px: ArrayLike, pitch: float
) -> tuple[FloatArray, FloatArray]:
    """Star directions and their derivatives.

    Returns
    -------
    s
        (n, 3) unit vectors in D.
    ds_dx
        (n, 3, 6) per parameter in SI.
    """
    aspect, f, _, _, k1, k2 = x
    p, q, r, B = _rays(x, row_px, col_px, pitch)
    r2 = r * r
    T = 1 + r2 * (3 * k1 + 5 * k2 * r2)
    radial, zero, one = (2 * k1 + 4 * k2 * r2) / (B * T), np.zeros_like(p), np.ones_like(p)
    dp = [p / aspect, -p / f, zero, -aspect * pitch / f * one, zero, zero]
    dq = [zero, -q / f, -pitch / f * one, zero, zero, zero]
    dB_explicit = [zero, zero, zero, zero, r2 * B / T, r2 * r2 * B / T]
    dr = np.stack(
        [np.stack([dp[i], dq[i], radial * (p * dp[i] + q * dq[i]) + dB_explicit[i]], axis=-1) for i in range(6)],
        axis=-1,
    )
    ray = np.stack([p, q, B], axis=-1)
    length = np.sqrt(np.sum(ray * ray, axis=-1, keepdims=True))
    s = ray / length
    along = np.einsum("...i,...ip->...p", s, dr)
    return s, (dr - s[..., :, None] * along[..., None, :]) / length[..., None]


def project(x: FloatArray, s: FloatArray, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Detector positions of directions.

    Parameters
    ----------
    x
        (6,) parameters, SI.
    s
        (n, 3) directions in D, any positive length.
    pitch
        Width of a pixel D_u, metres.

    Returns
    -------
    row_px, col_px
        (n,) pixels; NaN for a direction behind the sensor or beyond the radius where the distortion turns back.
    """
    aspect, f, u0, v0, k1, k2 = x
    s = np.asarray(s, dtype=float)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        tx, ty = (np.where(s[..., 2] > 0, s[..., axis] / s[..., 2], np.nan) for axis in (0, 1))
        r2 = tx * tx + ty * ty
        B = np.where(r2 < turning_radius(k1, k2) ** 2, 1 + r2 * (k1 + k2 * r2), np.nan)
        return tx * B * f / (aspect * pitch) + v0, ty * B * f / pitch + u0


def principal_point(x: FloatArray) -> tuple[float, float]:
    """Row and column of the principal point, pixels."""
    return float(x[3]), float(x[2])


def radial_tangent(x: FloatArray, radius_px: ArrayLike, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Tangent of the off-axis angle at a radius in widths of a pixel, with f, k1 and k2 acting together.

    Returns
    -------
    tangent
        (n,) tan theta = r with r B(r) = R = pitch radius / f, aspect left out.
    gradient
        (n, 6) its derivatives in SI: dr/df = -R / (f T), dr/dk1 = -r^3 / T, dr/dk2 = -r^5 / T.
    """
    f, k1, k2 = x[1], x[4], x[5]
    reach = pitch * np.asarray(radius_px, dtype=float) / f
    r = _undistorted_radius(reach, k1, k2)
    T = 1 + r**2 * (3 * k1 + 5 * k2 * r**2)
    gradient = np.zeros((*r.shape, 6))
    gradient[..., 1], gradient[..., 4], gradient[..., 5] = -reach / (f * T), -(r**3) / T, -(r**5) / T
    return r, gradient


PINHOLE_RADIAL = CameraModel(
    name="pinhole_radial",
    kernel=KERNEL,
    parameter_names=("s", "f_m", "u0_px", "v0_px", "k1", "k2"),
    symbols=("s", "f", "u0", "v0", "k1", "k2"),
    units=("1", "m", "px", "px", "1", "1"),
    directions=directions,
    directions_and_jacobian=directions_and_jacobian,
    project=project,
    principal_point=principal_point,
    radial_tangent=radial_tangent,
    default_typical_sigma=(1e-5, 1e-7, 1.0, 1.0, 1e-2, 1e-1),
    plausible=((0.5, 2.0), (1e-4, 100.0), (-1e5, 1e5), (-1e5, 1e5), (-1e4, 1e4), (-1e7, 1e7)),
)
