"""What an archive exports for a time range: rows with a time each, and the file that a mapping profile reads.

Times are whole microseconds since 1970 (UTC); a range holds its start and not its stop, whatever a server makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from boresight.errors import UnavailableError
from boresight.telemetry.imports.profile import Profile

EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND: Final = timedelta(microseconds=1)
#: Of one export, as a file and in memory.
MOST_EXPORT_BYTES: Final = 128_000_000


@dataclass(frozen=True)
class ArchiveRows:
    """Rows of an export in the order of their times: `times_us[row]`, `lines[row]`, and the line of their columns' names."""

    header: str
    times_us: npt.NDArray[np.int64]
    lines: Sequence[str]

    def without(self, taken_us: npt.NDArray[np.int64]) -> ArchiveRows:
        """Return the rows whose times are not among those."""
        kept = np.flatnonzero(~np.isin(self.times_us, taken_us)).tolist()
        return ArchiveRows(self.header, self.times_us[kept], [self.lines[row] for row in kept])

    def to_bytes(self) -> bytes:
        """Write them as the file of an export."""
        return "\n".join((self.header, *self.lines, "")).encode()


class Archive(Protocol):
    """A mission control system from which telemetry comes."""

    #: What a file of an export ends with.
    suffix: str

    def export(self, profile: Profile, start_us: int, stop_us: int) -> ArchiveRows:
        """Return what a profile names, from start to before stop."""

    def close(self) -> None:
        """Close the connection."""


def make_rows(header: str, found: Sequence[tuple[int, str]], start_us: int, stop_us: int) -> ArchiveRows:
    """Return rows in the order of time, of the range alone."""
    inside = sorted((one for one in found if start_us <= one[0] < stop_us), key=lambda one: one[0])
    return ArchiveRows(header, np.array([at for at, _ in inside], dtype=np.int64), [line for _, line in inside])


def read_time_us(text: str, system: str) -> int:
    """Read a time of an export."""
    try:
        at = datetime.fromisoformat(text)
    except ValueError as error:
        raise UnavailableError(f"{system} exported {text[:40]!r} where a time should be; check its version.") from error
    return count_us(at if at.tzinfo else at.replace(tzinfo=UTC))


def count_us(at: datetime) -> int:
    """Return the microseconds of a time since 1970."""
    return (at - EPOCH) // MICROSECOND


def write_time(at_us: int) -> str:
    """Write a time as ISO 8601 with all its microseconds."""
    return f"{EPOCH + at_us * MICROSECOND:%Y-%m-%dT%H:%M:%S.%fZ}"
