"""The information filter over passes as a compiled loop: what the passes up to each one know of parameters that walk.

`estimation.walk` derives it and is its caller; the tests hold it against the dense likelihood.
"""

from __future__ import annotations

import numpy as np

from boresight.kernels.compilation import loop, part

#: Share of its diagonal below which a pivot is an open direction.
OPEN = 1e-13


@part()
def factor(M):
    """Put the lower Cholesky factor of M (n, n) into its lower half; returns log |M|, NaN where M leaves a direction open."""
    total = 0.0
    for j in range(M.shape[0]):
        pivot = M[j, j]
        for i in range(j):
            pivot -= M[j, i] * M[j, i]
        if not pivot > OPEN * M[j, j]:
            return np.nan
        total += np.log(pivot)
        M[j, j] = np.sqrt(pivot)
        for k in range(j + 1, M.shape[0]):
            value = M[k, j]
            for i in range(j):
                value -= M[k, i] * M[j, i]
            M[k, j] = value / M[j, j]
    return total


@part()
def half_solve(L, right, n_columns):
    """Turn the first columns of right (n, ...) into L^-1 times them."""
    for i in range(L.shape[0]):
        for c in range(n_columns):
            value = right[i, c]
            for j in range(i):
                value -= L[i, j] * right[j, c]
            right[i, c] = value / L[i, i]


@loop("f3 f3 f2 f3 f3 f2", first=False)
def filter_passes(A, right, W, known, known_right, border):
    """Filter passes whose own parameters follow a random walk, beside the parameters common to all (the border).

    A (n_passes, m, m) and right (n_passes, m, n_border) are of each pass alone, W (n_passes, m) is the information between a pass
    and the one before it. Fills `known` and `known_right`, the same of all passes up to each; takes what the passes know from
    `border` (n_border, n_border), and returns log |H| of what was eliminated, NaN where a direction is open.
    """
    K, m, n_border = right.shape
    L, rest, gain, solved = np.empty((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty((m, n_border))
    total = 0.0
    for k in range(K):
        for i in range(m):
            for j in range(m):
                known[k, i, j] = A[k, i, j]
            for c in range(n_border):
                known_right[k, i, c] = right[k, i, c]
        if k > 0:  # (A_f^-1 + W^-1)^-1 = W M^-1 A_f with M = A_f + W = L L^T, and W M^-1 of the right sides
            for i in range(m):
                for j in range(m):
                    value = 0.0
                    for p in range(m):
                        value += gain[p, i] * rest[p, j]
                    known[k, i, j] += 0.5 * value
                    known[k, j, i] += 0.5 * value
                for c in range(n_border):
                    value = 0.0
                    for p in range(m):
                        value += gain[p, i] * solved[p, c]
                    known_right[k, i, c] += value
        for i in range(m):
            for j in range(m):
                L[i, j] = rest[i, j] = known[k, i, j]
                gain[i, j] = 0.0
            if k + 1 < K:
                L[i, i] += W[k + 1, i]
                gain[i, i] = W[k + 1, i]
            for c in range(n_border):
                solved[i, c] = known_right[k, i, c]
        total += factor(L)
        if np.isnan(total):
            return total
        half_solve(L, solved, n_border)
        half_solve(L, gain, m)
        half_solve(L, rest, m)
        for a in range(n_border):
            for b in range(a + 1):
                value = 0.0
                for i in range(m):
                    value += solved[i, a] * solved[i, b]
                border[a, b] -= value
                if a != b:
                    border[b, a] -= value
    return total
