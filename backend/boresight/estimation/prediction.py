"""The covariance after further frames of the same kind, before they are taken.

Each frame brings on average the information a = A / n of the n frames that are there. A batch, or a filter without process
noise, ends at P_k^-1 = P^-1 + k a; a filter's P^-1 holds its start once, which further frames leave as it is.

With process noise Q = q^2 I and a forgetting factor l, a frame takes P to ((P / l + Q)^-1 + a)^-1. A run of such steps is again

    P -> F (I + P G)^-1 P F^T + C,

and two runs, 1 then 2, join to one (Särkkä & García-Fernández 2021, Eq 10):

    F = F_2 (I + C_1 G_2)^-1 F_1      C = F_2 (I + C_1 G_2)^-1 C_1 F_2^T + C_2      G = F_1^T (I + G_2 C_1)^-1 G_2 F_1 + G_1.

Q is a multiple of I, so in the eigenvectors of a all of these stay diagonal: three numbers a direction, and k steps by repeated
doubling. Only P itself is full. One step has F = 1 / (sqrt(l) (1 + q^2 a)), C = q^2 / (1 + q^2 a), G = a / (l (1 + q^2 a)).

References
----------
Särkkä, García-Fernández, "Temporal parallelization of Bayesian smoothers", IEEE TAC 66, 2021.
"""

from __future__ import annotations

import math

import numpy as np

from boresight.arrays import FloatArray

#: Share of what a filter knew that is nothing: further frames are like those before, where a direction is seen at all.
FORGOTTEN = 1e-100
Run = tuple[FloatArray, FloatArray, FloatArray]


def further_covariance(
    P: FloatArray, per_frame: FloatArray, frames: int, process_noise: float = 0.0, forgetting_factor: float = 1.0
) -> FloatArray:
    """Covariance after so many further frames.

    Parameters
    ----------
    P
        (n_free, n_free) covariance now, in typical sigmas.
    per_frame
        (n_free, n_free) mean information of a frame.
    frames
        How many more; 0 gives P back.
    process_noise
        Standard deviation added a frame to each free parameter, in typical sigmas.
    forgetting_factor
        Share of the information carried from frame to frame.
    """
    if frames <= 0:
        return P
    if forgetting_factor < 1.0:
        frames = min(frames, math.ceil(math.log(FORGOTTEN) / math.log(forgetting_factor)))
    values, vectors = np.linalg.eigh(per_frame)
    F, C, G = _repeated(_one_step(np.maximum(values, 0.0), process_noise**2, forgetting_factor), frames)
    here = vectors.T @ P @ vectors
    after = np.linalg.solve(np.eye(len(P)) + here * G, here)
    return np.asarray(vectors @ (F[:, None] * after * F + np.diag(C)) @ vectors.T)


def _one_step(a: FloatArray, q2: float, forgetting_factor: float) -> Run:
    """Forget, add noise, take a frame in."""
    damp = 1 / (1 + q2 * a)
    return damp / np.sqrt(forgetting_factor), q2 * damp, a * damp / forgetting_factor


def _joined(one: Run, two: Run) -> Run:
    """One run after another."""
    (F_1, C_1, G_1), (F_2, C_2, G_2) = one, two
    damp = 1 / (1 + C_1 * G_2)
    return F_2 * damp * F_1, F_2 * damp * C_1 * F_2 + C_2, F_1 * damp * G_2 * F_1 + G_1


def _repeated(step: Run, times: int) -> Run:
    """A step taken `times` times, by doubling."""
    nothing = np.zeros_like(step[0])
    whole: Run = (nothing + 1, nothing, nothing)
    while times:
        if times & 1:
            whole = _joined(whole, step)
        step, times = _joined(step, step), times >> 1
    return whole
