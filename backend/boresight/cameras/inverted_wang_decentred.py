"""`inverted_wang` with what its lens may have besides: decentring, and a sixth order of the radius.

With U, V of `inverted_wang` (E Eqs 1-4),

    B = 1 + b_2 rho^2 + b_4 rho^4 + b_6 rho^6
    t_x = (B U + p_1 (rho^2 + 2 U^2) + 2 p_2 U V) / f
    t_y = (B V + p_2 (rho^2 + 2 V^2) + 2 p_1 U V) / f

which are Conrady's decentring terms, taken on the detector's side, where this model's polynomial is, so that a pixel gives its ray
without iteration here too. With b_6 = p_1 = p_2 = 0 it is `inverted_wang`, whose module derives the rest: only the slope of t over
(U, V) is another, symmetric again,

    f M_UU = B + S U^2 + 6 p_1 U + 2 p_2 V      S = 2 b_2 + 4 b_4 rho^2 + 6 b_6 rho^4
    f M_VV = B + S V^2 + 2 p_1 U + 6 p_2 V      f M_UV = S U V + 2 p_1 V + 2 p_2 U

x = [f m_0 n_0 b_4 b_2 a_1 a_2 g_y b_6 p_1 p_2] in SI (m, px, px, m^-4, m^-2, rad, rad, 1, m^-6, m^-1, m^-1). Decentring and tilt
turn the image about nearly the same way to first order; few fields tell p from a.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from boresight.cameras.model import CameraModel, Equations, Parameter, Role


class InvertedWangDecentred(NamedTuple):
    """State of the camera, SI."""

    f_m: Annotated[float, Parameter(Role.FOCAL, "f", "m", 8e-6, 1e-4, 100.0, shown=("mm", 1e3))]
    m0_px: Annotated[float, Parameter(Role.ROW, "m0", "px", 30.0, -1e5, 1e5)]
    n0_px: Annotated[float, Parameter(Role.COLUMN, "n0", "px", 30.0, -1e5, 1e5)]
    b4_per_m4: Annotated[float, Parameter(Role.RADIAL, "b4", "m⁻⁴", 1e8, -1e15, 1e15)]
    b2_per_m2: Annotated[float, Parameter(Role.RADIAL, "b2", "m⁻²", 1e3, -1e8, 1e8)]
    a1_rad: Annotated[float, Parameter(Role.TILT, "a1", "rad", 0.01, -1.0, 1.0, shown=("mrad", 1e3))]
    a2_rad: Annotated[float, Parameter(Role.TILT, "a2", "rad", 0.01, -1.0, 1.0, shown=("mrad", 1e3))]
    g_y: Annotated[float, Parameter(Role.ASPECT, "g_y", "1", 2e-4, 0.5, 2.0)]
    b6_per_m6: Annotated[float, Parameter(Role.RADIAL, "b6", "m⁻⁶", 1e13, -1e22, 1e22)]
    p1_per_m: Annotated[float, Parameter(Role.DECENTRING, "p1", "m⁻¹", 0.1, -1e4, 1e4)]
    p2_per_m: Annotated[float, Parameter(Role.DECENTRING, "p2", "m⁻¹", 0.1, -1e4, 1e4)]


def star(x: Any, pitch: Any, row_px: Any, col_px: Any) -> Any:
    """Tangents of one star and their derivatives; the slope of t over (U, V) is ((xx, xy), (xy, yy))."""
    f, m0, n0, b4, b2, a1, a2, g_y, b6, p1, p2 = x
    dn = col_px - n0
    u, v = pitch * (row_px - m0), g_y * pitch * dn
    inverse, over_f = 1.0 / (a1 * v + a2 * u + f), 1.0 / f
    U, V = u * f * inverse, v * f * inverse
    UU, UV, VV = U * U, U * V, V * V
    rho2 = UU + VV
    B = over_f * (1.0 + rho2 * (b2 + rho2 * (b4 + rho2 * b6)))
    S = over_f * (2.0 * b2 + rho2 * (4.0 * b4 + rho2 * 6.0 * b6))
    first, both, second = over_f * (rho2 + 2.0 * UU), over_f * 2.0 * UV, over_f * (rho2 + 2.0 * VV)
    tx, ty = B * U + p1 * first + p2 * both, B * V + p2 * second + p1 * both
    p1_f, p2_f = 2.0 * p1 * over_f, 2.0 * p2 * over_f
    xx, xy, yy = (
        B + S * UU + 3.0 * p1_f * U + p2_f * V,
        S * UV + p1_f * V + p2_f * U,
        B + S * VV + p1_f * U + 3.0 * p2_f * V,
    )
    fd2 = f * inverse * inverse
    u_u, u_v, v_u, v_v = fd2 * (a1 * v + f), -fd2 * a1 * u, -fd2 * a2 * v, fd2 * (a2 * u + f)
    along_x, along_y = xx * u + xy * v, xy * u + yy * v
    tilted = (a1 * v + a2 * u) * inverse * inverse
    col_x, col_y = pitch * (xx * u_v + xy * v_v), pitch * (xy * u_v + yy * v_v)
    radial_x, radial_y = rho2 * U * over_f, rho2 * V * over_f
    dx = (
        tilted * along_x - tx * over_f, -pitch * (xx * u_u + xy * v_u), -g_y * col_x, rho2 * radial_x, radial_x,
        -fd2 * v * along_x, -fd2 * u * along_x, dn * col_x, rho2 * rho2 * radial_x, first, both,
    )  # fmt: skip
    dy = (
        tilted * along_y - ty * over_f, -pitch * (xy * u_u + yy * v_u), -g_y * col_y, rho2 * radial_y, radial_y,
        -fd2 * v * along_y, -fd2 * u * along_y, dn * col_y, rho2 * rho2 * radial_y, both, second,
    )  # fmt: skip
    return tx, ty, dx, dy


INVERTED_WANG_DECENTRED = CameraModel(
    name="inverted_wang_decentred",
    state=InvertedWangDecentred,
    star=star,
    equations=Equations(
        runs="from a detector position to a direction, without iteration",
        source="Enright, Jovanovic, Vaz 2018, Eqs 1-7, with a sixth order and Conrady's decentring on the detector's side",
        steps=(
            "u = pitch (row - m0)",
            "v = g_y pitch (column - n0)",
            "U = u f / (a1 v + a2 u + f)",
            "V = v f / (a1 v + a2 u + f)",
            "rho^2 = U^2 + V^2",
            "B = 1 + b2 rho^2 + b4 rho^4 + b6 rho^6",
            "x = B U + p1 (rho^2 + 2 U^2) + 2 p2 U V",
            "y = B V + p2 (rho^2 + 2 V^2) + 2 p1 U V",
            "s = (x, y, f) / |(x, y, f)|",
        ),
        inverse="solve (x, y) = f (s_x, s_y) / s_z for (U, V) on the branch through zero, then u and v linearly",
    ),
)
