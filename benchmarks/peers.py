"""The work of the compiled loops as others would write it: NumPy in batches, SciPy's optimiser, a NumPy filter, SciPy's trees, C.

The C peer is `arclengths.c` beside this file, by gcc -O3 -march=native on one thread, compiled into a folder that is thrown away
when the measurement ends; without a C compiler there are no such figures.

Matching by SciPy goes exposure by exposure: attitude by `Rotation.align_vectors` from the named stars, the catalogue's stars of
the field from a k-d tree, each detection its nearest star inside one fixed tolerance, then arcs pair by pair, the worst offender
dropped first, and the attitude again. There is no parameter covariance in it, no second exposure, no doubt between two stars: it
does less than the product does.

The update by singular values is there twice. Both do what `kernels.factor_values`, `value_rows`, `whiten` and `information_update`
do for Model 4 with {2, 3}: the catalogue's and the measured values with their gradients, the full R, the rows that determine the
others, whitening, and

    Lambda+ = Lambda + H'^T H',      z+ = z - (Lambda+)^-1 H'^T e'.

`plain_update` decomposes one combination at a time by `numpy.linalg.svd`. `lean_update` decomposes all at once, as eigenvectors of
prefix sums of w w^T, and leaves the choice of rows to LAPACK's pivoted Cholesky factorisation of their correlations.
"""

from __future__ import annotations

import ctypes
import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpstrf
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters import FilterHistory, Tuning
from boresight.estimation.filters.history import FilterState
from boresight.estimation.filters.square_root import padded
from boresight.estimation.singular_values import (
    APART,
    CHOSEN,
    DETERMINED,
    decomposition,
    determined_rows,
    members,
    row_of_value,
    windows,
)


def plain_directions(
    x: FloatArray, row_px: FloatArray, col_px: FloatArray, pitch: float
) -> tuple[FloatArray, FloatArray]:
    """Directions (n, 3) of `inverted_wang` and their derivatives (n, 3, 8) in NumPy, by rays and not by tangents (E Eqs 1-77)."""
    f, m0, n0, b4, b2, a1, a2, g_y = x
    u, v = pitch * (row_px - m0), g_y * pitch * (col_px - n0)
    D = a1 * v + a2 * u + f
    U, V = u * f / D, v * f / D
    rho2 = U * U + V * V
    B, slope = 1 + rho2 * (b2 + rho2 * b4), 2 * b2 + 4 * b4 * rho2
    zero, fd2, dn = np.zeros_like(U), f / D**2, pitch * (col_px - n0)
    dU_du, dU_dv = fd2 * (a1 * v + f), -fd2 * a1 * u
    dV_du, dV_dv = -fd2 * a2 * v, fd2 * (a2 * u + f)
    tilt = (a1 * v + a2 * u) / D**2
    dU = [u * tilt, -pitch * dU_du, -g_y * pitch * dU_dv, zero, zero, -fd2 * u * v, -fd2 * u * u, dn * dU_dv]
    dV = [v * tilt, -pitch * dV_du, -g_y * pitch * dV_dv, zero, zero, -fd2 * v * v, -fd2 * v * u, dn * dV_dv]
    dB_explicit = [zero, zero, zero, rho2**2, rho2, zero, zero, zero]
    dr = np.zeros((*U.shape, 3, 8))
    for p in range(8):
        dB = slope * (U * dU[p] + V * dV[p]) + dB_explicit[p]
        dr[..., 0, p], dr[..., 1, p] = B * dU[p] + U * dB, B * dV[p] + V * dB
    dr[..., 2, 0] = 1.0
    r = np.stack([B * U, B * V, np.full_like(U, f)], axis=-1)
    length = np.linalg.norm(r, axis=-1, keepdims=True)
    s = r / length
    along = np.einsum("...i,...ip->...p", s, dr)
    return s, (dr - s[..., None] * along[..., None, :]) / length[..., None]


@dataclass(frozen=True)
class EqualExposures:
    """Exposures with the same number n of stars, so that NumPy can take them in one piece: arrays (n_exposures, ...).

    Centroids (n,) in arc order, catalogue arcs phi (2n - 3,), rad, and the inverse of the lower factor of R (2n - 3, 2n - 3).
    """

    pitch: float
    row_px: FloatArray
    col_px: FloatArray
    phi: FloatArray
    whitener: FloatArray

    @classmethod
    def of(cls, arcs: ArcSet, n: int) -> EqualExposures:
        """Reshape a whitened set of n-star exposures, and invert its factors."""
        m = 2 * n - 3
        band = arcs.band.reshape(-1, m, 5)
        L = np.zeros((len(band), m, m))
        for d in range(5):
            L[:, np.arange(d, m), np.arange(m - d)] = band[:, d:, 4 - d]
        row, col, phi = arcs.row_px.reshape(-1, n), arcs.col_px.reshape(-1, n), arcs.phi.reshape(-1, m)
        return cls(arcs.pitch, row, col, phi, np.asarray(np.linalg.inv(L)))

    def part(self, first: int, last: int) -> EqualExposures:
        """Return the exposures first <= k < last."""
        part = slice(first, last)
        return EqualExposures(self.pitch, self.row_px[part], self.col_px[part], self.phi[part], self.whitener[part])

    def rows(self, x: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (n_arcs,) and scaled Jacobian (n_arcs, 8) of all exposures at once."""
        s, ds = plain_directions(x, self.row_px, self.col_px, self.pitch)
        i, j = arcsets.pairs(self.row_px.shape[1]).T
        measured = arcsets.arclength(s[:, i], s[:, j])
        e = measured - self.phi
        H = np.einsum("kai,kaip->kap", s[:, j], ds[:, i]) + np.einsum("kai,kaip->kap", s[:, i], ds[:, j])
        H *= -(1.0 / np.sin(measured))[..., None] * scale
        return (self.whitener @ e[..., None]).ravel(), (self.whitener @ H).reshape(-1, len(x))


def numpy_evaluation(data: EqualExposures, x: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A and b of the normal equations by batched NumPy with a dense whitener."""
    e, H = data.rows(x, scale)
    return H.T @ H, H.T @ e


def scipy_fit(data: EqualExposures, x_0: FloatArray, scale: FloatArray) -> tuple[FloatArray, int]:
    """Fit by `scipy.optimize.least_squares` with the analytic Jacobian, batched: x (8,), and how often both were evaluated."""
    solved = least_squares(
        lambda z: data.rows(x_0 + z * scale, scale)[0],
        np.zeros(len(x_0)),
        jac=lambda z: data.rows(x_0 + z * scale, scale)[1],
        xtol=1e-10,
    )
    return np.asarray(x_0 + solved.x * scale), int(solved.njev)


def numpy_square_root_filter(
    arcs: ArcSet, x_0: FloatArray, scale: FloatArray, start_sigma: float, linearisations: int, rest: float
) -> FloatArray:
    """The whole job of the product's filter, frame by frame in plain NumPy; returns x (8,).

    Each frame gets its R (E Eqs 16-18) and Cholesky factor, its model and Jacobian, Carlson's update element by element as the
    textbook prints it (Grewal and Andrews), and is linearised again until its residual agrees with its linear prediction.
    """
    z, S = np.zeros(len(x_0)), start_sigma * np.eye(len(x_0))
    for k in range(arcs.n_frames):
        frame = arcs.frames(k, k + 1)
        whiteners = _plain_whiteners(frame, x_0 + z * scale)
        z_prior, S_prior = z, S
        for _ in range(linearisations):
            z_lin = z
            e, H = _plain_rows(frame, x_0 + z * scale, scale, whiteners)
            z, S = z_prior.copy(), S_prior.copy()
            for a in range(len(e)):
                _carlson(z, S, H[a], e[a] + H[a] @ (z - z_lin))
            after, _ = _plain_rows(frame, x_0 + z * scale, scale, whiteners)
            if np.abs(after - e - H @ (z - z_lin)).max() < rest:
                break
    return np.asarray(x_0 + z * scale)


def _plain_whiteners(frame: ArcSet, x: FloatArray) -> list[FloatArray]:
    """Inverse Cholesky factors of each exposure's full R at state x."""
    sigma = arcsets.angular_sigma(INVERTED_WANG, x, frame)
    parts = [slice(*frame.star_start[m : m + 2]) for m in range(frame.n_exposures)]
    return [np.linalg.inv(np.linalg.cholesky(arcsets.covariance(frame.s_i[part], sigma[part]))) for part in parts]


def _plain_rows(
    frame: ArcSet, x: FloatArray, scale: FloatArray, whiteners: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals and scaled Jacobian of a frame, exposure by exposure."""
    residuals, jacobians = [], []
    for m, whitener in enumerate(whiteners):
        part = slice(*frame.star_start[m : m + 2])
        s, ds = plain_directions(x, frame.row_px[part], frame.col_px[part], frame.pitch)
        i, j = arcsets.pairs(len(s)).T
        measured = arcsets.arclength(s[i], s[j])
        e = measured - arcsets.arclength(frame.s_i[part][i], frame.s_i[part][j])
        H = np.einsum("ai,aip->ap", s[j], ds[i]) + np.einsum("ai,aip->ap", s[i], ds[j])
        residuals.append(whitener @ e)
        jacobians.append(whitener @ (-H / np.sin(measured)[:, None] * scale))
    return np.concatenate(residuals), np.concatenate(jacobians)


def _carlson(z: FloatArray, S: FloatArray, h: FloatArray, innovation: float) -> None:
    """One scalar update in place, see `estimation.filters.square_root`."""
    n = len(z)
    f, gain = S.T @ h, np.zeros(n)
    alpha = 1.0
    for j in range(n):
        before, alpha = alpha, alpha + f[j] ** 2
        keep, move = np.sqrt(before / alpha), f[j] / np.sqrt(before * alpha)
        for i in range(j + 1):
            old = S[i, j]
            S[i, j] = keep * old - move * gain[i]
            gain[i] += old * f[j]
    z -= gain / alpha * innovation


def numpy_lean_square_root_filter(
    data: EqualExposures, x_0: FloatArray, scale: FloatArray, start_sigma: float
) -> FloatArray:
    """The leanest NumPy filter: whiteners given, one linearisation a frame, a column of S in one expression; returns x (8,)."""
    z, S = np.zeros(len(x_0)), start_sigma * np.eye(len(x_0))
    for first in range(0, len(data.phi), 2):
        z_lin = z.copy()
        e, H = data.part(first, first + 2).rows(x_0 + z * scale, scale)
        for a in range(len(e)):
            _carlson_by_columns(z, S, H[a], e[a] + H[a] @ (z - z_lin))
    return np.asarray(x_0 + z * scale)


def _carlson_by_columns(z: FloatArray, S: FloatArray, h: FloatArray, innovation: float) -> None:
    """One scalar update in place with each column in one NumPy expression."""
    f, gain = S.T @ h, np.zeros(len(z))
    alpha = 1.0
    for j in range(len(z)):
        before, alpha = alpha, alpha + f[j] ** 2
        column = S[:, j].copy()
        S[:, j] = np.sqrt(before / alpha) * column - f[j] / np.sqrt(before * alpha) * gain
        gain += column * f[j]
    z -= gain / alpha * innovation


def numpy_extended_filter(
    data: EqualExposures, x_0: FloatArray, scale: FloatArray, start_sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Vector extended Kalman filter, whiteners given, one linearisation a frame; returns x (8,) and P (8, 8)."""
    z, P = np.zeros(len(x_0)), start_sigma**2 * np.eye(len(x_0))
    for first in range(0, len(data.phi), 2):
        e, H = data.part(first, first + 2).rows(x_0 + z * scale, scale)
        K = np.linalg.solve(H @ P @ H.T + np.eye(len(e)), H @ P).T
        z, P = z - K @ e, (np.eye(len(z)) - K @ H) @ P
    return np.asarray(x_0 + z * scale), P


def scipy_match(
    row_start: IntArray,
    s_d: FloatArray,
    given: IntArray,
    hip: IntArray,
    s_i: FloatArray,
    cone_rad: float,
    tolerance_rad: float,
) -> IntArray:
    """Match every exposure that has two named stars.

    Parameters
    ----------
    row_start
        (n_exposures + 1,) first detection of each exposure.
    s_d, given
        (n_rows, 3) measured directions, right-handed, and (n_rows,) star numbers given, 0 = none.
    hip, s_i
        (n_stars,) numbers, ascending, and (n_stars, 3) apparent directions of the catalogue's stars.
    cone_rad
        Angle from the boresight to the farthest corner of the detector.
    tolerance_rad
        Largest distance of a match from its predicted place, and of an arc from the catalogue's.
    """
    matched, sky = np.zeros_like(given), KDTree(s_i)
    for first, last in itertools.pairwise(row_start):
        rows = slice(first, last)
        named = np.flatnonzero(given[rows] > 0)
        if len(named) >= 2:
            stars = np.searchsorted(hip, given[rows][named])
            turn, _ = Rotation.align_vectors(s_d[rows][named], s_i[stars])
            matched[rows] = _exposure(s_d[rows], turn, sky, hip, s_i, cone_rad, tolerance_rad)
    return matched


def _exposure(
    s_d: FloatArray, turn: Rotation, sky: KDTree, hip: IntArray, s_i: FloatArray, cone_rad: float, tolerance_rad: float
) -> IntArray:
    """Match one exposure from its attitude: (n,) star numbers, 0 = none."""
    field = np.array(sky.query_ball_point(turn.as_matrix()[2], 2 * np.sin(cone_rad / 2)))
    distance, nearest = KDTree(turn.apply(s_i[field])).query(s_d)
    found = np.flatnonzero(distance < tolerance_rad)
    star = field[nearest[found]]
    agree = np.abs(_arcs(s_d[found]) - _arcs(s_i[star])) <= tolerance_rad
    kept = np.arange(len(found))
    while len(kept) and not agree[np.ix_(kept, kept)].all():
        kept = np.delete(kept, np.argmin(agree[np.ix_(kept, kept)].sum(axis=0)))
    if len(kept) >= 2:
        Rotation.align_vectors(s_d[found[kept]], s_i[star[kept]])
    matched = np.zeros(len(s_d), np.int64)
    matched[found[kept]] = hip[star[kept]]
    return matched


def _arcs(s: FloatArray) -> FloatArray:
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(s[:, None] - s, axis=-1) / 2, 0.0, 1.0)))


#: Catalogue directions (n, 3) and their errors (n,) rad.
Known = tuple[FloatArray, FloatArray]
#: Measured directions (n, 3) and scaled derivatives (n, 3, n_free).
Seen = tuple[FloatArray, FloatArray]
#: Values (m,) and their gradients (m, n, 3).
Values = tuple[FloatArray, FloatArray]


def plain_update(known: Known, seen: Seen, z: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return z+ and Lambda+ of an exposure, combination by combination."""
    (s_i, sigma_rad), (s, D) = known, seen
    combinations = [members(len(s), window) for window in windows(len(s), CHOSEN.model)]
    catalogue = [decomposition(s_i[stars]) for stars in combinations]
    rows: list[IntArray] = []
    for stars, (sigma, _) in zip(combinations, catalogue, strict=True):
        own = row_of_value(sigma, CHOSEN, float(sigma_rad[stars].max()))
        rows.append(np.where(own >= 0, own + max((int(row.max()) + 1 for row in rows), default=0), -1))
    z_i, g_i = _stacked(s_i, combinations, catalogue, rows)
    G = sigma_rad[:, None] * (g_i - np.einsum("rnj,nj->rn", g_i, s_i)[..., None] * s_i)
    R = np.einsum("rnj,snj->rs", G, G)
    kept = determined_rows(R)
    values, g = _stacked(s, combinations, [decomposition(s[stars]) for stars in combinations], rows)
    factor = np.linalg.cholesky(R[np.ix_(kept, kept)])
    return _taken(factor, (values - z_i)[kept], np.einsum("rnj,njp->rp", g, D)[kept], z, information)


def _stacked(
    s: FloatArray, combinations: list[IntArray], found: list[tuple[FloatArray, FloatArray]], rows: list[IntArray]
) -> Values:
    """Stack values and gradients of decomposed combinations by the row that each takes part in."""
    m = max(int(row.max()) for row in rows) + 1
    z, g = np.zeros(m), np.zeros((m, len(s), 3))
    for stars, (sigma, P), row in zip(combinations, found, rows, strict=True):
        for k in np.flatnonzero(row >= 0):
            z[row[k]] += sigma[k]
            g[row[k], stars] += np.outer(s[stars] @ P[:, k] / sigma[k], P[:, k])
    return z, g


def lean_update(known: Known, seen: Seen, z: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return z+ and Lambda+ of an exposure, all combinations at once."""
    (s_i, sigma_rad), (s, D) = known, seen
    sigma, z_i, g_i = _at_once(s_i)
    noise = APART * np.maximum.accumulate(sigma_rad)[2:]
    merged = sigma[:, 1] - sigma[:, 2] < noise
    second = sigma[:, 0] - sigma[:, 1] >= noise
    third = sigma[:, 2] > noise
    measured = np.stack([second & (third | ~merged), third & ~merged], axis=1).ravel()
    merge = np.repeat(merged, 2)[measured]
    values, g = _at_once(s)[1:]
    (z_i, g_i), (values, g) = _chosen(z_i, g_i, measured, merge), _chosen(values, g, measured, merge)
    G = (sigma_rad[:, None] * (g_i - np.einsum("rnj,nj->rn", g_i, s_i)[..., None] * s_i)).reshape(len(g_i), -1)
    R = G @ G.T
    row_sigma = np.sqrt(R.diagonal())
    correlation = R / np.outer(row_sigma, row_sigma)
    np.fill_diagonal(correlation, 1.0)
    factor, pivot, rank, _ = dpstrf(correlation, lower=1, tol=DETERMINED)
    kept = pivot[:rank] - 1
    factor = row_sigma[kept, None] * np.tril(factor[:rank, :rank])
    H = g[kept].reshape(rank, -1) @ D.reshape(g[0].size, -1)
    return _taken(factor, (values - z_i)[kept], H, z, information)


def _at_once(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All values (n - 2, 3) of Model 4, then the second and third in turn (2 n - 4,) with their gradients (2 n - 4, n, 3)."""
    squares, P = np.linalg.eigh(np.cumsum(s[:, :, None] * s[:, None, :], axis=0)[2:])
    sigma, P = np.sqrt(np.maximum(squares[:, ::-1], 0.0)), P[:, :, ::-1]
    inside = np.tri(len(s), dtype=bool)[2:, None]
    along = np.einsum("nj,cjk->ckn", s, P[:, :, 1:]) / sigma[:, 1:, None] * inside
    return sigma, sigma[:, 1:].ravel(), np.einsum("ckn,cjk->cknj", along, P[:, :, 1:]).reshape(-1, len(s), 3)


def _chosen(z: FloatArray, g: FloatArray, measured: BoolArray, merge: BoolArray) -> Values:
    """Rows that are measured; where a second and third value lie too close, their sum in place of the second."""
    if not merge.any():
        return z[measured], g[measured]
    pair_z = z.reshape(-1, 2).sum(axis=1).repeat(2)
    pair_g = g.reshape(-1, 2, *g.shape[1:]).sum(axis=1).repeat(2, axis=0)
    return np.where(merge, pair_z[measured], z[measured]), np.where(merge[:, None, None], pair_g[measured], g[measured])


def _taken(
    factor: FloatArray, e: FloatArray, H: FloatArray, z: FloatArray, information: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Whiten rows by the lower factor of their covariance and take them in."""
    white = np.linalg.solve(factor, np.column_stack([H, e]))
    whitened, residuals = white[:, :-1], white[:, -1]
    information = information + whitened.T @ whitened
    return z - np.linalg.solve(information, whitened.T @ residuals), information


SOURCE = Path(__file__).with_name("arclengths.c")
COMPILERS = ("gcc", "cc", "clang")
FLAGS = ("-std=c11", "-O3", "-march=native", "-fPIC")
#: IEEE order of sums as a C programmer gets it by default, and reordered as our loops allow it.
VARIANTS = {"c": (), "c_fast_math": ("-ffast-math",)}
COMPILE_S = 60.0


@dataclass(frozen=True)
class CPeer:
    """A compiled copy of the C source."""

    library: ctypes.CDLL

    def normal_equations(
        self, arcs: ArcSet, x: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (8, 8), b (8,) and (chi-square, sum of squares) with all eight parameters free, as `batch.normal_equations`."""
        _refuse_other_models(arcs)
        free = np.arange(len(scale))
        A, b, costs = np.empty((len(free), len(free))), np.empty(len(free)), np.empty(2)
        self.library.normal_equations(
            _at(x), ctypes.c_double(arcs.pitch), ctypes.c_long(len(arcs.star_start) - 1), _at(arcs.star_start), _at(arcs.row_px),
            _at(arcs.col_px), _at(arcs.phi), _at(arcs.band), ctypes.c_long(len(free)), _at(free), _at(scale), _at(A), _at(b),
            _at(costs),
        )  # fmt: skip
        return A, b, costs

    def square_root_filter(self, arcs: ArcSet, state: FilterState, scale: FloatArray, tuning: Tuning) -> FilterHistory:
        """Run Carlson's filter without process noise over whitened arcs, all eight parameters free."""
        _refuse_other_models(arcs)
        n, free = arcs.n_frames, np.arange(len(scale))
        x, z, S = state.x.copy(), padded(state.z, 8), padded(state.S, 8)
        states, sigmas, nis, squares = np.empty((n, len(x))), np.empty((n, len(free))), np.empty(n), np.empty(n)
        self.library.square_root_filter(
            _at(x), _at(z), _at(S.T), ctypes.c_double(arcs.pitch), ctypes.c_long(n), _at(arcs.frame_start), _at(arcs.star_start),
            _at(arcs.row_px), _at(arcs.col_px), _at(arcs.phi), _at(arcs.band), ctypes.c_long(len(free)), _at(free), _at(scale),
            ctypes.c_long(tuning.linearisations), ctypes.c_double(tuning.rest), _at(states), _at(sigmas), _at(nis), _at(squares),
        )  # fmt: skip
        dof = 2 * np.diff(arcs.star_start[arcs.frame_start]) - 3 * np.diff(arcs.frame_start)
        return FilterHistory(states, sigmas, nis, dof, squares, np.zeros(n, np.int64), FilterState(x, z, S), True)


@contextmanager
def compiled() -> Iterator[dict[str, CPeer]]:
    """Compile every variant for the length of a measurement; empty where there is no C compiler that can."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    with tempfile.TemporaryDirectory(prefix="boresight-c-") as folder:
        yield {} if compiler is None else dict(_built(compiler, Path(folder)))


def _built(compiler: str, folder: Path) -> Iterator[tuple[str, CPeer]]:
    for name, more in VARIANTS.items():
        target = folder / f"{name}.so"
        part = target.with_suffix(".o")
        # linked apart: gcc would link a start file with -ffast-math that lets this whole process lose its denormal numbers
        steps = [
            [compiler, *FLAGS, *more, "-c", str(SOURCE), "-o", str(part)],
            [compiler, "-shared", str(part), "-o", str(target), "-lm"],
        ]
        if not any(
            subprocess.run(words, capture_output=True, timeout=COMPILE_S, check=False).returncode for words in steps
        ):
            yield name, CPeer(ctypes.CDLL(str(target)))


def _refuse_other_models(arcs: ArcSet) -> None:
    """Raise where the C source does not know the model."""
    if arcs.camera != INVERTED_WANG:
        raise ValueError(f"Expected arcs of inverted_wang / Received {arcs.camera.name}")


def _at(values: NDArray[Any]) -> ctypes.c_void_p:
    if not values.flags.c_contiguous or values.dtype not in (np.float64, np.dtype(ctypes.c_long)):
        raise ValueError(f"Expected a contiguous array of doubles or longs / Received {values.dtype}, {values.flags}")
    return ctypes.c_void_p(values.ctypes.data)
