"""Sums of whitened rows over frames as one compiled pass: what the trust page asks of every frame.

With e (n_arcs,) and H (n_arcs, n_free) the whitened residuals and the scaled Jacobian, and P a covariance (n_free, n_free)::

    chi2_k = sum e^2       b_k = sum H e       d_k = sum H^2       l_k = sum_rows h^T P h        over the arcs of frame k.

The tests hold the loop against NumPy.
"""

from __future__ import annotations

import numpy as np

from boresight.kernels.compilation import FAST, loop


@loop("i1 f1 f2 f2 f1 f2 f2 f1", fastmath=FAST - {"afn"})
def frame_sums(arc_start, e, H, P, chi2, scores, squares, leverage):
    """Add up the rows of every frame.

    The caller is `calibration.trust.fitted_set`. `arc_start` (n_frames + 1,) is the first arc of each frame; fills `chi2`
    (n_frames,), `scores` and `squares` (n_frames, n_free) and `leverage` (n_frames,).
    """
    n = H.shape[1]
    A = np.empty((n, n))
    for k in range(len(arc_start) - 1):
        chi2[k] = 0.0
        for p in range(n):
            scores[k, p] = 0.0
            for q in range(p + 1):
                A[p, q] = 0.0
        for a in range(arc_start[k], arc_start[k + 1]):
            chi2[k] += e[a] * e[a]
            for p in range(n):
                scores[k, p] += H[a, p] * e[a]
                for q in range(p + 1):
                    A[p, q] += H[a, p] * H[a, q]
        leverage[k] = 0.0
        for p in range(n):
            squares[k, p] = A[p, p]
            leverage[k] += P[p, p] * A[p, p]
            for q in range(p):
                leverage[k] += 2.0 * P[p, q] * A[p, q]
