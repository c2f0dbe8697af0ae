"""A telemetry set under given or renewed matches: the problem it makes at any state, and what was matched on the way.

Matched again, the set is T(x) of E section II-B: what "a ground-based implementation of the sensor flight software"
makes of it under x. With `match_rule` "flight" it is what the flight code itself would keep: arcs that disagree with
the catalogue by more than one fixed tolerance cost their star, and an exposure without enough of them is lost
(`calibration.flight`).

What is known of x for the tolerance: at the start the ground calibration's sigmas; at an estimate whose data hold the
information A (in typical sigmas) its own covariance beside the start's, (A + I / initial_sigma_scale^2)^-1, widened by
chi-square where the residuals say that it claims too much; parameters held fixed keep the ground's sigmas at all times.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.flight import flight_tolerance, flight_view
from boresight.calibration.problem import AnyProblem, Problem, build_problem, problem_from
from boresight.calibration.rematch import Matches, Rematcher, ground_covariance, joined_matches, matched_telemetry
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.sighting import GivenMatches, given_matches
from boresight.calibration.streaming.sample import (
    WHOLE,
    Ends,
    MatchedRows,
    judged_frames,
    judged_matches,
    judged_telemetry,
)
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterState
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry, rows_of
from boresight.telemetry.sensors import Sensor

#: Frames that are matched together, counted from a set's first: an exposure without a start looks for a neighbour among these.
MATCHED_FRAMES = 4096


@dataclass(frozen=True)
class Matched:
    """A set under one state.

    Parameters
    ----------
    problem
        Its arcs.
    telemetry
        The set with the stars it was matched with.
    matches
        Which star is which; before the flight code's check where `match_rule` asks for it.
    """

    problem: Problem
    telemetry: Telemetry
    matches: Matches | GivenMatches

    @property
    def unidentified(self) -> int:
        """Exposures that want the lost-in-space extra, which is not installed."""
        return self.matches.unidentified if isinstance(self.matches, Matches) else 0


@dataclass(frozen=True)
class Under:
    """What a set is matched under: x, SI, its covariance P, SI, and centroid errors so many times the stated ones."""

    x: FloatArray
    P: FloatArray
    noise: float = 1.0


@dataclass(frozen=True)
class Known:
    """What is known of a sensor's parameters, see the module."""

    sensor: Sensor
    parameters: Parameters
    settings: CalibrationSettings

    def at_start(self) -> Under:
        """Before any estimate."""
        return Under(self.sensor.initial, self._ground)

    def at(self, estimate: Estimate, problem: AnyProblem) -> Under:
        """After an estimate made from a problem."""
        n = len(self.parameters.free)
        held = np.asarray(np.linalg.inv(estimate.A + np.eye(n) / self.settings.initial_sigma_scale**2), np.float64)
        dof = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures - n
        excess = max(1.0, estimate.chi2 / max(dof, 1))
        return replace(self.at_covariance(estimate.x, held * excess), noise=float(np.sqrt(excess)))

    def at_covariance(self, x: FloatArray, P: FloatArray) -> Under:
        """At x, SI, with its free parameters' covariance P (n_free, n_free) in typical sigmas."""
        return Under(x, self.parameters.full_covariance(P, self._ground, n=len(x)))

    @property
    def _ground(self) -> FloatArray:
        """Covariance of a ground calibration."""
        return ground_covariance(self.sensor, self.settings.initial_sigma_scale)


@dataclass(frozen=True)
class Judged:
    """What of a set is judged in memory, all of it or a sample: as it is matched first, and last."""

    sets: MatchedSet
    first: Matched
    last: Matched


class MatchedSet:
    """A set that can be matched under any state, or whose given matches stand.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The set, whose it is, and the stars there are.
    parameters, settings
        Which parameters are free, and how to match.
    cache_folder
        Where lost-in-space identification keeps its tables.
    """

    def __init__(
        self,
        telemetry: Telemetry,
        sensor: Sensor,
        catalogue: Catalogue,
        parameters: Parameters,
        settings: CalibrationSettings,
        cache_folder: Path | None,
    ) -> None:
        self.telemetry, self.sensor, self.catalogue = telemetry, sensor, catalogue
        self._parameters, self.settings = parameters, settings
        self._cache_folder = cache_folder
        self._known = Known(sensor, parameters, settings)
        self.matcher: Rematcher | None = None
        if settings.match == "rematch":
            self.matcher = Rematcher(telemetry, sensor, catalogue, settings, cache_folder)
        else:
            given = given_matches(telemetry, sensor, catalogue)
            problem = problem_from(telemetry, sensor, given.s_i, settings.minimum_stars)
            self._standing = Matched(problem, telemetry, given)

    @property
    def prepared(self) -> float:
        """Share of a calibration's progress that making it ready took."""
        return 0.0

    @property
    def renewed(self) -> MatchedSet | None:
        """The set where its matches follow the state."""
        return None if self.matcher is None else self

    def matched_frames(self) -> RematchedFrames:
        """Its frames for a filter, each matched with the state that the filter has when it comes to it."""
        return RematchedFrames(self)

    def changed(self, before: Matched, after: Matched) -> int:
        """Count the detections whose star differs between two of its matchings."""
        return int(np.sum(before.telemetry.star_id != after.telemetry.star_id))

    def judged(self, first: Matched, last: Matched) -> Judged:
        """What of it is judged."""
        ends = judged_frames(last.problem.arcs)
        if ends == WHOLE:
            return Judged(self, first, last)
        telemetry = judged_telemetry([self.telemetry], ends)
        sets = MatchedSet(telemetry, self.sensor, self.catalogue, self._parameters, self.settings, self._cache_folder)
        if self.matcher is None:
            return Judged(sets, sets.at_start(), sets.at_start())
        return Judged(sets, *(sets.judged_from([self._rows(state)], ends) for state in (first, last)))

    def judged_from(self, parts: Iterable[MatchedRows], ends: Ends) -> Matched:
        """Put together the judged stretches of a set, whose telemetry this is, from the matches of its parts."""
        telemetry, matches, kept = judged_matches(parts, ends)
        taken = replace(matches, star_id=kept, s_i=np.where(kept[:, None] > 0, matches.s_i, np.nan))
        named = matched_telemetry(telemetry, taken)
        problem = build_problem(named, self.sensor, self.catalogue, self.settings.minimum_stars)
        return Matched(problem, named, matches)

    def _rows(self, matched: Matched) -> MatchedRows:
        """The set with its matches under a state."""
        kept = cast("IntArray", matched.telemetry.star_id)
        return self.telemetry, cast("Matches", matched.matches), kept

    def at_start(self) -> Matched:
        """Match with the sensor's own parameters."""
        return self._at(self._known.at_start())

    def at(self, estimate: Estimate, problem: AnyProblem) -> Matched:
        """Match with an estimate made from a problem."""
        return self._at(self._known.at(estimate, problem))

    def at_covariance(self, x: FloatArray, P: FloatArray, noise: float = 1.0) -> Matched:
        """Match with x, SI, its free parameters' covariance P (n_free, n_free) in typical sigmas, centroid errors times `noise`."""
        return self._at(replace(self._known.at_covariance(x, P), noise=noise))

    def arcs(self, frames: slice, state: FilterState) -> ArcSet:
        """Arcs of consecutive frames of the set, matched with the state of a filter."""
        if self.matcher is None:
            return self._standing.problem.arcs.frames(frames.start, frames.stop)
        telemetry = rows_of(self.telemetry, self.matcher.rows(frames))
        under = self._known.at_covariance(state.x, state.P)
        return matched_under(
            telemetry, self.matcher, frames, under, self.sensor, self.catalogue, self.settings
        ).problem.arcs

    def _at(self, under: Under) -> Matched:
        """Match the set, a range of frames at a time."""
        if self.matcher is None:
            return self._standing
        n = self.matcher.n_frames
        ranges = [slice(first, min(first + MATCHED_FRAMES, n)) for first in range(0, n, MATCHED_FRAMES)]
        matches = joined_matches([self.matcher(under.x, under.P, frames, under.noise) for frames in ranges])
        return matched_with(self.telemetry, matches, under.x, self.sensor, self.catalogue, self.settings)


def matched_under(
    telemetry: Telemetry,
    matcher: Rematcher,
    frames: slice,
    under: Under,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
) -> Matched:
    """Match consecutive frames, which are this telemetry."""
    matches = matcher(under.x, under.P, frames, under.noise)
    return matched_with(telemetry, matches, under.x, sensor, catalogue, settings)


def matched_with(
    telemetry: Telemetry,
    matches: Matches,
    x: FloatArray,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
) -> Matched:
    """Make a problem of the matches that the flight code would accept at x, or of all where `match_rule` does not ask it."""
    kept = _flown(telemetry, matches, x, sensor, settings) if settings.match_rule == "flight" else matches
    named = matched_telemetry(telemetry, kept)
    return Matched(build_problem(named, sensor, catalogue, settings.minimum_stars), named, matches)


def _flown(
    telemetry: Telemetry, matches: Matches, x: FloatArray, sensor: Sensor, settings: CalibrationSettings
) -> Matches:
    """Keep what the flight code would accept at x."""
    tolerance = flight_tolerance(sensor, settings)
    view = flight_view(telemetry, sensor, matches, x, tolerance, settings.minimum_stars)
    taken = view.accepted & np.repeat(view.valid, np.diff(matches.exposure_start))
    return replace(
        matches,
        star_id=np.where(taken, matches.star_id, 0),
        s_i=np.where(taken[:, None], matches.s_i, np.nan),
    )


class RematchedFrames:
    """The frames of a set, matched again with the state of the filter that takes them.

    `matching_s` counts the processor time of this thread that matching took, for a filter's cost is told without it.
    """

    def __init__(self, matched_set: MatchedSet) -> None:
        self.matching_s = 0.0
        self._set = matched_set
        self._frame = np.unique(matched_set.telemetry.frame)

    @property
    def n_frames(self) -> int:
        """How many there are."""
        return len(self._frame)

    def place_of(self, frame: int) -> int:
        """Place of a frame number among them."""
        return int(np.searchsorted(self._frame, frame))

    def arcs(self, first: int, last: int, state: FilterState) -> ArcSet:
        """Match the frames first <= k < last at this state."""
        began = time.thread_time()
        arcs = self._set.arcs(slice(first, last), state)
        self.matching_s += time.thread_time() - began
        return arcs
