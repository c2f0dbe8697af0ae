"""The update by singular values of one exposure without compiled loops, twice: as the textbook has it, and as lean as NumPy allows.

Both do what `kernels.weigh_values`, `value_rows`, `whiten` and `information_update` do for Model 4 with {2, 3}: the catalogue's and
the measured values with their gradients, the full R, the rows that determine the others, whitening, and

    Lambda+ = Lambda + H'^T H',      z+ = z - (Lambda+)^-1 H'^T e'.

`plain_update` decomposes one combination at a time by `numpy.linalg.svd`. `lean_update` decomposes all at once, as eigenvectors of
prefix sums of w w^T, and leaves the choice of rows to LAPACK's pivoted Cholesky factorisation of their correlations. They are the
yardsticks of `studies.singular_speed`; nothing in the product calls them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpstrf

from boresight.arrays import FloatArray, IntArray
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


def _chosen(z: FloatArray, g: FloatArray, measured: NDArray[np.bool_], merge: NDArray[np.bool_]) -> Values:
    """Rows that are measured; where a second and third value lie too close, their sum in place of the second."""
    if not merge.any():
        return z[measured], g[measured]
    pair_z, pair_g = (
        z.reshape(-1, 2).sum(axis=1).repeat(2),
        g.reshape(-1, 2, *g.shape[1:]).sum(axis=1).repeat(2, axis=0),
    )
    return np.where(merge, pair_z[measured], z[measured]), np.where(merge[:, None, None], pair_g[measured], g[measured])


def _taken(
    factor: FloatArray, e: FloatArray, H: FloatArray, z: FloatArray, information: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Whiten rows by the lower factor of their covariance and take them in."""
    white = np.linalg.solve(factor, np.column_stack([H, e]))
    whitened, residuals = white[:, :-1], white[:, -1]
    information = information + whitened.T @ whitened
    return z - np.linalg.solve(information, whitened.T @ residuals), information
