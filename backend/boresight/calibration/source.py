"""Where a calibration's telemetry comes from: memory, or a file that may be larger than it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

from boresight.telemetry.read.chunks import CHUNK_FRAMES, read_chunks, rows_in
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.read.readers import Stretch, read_telemetry, stretches
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.working_table import WorkingTable

#: Detections from which a file is calibrated piece by piece. In memory such a set and its arcs take about 400 MB.
LARGE_ROWS = 500_000
#: A row of CSV is about as long; of JSON Lines three times.
BYTES_A_ROW = 100


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
        return self.path.stat().st_size // BYTES_A_ROW if rows is None else rows

    def large(self) -> bool:
        """Whether it is to be taken piece by piece."""
        return self.about_rows() >= self.large_rows

    def opened(self) -> Telemetry | TelemetryFile:
        """Read a small file, refusing what cannot be used; leave a large one to whoever takes it piece by piece."""
        return self if self.large() else self.read()

    def read(self) -> Telemetry:
        """Read all of it; refuses as `telemetry.read.readers.read_telemetry`."""
        return read_telemetry(self.path, self.name, self.limits)

    def stretches(self) -> list[Stretch]:
        """Cut it into parts that can be read apart; none where it must be read from its start."""
        return stretches(self.path, self.name or self.path.name, self.chunk_frames, self.limits)

    def chunks(self) -> Iterator[Telemetry]:
        """Read it piece by piece; refuses as `telemetry.read.chunks.read_chunks`, at the end."""
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

    def large(self) -> bool:
        """Whether it is to be taken piece by piece."""
        return len(self.table) >= self.large_rows

    def read(self) -> Telemetry:
        """Map all of it."""
        return self.table.read()

    def chunks(self) -> Iterator[Telemetry]:
        """Map it piece by piece."""
        return self.table.parts()


def is_large(telemetry: Telemetry | TelemetryFile | StoredTable) -> TypeGuard[TelemetryFile | StoredTable]:
    """Whether telemetry is to be taken piece by piece."""
    return not isinstance(telemetry, Telemetry) and telemetry.large()


def read_whole(telemetry: Telemetry | TelemetryFile | StoredTable) -> Telemetry:
    """Return telemetry in memory."""
    return telemetry if isinstance(telemetry, Telemetry) else telemetry.read()
