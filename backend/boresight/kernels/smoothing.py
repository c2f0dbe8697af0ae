"""Both passes of the smoother as compiled loops: Carlson's filter about given states, and the square-root recursion back.

`estimation.smoother` derives them and is their caller; the tests hold them against dense least squares.
"""

from __future__ import annotations

import numpy as np

from boresight.kernels.arclengths import (
    _GAP,
    _ROOM,
    _exposure_rows,
    _largest_exposure,
    _largest_frame,
    _pad,
    _width,
    carlson_update,
    fold,
    inflate,
)
from boresight.kernels.compilation import FAST, loop, part


@loop("f1 f2F f2 camera f i1 i1 f1 f1 f1 f2 f1 i1 f1 f2 f2 f3 f1", first=False, fastmath=FAST)
def forward_pass(
    z, S, q, camera, pitch, frame_start, star_start, row_px, col_px, phi, band, x, free, scale, at, means, roots, chi2
):
    """Filter frames whose rows are taken at given states; z (8,) and S (8, 8) change in place, zero beyond the free parameters.

    `q` (n_frames, 8) is added before each frame. `x` is the state at z = 0, `at` (n_frames, n_free) where each frame is linearised.
    Fills `means` (n_frames, n_free), `roots` (n_frames, n_free, n_free), upper triangular, and `chi2` (n_frames,) at `at`.
    """
    N, n_free = len(camera), free.shape[0]
    most_arcs, fullest = _largest_frame(frame_start, star_start), _largest_exposure(star_start)
    w, g = np.empty((_GAP + fullest, _width(camera)))[_GAP:], np.empty((1 + _ROOM, max(fullest, _GAP)))[1:]
    e, H = np.empty(_GAP + most_arcs)[_GAP:], np.empty((_GAP + most_arcs, N))[_GAP:]
    f, gain, M, there, scales = np.empty(N), np.empty(N), np.empty((N, N)), x.copy(), np.empty(N)
    _pad(scale, scales)
    for k in range(frame_start.shape[0] - 1):
        inflate(S, q[k], M)
        for p in range(n_free):
            there[free[p]] = x[free[p]] + scale[p] * at[k, p]
        n_arcs = 0
        for m in range(frame_start[k], frame_start[k + 1]):
            s0 = star_start[m]
            n = star_start[m + 1] - s0
            _exposure_rows(
                camera, there, pitch, s0, n, 2 * s0 - 3 * m, row_px, col_px, phi, band, free, scales, w, g, e, H, n_arcs
            )
            n_arcs += 2 * n - 3
        chi2[k] = 0.0
        for a in range(n_arcs):
            chi2[k] += e[a] * e[a]
            innovation = e[a]
            for p in range(n_free):
                innovation += H[a, p] * (z[p] - at[k, p])
            carlson_update(camera, z, S, H[a], innovation, f, gain)
        for i in range(n_free):
            means[k, i] = z[i]
            for j in range(n_free):
                roots[k, i, j] = S[i, j]


@part()
def _solve(T, r, y):
    """Fill y with (T T^T)^-1 r, T upper triangular."""
    n = T.shape[0]
    for i in range(n - 1, -1, -1):
        value = r[i]
        for j in range(i + 1, n):
            value -= T[i, j] * y[j]
        y[i] = value / T[i, i]
    for i in range(n):
        value = y[i]
        for j in range(i):
            value -= T[j, i] * y[j]
        y[i] = value / T[i, i]


@loop("f2 f3 f2", first=False)
def backward_pass(means, roots, q):
    """Turn the filter's means (n_frames, n_free) and roots (n_frames, n_free, n_free) into those given all frames, in place.

    `q` (n_frames, n_free) was added before each frame.
    """
    n_frames, n = means.shape
    T, scratch, B, M = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, 3 * n))
    d, y = np.empty(n), np.empty(n)
    for k in range(n_frames - 2, -1, -1):
        most = 0.0
        for i in range(n):
            most = max(most, q[k + 1, i])
            d[i] = means[k + 1, i] - means[k, i]
            means[k, i] = means[k + 1, i]
            for j in range(n):
                T[i, j] = roots[k, i, j]
        if most == 0.0:
            for i in range(n):
                for j in range(n):
                    roots[k, i, j] = roots[k + 1, i, j]
            continue
        inflate(T, q[k + 1], scratch)
        _solve(T, d, y)
        for i in range(n):  # by itself and not by B: d is as long as a covariance is wide, and B has its condition
            means[k, i] -= q[k + 1, i] * q[k + 1, i] * y[i]
            d[i] = 0.0
        for i in range(n):
            d[i] = q[k + 1, i] * q[k + 1, i]
            _solve(T, d, y)
            d[i] = 0.0
            for j in range(n):
                B[i, j] = y[j]
        for i in range(n):
            for j in range(n):
                M[i, j] = roots[k + 1, i, j]
                M[i, n + j] = 0.0
                M[i, 2 * n + j] = -B[i, j] * q[k + 1, j]
            M[i, 2 * n + i] += q[k + 1, i]
            for j in range(n):
                for m in range(n):
                    M[i, j] -= B[i, m] * roots[k + 1, m, j]
                    M[i, n + j] += B[i, m] * roots[k, m, j]
        for i in range(n):
            for j in range(n):
                roots[k, i, j] = 0.0
        fold(roots[k], M)
