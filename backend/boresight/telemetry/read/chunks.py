"""A telemetry file in parts of whole frames, in constant memory: how every file is read, large or small.

A file comes as tables of bounded size (`tables`), cut anywhere. Their rows are turned into arrays at once and wait until
enough frames are whole; what comes out is cut where the frame number changes. Faults are collected as they are met, and
from the first one on nothing more comes out: the rest of the file is read for its faults alone, and then refused in the words
and order in which a file is refused that is read at once: form, columns, cells, and what rows say together.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from boresight.errors import RefusedInputError
from boresight.telemetry.read.arrays import check_columns, make_arrays, scale_quaternions
from boresight.telemetry.read.checks import Checks, Faults
from boresight.telemetry.read.comma_separated import csv_tables
from boresight.telemetry.read.formats import Tables, format_at
from boresight.telemetry.read.json_lines import json_tables
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.parquet import parquet_tables, rows_of_parquet
from boresight.telemetry.schema import Telemetry, count_bytes, joined, select_rows

#: Frames of a chunk: with 24 detections each about 100,000 rows, 15 MB.
CHUNK_FRAMES = 4096
#: Rows that wait for their frame to be whole, and their bytes. One frame of so many is a file whose frames are not numbered.
MOST_ROWS, MOST_BYTES = 1_000_000, 200_000_000


def read_chunks(
    path: Path, name: str | None = None, *, frames: int = CHUNK_FRAMES, limits: Limits = LIMITS
) -> Iterator[Telemetry]:
    """Read a telemetry file in parts of whole frames."""
    name = name or path.name
    return iterate_chunks(open_tables(path, name, limits), name, frames, limits)


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
        absent.add("there are no rows: there is nothing to calibrate from")
    for faults in (tables.form, absent, cells):
        faults.refuse()
    yield from _sound(waiting.rest(), checks)
    checks.refuse()


def rows_in(path: Path) -> int | None:
    """Return how many rows a file has where that is told cheaply, as Parquet does; None for text."""
    return rows_of_parquet(path, path.name) if format_at(path, path.name) == "Parquet" else None


def open_tables(path: Path, name: str, limits: Limits = LIMITS, *, as_text: bool = False) -> Tables:
    """Open a telemetry file as tables; `as_text` reads CSV and JSON Lines as text cells. Refuses as `read_chunks`."""
    match format_at(path, name):
        case "Parquet":
            return parquet_tables(path, name, limits)
        case "JSON Lines":
            return json_tables(path, name, limits, as_text=as_text)
        case _:
            return csv_tables(path, name, limits, as_text=as_text)


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
        """Yield parts of so many frames; the frames that are left wait on."""
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
            f"{self._name}: frame {frame} has over {size}: give every reading of the star tracker a frame number of its own."
        )
