"""Singular values of star combinations as compiled loops: their covariance, derivatives and whitened rows.

`estimation.singular_values` derives all of it. Nothing larger than 3 by 3 is decomposed. With the prefix sums over stars of
w w^T (six numbers) and of w dw^T + dw w^T (six by n_parameters), every window's sums are a difference of two, and

    sigma_k = sqrt(lambda_k),       d sigma_k / dx = p_k^T d(W W^T)/dx p_k / (2 sigma_k)

cost the same for three stars as for thirty. The exposures of one frame are taken together; `most` is the number of stars of the
fullest of them, and arrays are that large for each. The tests hold every loop against plain NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part

_SIX = 6
#: Jacobi sweeps of a 3 by 3 matrix; convergence is quadratic and five are enough.
_SWEEPS = 12
_SMALL = 1e-34  # of the squared trace: off-diagonal squares below it are rounding

_part = part(fastmath=FAST)


@_part
def _rotate(A, P, p, q):
    """One Jacobi rotation that makes A[p, q] zero; A (3, 3) symmetric, eigenvectors gather in the columns of P."""
    if A[p, q] == 0.0:
        return
    theta = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    o = 3 - p - q
    moved = t * A[p, q]
    A[p, p] -= moved
    A[q, q] += moved
    A[p, q] = A[q, p] = 0.0
    left, right = A[o, p], A[o, q]
    A[o, p] = A[p, o] = c * left - s * right
    A[o, q] = A[q, o] = s * left + c * right
    for i in range(3):
        left, right = P[i, p], P[i, q]
        P[i, p] = c * left - s * right
        P[i, q] = s * left + c * right


@_part
def _decompose(sums, A, P, value):
    """Singular values (3,), descending, and left vectors as columns of P, from w w^T summed as xx xy xz yy yz zz."""
    A[0, 0], A[1, 1], A[2, 2] = sums[0], sums[3], sums[5]
    A[0, 1] = A[1, 0] = sums[1]
    A[0, 2] = A[2, 0] = sums[2]
    A[1, 2] = A[2, 1] = sums[4]
    P[:] = 0.0
    P[0, 0] = P[1, 1] = P[2, 2] = 1.0
    small = _SMALL * (A[0, 0] + A[1, 1] + A[2, 2]) ** 2
    for _ in range(_SWEEPS):
        if not A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2] > small:
            break
        _rotate(A, P, 0, 1)
        _rotate(A, P, 0, 2)
        _rotate(A, P, 1, 2)
    for first, second in ((0, 1), (1, 2), (0, 1)):
        if A[first, first] < A[second, second]:
            A[first, first], A[second, second] = A[second, second], A[first, first]
            for i in range(3):
                P[i, first], P[i, second] = P[i, second], P[i, first]
    for k in range(3):
        value[k] = math.sqrt(max(A[k, k], 0.0)) if A[k, k] == A[k, k] else math.nan


@_part
def _combinations(n, model):
    """Return how many combinations n stars have under a model."""
    return n - 2 if model == 4 else n


@_part
def _window(n, model, c):
    """First star and number of stars of combination c."""
    if model == 4:
        return 0, c + 3
    if model == 1:
        return c, 3
    return c, max(3, n // 2) if model == 2 else n - 1


@_part
def _over_window(prefix, n, first, size, total):
    """Fill `total` with the sum over a window from prefix sums (n + 1, ...); it runs on past the last star to the first."""
    last = first + size
    if last <= n:
        for i in range(total.shape[0]):
            total[i] = prefix[last, i] - prefix[first, i]
    else:
        for i in range(total.shape[0]):
            total[i] = prefix[n, i] - prefix[first, i] + prefix[last - n, i]


@_part
def _prefix(s, prefix):
    """Fill prefix sums (n + 1, 6) of w w^T."""
    prefix[0] = 0.0
    for i in range(s.shape[0]):
        x, y, z = s[i, 0], s[i, 1], s[i, 2]
        prefix[i + 1, 0], prefix[i + 1, 1], prefix[i + 1, 2] = x * x, x * y, x * z
        prefix[i + 1, 3], prefix[i + 1, 4], prefix[i + 1, 5] = y * y, y * z, z * z
        for a in range(_SIX):
            prefix[i + 1, a] += prefix[i, a]


@_part
def _prefix_slopes(s, D, slopes):
    """Fill prefix sums (n + 1, 6 n_parameters) of w dw^T + dw w^T."""
    slopes[0] = 0.0
    for i in range(s.shape[0]):
        place = 0
        for a in range(3):
            for b in range(a, 3):
                for p in range(D.shape[2]):
                    slopes[i + 1, place] = slopes[i, place] + s[i, a] * D[i, b, p] + s[i, b] * D[i, a, p]
                    place += 1


@_part
def _rows_of_values(value, chosen, apart, place, row):
    """Fill the row (3,) that each value takes part in, -1 for none, from row `place` on; return the next free row."""
    k = 0
    while k < 3:
        last = k
        while last < 2 and value[last] - value[last + 1] < apart:
            last += 1
        wanted = value[last] > apart
        for j in range(k, last + 1):
            wanted = wanted and chosen[j]
        for j in range(k, last + 1):
            row[j] = place if wanted else -1
        place += 1 if wanted else 0
        k = last + 1
    return place


@_part
def _add_combination(s, sigma, P, value, row, first, size, G):
    """Add h_ri = sigma_i (I - w w^T) g_ri of one combination to its rows of G (m, 3 n)."""
    n = s.shape[0]
    for k in range(3):
        if row[k] < 0:
            continue
        x, y, z, inverse = P[0, k], P[1, k], P[2, k], 1.0 / value[k]
        for t in range(first, first + size):
            i = t if t < n else t - n
            c = x * s[i, 0] + y * s[i, 1] + z * s[i, 2]
            weight = sigma[i] * c * inverse
            G[row[k], 3 * i] += weight * (x - c * s[i, 0])
            G[row[k], 3 * i + 1] += weight * (y - c * s[i, 1])
            G[row[k], 3 * i + 2] += weight * (z - c * s[i, 2])


@_part
def _factor(G, ends, determined, L, pivot, full, variance, left):
    """Cholesky factor L (rank, rank) of G G^T over the rows that determine the others, in the order `pivot`; returns the rank.

    The row with the largest share of its own variance left comes next. Row r of G is zero from column `ends[r]` on.
    """
    m = G.shape[0]
    for r in range(m):
        variance[r] = 0.0
        for t in range(ends[r]):
            variance[r] += G[r, t] * G[r, t]
        left[r] = variance[r]
    rank = 0
    while rank < m:
        best = 0
        for r in range(1, m):
            if left[r] * variance[best] > left[best] * variance[r]:
                best = r
        if not left[best] > determined * variance[best]:
            break
        root = math.sqrt(left[best])
        pivot[rank] = best
        left[best] = -1.0
        full[best, rank] = root
        for r in range(m):
            if left[r] < 0.0:
                continue
            value = 0.0
            for t in range(min(ends[r], ends[best])):
                value += G[r, t] * G[best, t]
            for t in range(rank):
                value -= full[r, t] * full[best, t]
            value /= root
            full[r, rank] = value
            left[r] = max(left[r] - value * value, 0.0)
        for t in range(rank + 1):
            L[rank, t] = full[best, t]
        rank += 1
    return rank


@loop("i1 f2 f1 i b1 f f i3 f2 f3 i2 i2", first=False, fastmath=FAST)
def factor_values(star_start, s_i, sigma, model, chosen, apart, determined, rows, z, L, pivot, sizes):
    """Take the catalogue's values of one frame and factor their covariance. Called by `estimation.filters.singular`.

    `star_start` (n_exposures + 1,) begins at 0; `sigma` (n_stars,) rad; `chosen` (3,). Fills per exposure `rows`
    (most, 3), the row that each value of a combination takes part in; `z` (3 most,), the values; `L` (3 most, 3 most) with `pivot`
    (3 most,), the factor over the rows kept; `sizes` (2,), the number of rows and of those kept.
    """
    most = rows.shape[1]
    prefix, sums = np.empty((most + 1, _SIX)), np.empty(_SIX)
    A, P, value = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    full, ends = np.empty((3 * most, 3 * most)), np.empty(3 * most, np.int64)
    variance, left, G = np.empty(3 * most), np.empty(3 * most), np.empty((3 * most, 3 * most))
    for e in range(star_start.shape[0] - 1):
        s, noise = s_i[star_start[e] : star_start[e + 1]], sigma[star_start[e] : star_start[e + 1]]
        n = s.shape[0]
        for r in range(3 * n):
            for t in range(3 * n):
                G[r, t] = 0.0
        _prefix(s, prefix)
        z[e] = 0.0
        m = 0
        for c in range(_combinations(n, model)):
            first, size = _window(n, model, c)
            _over_window(prefix, n, first, size, sums)
            _decompose(sums, A, P, value)
            worst = 0.0
            for t in range(first, first + size):
                worst = max(worst, noise[t if t < n else t - n])
            after = _rows_of_values(value, chosen, apart * worst, m, rows[e, c])
            for r in range(m, after):
                ends[r] = 3 * min(first + size, n)
            m = after
            for k in range(3):
                if rows[e, c, k] >= 0:
                    z[e, rows[e, c, k]] += value[k]
            _add_combination(s, noise, P, value, rows[e, c], first, size, G)
        sizes[e, 0] = m
        sizes[e, 1] = _factor(G[:m], ends, determined, L[e], pivot[e], full, variance, left)


@loop("i1 f2 f3 i1 f1 i i3 f2 f2 f3", first=False, fastmath=FAST)
def value_rows(star_start, s, D, free, scale, model, rows, z, e, H):
    """Fill e (n_exposures, 3 most), measured minus catalogue values, and H (n_exposures, 3 most, n_free), in units of `scale`.

    Called by `estimation.filters.singular`; s (n_stars, 3) and D (n_stars, 3, n_parameters) are the measured directions of one
    frame and their derivatives, `rows` and `z` those of `factor_values`.
    """
    most = rows.shape[1]
    prefix, sums = np.empty((most + 1, _SIX)), np.empty(_SIX)
    slopes, slope = np.empty((most + 1, _SIX * D.shape[2])), np.empty(_SIX * D.shape[2])
    A, P, value = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    h = np.empty(D.shape[2])
    for x in range(star_start.shape[0] - 1):
        s0, s1 = star_start[x], star_start[x + 1]
        n = s1 - s0
        _prefix(s[s0:s1], prefix)
        _prefix_slopes(s[s0:s1], D[s0:s1], slopes)
        H[x] = 0.0
        for r in range(e.shape[1]):
            e[x, r] = -z[x, r]
        for c in range(_combinations(n, model)):
            first, size = _window(n, model, c)
            _over_window(prefix, n, first, size, sums)
            _over_window(slopes, n, first, size, slope)
            _decompose(sums, A, P, value)
            for k in range(3):
                r = rows[x, c, k]
                if r < 0:
                    continue
                e[x, r] += value[k]
                _slope_of_value(slope, P[0, k], P[1, k], P[2, k], 0.5 / value[k], h)
                for p in range(free.shape[0]):
                    H[x, r, p] += h[free[p]] * scale[p]


@_part
def _slope_of_value(slope, x, y, z, half_inverse, h):
    """Fill h (n_parameters,) with p^T d(W W^T) p / (2 sigma), p = (x, y, z)."""
    a, b, c = x * x * half_inverse, 2.0 * x * y * half_inverse, 2.0 * x * z * half_inverse
    d, f, g = y * y * half_inverse, 2.0 * y * z * half_inverse, z * z * half_inverse
    n = h.shape[0]
    for p in range(n):
        h[p] = (
            a * slope[p] + b * slope[n + p] + c * slope[2 * n + p]
            + d * slope[3 * n + p] + f * slope[4 * n + p] + g * slope[5 * n + p]
        )  # fmt: skip
