"""Singular values of the star vectors of a combination: a reference that no attitude changes (W section 3).

The n directions of a combination are the columns of W (3, n), W = P diag(sigma_1 >= sigma_2 >= sigma_3) Q^T. A rotation C turns P
alone, so the three sigma_k of the measured directions should be those of the catalogue's (W Eq 18). sigma_k^2 and p_k are an
eigenvalue and eigenvector of W W^T (3, 3), and q_k = W^T p_k / sigma_k: no n by n matrix is needed.

Derivatives
-----------
For a simple value, d sigma_k = p_k^T dW q_k (W takes them numerically). So the gradient by star i is

    g_ki = d sigma_k / d w_i = (p_k.w_i / sigma_k) p_k,         d sigma_k / dx = sum_i g_ki . dw_i/dx.

Unit vectors make sigma_1^2 + sigma_2^2 + sigma_3^2 = n whatever the camera: each value follows from the other two, so any two of
them hold what all three do (erratum to W 3.3.3 and Table 3), and a combination gives two independent rows, not three (erratum to
W 3.3). Choosing between pairs is choosing a scale: in a narrow field sigma_1, near sqrt(n), moves by the small share sigma_3 /
sigma_1 of what sigma_3 moves by, and its noise with it.

Where two values meet, neither has a derivative: their vectors turn freely in a common plane, and noise drives the two apart. Their
sum keeps one, the trace over that invariant plane. So where two of the catalogue's values lie within `APART` direction errors of
each other, their sum is measured in their place when both were asked for, and neither when only one was. For the same reason a
value within `APART` direction errors of zero, of stars on one great circle, is not measured: it is the size of a signed quantity.

Combinations
------------
Of the N stars of an exposure, in the order of `estimation.arcs`, whose every three in a row form a fat triangle (W section 3.3.2)::

    Model 1     three stars: 1-2-3, 2-3-4, ...                      N combinations
    Model 2     floor(N / 2) stars, but no fewer than three         N
    Model 3     N - 1 stars                                         N
    Model 4     the first 3, the first 4, ... all N                 N - 2

The windows of Models 1 to 3 run on past the last star to the first, a reading of the paper's figure: otherwise Model 3 has
two combinations, four rows for six parameters, and could not be observable in one image as its Figure 3 has it.

Covariance
----------
Combinations share stars, so their values are correlated. With the isotropic direction error sigma_i of `arcs.angular_sigma`,
which is tangential, and h_ri = sigma_i (I - w_i w_i^T) g_ri stacked in G (m, 3 N),

    R = sum_i h_ri . h_si = G G^T.

All invariants of N directions are functions of 2 N - 3 of them, so the 2 N rows of Models 1 to 3 make R singular: the redundant
rows repeat what others say, to first order, and are left out. The rows that are kept come from a Cholesky factorisation of the
correlation matrix, which no scale of a row changes: it takes the row next that keeps the largest share of its own variance, and
ends when all that remain are determined by others but for `DETERMINED` of theirs. (A thousandth of the largest variance of all
rows would take a third of their rows from {1, 2} and {1, 3}, and leave a predicted sigma up to 1.9 times as wide.)
With the centroids' rows D = dw/dx / sigma_i the information is D^T Pi D, Pi the projection on the rows of G. Model 4 with {2, 3}
has 2 N - 4 of the 2 N - 3 dimensions that there are; with {1, 3} and {1, 2, 3} its sigmas are the same to 0.1 %, and with
{1, 2}, more of whose rows end below the bound, to 1.3 % (W's sensor, 19 stars: `python -m benchmarks.monte_carlo subsets`).
What is left between them is curvature: sigma_1 tells of sigma_3 by its square. Nothing is seen of it at 0.2 px and 2,400 frames
(100 sets, mean NEES 6.3 for {2, 3}, {1, 2} and {1, 3}, at most 6.68 expected); at 0.5 px it is 6.7, 7.1 and 6.8.

This module is the plain form; `kernels.singular` holds the compiled one, which the tests hold against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray

STAR_MODELS = (1, 2, 3, 4)
VALUES = (1, 2, 3)
#: Values closer than so many direction errors are not told apart. Noise moves each by about one, and pushes neighbours apart by
#: its square over their distance, always the same way: by up to a hundredth of what it moves them by.
APART = 100.0
#: Share of its own variance below which what a row adds to others is that hundredth, curvature more than measurement. At a
#: hundredth of it the NEES of 200 sets of 150 frames of 19 stars was 9.7 where 7.5 to 8.6 is consistent; here it is 8.3.
DETERMINED = APART**-2


@dataclass(frozen=True)
class Selection:
    """Which singular values of which combinations are measured.

    Parameters
    ----------
    model
        1 to 4, see above.
    values
        A subset of 1, 2, 3.
    """

    model: int = 4
    values: tuple[int, ...] = (2, 3)

    @property
    def chosen(self) -> NDArray[np.bool_]:
        """(3,) which of the three are measured."""
        return np.array([k in self.values for k in VALUES])


#: The paper's own choice.
CHOSEN = Selection()


def windows(n: int, model: int) -> IntArray:
    """First star and number of stars of each combination of an exposure of n stars, (n_combinations, 2)."""
    if model == 4:
        return np.array([(0, size) for size in range(3, n + 1)])
    size = {1: 3, 2: max(3, n // 2), 3: n - 1}[model]
    return np.array([(first, size) for first in range(n)])


def members(n: int, window: IntArray) -> IntArray:
    """Stars of a combination; it runs on past the last star to the first."""
    return np.asarray((window[0] + np.arange(window[1])) % n)


def decomposition(s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular values (3,) of the directions s (n, 3), descending, and their left vectors p_k as columns (3, 3)."""
    P, sigma, _ = np.linalg.svd(s.T, full_matrices=False)
    return sigma, P


def gradients(s: FloatArray) -> FloatArray:
    """g_ki = d sigma_k / d s_i of directions s (n, 3) as free vectors, (3, n, 3); for simple, positive values."""
    sigma, P = decomposition(s)
    return np.asarray(np.einsum("nk,jk->knj", (s @ P) / sigma, P))


def row_of_value(sigma: FloatArray, selection: Selection, noise: float) -> IntArray:
    """Row of a combination that each value takes part in, (3,), or -1.

    Parameters
    ----------
    sigma
        (3,) the catalogue's values.
    noise
        Largest direction error of the combination's stars, rad.
    """
    rows, next_row, k = np.full(3, -1), 0, 0
    while k < 3:
        last = k
        while last < 2 and sigma[last] - sigma[last + 1] < APART * noise:
            last += 1
        if selection.chosen[k : last + 1].all() and sigma[last] > APART * noise:
            rows[k : last + 1] = next_row
            next_row += 1
        k = last + 1
    return rows


@dataclass(frozen=True)
class Exposure:
    """The measured values of one exposure, by NumPy alone.

    Parameters
    ----------
    rows
        (n_combinations, 3) row of the stack that each value takes part in, or -1.
    z
        (m,) the catalogue's values.
    R
        (m, m) their covariance, possibly singular.
    """

    rows: IntArray
    z: FloatArray
    R: FloatArray


def exposure(s_i: FloatArray, sigma_rad: FloatArray, selection: Selection) -> Exposure:
    """Values and covariance of the catalogue directions s_i (n, 3) with direction errors sigma_rad (n,)."""
    n = len(s_i)
    combinations = windows(n, selection.model)
    rows = np.full((len(combinations), 3), -1)
    m = 0
    for c, window in enumerate(combinations):
        stars = members(n, window)
        own = row_of_value(decomposition(s_i[stars])[0], selection, float(sigma_rad[stars].max()))
        rows[c] = np.where(own >= 0, own + m, -1)
        m = max(m, int(rows[c].max()) + 1)
    z, g = stacked(s_i, rows, selection)
    G = sigma_rad[:, None] * (g - np.einsum("rnj,nj->rn", g, s_i)[..., None] * s_i)
    return Exposure(rows, z, np.einsum("rnj,snj->rs", G, G))


def stacked(s: FloatArray, rows: IntArray, selection: Selection) -> tuple[FloatArray, FloatArray]:
    """Values (m,) of directions s (n, 3) and their gradients (m, n, 3), for the rows of `Exposure`."""
    n, m = len(s), int(rows.max(initial=-1)) + 1
    z, g = np.zeros(m), np.zeros((m, n, 3))
    for row, window in zip(rows, windows(n, selection.model), strict=True):
        stars = members(n, window)
        sigma, slopes = decomposition(s[stars])[0], gradients(s[stars])
        for k in np.flatnonzero(row >= 0):
            z[row[k]] += sigma[k]
            g[row[k], stars] += slopes[k]
    return z, g


def determined_rows(R: FloatArray) -> IntArray:
    """Rows that determine all others, in the order of their pivots: (rank,)."""
    sigma = np.sqrt(np.diag(R))
    left = R / np.outer(sigma, sigma)
    np.fill_diagonal(left, 1.0)  # rounding decides nothing: the first row comes first
    kept: list[int] = []
    while len(kept) < len(R):
        row = int(np.argmax(np.diag(left)))
        if left[row, row] <= DETERMINED:
            break
        kept.append(row)
        left = left - np.outer(left[row], left[row]) / left[row, row]
        left[row], left[:, row] = 0.0, 0.0
    return np.array(kept, dtype=np.int64)
