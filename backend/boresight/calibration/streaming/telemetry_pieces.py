"""A set as it came, in pieces of whole frames: one in memory, or files without compression, read, parsed and checked once."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import IntArray
from boresight.calibration.source import StoredTable, TelemetryFile
from boresight.columns import Columns, write_columns
from boresight.errors import CancelledError, RefusedInputError
from boresight.estimation.executor import Executor, LocalExecutor
from boresight.telemetry.quality.detector import OffDetector
from boresight.telemetry.read.readers import Stretch
from boresight.telemetry.schema import Telemetry, joined, select_rows
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.working_table import ARRAYS, WorkingTable

#: Told how far the copying and ordering of a set is: fraction and a line for a log.
Prepared = Callable[[float, str], None]
#: Share of a calibration's progress that making a large set ready is, and of that, reading.
PREPARED, READING = 0.5, 0.6


@dataclass(frozen=True)
class TelemetryPiece:
    """Whole frames of a set, in memory or in a file."""

    held: Telemetry | Columns | tuple[WorkingTable, int]
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
        if isinstance(self.held, tuple):
            return self.held[0].part(self.held[1])
        arrays: dict[str, Any] = self.held.read()
        del arrays["frame_start"]
        return Telemetry(**arrays, first_row=self.first_row)

    def frame_start(self) -> IntArray:
        """(n_frames + 1,) first row of each frame."""
        return self.held.read()["frame_start"] if isinstance(self.held, Columns) else frame_starts(self.read())


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
                parts.append(select_rows(piece.read(), rows))
            done += piece.frames
        return joined(parts), begins


@dataclass(frozen=True)
class Pieces:
    """A set in pieces: one in memory, or as many as it takes in a folder."""

    pieces: tuple[TelemetryPiece, ...]
    spread: Executor
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
    return Pieces((piece,), LocalExecutor())


def copied(
    file: TelemetryFile | StoredTable,
    sensor: Sensor,
    folder: Path,
    spread: Executor,
    told: Prepared,
    cancelled: Callable[[], bool],
) -> Pieces:
    """Take a stored table in its parts, which are mapped where they are; read a file into pieces.

    Stretches of a file are read wherever the spread does it; from its start where it has none or is refused.
    """
    if isinstance(file, StoredTable):
        pieces = _mapped(file, sensor, folder, spread, told)
    else:
        apart = _copied_apart(file, sensor, folder, spread, told)
        pieces = apart or _copied_in_turn(file, sensor, folder, told, cancelled)
    copy = Pieces(pieces, spread, folder)
    copy.off_detector.refuse()
    return copy


def _mapped(
    file: StoredTable, sensor: Sensor, folder: Path, spread: Executor, told: Prepared
) -> tuple[TelemetryPiece, ...]:
    """Look at the parts of a stored table; one that other machines may not see is copied as it is."""
    table = file.table
    if not file.shared:
        table = WorkingTable(Path(shutil.copyfile(file.path, folder / "table")), file.sha256)
    work = [(table, number, sensor, int(table.row_start[number])) for number in range(table.n_parts)]
    done = lambda k, n: told(READING * k / n, f"read {k} of {n} parts of the file")  # noqa: E731 - as for a file
    return tuple(spread.map(look_at_part, work, done=done))


def look_at_part(table: WorkingTable, number: int, sensor: Sensor, begins: int) -> TelemetryPiece:
    """Take a part of a stored table as a piece."""
    telemetry = table.part(number)
    return _piece((table, number), telemetry, frame_starts(telemetry), sensor, begins)


def _copied_apart(
    file: TelemetryFile, sensor: Sensor, folder: Path, spread: Executor, told: Prepared
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
    """Copy a set, or a part of it, a piece a chunk of whole frames."""
    for number, chunk in enumerate(chunks):
        arrays = {name: getattr(chunk, name) for name in ARRAYS}
        there = {name: np.asarray(values) for name, values in arrays.items() if values is not None}
        starts = frame_starts(chunk)
        columns = write_columns(path.with_name(f"{path.name}-{number:06d}"), there | {"frame_start": starts})
        yield _piece(columns, chunk, starts, sensor, begins)
        begins += len(chunk)


def _piece(
    held: Columns | tuple[WorkingTable, int], telemetry: Telemetry, starts: IntArray, sensor: Sensor, begins: int
) -> TelemetryPiece:
    """Say of rows, kept somewhere, what is asked of them without reading them again."""
    off = OffDetector()
    off.look_at(telemetry, sensor)
    epoch = _epoch(telemetry, starts[:-1])
    return TelemetryPiece(held, len(telemetry), begins, telemetry.first_row, len(starts) - 1, epoch, off)


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
