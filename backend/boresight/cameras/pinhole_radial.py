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

x = [s f u_0 v_0 k_1 k_2] in SI (1, m, px, px, 1, 1). The typical sigmas are those of `brown_conrady`, which holds this camera;
W Table 1 has a hundredth of them for f and a tenth for the principal point, the simulated sensor's (`simulation.sensors`).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from boresight.cameras.model import CameraModel, Equations, OpenCV, Parameter, Role
from boresight.kernels.star import part

STEPS = 60  # of the bracketed search, which takes about five
SETTLED = 1e-6  # share of the root that its last step may be: one more step leaves an error of the fourth power of that


class PinholeRadial(NamedTuple):
    """State of the camera, SI."""

    s: Annotated[float, Parameter(Role.ASPECT, "s", "1", 2e-4, 0.5, 2.0)]
    f_m: Annotated[float, Parameter(Role.FOCAL, "f", "m", 8e-6, 1e-4, 100.0, shown=("mm", 1e3))]
    u0_px: Annotated[float, Parameter(Role.COLUMN, "u0", "px", 10.0, -1e5, 1e5)]
    v0_px: Annotated[float, Parameter(Role.ROW, "v0", "px", 10.0, -1e5, 1e5)]
    k1: Annotated[float, Parameter(Role.RADIAL, "k1", "1", 1e-2, -1e4, 1e4)]
    k2: Annotated[float, Parameter(Role.RADIAL, "k2", "1", 1e-1, -1e7, 1e7)]


@part
def turning_radius_squared(k1: Any, k2: Any) -> Any:
    """r^2 at which the slope T first falls to zero, infinite where it never does short of a millionth off 90 degrees."""
    inside = 2.25 * k1 * k1 - 5.0 * k2
    if inside < 0.0:
        return math.inf
    denominator = math.sqrt(inside) - 1.5 * k1
    return 1.0 / denominator if denominator > 1e-12 else math.inf


@part
def undistorted_radius(reach: Any, k1: Any, k2: Any) -> Any:
    """Solve r (1 + k1 r^2 + k2 r^4) = R on the branch that rises from zero; NaN where it turns back before R.

    The last step is taken in the arithmetic of the arguments, so that a complex step passes through.
    """
    goal, c1, c2 = np.real(reach), np.real(k1), np.real(k2)
    turn2 = turning_radius_squared(c1, c2)
    low, high = 0.0, math.sqrt(turn2)
    if math.isfinite(high) and not high * (1.0 + turn2 * (c1 + c2 * turn2)) > goal:
        return math.nan * reach
    at = min(goal, 0.99 * high)
    for _ in range(STEPS):
        at2 = at * at
        excess = at * (1.0 + at2 * (c1 + c2 * at2)) - goal
        if excess > 0.0:
            high = at
        else:
            low = at
        step = excess / (1.0 + at2 * (3.0 * c1 + 5.0 * c2 * at2))
        at -= step
        if not low <= at <= high:
            at = 0.5 * (low + high)
        elif abs(step) <= SETTLED * at:
            break
    at2 = at * at
    return at - (at * (1.0 + at2 * (k1 + k2 * at2)) - reach) / (1.0 + at2 * (3.0 * k1 + 5.0 * k2 * at2))


def star(x: Any, pitch: Any, row_px: Any, col_px: Any) -> Any:
    """Tangents of one star and their derivatives; d(t_x, t_y) / d(p, q) is ((xx, xy), (xy, yy))."""
    s, f, u0, v0, k1, k2 = x
    scale, over_f = pitch / f, 1.0 / f
    across = scale * (row_px - v0)
    p, q = s * across, scale * (col_px - u0)
    r = undistorted_radius(np.sqrt(p * p + q * q), k1, k2)
    r2 = r * r
    B, T = 1.0 + r2 * (k1 + k2 * r2), 1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2)
    inverse, slope = 1.0 / B, (2.0 * k1 + 4.0 * k2 * r2) / T
    tx, ty = inverse * p, inverse * q
    xx, xy, yy = inverse * (1.0 - slope * tx * tx), -inverse * slope * tx * ty, inverse * (1.0 - slope * ty * ty)
    first, second = -r2 / T, -r2 * r2 / T
    dx = (xx * across, -(xx * p + xy * q) * over_f, -scale * xy, -s * scale * xx, first * tx, second * tx)
    dy = (xy * across, -(xy * p + yy * q) * over_f, -scale * yy, -s * scale * xy, first * ty, second * ty)
    return tx, ty, dx, dy


PINHOLE_RADIAL = CameraModel(
    name="pinhole_radial",
    state=PinholeRadial,
    star=star,
    equations=Equations(
        runs="from a direction to a detector position; its inverse needs an iteration",
        source="Wu et al. 2019, Sensors 19, Eqs 1-8, with the distortion radial about the principal point (Eq 6 corrected)",
        steps=(
            "t_x = s_x / s_z",
            "t_y = s_y / s_z",
            "r^2 = t_x^2 + t_y^2",
            "B = 1 + k1 r^2 + k2 r^4",
            "row = v0 + t_x B f / (s pitch)",
            "column = u0 + t_y B f / pitch",
        ),
        inverse="solve r (1 + k1 r^2 + k2 r^4) = R on the branch through zero, R = pitch |(s (row - v0), column - u0)| / f",
    ),
    opencv=lambda x, pitch: OpenCV(
        "plumb_bob", x["f_m"] / pitch, x["f_m"] / (x["s"] * pitch), (x["k1"], x["k2"], 0.0, 0.0, 0.0)
    ),
)
