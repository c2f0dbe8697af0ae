"""The iterated extended Kalman filter over a reference whose covariance may be singular, in information and in gain form.

A reference (singular values, angular distances) hands over a frame as whitened rows e', H', linearised at z_at, with unit
covariance on the space that they span. With the information Lambda = P^-1 of the scaled free parameters,

    Lambda+ = Lambda + H'^T H'
    z+      = z - (Lambda+)^-1 H'^T (e' + H' (z - z_at))
    NIS     = |nu|^2 - nu^T H' (Lambda+)^-1 H'^T nu,            nu = e' + H' (z - z_at)

costs no more than the rows themselves. W prints the gain form instead (Eqs 25-27), with an inverse as large as the m rows of an
exposure: with R of these rows, filled so that it can be inverted,

    K = P H^T (H P H^T + R)^-1,     z+ = z - K (e + H (z - z_at)),     P+ = (I - K H) P (I - K H)^T + K R K^T,

the last of which is Eq 27 as Joseph wrote it, that P stay positive. Both forms give the same to the rounding of H P H^T + R, whose
condition is that of the prior over the noise squared; the second is here to measure what the first saves. The exposures of a
frame have independent noise, so the gain form takes them one after the other, its innovation moving with them. Between frames
information becomes (P / lambda + Q)^-1, see `history`.

As in the other filters a frame is linearised again at its posterior, from its prior, until the true residuals there agree with
their linear prediction; a step that raises the frame's cost is halved. W's filter linearises once.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning

#: Residuals (m,), scaled Jacobian (m, n_free) and invertible covariance (m, m) of one exposure.
Measurement = tuple[FloatArray, FloatArray, FloatArray]

#: How often a step that raises its frame's cost is halved.
HALVINGS = 6


class Reference(Protocol):
    """What stays the same under a rotation, measured frame by frame."""

    def whiten(self, star_start: IntArray, s_i: FloatArray, sigma_rad: FloatArray) -> int:
        """Take a frame's catalogue directions (n_stars, 3) and their errors (n_stars,); return its degrees of freedom."""

    def rows(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (n_rows,) and scaled Jacobian (n_rows, n_free) of measured directions s and ds/dx."""

    def exposures(self, s: FloatArray, D: FloatArray) -> list[Measurement]:
        """The same before whitening, exposure by exposure."""


class Frame:
    """The stars of one frame, and their measured directions at any state."""

    def __init__(self, arcs: ArcSet, k: int, sigma_rad: FloatArray) -> None:
        e0, e1 = arcs.frame_start[k], arcs.frame_start[k + 1]
        s0, s1 = arcs.star_start[e0], arcs.star_start[e1]
        self._camera, self._pitch = arcs.camera, arcs.pitch
        self.star_start = arcs.star_start[e0 : e1 + 1] - s0
        self.row_px, self.col_px = arcs.row_px[s0:s1], arcs.col_px[s0:s1]
        self.s_i, self.sigma_rad = arcs.s_i[s0:s1], sigma_rad[s0:s1]
        self.phi = arcs.phi[2 * s0 - 3 * e0 : 2 * s1 - 3 * e1]

    def directions(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured directions (n_stars, 3) and ds/dx (n_stars, 3, n_parameters)."""
        return self._camera.directions_and_jacobian(x, self.row_px, self.col_px, self._pitch)

    def sum_of_squares(self, x: FloatArray) -> float:
        """Unweighted sum of squared arc errors, rad^2: what every method is judged by."""
        e = np.empty(len(self.phi))
        kernels.residuals(self._camera.kind, x, self._pitch, self.star_start, self.row_px, self.col_px, self.phi, e)
        return float(e @ e)


def information_filter(
    reference: Reference, arcs: ArcSet, state: FilterState, free: IntArray, scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; the other parameters and the result as in `square_root_filter`."""
    n, n_free = arcs.n_frames, len(free)
    sigma_rad = arcs.sigma_px * np.sqrt(arcs.camera.solid_angle(state.x, arcs.row_px, arcs.col_px, arcs.pitch))
    x, z, P = state.x.copy(), state.z, state.P
    x_start = x[free] - scale * z
    states, sigmas = np.empty((n, len(x))), np.empty((n, n_free))
    nis, dof, squares, passes = np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    prior = inverse(P)
    for k in range(n):
        frame = Frame(arcs, k, sigma_rad)
        dof[k] = reference.whiten(frame.star_start, frame.s_i, frame.sigma_rad)
        prior = between_frames(prior, tuning)
        P_prior = inverse(prior) if tuning.gain_form == "gain" else prior
        z_prior, at = z, frame.directions(x)
        e, H = reference.rows(*at)
        for turn in range(tuning.linearisations):
            z_at = z
            if tuning.gain_form == "gain":
                z, P, nis[k] = gain_update(reference.exposures(*at), P_prior, z_prior, z_at)
                posterior = inverse(P)
            else:
                z, posterior, P = np.empty(n_free), np.empty_like(prior), np.empty_like(prior)
                nis[k] = kernels.information_update(prior, z_prior, z_at, e, H, z, posterior, P)
            before = kernels.cost(prior, z_prior, z_at, e)
            for halved in range(HALVINGS + 1):
                x = x.copy()
                x[free] = x_start + scale * z
                at = frame.directions(x)
                e_post, H_post = reference.rows(*at)
                if kernels.cost(prior, z_prior, z, e_post) <= before * (1 + 1e-9) or halved == HALVINGS:
                    break  # x, its rows and z belong together, after the last halving too
                z = (z + z_at) / 2
            passes[k] = turn + 1
            if kernels.worst_departure(e, H, z_at, z, e_post) < tuning.rest:
                break
            e, H = e_post, H_post
        prior = posterior
        states[k], sigmas[k], squares[k] = x, np.sqrt(np.diag(P)), frame.sum_of_squares(x)
        if not (np.isfinite(squares[k]) and np.isfinite(sigmas[k]).all()):
            n = k
            break
    return FilterHistory(
        states[:n], sigmas[:n], nis[:n], dof[:n], squares[:n], passes[:n], FilterState(x, z, upper_factor(P)),
        n == arcs.n_frames,
    )  # fmt: skip


def between_frames(information: FloatArray, tuning: Tuning) -> FloatArray:
    """Information after forgetting and process noise, (P / lambda + Q)^-1."""
    kept = tuning.forgetting * information
    if not np.any(tuning.process_noise):
        return kept
    return inverse(inverse(kept) + tuning.process_noise**2 * np.eye(len(kept)))


def inverse(A: FloatArray) -> FloatArray:
    """Inverse of a positive definite A (n, n); NaN where it is not."""
    result = np.empty_like(A)
    kernels.invert(A, result)
    return result


def gain_update(
    exposures: list[Measurement], P: FloatArray, z_prior: FloatArray, z_at: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """The printed update with an inverse as large as the rows of an exposure (W Eqs 25-27); returns z, P and the NIS."""
    z, nis = z_prior, 0.0
    for e, H, R in exposures:
        innovation = e + H @ (z - z_at)
        W = H @ P @ H.T + R
        solved = np.linalg.solve(W, np.column_stack([H @ P, innovation]))
        K = solved[:, :-1].T
        keep = np.eye(len(z)) - K @ H
        z = z - K @ innovation
        P = keep @ P @ keep.T + K @ R @ K.T
        nis += float(innovation @ solved[:, -1])
    return z, P, nis


def upper_factor(P: FloatArray) -> FloatArray:
    """Upper triangular S with S S^T = P, by reversing rows and columns around the usual lower factor; NaN where there is none."""
    try:
        return np.asarray(np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1])
    except np.linalg.LinAlgError:
        return np.full_like(P, np.nan)
