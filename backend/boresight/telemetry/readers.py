"""Reading telemetry whole, in parts of whole frames in constant memory, or in stretches read apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.telemetry.imports.recognition import leading_to_import
from boresight.telemetry.read.checks import Checks, Faults, check_columns, make_arrays, scale_quaternions
from boresight.telemetry.read.compression import expanded, is_gzip
from boresight.telemetry.read.formats import Tables, format_at
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.parquet import (
    ParquetLayout,
    open_parquet,
    read_layout,
    rows_of_file,
    rows_of_parquet,
)
from boresight.telemetry.read.tables import open_tables
from boresight.telemetry.schema import Telemetry, count_bytes, joined, select_rows

if TYPE_CHECKING:
    import pyarrow.parquet as arrow_parquet

#: Frames of a chunk: with 24 detections each about 100,000 rows, 15 MB.
CHUNK_FRAMES = 4096
#: Rows that wait for their frame to be whole, and their bytes. One frame of so many is a file whose frames are not numbered.
MOST_ROWS, MOST_BYTES = 1_000_000, 200_000_000


def read_chunks(
    path: Path, name: str | None = None, *, frames: int = CHUNK_FRAMES, limits: Limits = LIMITS
) -> Iterator[Telemetry]:
    """Read a telemetry file in parts of whole frames."""
    name = name or path.name
    with expanded(path, name, limits) as place, leading_to_import(place, name):
        yield from iterate_chunks(open_tables(place, name, limits), name, frames, limits)


def iterate_chunks(tables: Tables, name: str, frames: int, limits: Limits = LIMITS) -> Iterator[Telemetry]:
    """Read tables in parts of whole frames, as `read_chunks` reads a file."""
    absent = Faults(name)
    check_columns(tables.columns, absent)
    cells, checks, rows = Faults(name, tables.first_row), Checks(name, limits.stars), 0
    waiting = _Waiting(frames, name)
    for table in tables.read():
        rows += table.num_rows
        limits.refuse_rows(name, rows)
        if absent.count or tables.form.found or not table.num_rows:
            continue
        part = make_arrays(_with_every_column(table, tables.columns), cells)
        cells.first_row += table.num_rows
        if not cells.count:
            yield from _sound(waiting.whole_frames(part), checks)
    if not rows:
        absent.add("there are no rows: export it again, with its stars")
    for faults in (tables.form, absent, cells):
        faults.refuse()
    yield from _sound(waiting.rest(), checks)
    checks.refuse()


def rows_in(path: Path) -> int | None:
    """Return how many rows a file has where that is told cheaply, as Parquet does; None for text and what is compressed."""
    if is_gzip(path):
        return None
    with leading_to_import(path, path.name):
        return rows_of_parquet(path, path.name) if format_at(path, path.name) == "Parquet" else None


def _sound(parts: Iterator[Telemetry], checks: Checks) -> Iterator[Telemetry]:
    """Yield parts until the checks find something; look at all of them."""
    for part in parts:
        checks.look_at(part)
        if not checks.found:
            scale_quaternions(part)
            yield part


def _with_every_column(table: pa.Table, columns: tuple[str, ...]) -> pa.Table:
    """Return a table with the columns of the whole file, in their order, nulls where it lacks one."""
    if tuple(table.column_names) == columns:
        return table
    present = set(table.column_names)
    cells = [table[name] if name in present else pa.nulls(table.num_rows, pa.string()) for name in columns]
    return pa.Table.from_arrays(cells, names=list(columns))


class _Waiting:
    """Rows that wait for their frame to be whole."""

    def __init__(self, frames: int, name: str) -> None:
        self._frames, self._name = max(frames, 1), name
        self._parts: list[Telemetry] = []
        self._changes = 0

    def whole_frames(self, part: Telemetry) -> Iterator[Telemetry]:
        """Take the next rows; yield as many times the wanted number of frames as are whole now."""
        last = self._parts[-1].frame[-1:] if self._parts else part.frame[:1]
        self._changes += int(np.count_nonzero(np.diff(part.frame, prepend=last)))
        self._parts.append(part)
        if self._changes >= self._frames:
            yield from self._cut(self._frames)
        if sum(map(len, self._parts)) > MOST_ROWS or sum(map(count_bytes, self._parts)) > MOST_BYTES:
            self._refuse_endless()
            yield from self._cut(self._changes)

    def rest(self) -> Iterator[Telemetry]:
        """Yield what still waits: the file is at its end."""
        if self._parts:
            yield joined(self._parts)

    def _cut(self, frames: int) -> Iterator[Telemetry]:
        every = joined(self._parts)
        changes = np.flatnonzero(np.diff(every.frame)) + 1
        seams = [0, *changes[frames - 1 :: frames].tolist()]
        for start, end in pairwise(seams):
            yield select_rows(every, slice(start, end))
        self._parts = [select_rows(every, slice(seams[-1], len(every)))]
        self._changes = len(changes) - (len(seams) - 1) * frames

    def _refuse_endless(self) -> None:
        """Refuse a frame of so many rows that its number means nothing, or of too many bytes."""
        if self._changes:
            return
        frame, many = self._parts[0].frame[0], sum(map(len, self._parts)) > MOST_ROWS
        size = f"{MOST_ROWS:,} rows" if many else f"{MOST_BYTES / 1e6:,.0f} MB"
        raise RefusedInputError(
            f"{self._name}: frame {frame} has over {size}: give each reading its own frame number.",
            code="frame-too-large",
        )


def read_telemetry(path: Path, name: str | None = None, limits: Limits = LIMITS) -> Telemetry:
    """Read a telemetry file.

    Parameters
    ----------
    path
        Where it is.
    name
        What its sender called it, and refusals call it; None for the name it has. The suffix says CSV, JSON Lines or
        Parquet; without one a file is what its bytes are.
    limits
        How much it may hold.

    Raises
    ------
    RefusedInputError
        When the file cannot be used; the first twenty faults name row and column.
    """
    return joined(list(read_chunks(path, name, limits=limits)))


#: A stretch has frames for so many parts, so that its head that is read twice is a small share of it.
PARTS = 4


@dataclass(frozen=True)
class Stretch:
    """Consecutive rows of a Parquet file, whole frames."""

    path: Path
    name: str
    begins: int
    ends: int
    layout: ParquetLayout
    limits: Limits = LIMITS

    def chunks(self, frames: int) -> Iterator[Telemetry]:
        """Read it in parts of so many frames; `first_row` counts in the whole file. Refuses what `read_chunks` refuses."""
        rows = range(self.begins, self.ends)
        tables = rows_of_file(self.path, self.name, self.layout, rows, self.limits)
        return iterate_chunks(tables, self.name, frames, self.limits)


def stretches(path: Path, name: str, frames: int, limits: Limits = LIMITS) -> list[Stretch]:
    """Cut a file into stretches of at least `PARTS * frames` frames."""
    if is_gzip(path):
        return []
    with leading_to_import(path, name):
        if format_at(path, name) != "Parquet":
            return []
    layout = read_layout(path, name, limits)
    if "frame" not in layout.columns:
        return []
    with open_parquet(path, name) as file:
        cuts = _cuts(file, PARTS * frames)
    return [Stretch(path, name, begins, ends, layout, limits) for begins, ends in pairwise(cuts)]


def _cuts(file: arrow_parquet.ParquetFile, least: int) -> list[int]:
    """First row of each stretch, and the end; nothing where there is at most one."""
    groups = [file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)]
    starts = np.cumsum(groups, dtype=np.int64)[:-1]
    if not len(starts) or not pa.types.is_integer(file.schema_arrow.field("frame").type):
        return []
    cuts, frames_before = [0], 0
    for row, frames in _first_frames(file, starts):
        if row < 0:
            return []
        if frames - frames_before >= least:
            cuts.append(row)
            frames_before = frames
    return [*cuts, file.metadata.num_rows] if len(cuts) > 1 else []


def _first_frames(file: arrow_parquet.ParquetFile, starts: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield the row of the first frame that begins in each group, and the frames before it; row -1 where frames do not ascend."""
    seen, begun = 0, 1
    last = None
    for batch in file.iter_batches(columns=["frame"], use_threads=False):
        column = batch.column(0)
        frame = column.to_numpy(zero_copy_only=False).astype(np.int64) if not column.null_count else np.array([1, 0])
        before = np.append(frame[:1] if last is None else last, frame[:-1])
        if np.any(frame < before):
            yield -1, begun
            return
        rows = seen + np.flatnonzero(frame != before)
        if len(rows):
            here = np.searchsorted(rows, starts[: np.searchsorted(starts, rows[-1], side="right")])
            yield from zip(rows[here].tolist(), (begun + here).tolist(), strict=True)
            starts = starts[len(here) :]
        last, seen, begun = frame[-1:], seen + len(frame), begun + len(rows)
