"""Which rows belong to which exposure: runs of rows that share frame and exposure number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.telemetry.schema import Telemetry

#: Multiplier of the hash, 2^64 over the golden ratio, and the shift that brings its high bits down.
_ODD, _HALF = np.uint64(0x9E3779B97F4A7C15), np.uint64(32)


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
    suspects = _suspects((exposure_of_entry, *keys))
    if not len(suspects):
        return suspects, suspects
    chosen = [key[suspects] for key in (*keys, exposure_of_entry)]
    order = np.lexsort(chosen)
    same = np.ones(len(order) - 1, dtype=np.bool_)
    for key in chosen:
        same &= np.diff(key[order]) == 0
    place = np.flatnonzero(same)
    later, earlier = suspects[order[place + 1]], suspects[order[place]]
    ascending = np.argsort(later)
    return later[ascending], earlier[ascending]


def _suspects(keys: tuple[NDArray[np.generic], ...]) -> IntArray:
    """Return, ascending, every entry whose keys may be those of another: their hashes are equal.

    Equal keys have equal hashes, so nothing is missed; sorting one column of hashes costs a tenth of sorting all the keys,
    and in a good file nothing is left to sort.
    """
    mixed = np.zeros(len(keys[0]), dtype=np.uint64)
    for key in keys:
        number = key.astype(np.float64) + 0.0 if key.dtype.kind == "f" else key.astype(np.int64)  # -0.0 equals 0.0
        mixed = (mixed ^ number.view(np.uint64)) * _ODD
        mixed ^= mixed >> _HALF
    ordered = np.sort(mixed)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    return np.flatnonzero(np.isin(mixed, repeated)) if len(repeated) else np.empty(0, np.int64)
