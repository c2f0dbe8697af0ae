"""Single frames, or some taken evenly, out of a stored table, however large it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from boresight.arrays import IntArray
from boresight.errors import NotFoundError
from boresight.telemetry.schema import Telemetry, find_exposures, joined
from boresight.telemetry.working_table import WorkingTable

#: Tables whose list of frames is kept; one of 100,000 frames takes 1.6 MB.
TABLES_KEPT = 8


@dataclass(frozen=True)
class FrameIndex:
    """Where the frames of a table are.

    `frame`: (n_frames,) frame numbers, ascending. `first_row`: (n_frames + 1,) first row of each, and the end.
    """

    table: WorkingTable
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
                f"to {self.frame[-1]}."
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
    table = WorkingTable(path)
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
