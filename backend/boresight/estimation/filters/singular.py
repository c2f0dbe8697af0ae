"""The filter on singular values of star combinations (W section 3.2), with the covariance that W leaves open.

`estimation.singular_values` says what is measured and how well, `information` how it is taken in. The redundant rows of an
exposure are left out before the update, in both forms: those that are kept have an R that can be inverted.
"""

from __future__ import annotations

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray, IntArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.information import Measurement, information_filter
from boresight.estimation.singular_values import APART, DETERMINED, Selection


class SingularValues:
    """The chosen singular values of a frame's star combinations."""

    def __init__(self, selection: Selection, free: IntArray, scale: FloatArray) -> None:
        self._model, self._chosen = selection.model, selection.chosen
        self._free, self._scale = free, scale

    def whiten(self, star_start: IntArray, s_i: FloatArray, sigma_rad: FloatArray) -> int:
        """Take the catalogue's values and factor their covariance; return how many are independent."""
        exposures, most = len(star_start) - 1, int(np.diff(star_start).max())
        self._star_start = star_start
        self._rows = np.full((exposures, most, 3), -1)
        self._z = np.empty((exposures, 3 * most))
        self._L = np.empty((exposures, 3 * most, 3 * most))
        self._pivot = np.empty((exposures, 3 * most), np.int64)
        self._sizes = np.empty((exposures, 2), np.int64)
        kernels.factor_values(
            star_start, s_i, sigma_rad, self._model, self._chosen, APART, DETERMINED,
            self._rows, self._z, self._L, self._pivot, self._sizes,
        )  # fmt: skip
        return int(self._sizes[:, 1].sum())

    def rows(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals and Jacobian of the rows kept."""
        n = int(self._sizes[:, 1].sum())
        e, H = np.empty(n), np.empty((n, len(self._free)))
        kernels.whiten(*self.unwhitened(s, D), self._L, self._pivot, self._sizes, e, H)
        return e, H

    def unwhitened(self, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured minus catalogue values (n_exposures, 3 most) and their Jacobian (n_exposures, 3 most, n_free)."""
        e, H = np.empty_like(self._z), np.empty((*self._z.shape, len(self._free)))
        kernels.value_rows(self._star_start, s, D, self._free, self._scale, self._model, self._rows, self._z, e, H)
        return e, H

    def exposures(self, s: FloatArray, D: FloatArray) -> list[Measurement]:
        """Residuals, Jacobian and covariance of the rows kept, exposure by exposure."""
        measured = []
        for e, H, L, pivot, (_, rank) in zip(*self.unwhitened(s, D), self._L, self._pivot, self._sizes, strict=True):
            kept, factor = pivot[:rank], np.tril(L[:rank, :rank])
            measured.append((e[kept], H[kept], factor @ factor.T))
        return measured


def singular_filter(
    arcs: ArcSet, state: FilterState, free: IntArray, scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; parameters and result as in `square_root_filter`."""
    return information_filter(SingularValues(tuning.selection, free, scale), arcs, state, free, scale, tuning)
