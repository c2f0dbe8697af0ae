"""From the pieces of a set to the arcs of its problem, piece by piece.

What `calibration.problem` counts of a set adds up over its parts. One refusal does not: that no matched star has a time is true of
a set only if it is true of every part, so a part without times gives what it can, and the sum decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.problem import LeftOut, Problem, added, make_problem
from boresight.calibration.streaming.telemetry_pieces import TelemetryPiece
from boresight.columns import Columns, write_columns
from boresight.estimation.executor import Executor, Told
from boresight.estimation.stored_arcs import ArcsPiece, StoredArcs, write_arcs
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import TimelessError, star_directions
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor


@dataclass(frozen=True)
class OrderedPiece:
    """The arcs of a piece, and what is counted of it; `timeless` stars wanted a time where the whole piece has none."""

    arcs: ArcsPiece
    frames_in_set: int
    left_out: tuple[LeftOut, ...]
    timeless: int


def write_catalogue(catalogue: Catalogue, folder: Path) -> Columns:
    """Put the stars where every machine can map them."""
    arrays = {item.name: getattr(catalogue, item.name) for item in fields(Catalogue)}
    return write_columns(folder / "catalogue", arrays)


@lru_cache(maxsize=1)
def read_catalogue(columns: Columns) -> Catalogue:
    """Map the stars; those read last are kept."""
    return Catalogue(**columns.read())


def order_set(
    pieces: Sequence[TelemetryPiece],
    sensor: Sensor,
    catalogue: Columns,
    minimum_stars: int,
    folder: Path,
    executor: Executor,
    done: Told,
) -> Problem:
    """Order the stars of every exposure of a set."""
    work = [
        (piece, sensor, catalogue, minimum_stars, str(folder / f"arcs-{number:06d}"))
        for number, piece in enumerate(pieces)
    ]
    parts: list[OrderedPiece] = executor.map(order_piece, work, done=done)
    refuse_timeless(pieces, sum(part.timeless for part in parts), catalogue, executor)
    return problem_of_parts(parts, sensor, executor)


def problem_of_parts(parts: Sequence[OrderedPiece], sensor: Sensor, executor: Executor) -> Problem:
    """Make one problem of the parts of a set; a part may have no frame."""
    pieces = tuple(part.arcs for part in parts if part.arcs.n_frames)
    timed = bool(pieces) and all(piece.has("time_utc") for piece in pieces)
    return Problem(
        sensor=sensor,
        arcs=StoredArcs(pieces, executor),
        time_utc=np.concatenate([piece.column("time_utc") for piece in pieces]) if timed else None,
        frames_in_set=sum(part.frames_in_set for part in parts),
        left_out=added(item for part in parts for item in part.left_out),
    )


def order_piece(
    piece: TelemetryPiece, sensor: Sensor, catalogue: Columns, minimum_stars: int, path: str
) -> OrderedPiece:
    """Order the stars of one piece and write its arcs."""
    telemetry, stars = piece.read(), read_catalogue(catalogue)
    timeless = 0
    try:
        s_i = _directions(telemetry, stars)
    except TimelessError as refusal:
        timeless, s_i = refusal.stars, _directions(telemetry, stars.brighter_than(-np.inf))
    return write_ordered(make_problem(telemetry, sensor, s_i, minimum_stars), piece.begins, Path(path), timeless)


def write_ordered(problem: Problem, begins: int, path: Path, timeless: int = 0) -> OrderedPiece:
    """Write the arcs of a piece whose rows begin at this place of the set."""
    arcs = problem.arcs.whole()
    arcs.source_row[:] += begins
    return OrderedPiece(write_arcs(path, arcs, problem.time_utc), problem.frames_in_set, problem.left_out, timeless)


def _directions(telemetry: Telemetry, catalogue: Catalogue) -> NDArray[np.float64]:
    """Apparent direction of every row, (n_rows, 3)."""
    return star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue
    )


def refuse_timeless(pieces: Sequence[TelemetryPiece], timeless: int, catalogue: Columns, executor: Executor) -> None:
    """Refuse a set in which no star that needs a time has one; `timeless` are those of parts that have none at all."""
    if timeless and not any(executor.map(has_timed_star, [(piece, catalogue) for piece in pieces])):
        raise TimelessError(timeless)


def has_timed_star(piece: TelemetryPiece, catalogue: Columns) -> bool:
    """Whether a star of this piece takes its direction from the catalogue at a known time."""
    telemetry = piece.read()
    if telemetry.star_id is None or telemetry.time_utc is None:
        return False
    wanted = (telemetry.star_id > 0) & ~np.isnat(telemetry.time_utc)
    if telemetry.ra_rad is not None:
        wanted &= np.isnan(telemetry.ra_rad)
    return bool((read_catalogue(catalogue).find_index(telemetry.star_id[wanted]) >= 0).any())
