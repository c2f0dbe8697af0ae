"""A telemetry set under given or renewed matches: the problem it makes at any state, and what was matched on the way.

Given matches are proposals: `calibration.matching.verification` says which of them a state refuses, and the arcs of the
exposures that lose a star are made again.

Matched again, the set is T(x) of E section II-B: what "a ground-based implementation of the sensor flight software"
makes of it under x. With `match_rule` "flight" it is what the flight code itself would keep: arcs that disagree with
the catalogue by more than one fixed tolerance cost their star, and an exposure without enough of them is lost
(`calibration.matching.flight_check`).

What is known of x for the tolerance: at the start the ground calibration's sigmas; at an estimate whose data hold the
information A (in typical sigmas) its own covariance beside the start's, (A + I / initial_sigma_scale^2)^-1, widened by
chi-square where the residuals say that it claims too much; parameters held fixed keep the ground's sigmas at all times.

A set in files is matched a range of frames at a time, and its arcs are made piece by piece. The ranges are those of a set in
memory (`MATCHED_FRAMES`), wherever a piece ends, so the same neighbours are looked at. What depends on the whole set travels with
each range: its first time, and the stars that may be matched, which follow from the faintest that it names or from how many it
detects. Counts add up over the parts. That no matched star has a time is true of a set only if it is true of every part, so a
part without times gives what it can, and the sum decides whether the set is refused.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.calibration.calibration import LeftOut, RemovedStar
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.matching.flight_check import check_flight, compute_flight_tolerance
from boresight.calibration.matching.matched_frames import GivenMatches, read_given_matches
from boresight.calibration.matching.rematch import (
    Matches,
    MatchingSky,
    Rematcher,
    blend_rad,
    compute_magnitude_limit,
    ground_covariance,
    joined_matches,
    matching_sky,
)
from boresight.calibration.matching.verification import (
    MOST_REFUSED,
    NONE,
    Refusals,
    Verification,
    list_removed,
    measure_noise,
    verification_after,
    verification_before,
)
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import (
    COLLINEAR_REASON,
    Problem,
    added,
    build_problem,
    find_parity,
    make_problem,
    make_problem_of_directions,
    too_few_reason,
)
from boresight.calibration.sequence import Frames
from boresight.calibration.telemetry_pieces import (
    PREPARED,
    READING,
    WHOLE,
    FrameRange,
    MatchedRows,
    Pieces,
    Prepared,
    TelemetryPiece,
    in_memory,
    judged_frames,
    judged_matches,
    judged_telemetry,
)
from boresight.columns import Columns, write_columns
from boresight.estimation.arcs import ArcSet
from boresight.estimation.executor import Executor, ProgressCallback
from boresight.estimation.filters.history import FilterState
from boresight.estimation.stored_arcs import ArcsPiece, StoredArcs, write_arcs
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import TimelessError, star_directions
from boresight.telemetry.schema import UNMATCHED, Telemetry, find_exposures, select_rows
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
    done: ProgressCallback,
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
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue,
        telemetry.site,
    )  # fmt: skip


@dataclass(frozen=True)
class ReducedPiece:
    """The arcs of a piece without some stars, and the exposures that are lost with them."""

    arcs: ArcsPiece
    few: int
    collinear: int


def without_stars(problem: Problem, refused: Refusals, minimum_stars: int, folder: Path | None) -> Problem:
    """Return a problem without refused stars; of one in files the pieces that hold any are written into a folder."""
    arcs = problem.arcs
    if isinstance(arcs, ArcSet):
        kept, few, collinear = arcs.without(refused.row, minimum_stars)
        times = None if problem.time_utc is None else problem.time_utc[np.isin(arcs.frame, kept.frame)]
        return _counted(replace(problem, arcs=kept, time_utc=times), refused, few, collinear, minimum_stars)
    work = [
        (piece, rows, minimum_stars, str((folder or Path()) / f"{k:06d}"))
        for k, piece in enumerate(arcs.pieces)
        if len(rows := _rows_of_piece(piece, refused.row))
    ]
    reduced: list[ReducedPiece] = arcs.executor.map(reduce_piece, work)
    new = {part[0].columns: result for part, result in zip(work, reduced, strict=True)}
    pieces = [new[piece.columns].arcs if piece.columns in new else piece for piece in arcs.pieces]
    pieces = [piece for piece in pieces if piece.n_frames]
    timed = problem.time_utc is not None and bool(pieces)
    changed = replace(
        problem,
        arcs=StoredArcs(tuple(pieces), arcs.executor),
        time_utc=np.concatenate([piece.column("time_utc") for piece in pieces]) if timed else None,
    )
    few, collinear = sum(part.few for part in reduced), sum(part.collinear for part in reduced)
    return _counted(changed, refused, few, collinear, minimum_stars)


def _rows_of_piece(piece: ArcsPiece, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of ascending rows that may be a piece's."""
    own = piece.column("source_row")
    return rows[slice(*np.searchsorted(rows, [own.min(), own.max() + 1]))]


def reduce_piece(piece: ArcsPiece, rows: NDArray[np.int64], minimum_stars: int, path: str) -> ReducedPiece:
    """Write a piece without the stars of some rows."""
    arcs = piece.read()
    kept, few, collinear = arcs.without(rows, minimum_stars)
    times = piece.column("time_utc")[np.isin(arcs.frame, kept.frame)] if piece.has("time_utc") else None
    return ReducedPiece(write_arcs(Path(path), kept, times), few, collinear)


def _counted(problem: Problem, refused: Refusals, few: int, collinear: int, minimum_stars: int) -> Problem:
    """Count what was left out with refused stars."""
    new = [LeftOut(what="stars", count=count, reason=reason) for reason, count in refused.counted().items()]
    new += [
        LeftOut(what="exposures", count=few, reason=too_few_reason(minimum_stars)),
        LeftOut(what="exposures", count=collinear, reason=COLLINEAR_REASON),
    ]
    return replace(problem, left_out=added([*problem.left_out, *new]))


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


_MATCHES = tuple(item.name for item in fields(Matches))


@dataclass(frozen=True)
class MatchingState:
    """What a set is matched under: x, SI, its covariance P, SI, and centroid errors so many times the stated ones."""

    x: FloatArray
    P: FloatArray
    noise: float = 1.0


@dataclass(frozen=True)
class MatchingPlan:
    """How a set in files is matched, the same for all its ranges."""

    sensor: Sensor
    catalogue: Columns
    settings: CalibrationSettings
    cache_folder: Path | None
    magnitude_limit: float
    epoch: np.datetime64 | None


@dataclass(frozen=True)
class MatchedRange:
    """A range as matched under some state: its rows with their matches, and where it is in files its arcs."""

    held: MatchedRows | tuple[FrameRange, Columns]
    ordered: OrderedPiece | None = None

    def rows(self) -> MatchedRows:
        """The telemetry, the matches and the kept stars; maps them where they are in files."""
        if isinstance(self.held, MatchedRows):
            return self.held
        of, matches = self.held
        arrays: dict[str, Any] = matches.read()
        return MatchedRows(of.read()[0], Matches(**{name: arrays[name] for name in _MATCHES}), arrays["kept"])


def match_range(how: MatchingPlan, of: FrameRange, under: MatchingState, path: str) -> MatchedRange:
    """Match one range and write what comes out."""
    telemetry, begins = of.read()
    rows, matches, timeless = matched_range(how, telemetry, under)
    arrays = {name: getattr(matches, name) for name in _MATCHES} | {"kept": rows.kept}
    problem = build_problem(rows.named(), how.sensor, read_catalogue(how.catalogue), how.settings.minimum_stars)
    ordered = write_ordered(problem, begins, Path(f"{path}-arcs"), timeless)
    return MatchedRange((of, write_columns(Path(f"{path}-matches"), arrays)), ordered)


def matched_range(how: MatchingPlan, telemetry: Telemetry, under: MatchingState) -> tuple[MatchedRows, Matches, int]:
    """Match rows in memory; returns them, their matches, and how many stars wanted a time where none of these rows has one."""
    stars, timeless = read_catalogue(how.catalogue), 0
    sky = _sky(how.catalogue, how.magnitude_limit, blend_rad(how.sensor))
    try:
        matcher = _rematcher(how, telemetry, stars, sky)
    except TimelessError as refusal:
        timeless, matcher = refusal.stars, _rematcher(how, telemetry, stars.brighter_than(-np.inf), sky)
    matches = matcher(under.x, under.P, noise=under.noise)
    return matched_rows(telemetry, matches, under.x, how.sensor, how.settings), matches, timeless


def matched_rows(
    telemetry: Telemetry, matches: Matches, x: FloatArray, sensor: Sensor, settings: CalibrationSettings
) -> MatchedRows:
    """Keep the matches that the flight code would accept at x, or all where `match_rule` does not ask it."""
    if settings.match_rule != "flight":
        return MatchedRows(telemetry, matches, matches.star_id)
    view = check_flight(
        telemetry, sensor, matches, x, compute_flight_tolerance(sensor, settings), settings.minimum_stars
    )
    taken = view.accepted & np.repeat(view.valid, np.diff(matches.exposure_start))
    return MatchedRows(telemetry, matches, np.where(taken, matches.star_id, 0))


def _rematcher(how: MatchingPlan, telemetry: Telemetry, stars: Catalogue, sky: MatchingSky) -> Rematcher:
    return Rematcher(telemetry, how.sensor, stars, how.settings, how.cache_folder, sky, how.epoch)


@lru_cache(maxsize=1)
def _sky(catalogue: Columns, magnitude_limit: float, blend: float) -> MatchingSky:
    """The stars that may be matched; those asked for last are kept."""
    return matching_sky(read_catalogue(catalogue), magnitude_limit, blend)


def magnitude_limit(pieces: Sequence[TelemetryPiece], sensor: Sensor, catalogue: Columns, executor: Executor) -> float:
    """Faintest star that may be matched, Hp, as `rematch.compute_magnitude_limit` finds it of a set in memory."""
    parts: list[tuple[int, NDArray[np.int64]]] = executor.map(seen_in_piece, [(piece, catalogue) for piece in pieces])
    longest = max(len(counts) for _, counts in parts)
    counts = np.sum([np.pad(part, (0, longest - len(part))) for _, part in parts], axis=0)
    faintest = np.array(sorted({star for star, _ in parts if star > 0}), np.int64)
    return compute_magnitude_limit(sensor, read_catalogue(catalogue), faintest, _median(counts))


def seen_in_piece(piece: TelemetryPiece, catalogue: Columns) -> tuple[int, NDArray[np.int64]]:
    """The faintest known star that a piece names, 0 = none, and how many of its exposures have 0, 1, 2, ... detections."""
    telemetry, stars = piece.read(), read_catalogue(catalogue)
    counts = np.bincount(find_exposures(telemetry).count)
    if telemetry.star_id is None:
        return 0, counts
    index = stars.find_index(np.unique(telemetry.star_id[telemetry.star_id > 0]))
    index = index[index >= 0]
    return (int(stars.hip[index[np.argmax(stars.magnitude[index])]]) if len(index) else 0), counts


def _median(counts: NDArray[np.int64]) -> float:
    """Median of values of which 0, 1, 2, ... occur so often."""
    ends, n = np.cumsum(counts), int(counts.sum())
    middle = np.searchsorted(ends, [(n - 1) // 2, n // 2], side="right")
    return float(middle.mean())


def changed_in_range(before: MatchedRange, after: MatchedRange) -> int:
    """Count the detections of a range whose star differs."""
    return int(np.sum(before.rows().kept != after.rows().kept))


#: Frames that are matched together, counted from a set's first: an exposure without a start looks for a neighbour among these.
MATCHED_FRAMES = 4096


@dataclass(frozen=True)
class Matched:
    """A set under one state; of one whose stars are given also what was refused of them, and how that was found."""

    problem: Problem
    ranges: tuple[MatchedRange, ...]
    folder: Path | None = None
    refused: Refusals = NONE
    verification: Verification | None = None

    @cached_property
    def telemetry(self) -> Telemetry:
        """The set in memory with the stars it was matched with."""
        return self.ranges[0].rows().named()

    @property
    def matches(self) -> Matches | GivenMatches:
        """Which star is which, of a set in memory."""
        return self.ranges[0].rows().matches


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known of a sensor's parameters, see the module."""

    sensor: Sensor
    parameters: Parameters
    settings: CalibrationSettings

    def at_start(self) -> MatchingState:
        """Before any estimate: the ground calibration's sigmas, or those of a prior."""
        if (prior := self.parameters.prior) is not None:
            ground = np.eye(len(prior.P)) / self.settings.initial_sigma_scale**2
            return self.at_covariance(prior.x, np.asarray(np.linalg.inv(prior.A + ground)))
        return MatchingState(self.sensor.initial, self._ground)

    def at(self, estimate: Estimate, problem: Problem) -> MatchingState:
        """After an estimate made from a problem."""
        n = len(self.parameters.free)
        held = np.asarray(np.linalg.inv(estimate.A + self.parameters.known_at_start(self.settings)), np.float64)
        dof = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures - n
        excess = max(1.0, estimate.chi2 / max(dof, 1))
        return replace(self.at_covariance(estimate.x, held * excess), noise=float(np.sqrt(excess)))

    def at_covariance(self, x: FloatArray, P: FloatArray) -> MatchingState:
        """At x, SI, with its free parameters' covariance P (n_free, n_free) in typical sigmas."""
        return MatchingState(x, self.parameters.full_covariance(P, self._ground, n=len(x)))

    @property
    def _ground(self) -> FloatArray:
        return ground_covariance(self.sensor, self.settings.initial_sigma_scale)


@dataclass(frozen=True)
class EvaluatedSet:
    """What of a set is judged in memory, all of it or a sample: as it is matched first, and last."""

    sets: Dataset
    first: Matched
    last: Matched


def _unnamed(telemetry: Telemetry, rows: NDArray[np.int64]) -> Telemetry:
    """Take star numbers and directions from some rows."""
    changed: dict[str, Any] = {}
    for name, nothing in (("star_id", UNMATCHED), ("ra_rad", np.nan), ("dec_rad", np.nan)):
        values = getattr(telemetry, name)
        if values is not None:
            changed[name] = values.copy()
            changed[name][rows] = nothing
    return replace(telemetry, **changed)


class Dataset:
    """A set over pieces that can be matched under any state, or whose given matches are verified under any."""

    def __init__(
        self,
        pieces: Pieces | Telemetry,
        sensor: Sensor,
        catalogue: Catalogue,
        parameters: Parameters,
        settings: CalibrationSettings,
        cache_folder: Path | None,
        told: Prepared = lambda _fraction, _line: None,
    ) -> None:
        self.sensor, self.catalogue, self.settings = sensor, catalogue, settings
        self.matching_s = (
            0.0  # processor time of this thread that matching for a filter took: its cost is told without it
        )
        self._pieces = in_memory(pieces) if isinstance(pieces, Telemetry) else pieces
        self._parameters, self._cache_folder, self._told = parameters, cache_folder, told
        self._known = PriorKnowledge(sensor, parameters, settings)
        self._states: list[Matched] = []

    @property
    def prepared(self) -> float:
        """Share of a calibration's progress that making it ready took."""
        return PREPARED if self._pieces.folder else 0.0

    @property
    def is_given(self) -> bool:
        """Whether the stars are those that the file proposes: a state may refuse them, and finds no others."""
        return self.settings.match == "given"

    @property
    def proposed_stars(self) -> int:
        """How many stars the file proposes that can be used."""
        return self._proposed.problem.arcs.n_stars

    @property
    def telemetry(self) -> Telemetry:
        """The set as it came, of one that is in memory."""
        return self._pieces.pieces[0].read()

    def at_start(self) -> Matched:
        """Match with the sensor's own parameters; given stars are held against one another."""
        if not self.is_given:
            return self._at(self._known.at_start(), self._first_done("matched"))
        proposed = self._proposed
        if not proposed.problem.arcs.n_exposures:
            return proposed
        found = self._verified(verification_before(proposed.problem, self._known.at_start().P, self._parity))
        return proposed if len(found.refused) > MOST_REFUSED * self.proposed_stars else found

    def at(self, estimate: Estimate, problem: Problem) -> Matched:
        """Match with an estimate made from a problem; of matchings between the first and that one the files are removed."""
        for state in self._states[1:]:
            if state.folder is not None and state.problem is not problem:
                shutil.rmtree(state.folder, ignore_errors=True)
        under = self._known.at(estimate, problem)
        return self._verified_after(under, problem) if self.is_given else self._at(under)

    def at_covariance(self, x: FloatArray, P: FloatArray, noise: float = 1.0) -> Matched:
        """Match with x, SI, its free parameters' covariance P (n_free, n_free) in typical sigmas, centroid errors times `noise`.

        Where stars are given the data tell how large the errors are.
        """
        if not self.is_given:
            return self._at(replace(self._known.at_covariance(x, P), noise=noise))
        proposed = self._proposed
        if not proposed.problem.arcs.n_exposures:
            return proposed
        drift = self.settings.process_noise**2 * self._pieces.n_frames if self.settings.sequential else 0.0
        under = self._known.at_covariance(x, P + drift * np.eye(len(P)))
        return self._verified_after(under, (self._states[-1] if self._states else proposed).problem)

    def removed(self, matched: Matched) -> list[RemovedStar]:
        """List the given stars that one of its matchings refused."""
        return list(list_removed(self._pieces, matched.refused))

    def frames(self) -> Frames:
        """Its frames for a filter, each matched with the state that the filter has when it comes to it."""
        return Frames(self._pieces.frame(), self._latest)

    def changed(self, before: Matched, after: Matched) -> int:
        """Count the detections whose star differs between two of its matchings."""
        if self.is_given:
            return before.refused.differ(after.refused)
        return sum(self._pieces.executor.map(changed_in_range, list(zip(before.ranges, after.ranges, strict=True))))

    def judged(self, first: Matched, last: Matched) -> EvaluatedSet:
        """What of two of its matchings is judged in memory."""
        ends = judged_frames(last.problem.arcs)
        if ends == WHOLE and not self._pieces.folder:
            return EvaluatedSet(self, last if self.is_given else first, last)
        telemetry = judged_telemetry(self._pieces.parts(), ends)
        sets = Dataset(telemetry, self.sensor, self.catalogue, self._parameters, self.settings, self._cache_folder)
        if self.is_given:
            same = sets._proposed if last.verification is None else sets._verified(last.verification)
            return EvaluatedSet(sets, same, same)
        rows = [judged_matches((part.rows() for part in state.ranges), ends) for state in (first, last)]
        return EvaluatedSet(sets, *(sets._match_rows(part) for part in rows))

    def _first_done(self, verb: str) -> ProgressCallback:
        return lambda k, n: self._told(READING + (1 - READING) * k / n, f"{verb} {k} of {n} pieces")

    def _at(self, under: MatchingState, done: ProgressCallback | None = None) -> Matched:
        """Match all ranges of frames; files go into a folder of their own."""
        if self._pieces.folder is None:
            return self._match_rows(self._matched_rows(under))
        folder = self._pieces.folder / f"state-{len(self._states)}"
        folder.mkdir()
        work = [
            (self._how, self._pieces.frames(*ends), under, str(folder / f"{k:06d}"))
            for k, ends in enumerate(self._ranges)
        ]
        ranges: list[MatchedRange] = self._pieces.executor.map(match_range, work, done=done)
        parts = [part.ordered for part in ranges if part.ordered is not None]
        timeless = sum(part.timeless for part in parts)
        refuse_timeless(self._pieces.pieces, timeless, self._how.catalogue, self._pieces.executor)
        problem = problem_of_parts(parts, self.sensor, self._pieces.executor)
        self._states.append(Matched(problem, tuple(ranges), folder))
        return self._states[-1]

    def _matched_rows(self, under: MatchingState) -> MatchedRows:
        """Match a set in memory, a range of frames at a time."""
        parts = [self._matcher(under.x, under.P, slice(*ends), under.noise) for ends in self._ranges]
        return matched_rows(self.telemetry, joined_matches(parts), under.x, self.sensor, self.settings)

    def _match_rows(self, rows: MatchedRows) -> Matched:
        problem = build_problem(rows.named(), self.sensor, self.catalogue, self.settings.minimum_stars)
        return Matched(problem, (MatchedRange(rows),))

    def _latest(self, first: int, last: int, state: FilterState) -> ArcSet:
        """Arcs of the frames first <= k < last, matched with the state of a filter."""
        began = time.thread_time()
        under = self._known.at_covariance(state.x, state.P)
        if self._pieces.folder is None:
            frames = slice(first, last)
            telemetry, matches = (
                select_rows(self.telemetry, self._matcher.rows(frames)),
                self._matcher(under.x, under.P, frames),
            )
            rows = matched_rows(telemetry, matches, under.x, self.sensor, self.settings)
        else:
            rows, _, _ = matched_range(self._how, self._pieces.frames(first, last).read()[0], under)
        arcs = build_problem(rows.named(), self.sensor, self.catalogue, self.settings.minimum_stars).arcs.whole()
        self.matching_s += time.thread_time() - began
        return arcs

    @property
    def _ranges(self) -> list[tuple[int, int]]:
        """First frame and end of each range that is matched together."""
        n = self._pieces.n_frames
        return [(first, min(first + MATCHED_FRAMES, n)) for first in range(0, n, MATCHED_FRAMES)]

    @cached_property
    def _matcher(self) -> Rematcher:
        return Rematcher(self.telemetry, self.sensor, self.catalogue, self.settings, self._cache_folder)

    @cached_property
    def _how(self) -> MatchingPlan:
        pieces, folder = self._pieces, self._pieces.folder or Path()
        stars = write_catalogue(self.catalogue, folder)
        limit = magnitude_limit(pieces.pieces, self.sensor, stars, pieces.executor)
        return MatchingPlan(self.sensor, stars, self.settings, self._cache_folder, limit, pieces.epoch)

    def _verified_after(self, under: MatchingState, problem: Problem) -> Matched:
        """Hold the given stars against an estimate; the noise is that of the stars of a problem."""
        noise = measure_noise(problem.whitened(under.x), under.x, self._parity)
        n_free = len(self._parameters.free)
        return self._verified(verification_after(self._proposed.problem, under.x, under.P, noise, n_free, self._parity))

    def _verified(self, how: Verification) -> Matched:
        """Verify the given stars; where the same stand as the last time, so do their arcs."""
        proposed = self._proposed
        refused = how.verify(proposed.problem.whitened(how.x))
        if not len(refused):
            return replace(proposed, verification=how)
        last = self._states[-1] if self._states else proposed
        if last.refused.differ(refused) == 0:
            return replace(last, refused=refused, verification=how)
        self._states.append(replace(self._without(refused), refused=refused, verification=how))
        return self._states[-1]

    def _without(self, refused: Refusals) -> Matched:
        """Take refused stars out of the given ones; files go into a folder of their own."""
        proposed, folder = self._proposed, self._pieces.folder
        if folder is not None:
            folder = folder / f"state-{len(self._states)}"
            folder.mkdir()
        problem = without_stars(proposed.problem, refused, self.settings.minimum_stars, folder)
        if folder is not None:
            return Matched(problem, (), folder)
        given = proposed.matches
        star_id, s_i = given.star_id.copy(), given.s_i.copy()
        star_id[refused.row], s_i[refused.row] = 0, np.nan
        rows = MatchedRows(_unnamed(self.telemetry, refused.row), replace(given, star_id=star_id, s_i=s_i), star_id)
        return Matched(problem, (MatchedRange(rows),))

    @cached_property
    def _parity(self) -> int:
        return find_parity(self._proposed.problem.arcs, self.sensor.initial, self.sensor.parity)

    @cached_property
    def _proposed(self) -> Matched:
        """All usable stars that the file proposes."""
        if self._pieces.folder is None:
            given = read_given_matches(self.telemetry, self.sensor, self.catalogue)
            problem = make_problem_of_directions(self.telemetry, self.sensor, given.s_i, self.settings.minimum_stars)
            return Matched(problem, (MatchedRange(MatchedRows(self.telemetry, given, given.star_id)),))
        stars = write_catalogue(self.catalogue, self._pieces.folder)
        problem = order_set(
            self._pieces.pieces, self.sensor, stars, self.settings.minimum_stars, self._pieces.folder, self._pieces.executor,
            self._first_done("ordered"),
        )  # fmt: skip
        return Matched(problem, ())
