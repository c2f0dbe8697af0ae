"""The extended Kalman filter in covariance form: the vector update of a whole frame (E Eqs 25-29, with errata).

With the frame's whitened rows e' and H' (so R = I), linearised at z_lin::

    K = P H^T (H P H^T + I)^-1                        erratum to Eq 25, printed P H
    z <- z_prior - K (e' + H' (z_prior - z_lin))      erratum to Eq 26, printed plus
    P <- (I - K H) P (I - K H)^T + K K^T              Joseph's form of Eq 27, which keeps P symmetric and positive

and P / lambda + Q between frames. It takes the same iterations as the square-root filter and gives the same estimate; it stands
here as the independent form the fast one is proven by, and as a choice for those who want to read it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.information import upper_factor

#: How often a step that raises its frame's cost is halved.
HALVINGS = 6


def extended_filter(
    arcs: ArcSet, state: FilterState, free: NDArray[np.int64], scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; parameters and result as in `square_root_filter`."""
    n, n_free = arcs.n_frames, len(free)
    x, z, P = state.x.copy(), state.z.copy(), state.P
    x_start = x[free] - scale * z
    Q = tuning.process_noise**2 * np.eye(n_free)
    states, sigmas = np.empty((n, len(x))), np.empty((n, n_free))
    nis, dof, squares, passes = np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    for k in range(n):
        frame = arcs.frames(k, k + 1)
        z_prior, P_prior = z, P / tuning.forgetting + Q
        for turn in range(tuning.linearisations):
            z_lin = z
            e, H, _ = _rows(frame, x, free, scale)
            try:
                z, P, nis[k] = _update(z_prior, P_prior, z_lin, e, H)
                before = _cost(z_lin - z_prior, P_prior, e)
            except np.linalg.LinAlgError:  # a covariance beyond what a float holds: the filter diverged
                squares[k] = np.nan
                break
            for halved in range(HALVINGS + 1):
                x = x.copy()
                x[free] = x_start + scale * z
                post, _, squares[k] = _rows(frame, x, free, scale)
                if _cost(z - z_prior, P_prior, post) <= before * (1 + 1e-9) or halved == HALVINGS:
                    break  # x, its rows and z belong together, after the last halving too
                z = (z + z_lin) / 2
            passes[k] = turn + 1
            if np.max(np.abs(post - (e + H @ (z - z_lin))), initial=0.0) < tuning.rest:
                break
        states[k], sigmas[k], dof[k] = x, np.sqrt(np.diag(P)), frame.n_arcs
        if not np.isfinite(squares[k]):
            n = k
            break
    return FilterHistory(
        states[:n], sigmas[:n], nis[:n], dof[:n], squares[:n], passes[:n],
        FilterState(x, z, upper_factor(P)), n == arcs.n_frames,
    )  # fmt: skip


def _rows(
    frame: ArcSet, x: FloatArray, free: NDArray[np.int64], scale: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Whitened residual (n_arcs,), scaled Jacobian (n_arcs, n_free) and unweighted sum of squares of one frame."""
    e, H = np.empty(frame.n_arcs), np.empty((frame.n_arcs, len(free)))
    total = kernels.whitened_rows(
        frame.camera.kind,
        x,
        frame.pitch,
        frame.star_start,
        frame.row_px,
        frame.col_px,
        frame.phi,
        frame.band,
        free,
        scale,
        e,
        H,
    )
    return e, H, float(total)


def _update(
    z_prior: FloatArray, P_prior: FloatArray, z_lin: FloatArray, e: FloatArray, H: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """One linear update; returns posterior z, P and the normalised innovation squared."""
    innovation = e + H @ (z_prior - z_lin)
    W = H @ P_prior @ H.T + np.eye(len(e))
    K = np.linalg.solve(W, H @ P_prior).T
    keep = np.eye(len(z_prior)) - K @ H
    P = keep @ P_prior @ keep.T + K @ K.T
    return z_prior - K @ innovation, P, float(innovation @ np.linalg.solve(W, innovation))


def _cost(departure: FloatArray, P_prior: FloatArray, e: FloatArray) -> float:
    """A frame's cost: departure from its prior plus whitened residuals, both squared."""
    return float(departure @ np.linalg.solve(P_prior, departure) + e @ e)
