"""The filter on the angular distances of all pairs: W's baseline, with its covariance in full.

`estimation.angular` says what is measured and how well, `information` how it is taken in.

Gain form of many pairs
-----------------------
The m rows of an exposure lie, with their noise, in the 2 N - 3 dimensions of the range of G. An orthogonal turn of all rows that
puts this range first leaves the gain's result as it is, and leaves the rows beyond without residual, without slope and without
correlation to the others: they move nothing, and the m by m inverse falls into one of 2 N - 3 and one of noise alone. So where an
exposure has more than `MOST_PAIRS` pairs, its gain is taken over the displacements y of `estimation.angular` instead, whose
covariance, its null space filled with ones, is I (2 N, 2 N). Both ways end at the same numbers to rounding, which the tests hold
them to. What is lost is only what the printed form is kept for, the time that its inverse takes.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.estimation.angular import all_pairs
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.information import Measurement, information_filter

#: Pairs of an exposure, those of 63 stars, beyond which no m by m matrix is made: there its inverse takes a second each time that a
#: frame is linearised, and grows with m^3; 150 stars would take three minutes and several matrices of 1 GB.
MOST_PAIRS = 2000


class AllPairs:
    """The angular distances of all pairs of a frame's exposures."""

    def __init__(self, free: IntArray, scale: FloatArray) -> None:
        self._free, self._scale = free, scale

    def whiten(self, star_start: IntArray, s_i: FloatArray, sigma_rad: FloatArray) -> int:
        """Take the catalogue's angles and factor their covariance; return 2 N - 3 an exposure."""
        counts = np.diff(star_start)
        exposures, most = len(counts), int(counts.max())
        pairs = most * (most - 1) // 2
        self._star_start = star_start
        self._phi, self._G = np.empty((exposures, pairs)), np.empty((exposures, pairs, 4))
        self._L = np.empty((exposures, 2 * most, 2 * most))
        kernels.factor_pairs(star_start, s_i, sigma_rad, self._phi, self._G, self._L)
        return int(2 * star_start[-1] - 3 * exposures)

    def rows(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacement of every star that explains the residuals best, two rows a star, and its Jacobian."""
        return self._displacements(*self.unwhitened(s, D))

    def unwhitened(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured minus catalogue angles (n_exposures, pairs of most) and their Jacobian (.., n_free)."""
        e, H = np.empty_like(self._phi), np.empty((*self._phi.shape, len(self._free)))
        kernels.pair_rows(self._star_start, s, D, self._free, self._scale, self._phi, e, H)
        return e, H

    def exposures(self, s: FloatArray, D: FloatArray) -> list[Measurement]:
        """Residuals and Jacobian of all pairs on the range of R, and R with its null space filled, exposure by exposure."""
        e, H = self.unwhitened(s, D)
        y, slopes = self._displacements(e, H)
        measured = []
        for x, (first, last) in enumerate(pairwise(2 * self._star_start)):
            n = int(last - first) // 2
            if n * (n - 1) // 2 > MOST_PAIRS:
                measured.append((y[first:last], slopes[first:last], np.eye(2 * n)))
            else:
                measured.append(self._projected(e[x], H[x], x, n))
        return measured

    def _displacements(self, e: FloatArray, H: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacements (2 n_stars,) that explain residuals e best, and their Jacobian (2 n_stars, n_free)."""
        n = 2 * int(self._star_start[-1])
        y, slopes = np.empty(n), np.empty((n, len(self._free)))
        kernels.whiten_pairs(self._star_start, e, H, self._G, self._L, y, slopes)
        return y, slopes

    def _projected(self, e: FloatArray, H: FloatArray, x: int, n: int) -> Measurement:
        """All pairs of the n stars of exposure x."""
        pairs = all_pairs(n)
        m, G = len(pairs), np.zeros((len(pairs), 2 * n))
        places = np.stack([2 * pairs[:, 0], 2 * pairs[:, 0] + 1, 2 * pairs[:, 1], 2 * pairs[:, 1] + 1], axis=1)
        np.put_along_axis(G, places, self._G[x, :m], axis=1)
        factor = np.tril(self._L[x, : 2 * n, : 2 * n])
        onto = G @ np.linalg.solve(factor @ factor.T, G.T)
        R = G @ G.T
        return onto @ e[:m], onto @ H[:m], R + np.trace(R) / m * (np.eye(m) - onto)


def angular_filter(
    arcs: ArcSet, state: FilterState, free: IntArray, scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; parameters and result as in `square_root_filter`."""
    return information_filter(AllPairs(free, scale), arcs, state, free, scale, tuning)
