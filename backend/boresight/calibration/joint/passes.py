"""The passes of a joint calibration: several telemetry sets of one sensor put one after the other, as one set.

Nothing but the camera's parameters is common to two passes: arcs know no attitude, so every exposure brings its own and takes
it away again, and the least-squares problem of all sets is the one whose rows are the rows of each. So the sets are taken as one
whose frames are numbered through, in memory or piece by piece, by every method that takes one set. Passes follow one another by
their first time where each has one, else in the order in which they were named, for a filter forgets by order.

Frames keep their numbers where these ascend from pass to pass; else a pass is moved so that it begins after the one before it.
A column that a pass lacks is absent there. A frame counts once: passes that hold the same one, bit for bit in its centroids, are
refused, whatever the files are called and whether they share all frames or some.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.calibration import InputPass
from boresight.calibration.telemetry_pieces import LARGE_ROWS, TelemetryInput
from boresight.errors import RefusedInputError
from boresight.telemetry.schema import TEMPERATURES_C, UNMATCHED, Telemetry, joined, within
from boresight.telemetry.working_table import ARRAYS

#: Most passes of one calibration: two years of daily ones.
MOST_PASSES = 1000


@dataclass(frozen=True)
class _Head:
    """Row and number of a pass's first frame, its first known time, and an entry of every array that it has, by name."""

    first_row: int
    frame: int
    begins: np.datetime64
    columns: dict[str, NDArray[Any]]


@dataclass(frozen=True)
class NamedTelemetry:
    """One pass: its telemetry, what refusals call it, and the content address of its file, where it is one."""

    telemetry: TelemetryInput
    name: str
    sha256: str | None = None

    def about_rows(self) -> int:
        """How many rows it has, or a guess."""
        return len(self.telemetry) if isinstance(self.telemetry, Telemetry) else self.telemetry.about_rows()

    def chunks(self) -> Iterator[Telemetry]:
        """Return it piece by piece."""
        return iter([self.telemetry]) if isinstance(self.telemetry, Telemetry) else self.telemetry.chunks()

    @cached_property
    def head(self) -> _Head:
        """What its first piece tells, which has every column of it."""
        part = next(self.chunks())
        columns = {name: values[:1].copy() for name in ARRAYS if (values := getattr(part, name)) is not None}
        return _Head(part.first_row, int(part.frame[0]), span(part)[0], columns)


@dataclass(frozen=True)
class JointTelemetry:
    """Several sets of one sensor as one, see the module; `passes` says what was read, once it was."""

    sets: tuple[NamedTelemetry, ...]
    large_rows: int = LARGE_ROWS
    passes: list[InputPass] = field(default_factory=list, init=False, compare=False)

    def about_rows(self) -> int:
        """How many rows all have together."""
        return sum(one.about_rows() for one in self.sets)

    @property
    def begins(self) -> np.datetime64:
        """First known time of all."""
        return min(
            (one.head.begins for one in self.sets if not np.isnat(one.head.begins)), default=np.datetime64("NaT", "us")
        )

    def large(self) -> bool:
        """Whether they are to be taken piece by piece."""
        return self.about_rows() >= self.large_rows

    def read(self) -> Telemetry:
        """Return all in memory."""
        return joined(list(self.chunks()))

    def chunks(self) -> Iterator[Telemetry]:
        """Return them piece by piece, numbered through."""
        self.passes.clear()
        hashes: list[NDArray[np.uint64]] = []
        rows, first_row, next_frame = 0, self.in_order[0].head.first_row, 0
        for number, one in enumerate(self.in_order):
            offset = 0 if number == 0 else max(next_frame - one.head.frame, 0)
            account = _Account(one, offset, rows + first_row - one.head.first_row)
            for part in one.chunks():
                moved = self._with_every_column(part, part.frame + offset, rows + first_row)
                account.add(moved)
                rows += len(moved)
                yield moved
            self.passes.append(account.describe())
            next_frame = account.last_frame + 1
            hashes.append(account.frame_hashes())
        refuse_shared_frames([one.name for one in self.in_order], hashes)

    @cached_property
    def in_order(self) -> Sequence[NamedTelemetry]:
        """The sets by their first time, where all have one."""
        begins = [one.head.begins for one in self.sets]
        if any(map(np.isnat, begins)):
            return self.sets
        return [self.sets[k] for k in np.argsort(np.array(begins), kind="stable")]

    @cached_property
    def _columns(self) -> dict[str, NDArray[Any]]:
        """An entry of every array that one of the sets has, by its name."""
        return {name: values for one in self.sets for name, values in one.head.columns.items()}

    def _with_every_column(self, part: Telemetry, frame: NDArray[np.int64], first_row: int) -> Telemetry:
        """Return a piece under its new numbers, absent cells in the columns that it lacks."""
        lacked = {
            name: np.full((len(part), *like.shape[1:]), _absent(like), like.dtype)
            for name, like in self._columns.items()
            if getattr(part, name) is None
        }
        arrays: dict[str, Any] = {"frame": frame, **lacked}
        return replace(part, **arrays, unknown={}, first_row=first_row)


def _absent(like: NDArray[Any]) -> Any:
    """Return the absent cell of an array's kind."""
    match like.dtype.kind:
        case "M":
            return np.datetime64("NaT", "us")
        case "f":
            return np.nan
        case _:
            return UNMATCHED


def span(telemetry: Telemetry) -> tuple[np.datetime64, np.datetime64]:
    """Return the first and the last known time, NaT where there is none."""
    never = np.datetime64("NaT", "us")
    if telemetry.time_utc is None or np.isnat(telemetry.time_utc).all():
        return never, never
    known = telemetry.time_utc[~np.isnat(telemetry.time_utc)]
    return known.min(), known.max()


def hash_frames(part: Telemetry) -> NDArray[np.uint64]:
    """Return a number for each frame that follows from its centroids alone, in whatever order.

    None for those that may be alike by chance: of one star, or rounded to whole pixels.
    """
    place = np.ascontiguousarray(np.column_stack([part.row_px, part.col_px]), np.float64)
    words = place.view(np.uint64)
    mixed = words[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ words[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed = (mixed ^ mixed >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9)
    starts = np.flatnonzero(np.diff(part.frame, prepend=part.frame[0] - 1))
    counts = np.diff(starts, append=len(part))
    fractions = np.logical_or.reduceat((place != np.rint(place)).any(axis=1), starts)
    return np.asarray(np.add.reduceat(mixed ^ mixed >> np.uint64(32), starts)[(counts > 1) & fractions])


def refuse_shared_frames(names: Sequence[str], hashes: Sequence[NDArray[np.uint64]]) -> None:
    """Refuse passes of which two hold the same frames."""
    own = [np.unique(one) for one in hashes]
    frames, owner = np.concatenate(own), np.repeat(np.arange(len(own)), [len(one) for one in own])
    order = np.argsort(frames, kind="stable")
    frames, owner = frames[order], owner[order]
    if len(twice := np.flatnonzero(frames[1:] == frames[:-1])):
        first, second = owner[twice[0]], owner[twice[0] + 1]
        shared = len(np.intersect1d(own[first], own[second]))
        held = f"{names[second]} contains the centroids of {names[first]}"
        if shared == len(own[second]):
            raise RefusedInputError(
                f"{held}: give each set only once, or its stars are counted twice.", code="same-centroids"
            )
        raise RefusedInputError(
            f"{held} in {shared:,} of its frames: remove them from one set, or their stars are counted twice.",
            code="shared-frames",
        )


class _Account:
    """What is told of a pass, piece by piece."""

    def __init__(self, of: NamedTelemetry, frame_offset: int, row_offset: int) -> None:
        self._of, self._frame_offset, self._row_offset = of, frame_offset, row_offset
        self._hashes: list[NDArray[np.uint64]] = []
        self._frames = self._rows = self._warm = 0
        self._first_frame: int | None = None
        self.last_frame = 0
        self._times: list[np.datetime64] = []
        self._degrees = 0.0

    def add(self, part: Telemetry) -> None:
        """Take the next piece, whole frames, under its new numbers."""
        if self._first_frame is None:
            self._first_frame = int(part.frame[0])
        self.last_frame = int(part.frame[-1])
        self._frames += 1 + int(np.count_nonzero(np.diff(part.frame)))
        self._rows += len(part)
        self._hashes.append(hash_frames(part))
        self._times += [time for time in span(part) if not np.isnat(time)]
        if part.temperature_c is not None:
            warm = within(part.temperature_c, TEMPERATURES_C)
            self._degrees += float(np.nansum(warm))
            self._warm += int(np.isfinite(warm).sum())

    def frame_hashes(self) -> NDArray[np.uint64]:
        """Return what two passes with the same frames share."""
        return np.concatenate(self._hashes)

    def describe(self) -> InputPass:
        """Say what it was."""
        times = sorted(self._times)
        return InputPass(
            name=self._of.name,
            sha256=self._of.sha256,
            frames=self._frames,
            detections=self._rows,
            first_frame=self._first_frame or 0,
            last_frame=self.last_frame,
            frame_offset=self._frame_offset,
            row_offset=self._row_offset,
            start_utc=f"{times[0]}Z" if times else None,
            end_utc=f"{times[-1]}Z" if times else None,
            temperature_c=self._degrees / self._warm if self._warm else None,
        )


def join_sets(sets: Sequence[NamedTelemetry], large_rows: int = LARGE_ROWS) -> JointTelemetry:
    """Take several sets of one sensor as one; refuses a file that is named twice, and more than can be meant."""
    if len(sets) > MOST_PASSES:
        raise RefusedInputError(
            f"{len(sets):,} sets were given, but at most {MOST_PASSES:,} are allowed: give fewer, or merge the sets of each day."
        )
    seen: dict[str, str] = {}
    for one in sets:
        if one.sha256 is not None and one.sha256 in seen:
            raise RefusedInputError(
                f"{one.name} is the file {seen[one.sha256]} again: name each set once, or its stars count twice.",
                code="same-file",
            )
        if one.sha256 is not None:
            seen[one.sha256] = one.name
    return JointTelemetry(tuple(sets), large_rows)


def list_passes(telemetry: TelemetryInput) -> list[InputPass]:
    """Return the passes of what was calibrated; none where it was one set."""
    return list(telemetry.passes) if isinstance(telemetry, JointTelemetry) else []
