"""Single frames, or some taken evenly, out of a stored table, however large it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import IntArray
from boresight.errors import NotFoundError
from boresight.telemetry.schema import Telemetry, find_exposures, joined
from boresight.telemetry.working_table import WorkingTable

#: Tables whose list of frames is kept; one of 100,000 frames takes 1.6 MB.
TABLES_KEPT = 8


@dataclass(frozen=True)
class JoinedTables:
    """Tables one after the other, and what the frame numbers of each are moved by; at a seam, the columns that both have."""

    tables: tuple[tuple[WorkingTable, int], ...]

    @cached_property
    def row_start(self) -> IntArray:
        """(n_tables + 1,) first row of each, and the end."""
        return np.cumsum([0, *(len(table) for table, _ in self.tables)], dtype=np.int64)

    def __len__(self) -> int:
        """Count the rows."""
        return int(self.row_start[-1])

    def parts(self) -> Iterator[Telemetry]:
        """Map the parts of all, one after the other."""
        return (_moved(part, offset) for table, offset in self.tables for part in table.parts())

    def rows(self, begin: int, end: int) -> Telemetry:
        """Map the rows begin <= k < end."""
        found = []
        for (table, offset), first, last in zip(self.tables, self.row_start, self.row_start[1:], strict=False):
            if begin < last and end > first:
                found.append(_moved(table.rows(max(begin - int(first), 0), min(end, int(last)) - int(first)), offset))
        return joined(_with_common_columns(found))


def _moved(telemetry: Telemetry, offset: int) -> Telemetry:
    return replace(telemetry, frame=telemetry.frame + offset) if offset else telemetry


def _with_common_columns(parts: Sequence[Telemetry]) -> list[Telemetry]:
    """Leave out what one of the parts has not."""
    lacked = {item.name: None for item in fields(Telemetry) if any(getattr(part, item.name) is None for part in parts)}
    texts = [name for name in parts[0].unknown if all(name in part.unknown for part in parts)]
    own: dict[str, Any] = dict(lacked)
    return [replace(part, **own, unknown={name: part.unknown[name] for name in texts}) for part in parts]


@dataclass(frozen=True)
class FrameIndex:
    """Where the frames of a table are.

    `frame`: (n_frames,) frame numbers, ascending. `first_row`: (n_frames + 1,) first row of each, and the end.
    """

    table: WorkingTable | JoinedTables
    frame: IntArray
    first_row: IntArray

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.frame)

    def find_place(self, frame: int) -> int:
        """Return the place of a frame number in `frame`."""
        place = int(np.searchsorted(self.frame, frame))
        if place == len(self.frame) or self.frame[place] != frame:
            raise NotFoundError(
                f"The telemetry has no frame {frame}; choose from its {len(self)}, which are numbered from {self.frame[0]} "
                f"to {self.frame[-1]}.",
                code="no-such-frame",
            )
        return place

    def read(self, place: int, neighbours: int = 0) -> Telemetry:
        """Read a frame by its place, with so many frames on either side."""
        first = int(self.first_row[max(place - neighbours, 0)])
        return self.table.rows(first, int(self.first_row[min(place + neighbours + 1, len(self))]))

    @cached_property
    def named_stars(self) -> IntArray:
        """Every star number that the table gives, ascending."""
        named = [np.unique(part.star_id) for part in self.table.parts() if part.star_id is not None]
        stars = np.unique(np.concatenate([np.empty(0, np.int64), *named]))
        return stars[stars > 0]

    @cached_property
    def typical_stars(self) -> float:
        """Median number of detections of an exposure."""
        return float(np.median(np.concatenate([find_exposures(part).count for part in self.table.parts()])))


@lru_cache(maxsize=TABLES_KEPT)
def frame_index(path: Path) -> FrameIndex:
    """Find the frames of a table that never changes under its path."""
    return _find_frames(WorkingTable(path))


@lru_cache(maxsize=TABLES_KEPT)
def joined_frame_index(tables: tuple[tuple[Path, int], ...]) -> FrameIndex:
    """Find the frames of several such tables as one, each with what its numbers are moved by."""
    return _find_frames(JoinedTables(tuple((WorkingTable(path), offset) for path, offset in tables)))


def _find_frames(table: WorkingTable | JoinedTables) -> FrameIndex:
    frame = np.concatenate([part.frame for part in table.parts()])
    first = np.append(0, np.flatnonzero(np.diff(frame)) + 1)
    return FrameIndex(table, frame[first], np.append(first, len(frame)))


@dataclass(frozen=True)
class Sample:
    """Frames of a set that stand for all."""

    telemetry: Telemetry
    frames: int
    frames_in_set: int


def evenly(n: int, most: int) -> IntArray:
    """Places of at most `most` of n things, as evenly as whole numbers allow, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def read_sample(path: Path, most_frames: int, most_stars: int) -> Sample:
    """Read some frames of a stored table."""
    index = frame_index(path)
    most = min(most_frames, max(1, most_stars * len(index) // len(index.table)))
    taken = evenly(len(index), most)
    telemetry = joined([index.read(int(place)) for place in taken])
    return Sample(telemetry, len(taken), len(index))
