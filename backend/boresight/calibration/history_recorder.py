"""What a filter did at each of its updates, in constant memory, and thinned on the way out.

A page draws about a thousand points. Between two points that are kept an outlier would be lost, so of each interval that a point
ends its largest innovation is kept with its frame, and the lowest and highest value of each parameter.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from tempfile import SpooledTemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.filters.history import FilterHistory, FilterState
from boresight.estimation.metrics import aggregate_rms

#: 100,000 updates with eight parameters.
IN_MEMORY_BYTES = 16_000_000
#: Records read at a time.
CHUNK = 16_384


@dataclass(frozen=True)
class IntervalPeaks:
    """Extremes of the interval that each kept update ends, itself included; leading dimension n_kept.

    `nis`, `dof`, `frame`: the largest normalised innovation per degree of freedom, its degrees of freedom, and the frame that
    it is of. `low`, `high`: (n_kept, n_parameters) of the states, SI.
    """

    nis: FloatArray
    dof: IntArray
    frame: IntArray
    low: FloatArray
    high: FloatArray


class RecordedHistory:
    """The history of a filter; arrays named as in `FilterHistory`, and `frame`, the frame number of each update.

    `state`: before the first update.
    """

    def __init__(self, state: FilterState) -> None:
        self._type = np.dtype(
            [
                ("frame", "i8"),
                ("states", "f8", len(state.x)),
                ("sigmas", "f8", len(state.z)),
                ("nis", "f8"),
                ("dof", "i8"),
                ("aggregate_rms", "f8"),
                ("linearisations", "i8"),
            ]
        )
        self._file = SpooledTemporaryFile(max_size=IN_MEMORY_BYTES)  # noqa: SIM115 - it lives as long as the history
        weakref.finalize(self, self._file.close)
        self._squares = 0.0
        self.last, self.finite = state, True
        self.blind: tuple[int, ...] = ()
        self.nis_sum, self.dof_sum, self.linearisations_sum = 0.0, 0, 0
        self._count = 0

    def __len__(self) -> int:
        """Count the updates."""
        return self._count

    def append(self, part: FilterHistory, frame: IntArray) -> None:
        """Take in the next updates and the frames (n,) they are of; a part that ran away holds fewer than these."""
        n = len(part.nis)
        records = np.empty(n, self._type)
        for name in ("states", "sigmas", "nis", "dof", "linearisations"):
            records[name] = getattr(part, name)
        records["frame"] = frame[:n]
        squares, dof = np.append(self._squares, part.sum_of_squares), np.append(float(self.dof_sum), part.dof)
        records["aggregate_rms"] = aggregate_rms(squares, dof)[1:]
        self._file.seek(0, 2)
        self._file.write(records.tobytes())
        self._count += n
        self._squares, self.dof_sum = float(np.cumsum(squares)[-1]), self.dof_sum + int(part.dof.sum())
        self.nis_sum = float(np.cumsum(np.append(self.nis_sum, part.nis))[-1])
        self.linearisations_sum += int(part.linearisations.sum())
        self.last, self.finite, self.blind = part.last, part.finite, part.blind

    def column(self, name: str) -> NDArray[Any]:
        """One array of all updates, in memory."""
        return np.concatenate([records[name] for records in self._chunks()] or [np.empty(0, self._type)[name]])

    @property
    def frame(self) -> IntArray:
        """(n,) frame number of each update."""
        return self.column("frame")

    @property
    def states(self) -> FloatArray:
        """(n, n_parameters), SI."""
        return self.column("states")

    @property
    def nis(self) -> FloatArray:
        """(n,) normalised innovation squared of each update."""
        return self.column("nis")

    @property
    def dof(self) -> IntArray:
        """(n,) their degrees of freedom."""
        return self.column("dof")

    def taken(self, places: IntArray) -> NDArray[Any]:
        """Records of some updates, (n,), by ascending place."""
        found, begins = [np.empty(0, self._type)], 0
        for records in self._chunks():
            mine = places[(places >= begins) & (places < begins + len(records))]
            found.append(records[mine - begins])
            begins += len(records)
        return np.concatenate(found)

    def select_frames(self, frame: IntArray) -> RecordedHistory:
        """The updates of some frames as a history of its own, which ends where this one does."""
        part = RecordedHistory(self.last)
        for records in self._chunks():
            mine = records[np.isin(records["frame"], frame)]
            part._file.write(mine.tobytes())
            part._count += len(mine)
        part.finite, part.blind, part._squares = self.finite, self.blind, self._squares
        part.nis_sum, part.dof_sum, part.linearisations_sum = self.nis_sum, self.dof_sum, self.linearisations_sum
        return part

    def peaks(self, places: IntArray) -> IntervalPeaks:
        """Extremes between the updates at these places (n_kept,), ascending; the last of all is among them."""
        n_parameters = self._type["states"].shape[0]
        found = IntervalPeaks(
            nis=np.full(len(places), -np.inf), dof=np.zeros(len(places), np.int64), frame=np.zeros(len(places), np.int64),
            low=np.full((len(places), n_parameters), np.inf), high=np.full((len(places), n_parameters), -np.inf),
        )  # fmt: skip
        begins, largest = 0, np.full(len(places), -np.inf)
        for records in self._chunks():
            of = np.searchsorted(places, np.arange(begins, begins + len(records)))
            starts = np.flatnonzero(np.diff(of, prepend=-1))
            at = of[starts]
            found.low[at] = np.minimum(found.low[at], np.minimum.reduceat(records["states"], starts))
            found.high[at] = np.maximum(found.high[at], np.maximum.reduceat(records["states"], starts))
            _keep_largest(found, largest, of, records)
            begins += len(records)
        return found

    def _chunks(self) -> Iterator[NDArray[Any]]:
        """All records, so many at a time."""
        self._file.seek(0)
        while data := self._file.read(CHUNK * self._type.itemsize):
            yield np.frombuffer(data, self._type)


def _keep_largest(found: IntervalPeaks, largest: FloatArray, of: IntArray, records: NDArray[Any]) -> None:
    """Put the largest innovation of each interval into `found`, where it is larger than what is there; the first of equal ones."""
    per_dof = records["nis"] / np.maximum(records["dof"], 1)
    order = np.lexsort((-np.arange(len(of)), per_dof, of))
    last = order[np.append(np.flatnonzero(np.diff(of[order])), len(order) - 1)]
    better = last[per_dof[last] > largest[of[last]]]
    at = of[better]
    largest[at] = per_dof[better]
    found.nis[at], found.dof[at], found.frame[at] = (
        records["nis"][better],
        records["dof"][better],
        records["frame"][better],
    )
