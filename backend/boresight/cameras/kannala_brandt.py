"""The camera of Kannala and Brandt for wide fields, as OpenCV's fisheye module writes it.

A pinhole's image of a star at the angle theta off the boresight grows with tan theta, without bound; a wide lens's with theta.
With X along columns, Y along rows and Z along the boresight, tan theta = |(X, Y)| / Z, and the lens shows the star at the radius

    rho = theta (1 + k_1 theta^2 + k_2 theta^4 + k_3 theta^6 + k_4 theta^8)

in the direction of (X, Y) (Kannala and Brandt 2006, Eq 6 with its radial terms), and at the pixel

    column = u_0 + (f / Delta) rho X / |(X, Y)|       row = v_0 + (f / (s Delta)) rho Y / |(X, Y)|

with Delta the pitch. Stars at 90 degrees or more off the boresight have no tangents, and none is given here: NaN.

Tangents. A centroid gives d = (d_y, d_x) = (s (row - v_0), column - u_0) Delta / f, and rho = |d|. theta solves the polynomial
on the branch that rises from zero, by Newton's method: a step is halved while the slope T = drho/dtheta is not positive where it
leads, or that lies farther from the goal. Then t = (Y, X) / Z = q d with q = tan(theta) / rho, which is 1 on the boresight.

Derivatives. drho = d.dd / rho and T dtheta = drho - theta (theta^2 dk_1 + theta^4 dk_2 + ...), so with w = (1 / cos^2 theta) / T

    dt = q dd + d (w - q) (d.dd) / rho^2 - (d / rho) w theta (theta^2 dk_1 + ...)

(w - q) / rho^2 is 0/0 on the boresight. There q = 1 + (1/3 - k_1) rho^2 and w = 1 + (1 - 3 k_1) rho^2 to first order, so that the
quotient tends to 2/3 - 2 k_1, which is taken where rho is below 1e-4: the rest is 1e-8 of it.

x = [s f u_0 v_0 k_1 k_2 k_3 k_4] (1, m, px, px, 1, 1, 1, 1).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from boresight.cameras.model import CameraModel, Equations, OpenCV, Parameter, Role, Usual
from boresight.kernels.star import part

STEPS = 60  # of the search, which takes about five
SETTLED = 1e-6  # the last step of it, rad: one more leaves an error of the fourth power of that
LEAST_SHARE = 1e-3  # of a step: where less is needed the place lies beyond what the lens shows
NEAR = 1e-8  # rho^2 below which quotients are taken from their series


class KannalaBrandt(NamedTuple):
    """State of the camera, SI."""

    s: Annotated[float, Parameter(Role.ASPECT, "s", "1", 2e-4, 0.5, 2.0)]
    f_m: Annotated[float, Parameter(Role.FOCAL, "f", "m", 8e-6, 1e-4, 100.0, shown=("mm", 1e3))]
    u0_px: Annotated[float, Parameter(Role.COLUMN, "u0", "px", 10.0, -1e5, 1e5)]
    v0_px: Annotated[float, Parameter(Role.ROW, "v0", "px", 10.0, -1e5, 1e5)]
    k1: Annotated[float, Parameter(Role.RADIAL, "k1", "1", 1e-2, -1e3, 1e3)]
    k2: Annotated[float, Parameter(Role.RADIAL, "k2", "1", 1e-2, -1e4, 1e4)]
    k3: Annotated[float, Parameter(Role.RADIAL, "k3", "1", 1e-2, -1e6, 1e6)]
    k4: Annotated[float, Parameter(Role.RADIAL, "k4", "1", 1e-2, -1e8, 1e8)]


@part
def radius(theta: Any, k1: Any, k2: Any, k3: Any, k4: Any) -> Any:
    """Return rho and its slope T at an angle."""
    t2 = theta * theta
    rho = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    return rho, 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))


@part
def angle(goal: Any, k1: Any, k2: Any, k3: Any, k4: Any) -> Any:
    """Return the angle that the lens shows at a radius; NaN beyond the branch that rises from zero, and from 90 degrees on."""
    theta = 0.0
    rho, T = radius(theta, k1, k2, k3, k4)
    for _ in range(STEPS):
        step = (goal - rho) / T
        if abs(step) <= SETTLED:
            theta += step
            return theta if theta < 0.5 * math.pi else math.nan
        share = 1.0
        while share > LEAST_SHARE:
            now, slope = radius(theta + share * step, k1, k2, k3, k4)
            if abs(goal - now) < abs(goal - rho) and slope > 0.0:
                break
            share *= 0.5
        if not share > LEAST_SHARE:
            return math.nan
        theta, rho, T = theta + share * step, now, slope
    return math.nan


def star(x: Any, pitch: Any, row_px: Any, col_px: Any) -> Any:
    """Tangents of one star and their derivatives."""
    s, f, u0, v0, k1, k2, k3, k4 = x
    scale, over_f = pitch / f, 1.0 / f
    across = scale * (row_px - v0)
    y, x = s * across, scale * (col_px - u0)
    rho2 = y * y + x * x
    rho = np.sqrt(rho2)
    theta = angle(np.real(rho), np.real(k1), np.real(k2), np.real(k3), np.real(k4))
    at, T = radius(theta, k1, k2, k3, k4)
    theta = theta + (rho - at) / T  # a complex step passes
    _, T = radius(theta, k1, k2, k3, k4)
    tangent = np.tan(theta)
    w = (1.0 + tangent * tangent) / T
    if np.real(rho2) > NEAR:
        q = tangent / rho
        bend, lens = (w - q) / rho2, -w * theta / rho
    else:
        q, bend, lens = 1.0 + (1.0 / 3.0 - k1) * rho2, 2.0 / 3.0 - 2.0 * k1, -w
    yy, yx, xx = q + bend * y * y, bend * y * x, q + bend * x * x
    t2 = theta * theta
    k_y, k_x = lens * t2 * y, lens * t2 * x
    dy = (
        yy * across, -(yy * y + yx * x) * over_f, -yx * scale, -s * yy * scale,
        k_y, k_y * t2, k_y * t2 * t2, k_y * t2 * t2 * t2,
    )  # fmt: skip
    dx = (
        yx * across, -(yx * y + xx * x) * over_f, -xx * scale, -s * yx * scale,
        k_x, k_x * t2, k_x * t2 * t2, k_x * t2 * t2 * t2,
    )  # fmt: skip
    return q * y, q * x, dy, dx


KANNALA_BRANDT = CameraModel(
    name="kannala_brandt",
    state=KannalaBrandt,
    star=star,
    equations=Equations(
        runs="from a direction to a detector position; its inverse needs an iteration",
        source="Kannala and Brandt 2006, Eq 6 with its radial terms; OpenCV, Fisheye camera model",
        steps=(
            "theta = atan2(|(s_x, s_y)|, s_z)",
            "rho = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)",
            "row = v0 + rho s_x / |(s_x, s_y)| f / (s pitch)",
            "column = u0 + rho s_y / |(s_x, s_y)| f / pitch",
        ),
        inverse="solve the second equation for theta on the branch through zero, rho = pitch |(s (row - v0), column - u0)| / f",
    ),
    opencv=lambda x, pitch: OpenCV(
        "equidistant", x["f_m"] / pitch, x["f_m"] / (x["s"] * pitch), (x["k1"], x["k2"], x["k3"], x["k4"])
    ),
    usual=Usual(50.0, "a fisheye's equations reach there"),
)
