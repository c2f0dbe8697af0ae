"""A set as it came, in pieces of whole frames: one in memory, or files without compression, read, parsed and checked once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import IntArray
from boresight.calibration.source import TelemetryFile
from boresight.columns import Columns, write_columns
from boresight.errors import CancelledError, RefusedInputError
from boresight.estimation.spread import InThisProcess, Spread
from boresight.telemetry.quality.detector import OffDetector
from boresight.telemetry.read.readers import Stretch
from boresight.telemetry.schema import Telemetry, joined, rows_of
from boresight.telemetry.sensors import Sensor

#: Columns that nobody interprets stay behind, and so does what is no array.
KEPT = tuple(item.name for item in fields(Telemetry) if item.name not in {"unknown", "first_row"})
#: Told how far the copying and ordering of a set is: fraction and a line for a log.
Prepared = Callable[[float, str], None]
#: Share of a calibration's progress that making a large set ready is, and of that, reading.
PREPARED, READING = 0.5, 0.6


@dataclass(frozen=True)
class TelemetryPiece:
    """Whole frames of a set, in memory or in a file.

    Parameters
    ----------
    held
        The set, or the arrays of a `Telemetry`, those it has.
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

    held: Telemetry | Columns
    rows: int
    begins: int
    first_row: int
    frames: int
    epoch: np.datetime64
    off_detector: OffDetector

    def read(self) -> Telemetry:
        """Map it."""
        if isinstance(self.held, Telemetry):
            return self.held
        arrays: dict[str, Any] = self.held.read()
        del arrays["frame_start"]
        return Telemetry(**arrays, first_row=self.first_row)

    def frame_start(self) -> IntArray:
        """(n_frames + 1,) first row of each frame."""
        return frame_starts(self.held) if isinstance(self.held, Telemetry) else self.held.read()["frame_start"]


@dataclass(frozen=True)
class FrameRange:
    """The frames first <= k < last of consecutive pieces."""

    pieces: tuple[TelemetryPiece, ...]
    first: int
    last: int

    def read(self) -> tuple[Telemetry, int]:
        """Map its rows; returns them and the place of the first in the set."""
        parts, done, begins = [], 0, -1
        for piece in self.pieces:
            starts = piece.frame_start()
            rows = slice(*(int(starts[np.clip(k - done, 0, piece.frames)]) for k in (self.first, self.last)))
            if rows.start < rows.stop:
                begins = begins if begins >= 0 else piece.begins + rows.start
                parts.append(rows_of(piece.read(), rows))
            done += piece.frames
        return joined(parts), begins


@dataclass(frozen=True)
class Pieces:
    """A set in pieces: one in memory, or as many as it takes in a folder.

    Parameters
    ----------
    pieces
        As it came.
    spread
        What computes over them.
    folder
        Where everything else goes; None where all is in memory.
    """

    pieces: tuple[TelemetryPiece, ...]
    spread: Spread
    folder: Path | None = None

    @property
    def n_frames(self) -> int:
        """Frames of the set."""
        return sum(piece.frames for piece in self.pieces)

    @property
    def off_detector(self) -> OffDetector:
        """The matched stars of the set that lie off the detector."""
        off = OffDetector()
        for piece in self.pieces:
            off.absorb(piece.off_detector)
        return off

    @property
    def epoch(self) -> np.datetime64 | None:
        """First known time of the set."""
        known = [piece.epoch for piece in self.pieces if not np.isnat(piece.epoch)]
        return min(known) if known else None

    def parts(self) -> Iterator[Telemetry]:
        """Map the pieces one after the other."""
        return (piece.read() for piece in self.pieces)

    def frame(self) -> IntArray:
        """(n_frames,) frame numbers of the set."""
        return np.concatenate(
            [part.frame[piece.frame_start()[:-1]] for part, piece in zip(self.parts(), self.pieces, strict=True)]
        )

    def frames(self, first: int, last: int) -> FrameRange:
        """The frames first <= k < last of the set."""
        ends = np.cumsum([piece.frames for piece in self.pieces])
        begin, end = int(np.searchsorted(ends, first, side="right")), int(np.searchsorted(ends, last))
        before = int(ends[begin - 1]) if begin else 0
        return FrameRange(self.pieces[begin : end + 1], first - before, last - before)


def in_memory(telemetry: Telemetry) -> Pieces:
    """Take a set that is in memory as one piece."""
    n_frames = len(frame_starts(telemetry)) - 1
    never = np.datetime64("NaT", "us")
    piece = TelemetryPiece(telemetry, len(telemetry), 0, telemetry.first_row, n_frames, never, OffDetector())
    return Pieces((piece,), InThisProcess())


def copied(
    file: TelemetryFile,
    sensor: Sensor,
    folder: Path,
    spread: Spread,
    told: Prepared,
    cancelled: Callable[[], bool],
) -> Pieces:
    """Read a file into pieces: stretches of it wherever the spread does it, or from its start where it has none or is refused.

    Raises
    ------
    RefusedInputError
        As reading the whole file and checking it against the sensor would.
    CancelledError
        When `cancelled` says so.
    """
    pieces = _copied_apart(file, sensor, folder, spread, told) or _copied_in_turn(file, sensor, folder, told, cancelled)
    copy = Pieces(pieces, spread, folder)
    copy.off_detector.refuse()
    return copy


def _copied_apart(
    file: TelemetryFile, sensor: Sensor, folder: Path, spread: Spread, told: Prepared
) -> tuple[TelemetryPiece, ...]:
    """Copy the stretches of a file; nothing when one of them cannot be used, or it has none."""
    work = [
        (stretch, file.chunk_frames, sensor, str(folder / f"telemetry-{number:06d}"))
        for number, stretch in enumerate(file.stretches())
    ]
    parts: list[tuple[TelemetryPiece, ...] | None] = spread.map(
        copy_stretch, work, done=lambda k, n: told(READING * k / n, f"read {k} of {n} parts of the file")
    )
    pieces: list[TelemetryPiece] = []
    for part, stretch in zip(parts, work, strict=True):
        copied_here = copy_stretch(*stretch) if part is None else part  # another machine may not see the file
        if copied_here is None:
            return ()
        pieces += copied_here
    return tuple(pieces)


def _copied_in_turn(
    file: TelemetryFile, sensor: Sensor, folder: Path, told: Prepared, cancelled: Callable[[], bool]
) -> tuple[TelemetryPiece, ...]:
    """Copy a file from its start to its end; refuses it in its words."""
    rows = max(file.about_rows(), 1)
    pieces: list[TelemetryPiece] = []
    for piece in write_pieces(file.chunks(), sensor, folder / "telemetry"):
        if cancelled():
            raise CancelledError(f"Stopped as asked after reading {piece.begins} rows")
        pieces.append(piece)
        done = piece.begins + piece.rows
        told(READING * min(done / rows, 1.0), f"read {done:,} detections")
    return tuple(pieces)


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
        starts = frame_starts(chunk)
        columns = write_columns(path.with_name(f"{path.name}-{number:06d}"), there | {"frame_start": starts})
        first = starts[:-1]
        yield TelemetryPiece(columns, len(chunk), begins, chunk.first_row, len(first), _epoch(chunk, first), off)
        begins += len(chunk)


def copy_stretch(stretch: Stretch, frames: int, sensor: Sensor, path: str) -> tuple[TelemetryPiece, ...] | None:
    """Copy one stretch of a file in pieces of so many frames; None where there is anything to refuse, or no such file here."""
    try:
        return tuple(write_pieces(stretch.chunks(frames), sensor, Path(path), stretch.begins))
    except (RefusedInputError, OSError):
        return None


def frame_starts(telemetry: Telemetry) -> IntArray:
    """First row of each frame, and the end, (n_frames + 1,)."""
    new = np.flatnonzero(np.diff(telemetry.frame)) + 1
    return np.concatenate([[0], new, [len(telemetry)]]).astype(np.int64)


def _epoch(telemetry: Telemetry, rows: IntArray) -> np.datetime64:
    """The first known time of some rows."""
    never = np.datetime64("NaT", "us")
    if telemetry.time_utc is None:
        return never
    times = telemetry.time_utc[rows]
    known = times[~np.isnat(times)]
    return known.min() if len(known) else never
