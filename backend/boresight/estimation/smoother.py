"""The smoother: parameters at every frame's time given all frames, before and after it, in square-root form.

The model is that of the filters. Before frame k the scaled free parameters step by w_k ~ N(0, Q_k), Q_k = diag(q_k^2), and the
start z_0 has the covariance P_0; a frame's whitened rows are e'_k(z_k). What is minimised over all z_k is

    (z_1 - z_0)^T (P_0 + Q_1)^-1 (z_1 - z_0) + sum_k>1 |diag(q_k)^-1 (z_k - z_k-1)|^2 + sum_k |e'_k(z_k)|^2

Forward, Carlson's filter takes the rows of every frame, e'_k + H'_k (z - z_k^lin), linearised at a state that is given for it, and
keeps z_k and S_k, P_k = S_k S_k^T, after each. Backward, with P-_k+1 = P_k + Q_k+1 and s for what all frames say,

    B_k   = Q_k+1 (P-_k+1)^-1                    G_k = I - B_k, the gain of Rauch, Tung and Striebel
    z_k^s = z_k+1^s - B_k (z_k+1^s - z_k)        = z_k + G_k (z_k+1^s - z_k)
    S_k^s : triangular root of [ G_k S_k+1^s   B_k S_k   G_k diag(q_k+1) ]

The last is Joseph's form of P_k + G_k (P_k+1^s - P-_k+1) G_k^T without its difference: P_k - G_k P-_k+1 G_k^T = B_k P_k B_k^T +
G_k Q_k+1 G_k^T. Written with B_k nothing cancels where Q is small, and where Q is zero every frame has the last
one's numbers to the last bit.

One pass each way is a Gauss-Newton step of that sum of squares over all frames at once (Bell 1994), so both are repeated with the
rows taken at the smoothed states, until no state moves by more than `REST` of its sigma. Where it rests is the optimum of the whole
problem and no matter of where the filter linearised: with Q = 0 it is the batch's, with the start as its prior (`prior`).

References
----------
Rauch, Tung, Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA Journal 3, 1965. Bierman, "Factorization
Methods for Discrete Sequential Estimation", 1977. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM J. Optim. 4,
1994.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.estimation.blocks import FRAMES
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.filters.history import FilterState
from boresight.estimation.filters.square_root import padded
from boresight.estimation.stored_arcs import Arcs

#: Largest move of a state between two rounds, in its sigmas, at which the smoother rests, and the most rounds.
REST, MOST_ROUNDS = 1e-7, 12
#: Move in the last round below which what the smoother found may be used.
SETTLED = 1e-3
#: Numbers that are kept in memory; of longer sets they lie in a file that is gone when they are.
IN_MEMORY = 20_000_000


@dataclass(frozen=True)
class SmoothedFrames:
    """What all frames say of every frame's parameters, in typical sigmas from the start.

    Parameters
    ----------
    z
        (n_frames, n_free) departure of the free parameters from their start.
    S
        (n_frames, n_free, n_free) upper triangular, covariance of z = S S^T.
    chi2
        Sum of squares of the whitened rows at these states.
    rounds, moved
        Passes each way, and the largest move of a state in the last, in its sigmas.
    """

    z: FloatArray
    S: FloatArray
    chi2: float
    rounds: int
    moved: float

    @property
    def settled(self) -> bool:
        """Whether the numbers may be used."""
        return self.moved < SETTLED

    @property
    def sigma(self) -> FloatArray:
        """(n_frames, n_free) one-sigma in typical sigmas."""
        return np.asarray(np.sqrt(np.einsum("kij,kij->ki", self.S, self.S)))


def smooth(
    arcs: Arcs,
    start: FilterState,
    free: IntArray,
    scale: FloatArray,
    q: FloatArray,
    x: FloatArray,
    cancelled: Callable[[], bool] = lambda: False,
) -> SmoothedFrames:
    """Smooth over a set.

    Parameters
    ----------
    arcs
        Whitened arcs of all frames, in memory or in files.
    start
        Before the first frame, as a filter has it.
    free, scale
        (n_free,) places and typical sigmas of the free parameters.
    q
        (n_frames, n_free) standard deviation of the step before each frame, typical sigmas.
    x
        (n_parameters,) state at which every frame is linearised first: a filter's end, SI.
    cancelled
        Asked every few frames; True stops.
    """
    n, n_free = q.shape
    origin = start.x.copy()
    origin[free] -= scale * start.z
    z, at, S = _room(n, n_free), _room(n, n_free), _room(n, n_free, n_free)
    at[:] = (x[free] - origin[free]) / scale
    moved, chi2, rounds = np.inf, np.nan, 0
    while moved > REST and rounds < MOST_ROUNDS:
        chi2, rounds = _forward(arcs, start, free, scale, q, origin, at, z, S, cancelled), rounds + 1
        kernels.backward_pass(z, S, np.ascontiguousarray(q))
        before, moved = moved, _largest_move(z, at, S)
        at[:] = z
        if not np.isfinite(moved) or before < moved < SETTLED:  # rounding moves it, or nothing will
            break
    return SmoothedFrames(z, S, chi2, rounds, moved)


def _forward(  # noqa: PLR0913, PLR0917 - what `smooth` has, and three arrays to fill
    arcs: Arcs, start: FilterState, free: IntArray, scale: FloatArray, q: FloatArray, origin: FloatArray, at: FloatArray,
    z: FloatArray, S: FloatArray, cancelled: Callable[[], bool],
) -> float:  # fmt: skip
    """Run the filter over all frames, linearised at `at`; fills z and S, and returns chi-square there."""
    size, total = len(origin), 0.0
    mean, root = padded(start.z, size), padded(start.S, size)
    for first in range(0, len(z), FRAMES):
        refuse_cancelled(cancelled, f"after {first} of {len(z)} frames of the smoother")
        block = slice(first, min(first + FRAMES, len(z)))
        part = arcs.frames(block.start, block.stop)
        steps, chi2 = np.zeros((part.n_frames, size)), np.empty(part.n_frames)
        steps[:, : len(free)] = q[block]
        kernels.forward_pass(
            mean, root, steps, part.camera.kind, part.pitch, part.frame_start, part.star_start, part.row_px, part.col_px,
            part.known_phi, part.band, origin, free, scale, at[block], z[block], S[block], chi2,
        )  # fmt: skip
        total += float(chi2.sum())
    return total


def _largest_move(z: FloatArray, at: FloatArray, S: FloatArray) -> float:
    """Largest distance between two states of a frame, in the sigma of each parameter."""
    worst = 0.0
    for first in range(0, len(z), FRAMES):
        block = slice(first, first + FRAMES)
        sigma = np.sqrt(np.einsum("kij,kij->ki", S[block], S[block]))
        moved = float((np.abs(z[block] - at[block]) / sigma).max())
        worst = max(worst, moved) if np.isfinite(moved) else np.inf
    return worst


def _room(*shape: int) -> FloatArray:
    """Return an array of a shape, in a nameless file where it is large."""
    if np.prod(shape) <= IN_MEMORY:
        return np.empty(shape)
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, np.float64, "w+", shape=shape).view(np.ndarray)
