"""Where a calibration's telemetry comes from: memory, or pieces of whole frames in files; and a sample of a large set."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.calibration.matching.matched_frames import GivenMatches
from boresight.calibration.matching.rematch import Matches, joined_matches, matched_telemetry
from boresight.columns import Columns, write_columns
from boresight.errors import RefusedInputError
from boresight.estimation.blocks import FRAMES
from boresight.estimation.executor import Executor, LocalExecutor, refuse_cancelled
from boresight.estimation.stored_arcs import Arcs
from boresight.site import Site
from boresight.telemetry.quality.detector import OffDetector
from boresight.telemetry.read.compression import expanded_bytes
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.readers import CHUNK_FRAMES, Stretch, read_chunks, read_telemetry, rows_in, stretches
from boresight.telemetry.schema import Telemetry, joined, select_rows
from boresight.telemetry.sensors import Sensor
from boresight.telemetry.working_table import ARRAYS, WorkingTable

#: Detections from which a file is calibrated piece by piece. In memory such a set and its arcs take about 400 MB.
LARGE_ROWS = 500_000
#: A row of CSV is about as long; of JSON Lines three times.
BYTES_A_ROW = 100


class ChunkedTelemetry(Protocol):
    """Telemetry that can be taken piece by piece."""

    def about_rows(self) -> int:
        """How many rows it has, or a guess."""
        ...

    def large(self) -> bool:
        """Whether it is to be taken piece by piece."""
        ...

    def read(self) -> Telemetry:
        """Return all of it in memory."""
        ...

    def chunks(self) -> Iterator[Telemetry]:
        """Return it piece by piece, whole frames."""
        ...


#: What is calibrated: in memory, or to be taken piece by piece.
TelemetryInput = Telemetry | ChunkedTelemetry


@dataclass(frozen=True)
class TelemetryFile:
    """A telemetry file that has not been read."""

    path: Path
    name: str | None = None
    large_rows: int = LARGE_ROWS
    chunk_frames: int = CHUNK_FRAMES
    limits: Limits = LIMITS

    def about_rows(self) -> int:
        """How many rows it has; a guess from its size where it is text."""
        rows = rows_in(self.path)
        return expanded_bytes(self.path) // BYTES_A_ROW if rows is None else rows

    def large(self) -> bool:
        """Whether it is to be taken piece by piece."""
        return self.about_rows() >= self.large_rows

    def opened(self) -> Telemetry | TelemetryFile:
        """Read a small file, refusing what cannot be used; leave a large one to whoever takes it piece by piece."""
        return self if self.large() else self.read()

    def read(self) -> Telemetry:
        """Read all of it; refuses as `telemetry.readers.read_telemetry`."""
        return read_telemetry(self.path, self.name, self.limits)

    def stretches(self) -> list[Stretch]:
        """Cut it into parts that can be read apart; none where it must be read from its start."""
        return stretches(self.path, self.name or self.path.name, self.chunk_frames, self.limits)

    def chunks(self) -> Iterator[Telemetry]:
        """Read it piece by piece; refuses as `telemetry.readers.read_chunks`, at the end."""
        return read_chunks(self.path, self.name, frames=self.chunk_frames, limits=self.limits)


@dataclass(frozen=True)
class StoredTable:
    """The table of a set as it is stored: nothing of it is parsed, checked or converted again."""

    path: Path
    sha256: str
    large_rows: int = LARGE_ROWS
    shared: bool = True

    @property
    def table(self) -> WorkingTable:
        """The table, held against its address wherever it is mapped."""
        return WorkingTable(self.path, self.sha256)

    def about_rows(self) -> int:
        """How many rows it has."""
        return len(self.table)

    def large(self) -> bool:
        """Whether it is to be taken piece by piece."""
        return self.about_rows() >= self.large_rows

    def read(self) -> Telemetry:
        """Map all of it."""
        return self.table.read()

    def chunks(self) -> Iterator[Telemetry]:
        """Map it piece by piece."""
        return self.table.parts()


def is_large(telemetry: TelemetryInput) -> TypeGuard[ChunkedTelemetry]:
    """Whether telemetry is to be taken piece by piece."""
    return not isinstance(telemetry, Telemetry) and telemetry.large()


def read_whole(telemetry: TelemetryInput) -> Telemetry:
    """Return telemetry in memory."""
    return telemetry if isinstance(telemetry, Telemetry) else telemetry.read()


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
    site: Site | None = None

    def read(self) -> Telemetry:
        """Map it."""
        if isinstance(self.held, Telemetry):
            return self.held
        if isinstance(self.held, tuple):
            return self.held[0].part(self.held[1])
        arrays: dict[str, Any] = self.held.read()
        del arrays["frame_start"]
        return Telemetry(**arrays, first_row=self.first_row, site=self.site)

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
    executor: Executor
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
    file: ChunkedTelemetry,
    sensor: Sensor,
    folder: Path,
    executor: Executor,
    told: Prepared,
    cancelled: Callable[[], bool],
    correct: Callable[[Telemetry], Telemetry] | None = None,
) -> Pieces:
    """Take a stored table in its parts, which are mapped where they are; read a file into pieces.

    Stretches of a file are read wherever the executor does it; from its start where it has none or is refused. What `correct`
    puts right is copied from the start too, piece by piece.
    """
    if correct is not None:
        pieces = _copied_in_turn(file, sensor, folder, told, cancelled, correct)
    elif isinstance(file, StoredTable):
        pieces = _mapped(file, sensor, folder, executor, told)
    else:
        apart = _copied_apart(file, sensor, folder, executor, told) if isinstance(file, TelemetryFile) else ()
        pieces = apart or _copied_in_turn(file, sensor, folder, told, cancelled)
    copy = Pieces(pieces, executor, folder)
    copy.off_detector.refuse()
    return copy


def _mapped(
    file: StoredTable, sensor: Sensor, folder: Path, executor: Executor, told: Prepared
) -> tuple[TelemetryPiece, ...]:
    """Look at the parts of a stored table; one that other machines may not see is copied as it is."""
    table = file.table
    if not file.shared:
        table = WorkingTable(Path(shutil.copyfile(file.path, folder / "table")), file.sha256)
    work = [(table, number, sensor, int(table.row_start[number])) for number in range(table.n_parts)]
    done = lambda k, n: told(READING * k / n, f"read {k} of {n} parts of the file")  # noqa: E731 - as for a file
    return tuple(executor.map(look_at_part, work, done=done))


def look_at_part(table: WorkingTable, number: int, sensor: Sensor, begins: int) -> TelemetryPiece:
    """Take a part of a stored table as a piece."""
    telemetry = table.part(number)
    return _piece((table, number), telemetry, frame_starts(telemetry), sensor, begins)


def _copied_apart(
    file: TelemetryFile, sensor: Sensor, folder: Path, executor: Executor, told: Prepared
) -> tuple[TelemetryPiece, ...]:
    """Copy the stretches of a file; nothing when one of them cannot be used, or it has none."""
    work = [
        (stretch, file.chunk_frames, sensor, str(folder / f"telemetry-{number:06d}"))
        for number, stretch in enumerate(file.stretches())
    ]
    parts: list[tuple[TelemetryPiece, ...] | None] = executor.map(
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
    file: ChunkedTelemetry,
    sensor: Sensor,
    folder: Path,
    told: Prepared,
    cancelled: Callable[[], bool],
    correct: Callable[[Telemetry], Telemetry] | None = None,
) -> tuple[TelemetryPiece, ...]:
    """Copy a file from its start to its end; refuses it in its words."""
    rows = max(file.about_rows(), 1)
    pieces: list[TelemetryPiece] = []
    chunks = file.chunks() if correct is None else map(correct, file.chunks())
    for piece in write_pieces(chunks, sensor, folder / "telemetry"):
        refuse_cancelled(cancelled, f"after reading {piece.begins} rows")
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
    """Return a piece for stored rows, with the facts about them that are needed without reading them again."""
    off = OffDetector()
    off.look_at(telemetry, sensor)
    epoch = _epoch(telemetry, starts[:-1])
    return TelemetryPiece(
        held, len(telemetry), begins, telemetry.first_row, len(starts) - 1, epoch, off, telemetry.site
    )


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
    never = np.datetime64("NaT", "us")
    if telemetry.time_utc is None:
        return never
    times = telemetry.time_utc[rows]
    known = times[~np.isnat(times)]
    return known.min() if len(known) else never


#: Stars up to which a set is judged whole, and of a larger one so many are.
JUDGED_WHOLE = 500_000
JUDGED_STARS = 300_000
#: Arrays of `Matches` with an entry a row; the others have one an exposure.
OF_ROWS = ("star_id", "s_i", "row_reason", "tolerance_rad", "flags")


def pick_blocks(n_blocks: int, most: int) -> NDArray[np.int64]:
    """Places of at most so many of the blocks, evenly spread; at least one."""
    return np.unique(np.linspace(0, n_blocks - 1, max(1, min(most, n_blocks))).round().astype(np.int64))


Ends = Sequence[tuple[int, int]]
#: One stretch from the first frame to the last.
WHOLE: Ends = ((np.iinfo(np.int64).min, np.iinfo(np.int64).max),)


@dataclass(frozen=True)
class MatchedRows:
    """Rows of a set, their matches, and the stars that were kept of these, (n_rows,)."""

    telemetry: Telemetry
    matches: Matches | GivenMatches
    kept: IntArray

    def named(self) -> Telemetry:
        """The rows with the stars that were kept, and their directions."""
        if isinstance(self.matches, GivenMatches):
            return self.telemetry
        s_i = np.where(self.kept[:, None] > 0, self.matches.s_i, np.nan)
        return matched_telemetry(self.telemetry, replace(self.matches, star_id=self.kept, s_i=s_i))


def judged_frames(arcs: Arcs) -> Ends:
    """First and last frame number of each stretch of a set that is judged: all of it, or evenly spread blocks of a large one."""
    if arcs.n_stars <= JUDGED_WHOLE:
        return WHOLE
    n_blocks = -(-arcs.n_frames // FRAMES)
    chosen = pick_blocks(n_blocks, JUDGED_STARS * n_blocks // arcs.n_stars)
    return [_ends(arcs, int(block)) for block in chosen]


def judged_telemetry(parts: Iterable[Telemetry], ends: Ends) -> Telemetry:
    """Rows of the frames in these stretches, also of those that take no part; `parts` are whole frames of the set as it came."""
    return joined([select_rows(part, rows) for part in parts for rows in _rows_of_frames(part, ends)])


def judged_matches(parts: Iterable[MatchedRows], ends: Ends) -> MatchedRows:
    """The same with the matches of these rows."""
    found = [
        (select_rows(part.telemetry, rows), _matches_of_rows(part.matches, rows), part.kept[rows])
        for part in parts
        for rows in _rows_of_frames(part.telemetry, ends)
        if isinstance(part.matches, Matches)
    ]
    telemetry, matches, kept = zip(*found, strict=True)
    return MatchedRows(joined(telemetry), joined_matches(matches), np.concatenate(kept))


def _ends(arcs: Arcs, block: int) -> tuple[int, int]:
    places = block * FRAMES, min((block + 1) * FRAMES, arcs.n_frames) - 1
    first, last = (int(arcs.frames(place, place + 1).frame[0]) for place in places)
    return first, last


def _rows_of_frames(telemetry: Telemetry, ends: Ends) -> Iterator[slice]:
    """Rows of a part that lie in each stretch, where there are any."""
    for first, last in ends:
        begin = int(np.searchsorted(telemetry.frame, first))
        end = int(np.searchsorted(telemetry.frame, last, side="right"))
        if begin < end:
            yield slice(begin, end)


def _matches_of_rows(matches: Matches, rows: slice) -> Matches:
    """The matches of some rows, which are whole frames."""
    e0, e1 = (int(place) for place in np.searchsorted(matches.exposure_start, [rows.start, rows.stop]))
    of = {True: rows, False: slice(e0, e1)}
    names = [item.name for item in fields(Matches) if item.name != "exposure_start"]
    arrays: dict[str, Any] = {name: getattr(matches, name)[of[name in OF_ROWS]] for name in names}
    return Matches(exposure_start=matches.exposure_start[e0 : e1 + 1] - rows.start, **arrays)
