"""Single frames out of a stored table, however large it is.

A Parquet table is compressed in groups of rows (`writers.ROW_GROUP`). Rows ascend by frame, so a list of where each frame begins
says which group holds it, and only that group is read: with 100,000 frames 65 thousand rows and not 2.4 million. The list
itself takes a pass over one column; it is kept for the tables looked at last, for a table never changes under its address.

Some frames of a stored set, taken evenly over it, without checking all of it: it was checked when it came in.

Every k-th of n frames stands for the set where its frames are alike in kind, which is what a forecast asks. Only the column
of frame numbers is looked at in full; the rows of the frames that are taken are cut out before they become arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.errors import NotFoundError, RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.parquet import FIRST_ROW
from boresight.telemetry.read.readers import telemetry_of
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Telemetry

#: Tables whose list of frames is kept; one of 100,000 frames takes 1.6 MB.
TABLES_KEPT = 8


@dataclass(frozen=True)
class FrameIndex:
    """Where the frames of a table are.

    Parameters
    ----------
    path
        The table.
    frame
        (n_frames,) frame numbers, ascending.
    first_row
        (n_frames + 1,) first row of each, and the end.
    group_start
        (n_groups + 1,) first row of each group that is compressed together, and the end.
    """

    path: Path
    frame: IntArray
    first_row: IntArray
    group_start: IntArray

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.frame)

    def place_of(self, frame: int) -> int:
        """Return the place of a frame number in `frame`.

        Raises
        ------
        NotFoundError
            When the table has no such frame.
        """
        place = int(np.searchsorted(self.frame, frame))
        if place == len(self.frame) or self.frame[place] != frame:
            raise NotFoundError(
                f"The telemetry has no frame {frame}; its {len(self)} frames are numbered from {self.frame[0]} "
                f"to {self.frame[-1]}."
            )
        return place

    def read(self, place: int, neighbours: int = 0) -> Telemetry:
        """Read a frame by its place, with so many frames on either side."""
        first = int(self.first_row[max(place - neighbours, 0)])
        last = int(self.first_row[min(place + neighbours + 1, len(self))])
        groups = range(
            int(np.searchsorted(self.group_start, first, side="right")) - 1,
            int(np.searchsorted(self.group_start, last, side="left")),
        )
        with arrow_parquet.ParquetFile(self.path, memory_map=True) as file:
            table = file.read_row_groups(list(groups), use_threads=False)
        table = table.slice(first - int(self.group_start[groups.start]), last - first)
        return telemetry_of(table, Faults(self.path.name, FIRST_ROW + first))

    @cached_property
    def named_stars(self) -> IntArray:
        """Every star number that the table gives, ascending."""
        with arrow_parquet.ParquetFile(self.path, memory_map=True) as file:
            if "star_id" not in file.schema_arrow.names:
                return np.empty(0, np.int64)
            star_id = file.read(columns=["star_id"])["star_id"].drop_null().unique().to_numpy()
        return np.sort(star_id[star_id > 0]).astype(np.int64)

    @cached_property
    def typical_stars(self) -> float:
        """Median number of detections of an exposure."""
        with arrow_parquet.ParquetFile(self.path, memory_map=True) as file:
            table = file.read(columns=["frame", "exposure"])
        frame, exposure = (_numbers(table[name]) for name in ("frame", "exposure"))
        starts = np.flatnonzero((np.diff(frame) != 0) | (np.diff(exposure) != 0)) + 1
        return float(np.median(np.diff(starts, prepend=0, append=len(frame))))


@lru_cache(maxsize=TABLES_KEPT)
def frame_index(path: Path) -> FrameIndex:
    """Find the frames of a table that never changes under its path.

    Raises
    ------
    RefusedInputError
        When the file is damaged.
    """
    try:
        with arrow_parquet.ParquetFile(path, memory_map=True) as file:
            frame = _numbers(file.read(columns=["frame"])["frame"])
            rows = [file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)]
    except (pa.ArrowException, OSError) as error:
        raise RefusedInputError(
            f"The stored table {path.name[:12]} is damaged: restore it from a backup, or upload the telemetry again."
        ) from error
    first = np.append(0, np.flatnonzero(np.diff(frame)) + 1)
    return FrameIndex(path, frame[first], np.append(first, len(frame)), np.append(0, np.cumsum(rows)))


def _numbers(column: pa.ChunkedArray) -> IntArray:
    """A complete integer column, (n_rows,)."""
    return np.asarray(column.to_numpy(), np.int64)


@dataclass(frozen=True)
class Sample:
    """Frames of a set that stand for all.

    Parameters
    ----------
    telemetry
        Their rows.
    frames, frames_in_set
        How many frames these are, and how many the set has.
    """

    telemetry: Telemetry
    frames: int
    frames_in_set: int


def evenly(n: int, most: int) -> NDArray[np.int64]:
    """Places of at most `most` of n things, as evenly as whole numbers allow, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def read_sample(path: Path, most_frames: int, most_stars: int) -> Sample:
    """Read some frames of a stored Parquet table.

    Parameters
    ----------
    path
        The table, as `writers.write_parquet` wrote it.
    most_frames, most_stars
        Fewer frames are taken where their stars would be more than so many.

    Raises
    ------
    RefusedInputError
        When the file is damaged.
    """
    try:
        file = arrow_parquet.ParquetFile(path)
        known = [name for name in file.schema_arrow.names if name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)]
        frame = file.read(["frame"])["frame"].to_numpy()
        first = np.flatnonzero(np.append(True, np.diff(frame) != 0))
        most = min(most_frames, max(1, most_stars * len(first) // len(frame)))
        taken = evenly(len(first), most)
        rows = _rows(first, len(frame), taken)
        table = file.read(known).take(pa.array(rows))
    except (pa.ArrowException, OSError) as error:
        raise RefusedInputError(f"The stored table {path.name[:12]} cannot be read; upload the set again.") from error
    return Sample(telemetry_of(table, Faults(path.name[:12], 1)), len(taken), len(first))


def _rows(first: NDArray[np.int64], n_rows: int, taken: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the frames taken, from the first row of each frame."""
    ends = np.append(first, n_rows)
    return np.concatenate([np.arange(ends[k], ends[k + 1]) for k in taken])
