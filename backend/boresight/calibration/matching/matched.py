"""A telemetry set under given or renewed matches: the problem it makes at any state, and what was matched on the way.

Matched again, the set is T(x) of E section II-B: what "a ground-based implementation of the sensor flight software"
makes of it under x. With `match_rule` "flight" it is what the flight code itself would keep: arcs that disagree with
the catalogue by more than one fixed tolerance cost their star, and an exposure without enough of them is lost
(`calibration.matching.flight_check`).

What is known of x for the tolerance: at the start the ground calibration's sigmas; at an estimate whose data hold the
information A (in typical sigmas) its own covariance beside the start's, (A + I / initial_sigma_scale^2)^-1, widened by
chi-square where the residuals say that it claims too much; parameters held fixed keep the ground's sigmas at all times.
"""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.matching.matched_frames import GivenMatches, read_given_matches
from boresight.calibration.matching.rematch import Matches, Rematcher, ground_covariance, joined_matches
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, build_problem, make_problem_of_directions
from boresight.calibration.sequence import Frames
from boresight.calibration.streaming import matching
from boresight.calibration.streaming.matching import (
    MatchedRange,
    MatchingState,
    changed_in_range,
    match_range,
    matched_rows,
)
from boresight.calibration.streaming.sample import WHOLE, MatchedRows, judged_frames, judged_matches, judged_telemetry
from boresight.calibration.streaming.stored_arcs import order_set, problem_of_parts, refuse_timeless, write_catalogue
from boresight.calibration.streaming.telemetry_pieces import PREPARED, READING, Pieces, Prepared, in_memory
from boresight.estimation.arcs import ArcSet
from boresight.estimation.executor import Told
from boresight.estimation.filters.history import FilterState
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.sensors import Sensor

#: Frames that are matched together, counted from a set's first: an exposure without a start looks for a neighbour among these.
MATCHED_FRAMES = 4096


@dataclass(frozen=True)
class Matched:
    """A set under one state."""

    problem: Problem
    ranges: tuple[MatchedRange, ...]
    folder: Path | None = None

    @property
    def unidentified(self) -> int:
        """Exposures that want the lost-in-space extra, which is not installed."""
        return sum(part.unidentified for part in self.ranges)

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
        """Before any estimate."""
        return MatchingState(self.sensor.initial, self._ground)

    def at(self, estimate: Estimate, problem: Problem) -> MatchingState:
        """After an estimate made from a problem."""
        n = len(self.parameters.free)
        held = np.asarray(np.linalg.inv(estimate.A + np.eye(n) / self.settings.initial_sigma_scale**2), np.float64)
        dof = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures - n
        excess = max(1.0, estimate.chi2 / max(dof, 1))
        return replace(self.at_covariance(estimate.x, held * excess), noise=float(np.sqrt(excess)))

    def at_covariance(self, x: FloatArray, P: FloatArray) -> MatchingState:
        """At x, SI, with its free parameters' covariance P (n_free, n_free) in typical sigmas."""
        return MatchingState(x, self.parameters.full_covariance(P, self._ground, n=len(x)))

    @property
    def _ground(self) -> FloatArray:
        """Covariance of a ground calibration."""
        return ground_covariance(self.sensor, self.settings.initial_sigma_scale)


@dataclass(frozen=True)
class EvaluatedSet:
    """What of a set is judged in memory, all of it or a sample: as it is matched first, and last."""

    sets: Dataset
    first: Matched
    last: Matched


class Dataset:
    """A set over pieces that can be matched under any state, or whose given matches stand."""

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
    def stands(self) -> bool:
        """Whether the given matches stand under every state."""
        return self.settings.match == "given"

    @property
    def telemetry(self) -> Telemetry:
        """The set as it came, of one that is in memory."""
        return self._pieces.pieces[0].read()

    def at_start(self) -> Matched:
        """Match with the sensor's own parameters."""
        return self._at(self._known.at_start(), self._first_done("matched"))

    def at(self, estimate: Estimate, problem: Problem) -> Matched:
        """Match with an estimate made from a problem; of matchings between the first and that one the files are removed."""
        for state in self._states[1:]:
            if state.folder is not None and state.problem is not problem:
                shutil.rmtree(state.folder, ignore_errors=True)
        return self._at(self._known.at(estimate, problem))

    def at_covariance(self, x: FloatArray, P: FloatArray, noise: float = 1.0) -> Matched:
        """Match with x, SI, its free parameters' covariance P (n_free, n_free) in typical sigmas, centroid errors times `noise`."""
        return self._at(replace(self._known.at_covariance(x, P), noise=noise))

    def frames(self) -> Frames:
        """Its frames for a filter, each matched with the state that the filter has when it comes to it."""
        return Frames(self._pieces.frame(), self._latest)

    def changed(self, before: Matched, after: Matched) -> int:
        """Count the detections whose star differs between two of its matchings."""
        return sum(self._pieces.spread.map(changed_in_range, list(zip(before.ranges, after.ranges, strict=True))))

    def judged(self, first: Matched, last: Matched) -> EvaluatedSet:
        """What of two of its matchings is judged in memory."""
        ends = judged_frames(last.problem.arcs)
        if ends == WHOLE and not self._pieces.folder:
            return EvaluatedSet(self, first, last)
        telemetry = judged_telemetry(self._pieces.parts(), ends)
        sets = Dataset(telemetry, self.sensor, self.catalogue, self._parameters, self.settings, self._cache_folder)
        if self.stands:
            return EvaluatedSet(sets, sets.at_start(), sets.at_start())
        rows = [judged_matches((part.rows() for part in state.ranges), ends) for state in (first, last)]
        return EvaluatedSet(sets, *(sets._of_rows(part) for part in rows))

    def _first_done(self, verb: str) -> Told:
        return lambda k, n: self._told(READING + (1 - READING) * k / n, f"{verb} {k} of {n} pieces")

    def _at(self, under: MatchingState, done: Told | None = None) -> Matched:
        """Match all ranges of frames; files go into a folder of their own."""
        if self.stands:
            return self._standing
        if self._pieces.folder is None:
            return self._of_rows(self._matched_rows(under))
        folder = self._pieces.folder / f"state-{len(self._states)}"
        folder.mkdir()
        work = [
            (self._how, self._pieces.frames(*ends), under, str(folder / f"{k:06d}"))
            for k, ends in enumerate(self._ranges)
        ]
        ranges: list[MatchedRange] = self._pieces.spread.map(match_range, work, done=done)
        parts = [part.ordered for part in ranges if part.ordered is not None]
        timeless = sum(part.timeless for part in parts)
        refuse_timeless(self._pieces.pieces, timeless, self._how.catalogue, self._pieces.spread)
        problem = problem_of_parts(parts, self.sensor, self._pieces.spread)
        self._states.append(Matched(problem, tuple(ranges), folder))
        return self._states[-1]

    def _matched_rows(self, under: MatchingState) -> MatchedRows:
        """Match a set in memory, a range of frames at a time."""
        parts = [self._matcher(under.x, under.P, slice(*ends), under.noise) for ends in self._ranges]
        return matched_rows(self.telemetry, joined_matches(parts), under.x, self.sensor, self.settings)

    def _of_rows(self, rows: MatchedRows) -> Matched:
        """Make a problem of rows in memory and their matches."""
        unidentified = rows.matches.unidentified if isinstance(rows.matches, Matches) else 0
        problem = build_problem(rows.named(), self.sensor, self.catalogue, self.settings.minimum_stars)
        return Matched(problem, (MatchedRange(rows, unidentified),))

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
            rows, _, _ = matching.matched_range(self._how, self._pieces.frames(first, last).read()[0], under)
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
        """Of a set in memory."""
        return Rematcher(self.telemetry, self.sensor, self.catalogue, self.settings, self._cache_folder)

    @cached_property
    def _how(self) -> matching.Matching:
        """Of a set in files."""
        pieces, folder = self._pieces, self._pieces.folder or Path()
        stars = write_catalogue(self.catalogue, folder)
        limit = matching.magnitude_limit(pieces.pieces, self.sensor, stars, pieces.spread)
        return matching.Matching(self.sensor, stars, self.settings, self._cache_folder, limit, pieces.epoch)

    @cached_property
    def _standing(self) -> Matched:
        """Under the given matches."""
        if self._pieces.folder is None:
            given = read_given_matches(self.telemetry, self.sensor, self.catalogue)
            problem = make_problem_of_directions(self.telemetry, self.sensor, given.s_i, self.settings.minimum_stars)
            return Matched(problem, (MatchedRange(MatchedRows(self.telemetry, given, given.star_id)),))
        stars = write_catalogue(self.catalogue, self._pieces.folder)
        problem = order_set(
            self._pieces.pieces, self.sensor, stars, self.settings.minimum_stars, self._pieces.folder, self._pieces.spread,
            self._first_done("ordered"),
        )  # fmt: skip
        return Matched(problem, ())
