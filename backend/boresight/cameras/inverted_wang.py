"""The ST-16 camera: Wang's model inverted, so that a pixel gives its ray without iteration (E Eqs 1-7).

With m, n the centroid, Delta the pixel pitch::

    u = Delta (m - m_0)              v = g_y Delta (n - n_0)                    Eq 1
    U = u f / (a_1 v + a_2 u + f)    V = v f / (a_1 v + a_2 u + f)              Eqs 2, 3
    rho^2 = U^2 + V^2                B = 1 + b_2 rho^2 + b_4 rho^4              Eqs 4, 5
    r = (B U, B V, f)                s = r / |r|                                Eqs 6, 7

g_y is an aspect factor between the axes; the text's "skew" is an erratum.

Tangents and derivatives (E Eqs 39-77). t = (B U, B V) / f depends on the pixel through (U, V) alone, so with

    M = d t / d(U, V) = (B I + (2 b_2 + 4 b_4 rho^2) [U; V] [U V]) / f,

every column is dt = M d(U, V) + [U; V] dB|explicit / f, and that of f less t / f. Writing dB that way is the erratum to Eqs 43,
48 ...: the printed 1/rho is 0/0 for a star on the principal point.

Symbols are the notation page's; x = [f m_0 n_0 b_4 b_2 a_1 a_2 g_y] in SI (m, px, px, m^-4, m^-2, rad, rad, 1).
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from boresight.cameras.model import CameraModel, Equations, Parameter, Role


class InvertedWang(NamedTuple):
    """State of the camera, SI."""

    f_m: Annotated[float, Parameter(Role.FOCAL, "f", "m", 8e-6, 1e-4, 100.0, shown=("mm", 1e3))]
    m0_px: Annotated[float, Parameter(Role.ROW, "m0", "px", 30.0, -1e5, 1e5)]
    n0_px: Annotated[float, Parameter(Role.COLUMN, "n0", "px", 30.0, -1e5, 1e5)]
    b4_per_m4: Annotated[float, Parameter(Role.RADIAL, "b4", "m⁻⁴", 1e8, -1e15, 1e15)]
    b2_per_m2: Annotated[float, Parameter(Role.RADIAL, "b2", "m⁻²", 1e3, -1e8, 1e8)]
    a1_rad: Annotated[float, Parameter(Role.TILT, "a1", "rad", 0.01, -1.0, 1.0, shown=("mrad", 1e3))]
    a2_rad: Annotated[float, Parameter(Role.TILT, "a2", "rad", 0.01, -1.0, 1.0, shown=("mrad", 1e3))]
    g_y: Annotated[float, Parameter(Role.ASPECT, "g_y", "1", 2e-4, 0.5, 2.0)]


def star(x: Any, pitch: Any, row_px: Any, col_px: Any) -> Any:
    """Tangents of one star and their derivatives (E Eqs 1-7, 44-77); the slope of t over (U, V) is ((xx, xy), (xy, yy))."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    dn = col_px - n0
    u, v = pitch * (row_px - m0), g_y * pitch * dn
    inverse, over_f = 1.0 / (a1 * v + a2 * u + f), 1.0 / f
    U, V = u * f * inverse, v * f * inverse
    rho2 = U * U + V * V
    B, slope = over_f * (1.0 + rho2 * (b2 + rho2 * b4)), over_f * (2.0 * b2 + 4.0 * b4 * rho2)
    tx, ty = B * U, B * V
    xx, xy, yy = B + slope * U * U, slope * U * V, B + slope * V * V
    fd2 = f * inverse * inverse
    u_u, u_v, v_u, v_v = fd2 * (a1 * v + f), -fd2 * a1 * u, -fd2 * a2 * v, fd2 * (a2 * u + f)
    along_x, along_y = xx * u + xy * v, xy * u + yy * v
    tilted = (a1 * v + a2 * u) * inverse * inverse
    col_x, col_y = pitch * (xx * u_v + xy * v_v), pitch * (xy * u_v + yy * v_v)
    radial_x, radial_y = rho2 * U * over_f, rho2 * V * over_f
    dx = (
        tilted * along_x - tx * over_f, -pitch * (xx * u_u + xy * v_u), -g_y * col_x,
        rho2 * radial_x, radial_x, -fd2 * v * along_x, -fd2 * u * along_x, dn * col_x,
    )  # fmt: skip
    dy = (
        tilted * along_y - ty * over_f, -pitch * (xy * u_u + yy * v_u), -g_y * col_y,
        rho2 * radial_y, radial_y, -fd2 * v * along_y, -fd2 * u * along_y, dn * col_y,
    )  # fmt: skip
    return tx, ty, dx, dy


INVERTED_WANG = CameraModel(
    name="inverted_wang",
    state=InvertedWang,
    star=star,
    equations=Equations(
        runs="from a detector position to a direction, without iteration",
        source="Enright, Jovanovic, Vaz 2018, doi:10.1109/JSEN.2018.2857621, Eqs 1-7",
        steps=(
            "u = pitch (row - m0)",
            "v = g_y pitch (column - n0)",
            "U = u f / (a1 v + a2 u + f)",
            "V = v f / (a1 v + a2 u + f)",
            "rho^2 = U^2 + V^2",
            "B = 1 + b2 rho^2 + b4 rho^4",
            "s = (B U, B V, f) / |(B U, B V, f)|",
        ),
        inverse="solve rho (1 + b2 rho^2 + b4 rho^4) = f |(s_x, s_y)| / s_z on the branch through zero, then u and v linearly",
    ),
)
