"""Which rows belong to which exposure: runs of rows that share frame and exposure number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.telemetry.schema import Telemetry

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Exposures:
    """The exposures of a set in file order.

    Parameters
    ----------
    start
        (n_exposures,) first entry of each.
    count
        (n_exposures,) entries of each.
    frame, exposure
        (n_exposures,) their numbers.
    of_entry
        (n_rows,) position in these arrays, for every entry of the telemetry.
    """

    start: IntArray
    count: IntArray
    frame: IntArray
    exposure: IntArray
    of_entry: IntArray

    def __len__(self) -> int:
        """Count the exposures."""
        return len(self.start)


def exposures_of(telemetry: Telemetry) -> Exposures:
    """Return the runs of rows with the same frame and exposure number."""
    rows = len(telemetry)
    first = np.ones(rows, dtype=np.bool_)
    first[1:] = (np.diff(telemetry.frame) != 0) | (np.diff(telemetry.exposure) != 0)
    start = np.flatnonzero(first)
    return Exposures(
        start=start,
        count=np.diff(start, append=rows),
        frame=telemetry.frame[start],
        exposure=telemetry.exposure[start],
        of_entry=np.cumsum(first) - 1,
    )


def repeats_within(exposure_of_entry: IntArray, *keys: NDArray[np.generic]) -> tuple[IntArray, IntArray]:
    """Find entries that have the same keys as an earlier entry of their exposure.

    Parameters
    ----------
    exposure_of_entry
        (n,) exposure of each entry.
    keys
        (n,) each; all must be equal.

    Returns
    -------
    later, earlier
        (n_repeats,) positions of the repeating entries and of the ones just before with the same keys; ascending.
    """
    order = np.lexsort((*keys, exposure_of_entry))
    same = np.ones(max(len(order) - 1, 0), dtype=np.bool_)
    for key in (exposure_of_entry, *keys):
        same &= np.diff(key[order]) == 0
    place = np.flatnonzero(same)
    later, earlier = order[place + 1], order[place]
    ascending = np.argsort(later)
    return later[ascending], earlier[ascending]
