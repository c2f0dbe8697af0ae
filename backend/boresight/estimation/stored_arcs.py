"""The arcs of a set in files, in the place of an `ArcSet`: the same blocks, so the same bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.cameras import CameraModel
from boresight.columns import Columns, write_columns
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import FRAMES, in_blocks
from boresight.estimation.executor import Executor

T = TypeVar("T")
Step = tuple[Callable[..., ArcSet], tuple[Any, ...]]

#: Blocks that one call computes: a tenth of a second, ten times what it costs to send it to another machine.
BLOCKS_A_RANGE = 16
_STORED = ("frame", "frame_start", "star_start", "row_px", "col_px", "sigma_px", "s_i", "source_row")


@dataclass(frozen=True)
class ArcsPiece:
    """Consecutive frames of a set in a file."""

    columns: Columns
    camera: CameraModel
    pitch: float
    n_frames: int
    n_exposures: int
    n_stars: int

    def read(self) -> ArcSet:
        """Map it."""
        arrays: dict[str, Any] = self.columns.read()
        return ArcSet(
            **{name: arrays[name] for name in _STORED},
            camera=self.camera, pitch=self.pitch, phi=np.empty(0), band=np.empty((0, 5)),
        )  # fmt: skip

    def column(self, name: str) -> NDArray[Any]:
        """Map one array of it."""
        return self.columns.read()[name]

    def has(self, name: str) -> bool:
        """Whether there is such an array."""
        return any(column.name == name for column in self.columns.layout)


def write_arcs(path: Path, arcs: ArcSet, time_utc: NDArray[np.datetime64] | None) -> ArcsPiece:
    """Write unwhitened arcs and the times of their frames."""
    arrays = {name: getattr(arcs, name) for name in _STORED}
    if time_utc is not None:
        arrays["time_utc"] = time_utc
    columns = write_columns(path, arrays)
    return ArcsPiece(columns, arcs.camera, arcs.pitch, arcs.n_frames, arcs.n_exposures, arcs.n_stars)


@dataclass(frozen=True)
class StoredArcs:
    """The arcs of a set in pieces; what is computed of them is the same to the last bit as of an `ArcSet`."""

    pieces: tuple[ArcsPiece, ...]
    executor: Executor
    steps: tuple[Step, ...] = ()

    @cached_property
    def frame(self) -> IntArray:
        """(n_frames,) frame numbers of the telemetry."""
        return np.concatenate([np.zeros(0, np.int64), *(piece.column("frame") for piece in self.pieces)])

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return sum(piece.n_frames for piece in self.pieces)

    @property
    def n_exposures(self) -> int:
        """Number of exposures."""
        return sum(piece.n_exposures for piece in self.pieces)

    @property
    def n_stars(self) -> int:
        """Number of star sightings."""
        return sum(piece.n_stars for piece in self.pieces)

    @property
    def n_arcs(self) -> int:
        """Number of arcs."""
        return 2 * self.n_stars - 3 * self.n_exposures

    def frames(self, first: int, last: int) -> ArcSet:
        """Return the frames first <= k < last as a set in memory."""
        pieces, k0, k1 = self.part(first, last)
        return taken([piece.read() for piece in pieces], k0, k1, self.steps)

    def whole(self) -> ArcSet:
        """Return the set in memory."""
        return self.frames(0, self.n_frames)

    def each(self, function: Callable[..., ArcSet], *arguments: Any) -> StoredArcs:
        """Remember to do this to every part that is taken."""
        return replace(self, steps=(*self.steps, (function, arguments)))

    def over_blocks(self, function: Callable[..., T], *arguments: Any) -> list[T]:
        """Call `function(block, *arguments)` for each block, a range of blocks at a time, wherever the executor computes it."""
        edges = range(0, self.n_frames, FRAMES * BLOCKS_A_RANGE)
        ranges = [self.part(first, min(first + edges.step, self.n_frames)) for first in edges]
        work = [(*part, self.steps, function, arguments) for part in ranges]
        return [result for results in self.executor.map(over_range, work) for result in results]

    def part(self, first: int, last: int) -> tuple[tuple[ArcsPiece, ...], int, int]:
        """The pieces that the frames first <= k < last lie in, and these places counted from the first of them."""
        ends = np.cumsum([piece.n_frames for piece in self.pieces], dtype=np.int64)
        begin, end = int(np.searchsorted(ends, first, side="right")), int(np.searchsorted(ends, last))
        before = int(ends[begin - 1]) if begin else 0
        return self.pieces[begin : end + 1], first - before, last - before


#: The arcs of a set, in memory or in files.
Arcs = ArcSet | StoredArcs


def over_range(
    pieces: Sequence[ArcsPiece],
    first: int,
    last: int,
    steps: Sequence[Step],
    function: Callable[..., T],
    arguments: tuple[Any, ...],
) -> list[T]:
    """Call `function(block, *arguments)` for each block of the frames first <= k < last of some pieces."""
    mapped = [piece.read() for piece in pieces]
    return in_blocks(lambda k0, k1: function(taken(mapped, first + k0, first + k1, steps), *arguments), last - first)


def taken(sets: Sequence[ArcSet], first: int, last: int, steps: Sequence[Step] = ()) -> ArcSet:
    """Put together the frames first <= k < last of consecutive sets, and do the steps to them."""
    parts, begins = [], 0
    for arcs in sets:
        k0, k1 = max(first - begins, 0), min(last - begins, arcs.n_frames)
        if k0 < k1:
            parts.append(arcs.frames(k0, k1))
        begins += arcs.n_frames
    arcs = joined(parts)
    for function, arguments in steps:
        arcs = function(arcs, *arguments)
    return arcs


def joined(parts: Sequence[ArcSet]) -> ArcSet:
    """Join consecutive unwhitened sets, at least one."""
    if len(parts) == 1:
        return parts[0]
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _STORED if "start" not in name
    }
    exposures = np.cumsum([0, *(part.n_exposures for part in parts)])
    stars = np.cumsum([0, *(part.n_stars for part in parts)])
    return replace(
        parts[0],
        **arrays,
        frame_start=_starts([part.frame_start for part in parts], exposures),
        star_start=_starts([part.star_start for part in parts], stars),
    )


def _starts(parts: Sequence[NDArray[np.int64]], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Join lists of first places, each of which ends with its end."""
    moved = [part[:-1] + offset for part, offset in zip(parts, offsets[:-1], strict=True)]
    return np.concatenate([*moved, offsets[-1:]])
