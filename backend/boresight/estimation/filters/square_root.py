"""Carlson's square-root filter on whitened arcs (E Appendix C), with its errata.

The covariance of the scaled free parameters is P = S S^T with S upper triangular. A frame's whitened rows, e' with Jacobian H'
(E Eqs 80-82, so that r = 1), are taken in one by one::

    f = S^T h                           erratum to Eq 87, printed S h
    alpha = 1 + f.f                     Eq 86
    z <- z - (S f / alpha) (e_i + h_i.(z - z_lin))          errata to Eq 83: the sign, and an innovation that moves in the frame
    S <- S (I - f f^T / alpha)^(1/2)    erratum to Eq 84, by Carlson's triangular columns

The printed I - f f^T can have negative eigenvalues, and with one residual vector kept for the whole frame the filter ends
thousands of sigmas away. Between frames P becomes P / lambda + Q: S is multiplied by 1 / sqrt(lambda) (the forgetting factor of
Griffith, see `history`), and the sum re-factored by rotations of [S M] (erratum to Eq 88, printed S + M).

Iteration. From a ground calibration ten sigmas off, one linearisation a frame makes the filter far over-confident. So a frame is
processed again from its prior with rows taken at its own posterior (the iterated extended Kalman filter, a Gauss-Newton step
each time), until the true residual there agrees with its linear prediction.

References
----------
Carlson, "Fast triangular formulation of the square root filter", AIAA Journal 11, 1973. Bell, Cathey, "The iterated Kalman filter
update as a Gauss-Newton method", IEEE TAC 38, 1993.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning


def square_root_filter(
    arcs: ArcSet, state: FilterState, free: NDArray[np.int64], scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set, or over the next frames of one.

    Parameters
    ----------
    arcs
        Whitened arcs of the frames to take in.
    state
        Where to start; `history.start` before the first frame, the former `last` afterwards.
    free
        (n_free,) places of the free parameters.
    scale
        (n_free,) typical sigmas, SI.
    tuning
        Linearisations, process noise and forgetting.
    """
    n, n_free = arcs.n_frames, len(free)
    x, q = state.x.copy(), np.full(n_free, tuning.process_noise)
    z, S, q = (padded(values, len(x)) for values in (state.z, state.S, q))
    states, sigmas = np.empty((n, len(x))), np.empty((n, n_free))
    nis, dof, squares, passes = np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    done = kernels.square_root_filter(
        x, z, S, q, tuning.widening, arcs.camera.kind, arcs.pitch, arcs.frame_start, arcs.star_start, arcs.row_px, arcs.col_px,
        arcs.known_phi, arcs.band, free, scale, tuning.linearisations, tuning.rest, states, sigmas, nis, dof, squares, passes,
    )  # fmt: skip
    return FilterHistory(
        states[:done], sigmas[:done], nis[:done], dof[:done], squares[:done], passes[:done],
        FilterState(x, z[:n_free], S[:n_free, :n_free]), done == n,
    )  # fmt: skip


def padded(values: FloatArray, size: int) -> FloatArray:
    """Copy into as many as the camera has parameters, with zeros beyond, columns contiguous: Carlson's update walks down them."""
    filled = np.zeros((size,) * values.ndim, order="F")
    filled[tuple(slice(0, n) for n in values.shape)] = values
    return filled
