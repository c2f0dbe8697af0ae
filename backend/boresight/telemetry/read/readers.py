"""Reading a telemetry file whole: its chunks put together; and writing one again.

Every fault of the file is collected with row and column, as an editor counts them, and refused in one sentence.
A quaternion is scaled to unit length on the way in; a star number of -1 becomes 0, which means unmatched.

A large Parquet file in stretches that are read apart, by whoever has time, and give the parts that the whole file gives.

A file is compressed in groups of rows. A stretch begins with the first frame that begins in its first group, and ends where the
next one begins: whole frames, and nearly whole groups, of which each is decompressed once and its head once more. Where frames
begin is told by one column, read beforehand, which is a fiftieth of the work; that they ascend is seen there too. Everything
else that a file can be refused for lies within a frame, so each stretch finds its own. But a refusal names the first twenty faults
of a file and counts the others: whoever meets a fault reads the file from its start (`chunks`), which says so in its words.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from numpy.typing import NDArray

from boresight.telemetry.read.chunks import iterate_chunks, open_tables, read_chunks
from boresight.telemetry.read.formats import format_at
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.parquet import Layout, open_parquet, read_layout, rows_of_file
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.writers import write_csv, write_parquet

__all__ = ["read_table", "read_telemetry", "write_csv", "write_parquet"]


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


def read_table(path: Path, name: str, limits: Limits = LIMITS) -> pa.Table:
    """Return the columns of a telemetry file as they stand in it."""
    tables = open_tables(path, name, limits)
    parts = list(tables.read())
    if any(part.schema != parts[0].schema for part in parts):  # some cell is no number: then every cell is a text
        tables = open_tables(path, name, limits, as_text=True)
        parts = list(tables.read())
    tables.form.refuse()
    plain = [part.cast(pa.schema([_plain(field) for field in part.schema])) for part in parts]
    return pa.concat_tables(plain, promote_options="default")


def _plain(field: pa.Field) -> pa.Field:
    """A column's type without a dictionary."""
    return field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field


#: A stretch has frames for so many parts, so that its head that is read twice is a small share of it.
PARTS = 4


@dataclass(frozen=True)
class Stretch:
    """Consecutive rows of a Parquet file, whole frames."""

    path: Path
    name: str
    begins: int
    ends: int
    layout: Layout
    limits: Limits = LIMITS

    def chunks(self, frames: int) -> Iterator[Telemetry]:
        """Read it in parts of so many frames; `first_row` counts in the whole file. Refuses what `chunks.read_chunks` refuses."""
        rows = range(self.begins, self.ends)
        tables = rows_of_file(self.path, self.name, self.layout, rows, self.limits)
        return iterate_chunks(tables, self.name, frames, self.limits)


def stretches(path: Path, name: str, frames: int, limits: Limits = LIMITS) -> list[Stretch]:
    """Cut a file into stretches of at least `PARTS * frames` frames."""
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
