"""The filter on the angular distances of all pairs: W's baseline, with its covariance in full.

`estimation.angular` says what is measured and how well, `information` how it is taken in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.errors import RefusedInputError
from boresight.estimation.angular import all_pairs
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.information import Measurement, information_filter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Pairs of an exposure beyond which the gain form is refused: its m by m inverse takes seconds a frame here, and grows with m^3.
MOST_PAIRS = 2000


class AllPairs:
    """The angular distances of all pairs of a frame's exposures."""

    def __init__(self, free: IntArray, scale: FloatArray) -> None:
        self._free, self._scale = free, scale

    def weigh(self, star_start: IntArray, s_i: FloatArray, sigma_rad: FloatArray) -> int:
        """Take the catalogue's angles and factor their covariance; return 2 N - 3 an exposure."""
        counts = np.diff(star_start)
        exposures, most = len(counts), int(counts.max())
        pairs = most * (most - 1) // 2
        self._star_start = star_start
        self._phi, self._G = np.empty((exposures, pairs)), np.empty((exposures, pairs, 4))
        self._L = np.empty((exposures, 2 * most, 2 * most))
        kernels.weigh_pairs(star_start, s_i, sigma_rad, self._phi, self._G, self._L)
        return int(2 * star_start[-1] - 3 * exposures)

    def rows(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacement of every star that explains the residuals best, two rows a star, and its Jacobian."""
        n = 2 * int(self._star_start[-1])
        e, H = np.empty(n), np.empty((n, len(self._free)))
        kernels.whiten_pairs(self._star_start, *self.unwhitened(s, D), self._G, self._L, e, H)
        return e, H

    def unwhitened(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured minus catalogue angles (n_exposures, pairs of most) and their Jacobian (.., n_free)."""
        e, H = np.empty_like(self._phi), np.empty((*self._phi.shape, len(self._free)))
        kernels.pair_rows(self._star_start, s, D, self._free, self._scale, self._phi, e, H)
        return e, H

    def exposures(self, s: FloatArray, D: FloatArray) -> list[Measurement]:
        """Residuals and Jacobian of all pairs on the range of R, and R with its null space filled, exposure by exposure."""
        measured = []
        unwhitened = zip(*self.unwhitened(s, D), self._G, self._L, np.diff(self._star_start), strict=True)
        for e, H, entries, L, n in unwhitened:
            pairs = all_pairs(int(n))
            m, G = len(pairs), np.zeros((len(pairs), 2 * n))
            if m > MOST_PAIRS:
                raise RefusedInputError(
                    f"The gain form would invert a matrix of {m} pairs of {n} stars in one exposure;"
                    f" it is kept to {MOST_PAIRS}: choose the information form, which gives the same."
                )
            places = np.stack([2 * pairs[:, 0], 2 * pairs[:, 0] + 1, 2 * pairs[:, 1], 2 * pairs[:, 1] + 1], axis=1)
            np.put_along_axis(G, places, entries[:m], axis=1)
            factor = np.tril(L[: 2 * n, : 2 * n])
            onto = G @ np.linalg.solve(factor @ factor.T, G.T)
            R = G @ G.T
            filled = R + np.trace(R) / m * (np.eye(m) - onto)
            measured.append((onto @ e[:m], onto @ H[:m], filled))
        return measured


def angular_filter(
    arcs: ArcSet, state: FilterState, free: IntArray, scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; parameters and result as in `square_root_filter`."""
    return information_filter(AllPairs(free, scale), arcs, state, free, scale, tuning)
