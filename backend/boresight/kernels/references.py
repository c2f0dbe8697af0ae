"""What selections of singular values hold of single frames, for many selections in one pass.

`estimation.statistics.references` derives both measures, `estimation.singular_values` the rows and their covariance. What
selections share is taken once: of each model the combinations' decompositions, the spread of their values by star G, its products
G G^T and the slopes; a selection adds up those of its rows, and goes through its own choice of rows. The tests hold the loop
against the filter's loops and NumPy.

Smallest singular value. Of the rows H of a frame only R of H = Q R is needed, by reflections, and

    sigma_min(H) = lambda_max(M)^(-1/2),        M = (R^T R)^-1 = R^-1 R^-T.

R^-1 comes from R and not from H^T H, so nothing is lost by squaring. Squaring M again and again leaves the projection on the
eigenvector of its largest eigenvalue, or on those that no digit tells apart; Rayleigh's quotient of a column is that eigenvalue.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.kernels.compilation import FAST, loop, part
from boresight.kernels.singular import (
    _SIX,
    _SMALL,
    _SWEEPS,
    _combinations,
    _over_window,
    _prefix,
    _prefix_slopes,
    _rows_of_values,
    _slope_of_value,
    _window,
)

_MODELS = 4
#: Squarings of M at most: eigenvalues that 2^40 does not tell apart are equal.
_SQUARINGS = 40
#: Share of the trace beside the largest eigenvalue: Rayleigh's quotient errs by its square, which is rounding.
_ALONE = 1e-9
_PLACES = 8  # numbers in the longest vector of a processor
_TINY = 1e-300

_part = part(fastmath=FAST)
_inlined = part(fastmath=FAST, forceinline=True)


@_part
def _combinations_of_star(n, model, i):
    """Return a, b, c, d: star i is in the combinations from a to b - 1, and from c to d - 1, none where these are equal."""
    if model == 4:
        return max(0, i - 2), n - 2, n - 2, n - 2
    first = i + 1 - _window(n, model, 0)[1]
    return (first, i + 1, n, n) if first >= 0 else (0, i + 1, n + first, n)


@_inlined
def _rotation(p, q, off):
    """Tangent, cosine and sine of the Jacobi rotation that makes `off`, between diagonals p and q, zero; none where it is."""
    d = q - p
    t = 2.0 * math.copysign(1.0, d) * off / (abs(d) + math.sqrt(d * d + 4.0 * off * off) + _TINY)
    c = 1.0 / math.sqrt(t * t + 1.0)
    return t, c, t * c


@_inlined
def _turn(c, s, a, b):
    """Turn a pair of numbers."""
    return c * a - s * b, s * a + c * b


@_part
def decompose_windows(prefix, n, model, A, value, P):
    """Singular values (., 3), descending, and left vectors as columns of P (., 3, 3), of every combination of n stars.

    As `singular._decompose` takes one of them, by Jacobi's rotations, but eight at a time: one in each place of a processor's
    vector, where roots and divisions cost what they cost for one. A (15 times 8,) holds xx xy xz yy yz zz of the eight, and then
    their nine of P, rows first; places without a combination hold ones on the diagonal.
    """
    count = _combinations(n, model)
    for begin in range(0, count, _PLACES):
        filled = min(_PLACES, count - begin)
        for i in range(15 * _PLACES):
            A[i] = 0.0
        for at in range(_PLACES):
            A[at] = A[3 * _PLACES + at] = A[5 * _PLACES + at] = 1.0
            A[6 * _PLACES + at] = A[10 * _PLACES + at] = A[14 * _PLACES + at] = 1.0
        for at in range(filled):
            first, size = _window(n, model, begin + at)
            last = first + size
            for i in range(_SIX):
                total = prefix[min(last, n), i] - prefix[first, i]
                A[i * _PLACES + at] = total if last <= n else total + prefix[last - n, i]
        for _ in range(_SWEEPS):
            unsettled = 0
            for at in range(_PLACES):
                xy, xz, yz = A[_PLACES + at], A[2 * _PLACES + at], A[4 * _PLACES + at]
                trace = A[at] + A[3 * _PLACES + at] + A[5 * _PLACES + at]
                unsettled += xy * xy + xz * xz + yz * yz > _SMALL * trace * trace
            if unsettled == 0:
                break
            for at in range(_PLACES):
                xx, xy, xz = A[at], A[_PLACES + at], A[2 * _PLACES + at]
                yy, yz, zz = A[3 * _PLACES + at], A[4 * _PLACES + at], A[5 * _PLACES + at]
                ax, ay, az = A[6 * _PLACES + at], A[7 * _PLACES + at], A[8 * _PLACES + at]
                bx, by, bz = A[9 * _PLACES + at], A[10 * _PLACES + at], A[11 * _PLACES + at]
                cx, cy, cz = A[12 * _PLACES + at], A[13 * _PLACES + at], A[14 * _PLACES + at]
                t, c, s = _rotation(xx, yy, xy)
                xx, yy = xx - t * xy, yy + t * xy
                xz, yz = _turn(c, s, xz, yz)
                ax, ay = _turn(c, s, ax, ay)
                bx, by = _turn(c, s, bx, by)
                cx, cy = _turn(c, s, cx, cy)
                t, c, s = _rotation(xx, zz, xz)
                xx, zz = xx - t * xz, zz + t * xz
                xy, yz = -s * yz, c * yz  # of the pair xy, yz: the first rotation left xy zero
                ax, az = _turn(c, s, ax, az)
                bx, bz = _turn(c, s, bx, bz)
                cx, cz = _turn(c, s, cx, cz)
                t, c, s = _rotation(yy, zz, yz)
                yy, zz = yy - t * yz, zz + t * yz
                xy, xz = c * xy, s * xy  # and the second xz
                ay, az = _turn(c, s, ay, az)
                by, bz = _turn(c, s, by, bz)
                cy, cz = _turn(c, s, cy, cz)
                A[at], A[_PLACES + at], A[2 * _PLACES + at] = xx, xy, xz
                A[3 * _PLACES + at], A[4 * _PLACES + at], A[5 * _PLACES + at] = yy, 0.0, zz
                A[6 * _PLACES + at], A[7 * _PLACES + at], A[8 * _PLACES + at] = ax, ay, az
                A[9 * _PLACES + at], A[10 * _PLACES + at], A[11 * _PLACES + at] = bx, by, bz
                A[12 * _PLACES + at], A[13 * _PLACES + at], A[14 * _PLACES + at] = cx, cy, cz
        for at in range(filled):
            x, y, z = A[at], A[3 * _PLACES + at], A[5 * _PLACES + at]
            to_x = int(x < y) + int(x < z)
            to_y = int(not x < y) + int(y < z)
            for k in range(3):
                to = to_x if k == 0 else to_y if k == 1 else 3 - to_x - to_y
                square = x if k == 0 else y if k == 1 else z
                value[begin + at, to] = math.nan if math.isnan(square) else math.sqrt(max(square, 0.0))
                for i in range(3):
                    P[begin + at, i, to] = A[(6 + 3 * i + k) * _PLACES + at]


@_part
def _catalogue_products(s, sigma, model, wanted, prefix, A, P, values, worst, T, products):
    """Take the catalogue's `values` (most, 3), the largest error of each combination, and the products of their spreads.

    Place k + 3 c of `products` (3 most, 3 most), lower triangle, is value k of combination c; only the wanted ones are filled.
    """
    n = s.shape[0]
    count = _combinations(n, model)
    for t in range(3 * n):
        for r in range(3 * count):
            T[t, r] = 0.0
    for r in range(3 * count):
        for t in range(r + 1):
            products[r, t] = 0.0
    _prefix(s, prefix)
    decompose_windows(prefix, n, model, A, values, P)
    for c in range(count):
        first, size = _window(n, model, c)
        worst[c] = 0.0
        for turn in range(first, first + size):
            i = turn if turn < n else turn - n
            worst[c] = max(worst[c], sigma[i])
            for k in range(3):
                if wanted[k]:
                    x, y, z = P[c, 0, k], P[c, 1, k], P[c, 2, k]
                    along = x * s[i, 0] + y * s[i, 1] + z * s[i, 2]
                    weight = sigma[i] * along / values[c, k]
                    T[3 * i, 3 * c + k] = weight * (x - along * s[i, 0])
                    T[3 * i + 1, 3 * c + k] = weight * (y - along * s[i, 1])
                    T[3 * i + 2, 3 * c + k] = weight * (z - along * s[i, 2])
    for i in range(n):
        a, b, c, d = _combinations_of_star(n, model, i)
        for t in range(3 * i, 3 * i + 3):
            for r in range(3 * a, 3 * b):
                _add_multiple(T[t, r], T, t, 3 * a, r + 1, products, r)
            for r in range(3 * c, 3 * d):
                _add_multiple(T[t, r], T, t, 3 * a, 3 * b, products, r)
                _add_multiple(T[t, r], T, t, 3 * c, r + 1, products, r)


@_part
def _add_multiple(weight, T, t, first, last, products, r):
    """Add a multiple of a stretch of row t of T to row r; places without a sign need no look at whether they count from the end."""
    if weight != 0.0:
        for u in range(np.uint64(first), np.uint64(last)):
            products[r, u] += weight * T[t, u]


@_part
def _measured_slopes(s, model, wanted, free, scale, prefix, slopes, slope, A, P, value, h, H):
    """Fill rows k + 3 c of `H` (3 most, n_free) with the slope of value k of combination c, in units of `scale`."""
    n = s.shape[0]
    _prefix(s, prefix)
    decompose_windows(prefix, n, model, A, value, P)
    for c in range(_combinations(n, model)):
        first, size = _window(n, model, c)
        _over_window(slopes, n, first, size, slope)
        for k in range(3):
            if wanted[k]:
                _slope_of_value(slope, P[c, 0, k], P[c, 1, k], P[c, 2, k], 0.5 / value[c, k], h)
                for p in range(free.shape[0]):
                    H[3 * c + k, p] = h[free[p]] * scale[p]


@_part
def _select(values, worst, count, chosen, apart, products, H, row, R, rows, at):
    """Add up products in the lower triangle of R (m, m), and slopes in `rows` from row `at` on, of the rows measured; return m."""
    m = 0
    for c in range(count):
        m = _rows_of_values(values[c], chosen, apart * worst[c], m, row[c])
    for r in range(m):
        for t in range(m):
            R[r, t] = 0.0
        for p in range(H.shape[1]):
            rows[at + r, p] = 0.0
    for c in range(count):
        for k in range(3):
            r = row[c, k]
            if r < 0:
                continue
            for p in range(H.shape[1]):
                rows[at + r, p] += H[3 * c + k, p]
            for b in range(c + 1):
                for j in range(3):
                    t = row[b, j]
                    if t < 0:
                        continue
                    value = products[3 * c + k, 3 * b + j] if b < c or j <= k else products[3 * b + j, 3 * c + k]
                    R[r, t] += value
                    if b < c:
                        R[t, r] += value
    return m


@_part
def _add_information(R, rows, at, m, determined, L, left, kept, A):
    """Add H^T R^+ H of the m rows from row `at` on to A (n_free, n_free), over the rows that determine the others.

    As `singular._factor` chooses them: the row with the largest share of its own variance left comes next.
    """
    n_free = rows.shape[1]
    for r in range(m):
        left[r] = R[r, r]
    rank = 0
    while rank < m:
        best = 0
        for r in range(1, m):
            if left[r] * R[best, best] > left[best] * R[r, r]:
                best = r
        if not left[best] > determined * R[best, best]:
            break
        inverse = 1.0 / math.sqrt(left[best])
        for p in range(n_free):
            kept[rank, p] = rows[at + best, p]
        for t in range(rank):
            weight = L[t, best]
            for p in range(n_free):
                kept[rank, p] -= weight * kept[t, p]
        for p in range(n_free):
            kept[rank, p] *= inverse
        for r in range(m):
            L[rank, r] = R[best, r]
        for t in range(rank):
            weight = L[t, best]
            for r in range(m):
                L[rank, r] -= weight * L[t, r]
        for r in range(m):
            L[rank, r] *= inverse
            if left[r] >= 0.0:
                left[r] = max(left[r] - L[rank, r] * L[rank, r], 0.0)
        left[best] = -1.0
        rank += 1
    for r in range(rank):
        for p in range(n_free):
            for q in range(n_free):
                A[p, q] += kept[r, p] * kept[r, q]


@_part
def _triangle(H, m, w):
    """Turn the first n rows of H (m, n) into R of H = Q R by reflections; what is below is no use."""
    n = H.shape[1]
    for k in range(n):
        size = 0.0
        for r in range(k, m):
            size += H[r, k] * H[r, k]
        if not size > 0.0:
            continue
        diagonal = -math.copysign(math.sqrt(size), H[k, k])
        head = H[k, k] - diagonal
        beta = 1.0 / (diagonal * head)  # less than zero
        H[k, k] = head
        for q in range(k + 1, n):
            w[q] = 0.0
        for r in range(k, m):
            for q in range(k + 1, n):
                w[q] += H[r, k] * H[r, q]
        for r in range(k, m):
            weight = beta * H[r, k]
            for q in range(k + 1, n):
                H[r, q] += weight * w[q]
        H[k, k] = diagonal


@_part
def _smallest(H, m, w, X, M, N):
    """Smallest singular value of the m rows of H, which change; 0 where they are fewer than columns, or one of R's pivots is 0."""
    n = H.shape[1]
    if m < n:
        return 0.0
    _triangle(H, m, w)
    for k in range(n):
        if H[k, k] == 0.0:
            return 0.0
    for j in range(n):  # R X = I
        for i in range(n):
            X[i, j] = 0.0
        for i in range(j, -1, -1):
            value = 1.0 if i == j else 0.0
            for t in range(i + 1, j + 1):
                value -= H[i, t] * X[t, j]
            X[i, j] = value / H[i, i]
    trace = 0.0
    for i in range(n):
        for j in range(n):
            value = 0.0
            for t in range(max(i, j), n):
                value += X[i, t] * X[j, t]
            M[i, j] = value
        trace += M[i, i]
    for i in range(n):
        for j in range(n):
            M[i, j] /= trace
            X[i, j] = M[i, j]
    for _ in range(_SQUARINGS):
        squares = 0.0
        for i in range(n):
            for j in range(n):
                N[i, j] = 0.0
            for t in range(n):
                for j in range(n):
                    N[i, j] += X[i, t] * X[t, j]
            squares += N[i, i]
        for i in range(n):
            for j in range(n):
                X[i, j] = N[i, j] / squares
        if not 1.0 - squares > _ALONE:
            break
    best = 0
    for i in range(1, n):
        if X[i, i] > X[best, best]:
            best = i
    norm, value = 0.0, 0.0
    for i in range(n):
        norm += X[i, best] * X[i, best]
        for j in range(n):
            value += X[i, best] * M[i, j] * X[j, best]
    return 1.0 / math.sqrt(value / norm * trace)


@loop("i1 i1 f2 f1 f2 f3 i1 f1 i1 b2 b1 f f f2 f3", fastmath=FAST)
def judge_selections(
    frame_start, star_start, s_i, sigma, s, D, free, scale, models, chosen, measured, apart, determined, smallest, A
):  # fmt: skip
    """Fill both measures of every selection: `smallest` (n_selections, n_frames), and add to `A` (n_selections, n_free, n_free).

    Called by `estimation.statistics.references`. `frame_start` (n_frames + 1,) and `star_start` (n_exposures + 1,) begin at 0;
    `s_i`, `sigma` are the catalogue directions and errors, `s`, `D` the measured directions and ds/dx; `models` (n_selections,)
    and `chosen` (n_selections, 3) what is selected, `measured` (n_selections,) whether the smallest singular value is wanted.
    """
    most, fullest, n_free = 0, 0, free.shape[0]
    for f in range(frame_start.shape[0] - 1):
        fullest = max(fullest, 3 * (star_start[frame_start[f + 1]] - star_start[frame_start[f]]))
    for e in range(star_start.shape[0] - 1):
        most = max(most, star_start[e + 1] - star_start[e])
    prefix = np.empty((most + 1, _SIX))
    slopes, slope = np.empty((most + 1, _SIX * D.shape[2])), np.empty(_SIX * D.shape[2])
    E, P, value, h = np.empty(15 * _PLACES), np.empty((most, 3, 3)), np.empty((most, 3)), np.empty(D.shape[2])
    values, worst, row = np.empty((most, 3)), np.empty(most), np.empty((most, 3), np.int64)
    T, products, R = np.empty((3 * most, 3 * most)), np.empty((3 * most, 3 * most)), np.empty((3 * most, 3 * most))
    L, left, H, kept = (
        np.empty((3 * most, 3 * most)),
        np.empty(3 * most),
        np.empty((3 * most, n_free)),
        np.empty((3 * most, n_free)),
    )
    rows, count = np.empty((models.shape[0], fullest, n_free)), np.empty(models.shape[0], np.int64)
    w, X, M, N = np.empty(n_free), np.empty((n_free, n_free)), np.empty((n_free, n_free)), np.empty((n_free, n_free))
    wanted, asked = np.zeros((_MODELS, 3), np.bool_), np.zeros(_MODELS, np.bool_)
    for t in range(models.shape[0]):
        asked[models[t] - 1] = True
        for k in range(3):
            wanted[models[t] - 1, k] |= chosen[t, k]
    for f in range(frame_start.shape[0] - 1):
        count[:] = 0
        for e in range(frame_start[f], frame_start[f + 1]):
            s0, s1 = star_start[e], star_start[e + 1]
            _prefix_slopes(s[s0:s1], D[s0:s1], slopes)
            for model in range(1, _MODELS + 1):
                if not asked[model - 1]:
                    continue
                of = wanted[model - 1]
                _catalogue_products(s_i[s0:s1], sigma[s0:s1], model, of, prefix, E, P, values, worst, T, products)
                _measured_slopes(s[s0:s1], model, of, free, scale, prefix, slopes, slope, E, P, value, h, H)
                for t in range(models.shape[0]):
                    if models[t] != model:
                        continue
                    m = _select(
                        values,
                        worst,
                        _combinations(s1 - s0, model),
                        chosen[t],
                        apart,
                        products,
                        H,
                        row,
                        R,
                        rows[t],
                        count[t],
                    )
                    _add_information(R, rows[t], count[t], m, determined, L, left, kept, A[t])
                    count[t] += m
        for t in range(models.shape[0]):
            smallest[t, f] = _smallest(rows[t], count[t], w, X, M, N) if measured[t] else math.nan
