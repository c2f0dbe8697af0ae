"""The working copy of a set as it came: whole frames a piece, uncompressed, so that it is read, parsed and checked once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.streaming.columns import Columns, write_columns
from boresight.errors import RefusedInputError
from boresight.telemetry.detector import OffDetector
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.stretches import Stretch

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
    off_detector
        Its matched stars off the detector.
    """

    columns: Columns
    rows: int
    begins: int
    first_row: int
    frames: int
    epoch: np.datetime64
    off_detector: OffDetector

    def read(self) -> Telemetry:
        """Map it."""
        arrays: dict[str, Any] = self.columns.read()
        return Telemetry(**arrays, first_row=self.first_row)


def write_pieces(chunks: Iterable[Telemetry], sensor: Sensor, path: Path, begins: int = 0) -> Iterator[TelemetryPiece]:
    """Copy a set, or a part of it, a piece a chunk of whole frames.

    Parameters
    ----------
    chunks
        Its rows.
    sensor
        Whose telemetry it is.
    path
        To which a number is added for each piece.
    begins
        Rows of the set before.
    """
    for number, chunk in enumerate(chunks):
        off = OffDetector()
        off.look_at(chunk, sensor)
        arrays = {name: getattr(chunk, name) for name in KEPT}
        there = {name: np.asarray(values) for name, values in arrays.items() if values is not None}
        columns = write_columns(path.with_name(f"{path.name}-{number:06d}"), there)
        first = np.unique(chunk.frame, return_index=True)[1]
        yield TelemetryPiece(columns, len(chunk), begins, chunk.first_row, len(first), _epoch(chunk, first), off)
        begins += len(chunk)


def copy_stretch(stretch: Stretch, frames: int, sensor: Sensor, path: str) -> tuple[TelemetryPiece, ...] | None:
    """Copy one stretch of a file in pieces of so many frames; None where there is anything to refuse, or no such file here."""
    try:
        return tuple(write_pieces(stretch.chunks(frames), sensor, Path(path), stretch.begins))
    except (RefusedInputError, OSError):
        return None


def _epoch(telemetry: Telemetry, rows: NDArray[np.int64]) -> np.datetime64:
    """The first known time of some rows."""
    never = np.datetime64("NaT", "us")
    if telemetry.time_utc is None:
        return never
    times = telemetry.time_utc[rows]
    known = times[~np.isnat(times)]
    return known.min() if len(known) else never
