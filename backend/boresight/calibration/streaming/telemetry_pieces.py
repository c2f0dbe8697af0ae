"""The working copy of a set as it came: whole frames a piece, uncompressed, so that it is read, parsed and checked once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.streaming.columns import Columns, write_columns
from boresight.telemetry.detector import find_off_detector
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Columns that nobody interprets stay behind, and so does what is no array.
KEPT = tuple(item.name for item in fields(Telemetry) if item.name not in {"unknown", "first_row"})


@dataclass(frozen=True)
class TelemetryPiece:
    """Whole frames of a set in a file.

    Parameters
    ----------
    columns
        The arrays of a `Telemetry`, those it has.
    rows
        How many.
    begins
        Rows of the set before them.
    first_row
        Row of the first in the file it came from, as an editor counts.
    frames
        How many frames they are of.
    epoch
        The first time at which one of these begins; NaT where none is known.
    """

    columns: Columns
    rows: int
    begins: int
    first_row: int
    frames: int
    epoch: np.datetime64

    def read(self) -> Telemetry:
        """Map it."""
        arrays: dict[str, Any] = self.columns.read()
        return Telemetry(**arrays, first_row=self.first_row)


def write_pieces(chunks: Iterable[Telemetry], sensor: Sensor, folder: Path) -> Iterator[TelemetryPiece]:
    """Copy a set into a folder, a piece a chunk of whole frames.

    Raises
    ------
    RefusedInputError
        When matched stars lie off the sensor's detector; the whole set is looked at first, so it names those that come first.
    """
    faults = Faults("The telemetry does not fit the sensor")
    begins = 0
    for number, chunk in enumerate(chunks):
        find_off_detector(chunk, sensor, faults)
        arrays = {name: getattr(chunk, name) for name in KEPT}
        there = {name: np.asarray(values) for name, values in arrays.items() if values is not None}
        columns = write_columns(folder / f"telemetry-{number:06d}", there)
        first = np.unique(chunk.frame, return_index=True)[1]
        yield TelemetryPiece(columns, len(chunk), begins, chunk.first_row, len(first), _epoch(chunk, first))
        begins += len(chunk)
    faults.refuse()


def _epoch(telemetry: Telemetry, rows: NDArray[np.int64]) -> np.datetime64:
    """The first known time of some rows."""
    never = np.datetime64("NaT", "us")
    if telemetry.time_utc is None:
        return never
    times = telemetry.time_utc[rows]
    known = times[~np.isnat(times)]
    return known.min() if len(known) else never
