"""The update of a few parameters by whitened rows, in information form, as a compiled loop.

`estimation.filters.information` derives it. Matrices are as small as the number of free parameters; a frame may have
many rows.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part

_part = part(fastmath=FAST)


@_part
def _factor(A, L):
    """Lower Cholesky factor L of A (n, n); NaN on the diagonal where A is not positive definite."""
    for i in range(A.shape[0]):
        for j in range(i + 1):
            value = A[i, j]
            for t in range(j):
                value -= L[i, t] * L[j, t]
            L[i, j] = math.sqrt(value) if i == j else value / L[j, j]


@_part
def _solve(L, b):
    """Solve L L^T y = b in place."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i):
            b[i] -= L[i, j] * b[j]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= L[j, i] * b[j]
        b[i] /= L[i, i]


@loop("f2 f2", first=False, fastmath=FAST)
def invert(A, inverse):
    """Fill the inverse of a positive definite A (n, n). Called by `estimation.filters.information`."""
    n = A.shape[0]
    _invert(A, inverse, np.empty((n, n)), np.empty(n))


@_part
def _invert(A, inverse, L, column):
    """Fill the inverse; L (n, n) and `column` (n,) are room."""
    n = A.shape[0]
    _factor(A, L)
    for j in range(n):
        for i in range(n):
            column[i] = 1.0 if i == j else 0.0
        _solve(L, column)
        for i in range(n):
            inverse[i, j] = column[i]


@loop("f2 f1 f1 f1 f2 f1 f2 f2", first=False, fastmath=FAST)
def information_update(prior, z_prior, z_at, e, H, z, posterior, P):
    """Fill z (n,), `posterior` = prior + H^T H (n, n) and its inverse P; returns the normalised innovation squared.

    Called by `estimation.filters.information`. e (m,) and H (m, n) are whitened rows linearised at `z_at`.
    """
    n = prior.shape[0]
    b, L, column = np.zeros(n), np.empty((n, n)), np.empty(n)
    for p in range(n):
        for q in range(n):
            posterior[p, q] = prior[p, q]
    total = 0.0
    for r in range(e.shape[0]):
        innovation = e[r]
        for p in range(n):
            innovation += H[r, p] * (z_prior[p] - z_at[p])
        total += innovation * innovation
        for p in range(n):
            b[p] += H[r, p] * innovation
            for q in range(p + 1):
                posterior[p, q] += H[r, p] * H[r, q]
    for p in range(n):
        for q in range(p):
            posterior[q, p] = posterior[p, q]
    _invert(posterior, P, L, column)
    for p in range(n):
        move = 0.0
        for q in range(n):
            move += P[p, q] * b[q]
        z[p] = z_prior[p] - move
        total -= b[p] * move
    return total


@loop("f2 f1 f1 f1", first=False, fastmath=FAST)
def cost(prior, z_prior, z, e):
    """Cost of a frame at z: departure from its prior and whitened residuals e (m,), both squared.

    Called by `estimation.filters.information`.
    """
    total = 0.0
    for r in range(e.shape[0]):
        total += e[r] * e[r]
    for p in range(prior.shape[0]):
        for q in range(prior.shape[0]):
            total += (z[p] - z_prior[p]) * prior[p, q] * (z[q] - z_prior[q])
    return total


@loop("f1 f2 f1 f1 f1", first=False, fastmath=FAST)
def worst_departure(e, H, z_at, z, true):
    """Largest difference of true residuals (m,) at z from their linear prediction e + H (z - z_at).

    Called by `estimation.filters.information`.
    """
    worst = 0.0
    for r in range(e.shape[0]):
        departure = true[r] - e[r]
        for p in range(z.shape[0]):
            departure -= H[r, p] * (z[p] - z_at[p])
        worst = max(worst, abs(departure))
    return worst


@loop("f2 f3 f3 i2 i2 f1 f2", first=False, fastmath=FAST)
def whiten(e, H, L, pivot, sizes, e_white, H_white):
    """Fill the whitened rows of a frame, L e' = e and L H' = H over the rows kept; returns their number.

    Called by `estimation.filters.singular`; the arguments are those of `kernels.singular`.
    """
    total = 0
    for x in range(sizes.shape[0]):
        for a in range(sizes[x, 1]):
            r, row, inverse = pivot[x, a], total + a, 1.0 / L[x, a, a]
            value = e[x, r]
            for b in range(a):
                value -= L[x, a, b] * e_white[total + b]
            e_white[row] = value * inverse
            for p in range(H.shape[2]):
                H_white[row, p] = H[x, r, p] * inverse
            for b in range(a):
                weight = L[x, a, b] * inverse
                for p in range(H.shape[2]):
                    H_white[row, p] -= weight * H_white[total + b, p]
        total += sizes[x, 1]
    return total
