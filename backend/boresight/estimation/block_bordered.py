"""Parameters of a pass beside common ones: every pass's normal equations reduced onto what it shares with the others.

Pass k = 1..K sees the free parameters z_k = (c, p_k), scaled by their typical sigmas: c common to all, p_k its own. Its arcs give
A_k and b_k at its own state (`batch`), and nothing else is needed of it. What joins the p_k is one of

    pass        nothing
    walk        p_k - p_{k-1} has the covariance Q_k, so W_k = Q_k^-1 is information between the two
    regression  p_k = p + v_k^T s, v_k what is known of the pass: its temperature or time from a reference, their powers, or 1 from
                a date on; s coefficients

Passes and walks. With r_k = p_k - p_{k-1} the normal equations of the stacked problem are

    [ C    E_1^T  E_2^T ... ]        C = sum_k A_k,cc            D_k = A_k,pp + W_k + W_{k+1}
    [ E_1  D_1   -W_2       ]        E_k = A_k,pc                (W_1 = W_{K+1} = 0)
    [ E_2 -W_2    D_2  ...  ]        right side -b_k,p - W_k r_k + W_{k+1} r_{k+1}

block tridiagonal with a border, solved in one sweep: L_k = D_k - W_k L_{k-1}^-1 W_k, the border reduced by S = C - E^T T^-1 E,
where T is the tridiagonal part. Of the inverse only what belongs to one pass is needed: with Z_k the diagonal blocks of T^-1,
which a sweep back gives as Z_k = L_k^-1 + L_k^-1 W_{k+1} Z_{k+1} W_{k+1} L_k^-1, and Y = T^-1 E,

    cov(c) = S^-1      cov(p_k) = Z_k + Y_k S^-1 Y_k^T      cov(p_k, c) = -Y_k S^-1

A walk about a regression, z_k = p_k + E_k s where p_k walks, has the coefficients s in the border beside c: with G_k, what a pass's
parameters have of both, C = sum_k G_k^T A_k G_k and E_k the rows of A_k G_k. A parameter that steps between two passes has no
information there, W = 0.

Without W this is the Schur complement of each pass by itself. With W alone it is the smoother of Rauch, Tung and Striebel.

Regression. z_k = B_k (z, s) with B_k = [I, E_k], E_k the v_k of each parameter in its row, so A = sum_k B_k^T A_k B_k is as small
as the parameters are few.

Each is the stacked least-squares problem itself, and no average of results: a pass that leaves a direction open says what it knows
of the others. The steps are damped as in `batch`, with every pass linearised again at its own state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.batch import NormalEquations


@dataclass(frozen=True)
class Solution:
    """A step of every pass, (n_passes, n_free) typical sigmas, its squared length in sigmas, and the covariance of each pass.

    `P`: (n_passes, n_free, n_free). `slope`, `slope_covariance`: (n_columns,) and (n_columns, n_columns) of a regression, typical
    sigmas a unit of its columns; empty for the others. `log_determinant`: log |H| of the whole problem.
    """

    step: FloatArray
    decrement: float
    P: FloatArray
    slope: FloatArray
    slope_covariance: FloatArray
    log_determinant: float


class Variation(Protocol):
    """How the parameters of a pass hang together."""

    def solve(self, sums: Sequence[NormalEquations], z: FloatArray, damping: float = 0.0) -> Solution:
        """Solve for the step of every pass from z, (n_passes, n_free); raises LinAlgError where something is open."""
        ...

    def cost(self, z: FloatArray) -> float:
        """What the link between passes adds to chi-square at z, (n_passes, n_free)."""
        ...


@dataclass(frozen=True)
class Linked:
    """Parameters of each pass, by themselves or as a random walk.

    Parameters
    ----------
    own
        (n_own,) places of the parameters of a pass among the free ones.
    W
        (n_passes, n_own) information between a pass and the one before it, for each parameter; 0 where there is no link, as there
        is none before the first.
    trend
        What the walk is about; None where it is about nothing.
    """

    own: IntArray
    W: FloatArray
    trend: Regressed | None = None

    def border(self, n: int) -> tuple[FloatArray, FloatArray]:
        """G of every pass (n_passes, n, n_border), and values of the trend (n_passes, n_own, n_columns), for n free parameters."""
        trend = Regressed(np.empty(0, np.int64), np.empty((len(self.W), 0))) if self.trend is None else self.trend
        B = trend.design(n)
        return np.delete(B, self.own, axis=2), B[:, self.own, n:]

    def solve(self, sums: Sequence[NormalEquations], z: FloatArray, damping: float = 0.0) -> Solution:
        """Solve for the step of every pass."""
        n = len(sums[0].b)
        own, (G, V) = self.own, self.border(n)
        K, m, n_c = len(sums), len(own), n - len(own)
        A, b = np.array([one.A for one in sums]), np.array([one.b for one in sums])
        W = np.array([np.diag(w) for w in self.W])
        r, slope = self._steps(z, V)
        after = np.concatenate([W[1:], np.zeros((1, m, m))])
        AG = A @ G
        C = np.einsum("kij,kil->jl", G, AG) + damping * np.eye(G.shape[2])
        D = A[:, own][:, :, own] + W + after + damping * np.eye(m)
        E = AG[:, own]
        pull = np.einsum("kij,kj->ki", W, r)
        g = b[:, own] + pull - np.concatenate([pull[1:], np.zeros((1, m))])
        g_c = np.einsum("kij,ki->j", G, b)
        L_inverse, Y_and_y = _sweep(D, W, np.concatenate([E, g[:, :, None]], axis=2))
        Y, y = Y_and_y[:, :, :-1], Y_and_y[:, :, -1]
        S_inverse = _inverse(C - np.einsum("kmi,kmj->ij", E, Y))
        d_c = -S_inverse @ (g_c - np.einsum("kmi,km->i", E, y))
        step = G @ d_c
        step[:, own] -= y + Y @ d_c
        of_border = G.copy()
        of_border[:, own] -= Y
        P, Z = of_border @ S_inverse @ of_border.transpose(0, 2, 1), np.zeros((m, m))
        for k in reversed(range(K)):
            Z = L_inverse[k] + L_inverse[k] @ after[k] @ Z @ after[k] @ L_inverse[k]
            P[k][np.ix_(own, own)] += Z
        d_own = -y - Y @ d_c
        decrement = -float(g_c @ d_c + np.sum(g * d_own))
        log_determinant = -float(np.linalg.slogdet(L_inverse)[1].sum() + np.linalg.slogdet(S_inverse)[1])
        return Solution(step, decrement, P, slope + d_c[n_c:], S_inverse[n_c:, n_c:], log_determinant)

    def _steps(self, z: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steps of the walk (n_passes, n_own) at z, about the coefficients that cost least, and these (n_columns,)."""
        r, passed = np.diff(z[:, self.own], axis=0, prepend=z[:1, self.own]), np.diff(V, axis=0, prepend=V[:1])
        if not V.shape[2]:
            return r, np.empty(0)
        root = np.sqrt(self.W)
        rows = (root[:, :, None] * passed).reshape(-1, V.shape[2])
        slope = np.asarray(np.linalg.lstsq(rows, (root * r).ravel(), rcond=None)[0], np.float64)
        return r - passed @ slope, slope

    def cost(self, z: FloatArray) -> float:
        """What the steps of the walk add to chi-square."""
        return float(np.sum(self.W[1:] * self._steps(z, self.border(z.shape[1])[1])[0][1:] ** 2))


@dataclass(frozen=True)
class Regressed:
    """Parameters of each pass that are linear in what is known of it: its temperature or time, powers of them, or 1 from a date on.

    Parameters
    ----------
    of
        (n_columns,) place of each column's parameter among the free ones; a parameter may have several, or none.
    values
        (n_passes, n_columns) what its coefficient is multiplied by.
    """

    of: IntArray
    values: FloatArray

    def design(self, n: int) -> FloatArray:
        """B of every pass, (n_passes, n, n + n_columns), for n free parameters."""
        m = len(self.of)
        B = np.zeros((len(self.values), n, n + m))
        B[:, np.arange(n), np.arange(n)] = 1.0
        B[:, self.of, np.arange(n, n + m)] = self.values
        return B

    def solve(self, sums: Sequence[NormalEquations], z: FloatArray, damping: float = 0.0) -> Solution:
        """Solve for the step of every pass."""
        n, m = len(sums[0].b), len(self.of)
        B = self.design(n)
        A = np.einsum("kij,kil,klm->jm", B, np.array([one.A for one in sums]), B)
        g = np.einsum("kij,ki->j", B, np.array([one.b for one in sums]))
        inverse = _inverse(A + damping * np.eye(n + m))
        d = -inverse @ g
        slope = d[n:].copy()
        for place in np.unique(self.of):
            mine = np.flatnonzero(self.of == place)
            X = np.column_stack([np.ones(len(z)), self.values[:, mine]])
            slope[mine] += np.linalg.lstsq(X, z[:, place], rcond=None)[0][1:]
        P = np.einsum("kij,jl,kml->kim", B, inverse, B)
        log_determinant = -float(np.linalg.slogdet(inverse)[1])
        return Solution(B @ d, -float(g @ d), P, slope, inverse[n:, n:], log_determinant)

    def cost(self, z: FloatArray) -> float:  # noqa: ARG002 - a line costs nothing
        """Nothing: the passes lie on the line."""
        return 0.0


def _sweep(D: FloatArray, W: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the block tridiagonal T with diagonal D and -W beside it, (n_passes, m, m), for a right side (n_passes, m, n).

    Returns the inverses of L, (n_passes, m, m), and T^-1 times the right side.
    """
    L_inverse, solved = np.empty_like(D), right.copy()
    for k in range(len(D)):
        before = W[k] @ L_inverse[k - 1] if k else np.zeros_like(W[0])
        L_inverse[k] = _inverse(D[k] - before @ W[k])
        if k:
            solved[k] += before @ solved[k - 1]
    for k in reversed(range(len(D))):
        further = W[k + 1] @ solved[k + 1] if k + 1 < len(D) else 0.0
        solved[k] = L_inverse[k] @ (solved[k] + further)
    return L_inverse, solved


#: Reciprocal condition below which a matrix leaves a direction open.
OPEN = 1e-13


def _inverse(A: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite matrix (n, n); LinAlgError where it is not."""
    if not len(A):
        return A
    values, vectors = np.linalg.eigh((A + A.T) / 2)
    if not values[0] > OPEN * values[-1]:
        raise np.linalg.LinAlgError("Expected a positive definite matrix, received one with an open direction")
    return np.asarray((vectors / values) @ vectors.T)
