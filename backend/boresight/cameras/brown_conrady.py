"""The pinhole camera with radial and tangential distortion of Brown and Conrady, as OpenCV and tetra3rs write it.

The model runs from the sky to the detector, like `pinhole_radial`, which it contains. With X along columns, Y along rows and Z
along the boresight, x = X / Z, y = Y / Z and r^2 = x^2 + y^2, the lens moves a star to

    x_d = x B + 2 p_1 x y + p_2 (r^2 + 2 x^2)          B = 1 + k_1 r^2 + k_2 r^4 + k_3 r^6
    y_d = y B + p_1 (r^2 + 2 y^2) + 2 p_2 x y

(OpenCV, "Camera Calibration and 3D Reconstruction"; Brown, Decentering distortion of lenses, 1966), and to the pixel

    column = u_0 + x_d f / Delta        row = v_0 + y_d f / (s Delta)

with Delta the pitch: f / Delta is OpenCV's f_x, f / (s Delta) its f_y. Our D has x along rows and y along columns, so the tangents
are t = (y, x); what that says of the frame's hand is in `pinhole_radial`.

Tangents. A centroid gives (y_d, x_d) = d; the tangents solve D(t) = d. Newton's method does, from t = 0 outwards: a step is halved
while it leads where det dD/dt is not positive or farther from d, so it stays on the branch that rises from the principal point, and
beyond its end the answer is NaN.

Derivatives. With J = dD/dt, D(t) = d gives dt = J^-1 (dd - dD|t): the pixel's side moves d, the lens's side moves D where t stands
still. J is symmetric:

    dy_d/dy = B + y^2 S + 6 p_1 y + 2 p_2 x       S = 2 k_1 + 4 k_2 r^2 + 6 k_3 r^4
    dx_d/dx = B + x^2 S + 2 p_1 y + 6 p_2 x       dy_d/dx = x y S + 2 p_1 x + 2 p_2 y

x = [s f u_0 v_0 k_1 k_2 p_1 p_2 k_3] (1, m, px, px, 1, 1, 1, 1, 1), the coefficients in OpenCV's order.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from boresight.cameras.model import CameraModel, Equations, OpenCV, Parameter, Role, Usual
from boresight.kernels.star import part

STEPS = 60  # of the search, which takes about five
SETTLED = 1e-6  # the last step of it, a tangent: one more leaves an error of the fourth power of that
LEAST_SHARE = 1e-3  # of a step: where less is needed the place lies beyond what the lens shows


class BrownConrady(NamedTuple):
    """State of the camera, SI."""

    s: Annotated[float, Parameter(Role.ASPECT, "s", "1", 2e-4, 0.5, 2.0)]
    f_m: Annotated[float, Parameter(Role.FOCAL, "f", "m", 8e-6, 1e-4, 100.0, shown=("mm", 1e3))]
    u0_px: Annotated[float, Parameter(Role.COLUMN, "u0", "px", 10.0, -1e5, 1e5)]
    v0_px: Annotated[float, Parameter(Role.ROW, "v0", "px", 10.0, -1e5, 1e5)]
    k1: Annotated[float, Parameter(Role.RADIAL, "k1", "1", 1e-2, -1e4, 1e4)]
    k2: Annotated[float, Parameter(Role.RADIAL, "k2", "1", 1e-1, -1e7, 1e7)]
    p1: Annotated[float, Parameter(Role.DECENTRING, "p1", "1", 1e-3, -10.0, 10.0)]
    p2: Annotated[float, Parameter(Role.DECENTRING, "p2", "1", 1e-3, -10.0, 10.0)]
    k3: Annotated[float, Parameter(Role.RADIAL, "k3", "1", 1.0, -1e10, 1e10)]


@part
def distorted(y: Any, x: Any, k1: Any, k2: Any, k3: Any, p1: Any, p2: Any) -> Any:
    """Return y_d, x_d and J: dy_d/dy, dy_d/dx = dx_d/dy, dx_d/dx."""
    yy, xx, yx = y * y, x * x, y * x
    r2 = yy + xx
    B, S = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * k1 + r2 * (4.0 * k2 + r2 * 6.0 * k3)
    y_d = y * B + p1 * (r2 + 2.0 * yy) + 2.0 * p2 * yx
    x_d = x * B + p2 * (r2 + 2.0 * xx) + 2.0 * p1 * yx
    across = yx * S + 2.0 * (p1 * x + p2 * y)
    return y_d, x_d, B + yy * S + 6.0 * p1 * y + 2.0 * p2 * x, across, B + xx * S + 2.0 * p1 * y + 6.0 * p2 * x


@part
def undistorted(goal_y: Any, goal_x: Any, k1: Any, k2: Any, k3: Any, p1: Any, p2: Any) -> Any:
    """Return (y, x) that the lens moves to a goal; NaN beyond the branch that rises from zero."""
    y, x = 0.0, 0.0
    y_d, x_d, J_yy, J_yx, J_xx = distorted(y, x, k1, k2, k3, p1, p2)
    off = (goal_y - y_d) ** 2 + (goal_x - x_d) ** 2
    for _ in range(STEPS):
        inverse = 1.0 / (J_yy * J_xx - J_yx * J_yx)
        down = (J_xx * (goal_y - y_d) - J_yx * (goal_x - x_d)) * inverse
        right = (J_yy * (goal_x - x_d) - J_yx * (goal_y - y_d)) * inverse
        if abs(down) + abs(right) <= SETTLED:
            return y + down, x + right
        share = 1.0
        while share > LEAST_SHARE:
            y_d, x_d, J_yy, J_yx, J_xx = distorted(y + share * down, x + share * right, k1, k2, k3, p1, p2)
            now = (goal_y - y_d) ** 2 + (goal_x - x_d) ** 2
            if now < off and J_yy * J_xx - J_yx * J_yx > 0.0 and J_yy > 0.0:
                break
            share *= 0.5
        if not share > LEAST_SHARE:
            return math.nan, math.nan
        y, x, off = y + share * down, x + share * right, now
    return math.nan, math.nan


def star(x: Any, pitch: Any, row_px: Any, col_px: Any) -> Any:
    """Tangents of one star and their derivatives."""
    s, f, u0, v0, k1, k2, p1, p2, k3 = x
    scale, over_f = pitch / f, 1.0 / f
    across = scale * (row_px - v0)
    y_d, x_d = s * across, scale * (col_px - u0)
    y, x = undistorted(np.real(y_d), np.real(x_d), np.real(k1), np.real(k2), np.real(k3), np.real(p1), np.real(p2))
    y_at, x_at, J_yy, J_yx, J_xx = distorted(y, x, k1, k2, k3, p1, p2)
    inverse = 1.0 / (J_yy * J_xx - J_yx * J_yx)
    yy, yx, xx = J_xx * inverse, -J_yx * inverse, J_yy * inverse
    y, x = y + yy * (y_d - y_at) + yx * (x_d - x_at), x + yx * (y_d - y_at) + xx * (x_d - x_at)  # a complex step passes
    r2 = x * x + y * y
    lens = -(yy * y + yx * x) * r2, -(yx * y + xx * x) * r2  # by k1
    first, second = r2 + 2.0 * y * y, r2 + 2.0 * x * x
    both = 2.0 * y * x
    dy = (
        yy * across, -(yy * y_d + yx * x_d) * over_f, -yx * scale, -s * yy * scale,
        lens[0], lens[0] * r2, -(yy * first + yx * both), -(yy * both + yx * second), lens[0] * r2 * r2,
    )  # fmt: skip
    dx = (
        yx * across, -(yx * y_d + xx * x_d) * over_f, -xx * scale, -s * yx * scale,
        lens[1], lens[1] * r2, -(yx * first + xx * both), -(yx * both + xx * second), lens[1] * r2 * r2,
    )  # fmt: skip
    return y, x, dy, dx


BROWN_CONRADY = CameraModel(
    name="brown_conrady",
    state=BrownConrady,
    star=star,
    equations=Equations(
        runs="from a direction to a detector position; its inverse needs an iteration",
        source="Brown 1966; OpenCV, Camera Calibration and 3D Reconstruction",
        steps=(
            "y = s_x / s_z, x = s_y / s_z",
            "r^2 = x^2 + y^2",
            "B = 1 + k1 r^2 + k2 r^4 + k3 r^6",
            "row = v0 + (y B + p1 (r^2 + 2 y^2) + 2 p2 x y) f / (s pitch)",
            "column = u0 + (x B + 2 p1 x y + p2 (r^2 + 2 x^2)) f / pitch",
        ),
        inverse="solve the same two equations for (x, y) on the branch through zero",
    ),
    opencv=lambda x, pitch: OpenCV(
        "plumb_bob", x["f_m"] / pitch, x["f_m"] / (x["s"] * pitch), (x["k1"], x["k2"], x["p1"], x["p2"], x["k3"])
    ),
    usual=Usual(0.0, "OpenCV's equations reach there"),
)
