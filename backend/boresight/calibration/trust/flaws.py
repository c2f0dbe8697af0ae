"""A flaw of the window or of the detector at one place: the place where the residuals show it most, and how likely noise is to.

A dent, a droplet or a bubble at p_0 bends light as a bump of the optical path of width w does, towards it or away from it:

    u(p) = c (p - p_0) / w exp(-|p - p_0|^2 / 2 w^2),        c in pixels.

Neither a polynomial of low order nor the spline's test, which adds up all there is, has much power for one place. So every
place p_0 is asked. With M and g the information and score of the residual spline (`estimation.residual_spline`: attitudes and
parameters are eliminated in them) and beta the field for c = 1, written as a spline,

    z(p_0) = beta^T g / sqrt(s^2 beta^T M beta)

is a standard normal at every place when there is no flaw, s^2 being the noise over the stated one. What counts is the largest |z|
over the detector. With the metric of a smooth normal field, d^2 = |n(p) - n(p')|^2 for n = M^(1/2) beta / |M^(1/2) beta|, in which
the detector has the area L_2 and half the circumference L_1, the expected Euler characteristic of where z exceeds t,

    p(t) = Phi(-t) + L_1 exp(-t^2 / 2) / (2 pi) + L_2 t exp(-t^2 / 2) / (2 pi)^(3/2),

is the chance that it does so anywhere (Adler and Taylor 2007, Theorem 12.4.1), to a relative error that falls exponentially with
t. It holds for either sign and each of the widths, which are added up: the chance is never understated by that.

Reference: R. J. Adler, J. E. Taylor, "Random fields and geometry", Springer 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation import residual_spline as splines
from boresight.estimation.residual_spline import Axis, Fit
from boresight.estimation.statistics.special import ndtr

#: Widths w that are looked for, in half diagonals of the detector, and places a width along an axis.
WIDTHS, PLACES_A_WIDTH = (0.15, 0.3), 3
#: Information of a field, beside that of the one that is known best, from which on it is rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Flaw:
    """The place where a flaw is likeliest: row, column and width, pixels; z there; p: chance of as much at any place."""

    row_px: float
    col_px: float
    width_px: float
    z: float
    p: float


@dataclass(frozen=True)
class Scan:
    """The likeliest place of a flaw of one width with its z, and L_1 and L_2 of the detector for that width."""

    row_px: float
    col_px: float
    width_px: float
    z: float
    areas: tuple[float, float]


def find_flaw(fit: Fit) -> Flaw | None:
    """Look for the place where a flaw is likeliest in what a camera leaves; None where no place is seen."""
    unit = float(np.hypot(fit.data.row.pixels, fit.data.col.pixels) / 2)
    scans = [one for share in WIDTHS if (one := scan(fit, share * unit)) is not None]
    best = max(scans, key=lambda one: abs(one.z), default=None)
    if best is None:
        return None
    p = sum(2 * chance_of_maximum(abs(best.z), *one.areas) for one in scans)
    return Flaw(best.row_px, best.col_px, best.width_px, best.z, min(1.0, p))


def scan(fit: Fit, width: float) -> Scan | None:
    """Ask every place for a flaw of one width."""
    data = fit.data
    rows, columns, beta = bumps(data.row, data.col, width)
    taken = data.M @ beta
    information = np.sum(beta * taken, axis=0)
    known = information > ROUNDING * max(float(information.max()), np.finfo(float).tiny)
    if not known.any():
        return None
    size = 1 / np.sqrt(np.where(known, information, np.inf))
    z = data.g @ beta * size / np.sqrt(fit.posterior.variance)
    at = int(np.argmax(np.abs(z)))
    areas = measure_field(beta * size, taken * size, (len(rows), len(columns)))
    row, col = (places.ravel()[at] for places in np.meshgrid(rows, columns, indexing="ij"))
    return Scan(float(row), float(col), width, float(z[at]), areas)


@cache
def bumps(row: Axis, col: Axis, width: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows (n,) and columns (m,) of the places of a width's flaws, and their fields as splines (2 k, n m)."""
    rows, columns = (
        np.linspace(0, axis.pixels - 1.0, 1 + int(np.ceil(PLACES_A_WIDTH * axis.pixels / width))) for axis in (row, col)
    )
    at = np.stack(splines.gauss_places(row, col), axis=1)
    centres = np.stack([one.ravel() for one in np.meshgrid(rows, columns, indexing="ij")], axis=1)
    return rows, columns, splines.write_as_spline(row, col, bump(at[..., None], centres.T, width))


def bump(places: FloatArray, centre: FloatArray, width: float) -> FloatArray:
    """Displacements (n, 2, ...) at places (n, 2, ...) by a flaw at a centre (2, ...), pixels a unit of c."""
    away = (places - centre) / width
    return np.asarray(away * np.exp(-np.sum(away**2, axis=1, keepdims=True) / 2))


def measure_field(v: FloatArray, w: FloatArray, shape: tuple[int, int]) -> tuple[float, float]:
    """L_1 and L_2 of a normal field whose values at a grid (n, m) of places have the correlation v^T w; both (k, n m).

    Only neighbours are correlated: of all pairs of places that is one in a hundred.
    """
    v, w = v.reshape(-1, *shape), w.reshape(-1, *shape)
    down, right = (np.diff(v, axis=1), np.diff(w, axis=1)), (np.diff(v, axis=2), np.diff(w, axis=2))

    def dot(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("k...,k...->...", a, b))

    along_rows, along_columns = dot(*down), dot(*right)
    across = dot(down[0][:, :, :-1], right[1][:, :-1])
    square = along_rows[:, :-1] * along_columns[:-1] - across**2
    edge = np.concatenate([along_columns[0], along_rows[:, -1], along_columns[-1], along_rows[:, 0]])
    around = np.sqrt(np.maximum(edge, 0.0))
    return float(np.sum(around)) / 2, float(np.sum(np.sqrt(np.maximum(square, 0.0))))


def chance_of_maximum(t: float, half_around: float, area: float) -> float:
    """Chance that a standard normal field of L_1 and L_2 exceeds t anywhere."""
    density = np.exp(-(t**2) / 2) / (2 * np.pi)
    return float(ndtr(-t) + half_around * density + area * t * density / np.sqrt(2 * np.pi))
