"""Proposed stars held against one another as compiled loops; `calibration.matching.verification` derives the tests.

Two loops look over a whole set and cost about as much as one evaluation of the batch. They tell which exposures need no closer
look: where no arc of the estimator disagrees, no star does, and no star's own statistic can exceed the chi-square of its
exposure. The third looks closely at the others, with the parts of `kernels.matching` (tangent axes, Wahba's problem, arcs that
agree).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from boresight.kernels.arclengths import (
    _GAP,
    _ROOM,
    _arcs,
    _exposure_residuals,
    _largest_exposure,
    _stars,
    _width,
)
from boresight.kernels.compilation import FAST, loop, part
from boresight.kernels.matching import (
    _add,
    _arcs_agree,
    _backward,
    _factor,
    _forward,
    _residual,
    _rows,
    _wahba,
)

#: Stars from which a consistent set is grown, those with the most votes first.
_SEEDS = 12
#: A star's own share of its residual below which its exposure says nothing of it.
_LEAST_SHARE = 1e-6
#: Most rounds of weights in an exposure, and the change at which they rest.
_ROUNDS, _SAME_WEIGHT = 200, 1e-13

_part = part(fastmath=FAST)


class Room(NamedTuple):
    """What `_wahba` writes in."""

    triads: np.ndarray  # (2, 3, 3)


@loop("camera f1 f i1 f1 f1 f1 f2 f2 f b1", first=False, fastmath=FAST)
def find_disagreeing(camera, x, pitch, star_start, row_px, col_px, phi, band, root, gate, disagrees):
    """Set `disagrees` (n_exposures,) where an arc differs from the catalogue's by more than `gate` of its sigmas.

    Called by `calibration.matching.verification`. The variance of an arc is that of its row of R, the sum of squares of its row of
    the factor `band`, and that of the parameters, |h^T root|^2 with root root^T = P (n_parameters, n_roots).
    """
    N = len(camera)
    most = _largest_exposure(star_start)
    w, g, h = np.empty((_GAP + most, _width(camera)))[_GAP:], np.empty((1 + _ROOM, max(most, _GAP)))[1:], np.empty(N)
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        a0 = 2 * s0 - 3 * k
        _stars(camera, x, pitch, row_px, col_px, s0, n, w)
        for i in range(n):
            g[0, i], g[1, i], g[2, i] = w[i, 0], w[i, 1], w[i, 2]
        _arcs(g, n, 1, 3)
        _arcs(g, n, 2, 8)
        disagrees[k] = False
        for a in range(2 * n - 3):
            i, odd = a // 2, a % 2
            j, kind = i + 1 + odd, 3 + 5 * odd
            excess = g[kind, i] - phi[a0 + a]
            variance = 0.0
            for d in range(5):
                variance += band[a0 + a, d] * band[a0 + a, d]
            if excess * excess <= gate * gate * variance:
                continue
            ix, iy, jx, jy = g[kind + 1, i], g[kind + 2, i], g[kind + 3, i], g[kind + 4, i]
            for p in range(N):
                h[p] = ix * w[i, 4 + p] + iy * w[i, 4 + N + p] + jx * w[j, 4 + p] + jy * w[j, 4 + N + p]
            for q in range(root.shape[1]):
                slope = 0.0
                for p in range(N):
                    slope += h[p] * root[p, q]
                variance += slope * slope
            if not excess * excess <= gate * gate * variance:
                disagrees[k] = True
                break


@loop("camera f1 f i1 f1 f1 f1 f2 f1", first=False, fastmath=FAST)
def exposure_chi2(camera, x, pitch, star_start, row_px, col_px, phi, band, chi2):
    """Fill `chi2` (n_exposures,) with the sum of squares of the whitened residuals of each exposure.

    Called by `calibration.matching.verification`.
    """
    most = _largest_exposure(star_start)
    g, e = np.empty((1 + _ROOM, max(most, _GAP)))[1:], np.empty(_GAP + 2 * most)[_GAP:]
    for k in range(star_start.shape[0] - 1):
        s0 = star_start[k]
        n = star_start[k + 1] - s0
        _exposure_residuals(camera, x, pitch, s0, n, 2 * s0 - 3 * k, row_px, col_px, phi, band, g, e, 0)
        total = 0.0
        for a in range(2 * n - 3):
            total += e[a] * e[a]
        chi2[k] = total


@_part
def _variance(sigma, r0, r1, bent):
    """Variance of one axis of a residual: centroid noise, and what the first order leaves out of a correction of this size."""
    return sigma * sigma + bent * bent * (r0 * r0 + r1 * r1)


@_part
def _largest_consistent(s, G, sigma, c, gate, use, agree, votes, ranked, members, held):
    """Mark in `use` (n,) the largest set of stars found of which every two have the catalogue's arc; returns its size.

    From each of the stars with the most votes on, those with the most votes that agree with all so far are added.
    """
    n = s.shape[0]
    for i in range(n):
        votes[i] = 0
        for j in range(i):
            agree[i, j] = _arcs_agree(s, G, sigma, i, j, c, i, j, gate, np.inf)
            agree[j, i] = agree[i, j]
            if agree[i, j]:
                votes[i] += 1
                votes[j] += 1
    for i in range(n):  # most votes first, equal ones as they come
        place = i
        while place > 0 and votes[ranked[place - 1]] < votes[i]:
            ranked[place] = ranked[place - 1]
            place -= 1
        ranked[place] = i
    best = 0
    for seed in range(min(n, _SEEDS)):
        members[0] = ranked[seed]
        size = 1
        for place in range(n):
            a = ranked[place]
            fits = a != ranked[seed]
            for b in range(size):
                if not fits:
                    break
                fits = agree[a, members[b]]
            if fits:
                members[size] = a
                size += 1
        if size > best:
            best = size
            for i in range(n):
                held[i] = False
            for b in range(size):
                held[members[b]] = True
    for i in range(n):
        use[i] = held[i]
    return best


@_part
def _statistics(s, T, A, sigma, bent, C, c, use, Lambda, eta, L, y, f0, f1, r, d2):
    """Fill `d2` (n,) with the chi-square of each star's place against what the others of the exposure and the prior predict.

    Of a star that is in use S = R - A Lambda^-1 A^T is the covariance of its residual, of another S = R + A Lambda^-1 A^T that of
    its innovation: r^T S^-1 r is the same statistic of the deleted star either way. False where Lambda has no factor.
    """
    d = A.shape[2]
    if not _factor(Lambda, L, d):
        return False
    _forward(L, eta, d, f0)
    _backward(L, f0, d, y)
    for i in range(s.shape[0]):
        _forward(L, A[i, 0], d, f0)
        _forward(L, A[i, 1], d, f1)
        _residual(s[i], T[i], C, c[i], r)
        variance = _variance(sigma[i], r[0], r[1], bent)
        sign = -1.0 if use[i] else 1.0
        v00, v01, v11, r0, r1 = variance, 0.0, variance, r[0], r[1]
        for q in range(d):
            v00 += sign * f0[q] * f0[q]
            v01 += sign * f0[q] * f1[q]
            v11 += sign * f1[q] * f1[q]
            r0 -= A[i, 0, q] * y[q]
            r1 -= A[i, 1, q] * y[q]
        determinant = v00 * v11 - v01 * v01
        if v00 <= 0.0 or determinant < _LEAST_SHARE * variance * variance:
            d2[i] = 0.0
        else:
            d2[i] = (v11 * r0 * r0 - 2.0 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
    return True


@loop("i1 f2 f3 f1 f2 f f f b1 b1 f1", first=False, fastmath=FAST)
def verify_stars(star_start, s, G, sigma, c, gate, limit, bent, use, voted, d2):
    """Verify the proposed stars of each exposure.

    Called by `calibration.matching.verification`, which derives it. `s` (n_stars, 3) are measured directions in the right-handed
    triad, `G` (n_stars, 3, p) their derivatives times P^(1/2), `sigma` (n_stars,) rad, `c` (n_stars, 3) the proposed directions,
    `bent` the share by which the first order misses a correction.
    Fills `voted` (n_stars,): whether a star is in the largest consistent set; `use`: whether it stands, its statistic `d2` being no
    larger than `limit`. Where fewer than three agree, none stands, and `d2` is infinite.
    """
    most, d = _largest_exposure(star_start), 3 + G.shape[2]
    room, C, r = Room(np.empty((2, 3, 3))), np.empty((3, 3)), np.empty(2)
    f0, f1 = np.empty(d), np.empty(d)
    A, T = np.empty((most, 2, d)), np.empty((most, 2, 3))
    agree, votes = np.empty((most, most), np.bool_), np.empty(most, np.int64)
    ranked, members, held = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.bool_)
    Lambda, L, eta, y = np.empty((d, d)), np.empty((d, d)), np.empty(d), np.empty(d)
    weight = np.empty(most)
    for k in range(star_start.shape[0] - 1):
        first, last = star_start[k], star_start[k + 1]
        n = last - first
        s_k, G_k, sigma_k, c_k = s[first:last], G[first:last], sigma[first:last], c[first:last]
        use_k, d2_k = use[first:last], d2[first:last]
        count = _largest_consistent(s_k, G_k, sigma_k, c_k, gate, use_k, agree, votes, ranked, members, held)
        for i in range(n):
            voted[first + i] = use_k[i]
            weight[i] = 1.0 / (sigma_k[i] * sigma_k[i])
            d2_k[i] = np.inf
        if count < 3 or not _wahba(s_k, c_k, weight[:n], use_k, C, room):
            for i in range(n):
                use_k[i] = False
            continue
        _rows(s_k, G_k, A[:n], T[:n])
        for a in range(d):
            eta[a] = 0.0
            for b in range(d):
                Lambda[a, b] = 1.0 if a == b and a >= 3 else 0.0
        for i in range(n):
            if use_k[i]:
                _residual(s_k[i], T[i], C, c_k[i], r)
                weight[i] = 1.0 / _variance(sigma_k[i], r[0], r[1], bent)
                _add(Lambda, eta, A[i], r[0], r[1], weight[i], d)
        for _ in range(4 * n):
            if not _statistics(s_k, T[:n], A[:n], sigma_k, bent, C, c_k, use_k, Lambda, eta, L, y, f0, f1, r, d2_k):
                break
            worst, nearest = -1, -1
            for i in range(n):
                if use_k[i] and d2_k[i] > limit and (worst < 0 or d2_k[i] > d2_k[worst]):
                    worst = i
                if not use_k[i] and d2_k[i] <= limit and (nearest < 0 or d2_k[i] < d2_k[nearest]):
                    nearest = i
            moved = worst if worst >= 0 else nearest
            if moved < 0 or (moved == worst and count <= 3):
                break
            _residual(s_k[moved], T[moved], C, c_k[moved], r)
            weight[moved] = 1.0 / _variance(sigma_k[moved], r[0], r[1], bent)
            use_k[moved] = not use_k[moved]
            count += 1 if use_k[moved] else -1
            _add(Lambda, eta, A[moved], r[0], r[1], weight[moved] if use_k[moved] else -weight[moved], d)


@_part
def _redescend(s, T, A, sigma, C, c, tuning, w, N, L, r, f0, f1, t2, renewed):
    """Fill `t2` (n,) with each star's statistic against the others by their weights, `renewed` (n,) with Tukey's weights there."""
    n = s.shape[0]
    for a in range(3):
        for b in range(3):
            N[a, b] = 0.0
    for i in range(n):
        weight = w[i] / (sigma[i] * sigma[i])
        if weight > 0.0:
            for a in range(3):
                for b in range(a + 1):
                    N[a, b] += weight * (A[i, 0, a] * A[i, 0, b] + A[i, 1, a] * A[i, 1, b])
    if not _factor(N, L, 3):
        return False
    for i in range(n):
        _forward(L, A[i, 0], 3, f0)
        _forward(L, A[i, 1], 3, f1)
        h00, h01, h11 = 0.0, 0.0, 0.0
        for q in range(3):
            h00 += f0[q] * f0[q]
            h01 += f0[q] * f1[q]
            h11 += f1[q] * f1[q]
        variance = sigma[i] * sigma[i]
        weight = w[i] / variance
        # B = I - weight H, V B = variance B + H with V the covariance of the deleted residual B^-1 r
        b00, b01, b11 = 1.0 - weight * h00, -weight * h01, 1.0 - weight * h11
        v00, v01, v11 = variance * b00 + h00, variance * b01 + h01, variance * b11 + h11
        of_b, of_v = b00 * b11 - b01 * b01, v00 * v11 - v01 * v01
        _residual(s[i], T[i], C, c[i], r)
        if not of_b > _LEAST_SHARE:
            t2[i] = 0.0
        else:
            e0, e1 = (b11 * r[0] - b01 * r[1]) / of_b, (b00 * r[1] - b01 * r[0]) / of_b
            u0, u1 = (v11 * r[0] - v01 * r[1]) / of_v, (v00 * r[1] - v01 * r[0]) / of_v
            t2[i] = e0 * u0 + e1 * u1
        left = 1.0 - t2[i] / (tuning * tuning)
        renewed[i] = left * left if left > 0.0 else 0.0
    return True


@loop("i1 f2 f1 f2 f f f1 f1", first=False, fastmath=FAST)
def weigh_stars(star_start, s, sigma, c, gate, tuning, w, t2):
    """Weigh the stars of each exposure by Tukey's biweight of their residual under the attitude of the others.

    Called by `estimation.robust`, which derives it. `s` (n_stars, 3) are measured directions in the right-handed triad, `sigma`
    (n_stars,) rad, `c` (n_stars, 3) the catalogue's. Begins with the largest set of which every two stars have the catalogue's arc
    within `gate` sigmas, and ends at weights that reproduce themselves. Fills `w` (n_stars,) and `t2` (n_stars,), the statistic;
    zero and infinite where fewer than three agree.
    """
    most = _largest_exposure(star_start)
    room, C, r = Room(np.empty((2, 3, 3))), np.empty((3, 3)), np.empty(2)
    G, f0, f1 = np.empty((most, 3, 0)), np.empty(3), np.empty(3)
    A, T = np.empty((most, 2, 3)), np.empty((most, 2, 3))
    agree, votes = np.empty((most, most), np.bool_), np.empty(most, np.int64)
    ranked, members, held = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.bool_)
    use, weight, renewed = np.empty(most, np.bool_), np.empty(most), np.empty(most)
    N, L = np.empty((3, 3)), np.empty((3, 3))
    for k in range(star_start.shape[0] - 1):
        first, last = star_start[k], star_start[k + 1]
        n = last - first
        s_k, sigma_k, c_k, w_k, t2_k = s[first:last], sigma[first:last], c[first:last], w[first:last], t2[first:last]
        count = _largest_consistent(s_k, G[:n], sigma_k, c_k, gate, use[:n], agree, votes, ranked, members, held)
        for i in range(n):
            w_k[i] = 1.0 if use[i] else 0.0
        _rows(s_k, G[:n], A[:n], T[:n])
        stands = count >= 3
        for _ in range(_ROUNDS):
            for i in range(n):
                weight[i] = w_k[i] / (sigma_k[i] * sigma_k[i])
                use[i] = w_k[i] > 0.0
            stands = stands and _wahba(s_k, c_k, weight[:n], use[:n], C, room)
            stands = stands and _redescend(
                s_k, T[:n], A[:n], sigma_k, C, c_k, tuning, w_k, N, L, r, f0, f1, t2_k, renewed
            )
            if not stands:
                break
            change = 0.0
            for i in range(n):
                change = max(change, abs(renewed[i] - w_k[i]))
                w_k[i] = renewed[i]
            if change < _SAME_WEIGHT:
                break
        if not stands:
            for i in range(n):
                w_k[i], t2_k[i] = 0.0, np.inf
