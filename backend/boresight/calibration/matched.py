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
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.flight import flight_tolerance, flight_view
from boresight.calibration.problem import AnyProblem, Problem, build_problem
from boresight.calibration.rematch import Matches, Rematcher, ground_covariance, matched_telemetry
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.sighting import GivenMatches, given_matches
from boresight.calibration.streaming.sample import JUDGED_WHOLE, judged_telemetry
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterState
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry, rows_of
from boresight.telemetry.sensors import Sensor

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
        self._ground = ground_covariance(sensor, settings.initial_sigma_scale)
        self._tolerance = flight_tolerance(sensor, settings)
        self.matcher: Rematcher | None = None
        if settings.match == "rematch":
            self.matcher = Rematcher(telemetry, sensor, catalogue, settings, cache_folder)
        else:
            problem = build_problem(telemetry, sensor, catalogue, settings.minimum_stars)
            self._standing = Matched(problem, telemetry, given_matches(telemetry, catalogue))

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
        if first.problem.arcs.n_stars <= JUDGED_WHOLE or self.matcher is not None:
            return Judged(self, first, last)
        telemetry = judged_telemetry(first.problem.arcs, lambda: [self.telemetry])
        sets = MatchedSet(telemetry, self.sensor, self.catalogue, self._parameters, self.settings, self._cache_folder)
        return Judged(sets, sets.at_start(), sets.at_start())

    def at_start(self) -> Matched:
        """Match with the sensor's own parameters."""
        return self._at(self.sensor.initial, self._ground)

    def at(self, estimate: Estimate, problem: AnyProblem) -> Matched:
        """Match with an estimate made from a problem."""
        n = len(self._parameters.free)
        held = np.asarray(np.linalg.inv(estimate.A + np.eye(n) / self.settings.initial_sigma_scale**2), np.float64)
        dof = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures - n
        excess = max(1.0, estimate.chi2 / max(dof, 1))
        return self._at(estimate.x, self._covariance(held * excess), noise=float(np.sqrt(excess)))

    def at_covariance(self, x: FloatArray, P: FloatArray, noise: float = 1.0) -> Matched:
        """Match with x, SI, its free parameters' covariance P (n_free, n_free) in typical sigmas, centroid errors times `noise`."""
        return self._at(x, self._covariance(P), noise=noise)

    def arcs(self, frames: slice, state: FilterState) -> ArcSet:
        """Arcs of consecutive frames of the set, matched with the state of a filter."""
        return self._at(state.x, self._covariance(state.P), frames).problem.arcs

    def _covariance(self, P: FloatArray) -> FloatArray:
        """Covariance of all parameters, SI, from that of the free ones (n_free, n_free) in typical sigmas."""
        free, scale = self._parameters.free, self._parameters.scale
        whole = self._ground.copy()
        whole[np.ix_(free, free)] = P * np.outer(scale, scale)
        return whole

    def _at(self, x: FloatArray, P: FloatArray, frames: slice = slice(None), noise: float = 1.0) -> Matched:
        """Match frames of the set under x with covariance P, SI, and centroid errors so many times the stated ones."""
        if self.matcher is None:
            return self._standing
        matches = self.matcher(x, P, frames, noise)
        part = rows_of(self.telemetry, self.matcher.rows(frames))
        kept = matches
        if self.settings.match_rule == "flight":
            kept = self._flown(part, matches, x)
        telemetry = matched_telemetry(part, kept)
        problem = build_problem(telemetry, self.sensor, self.catalogue, self.settings.minimum_stars)
        return Matched(problem, telemetry, matches)

    def _flown(self, telemetry: Telemetry, matches: Matches, x: FloatArray) -> Matches:
        """Keep what the flight code would accept at x."""
        view = flight_view(telemetry, self.sensor, matches, x, self._tolerance, self.settings.minimum_stars)
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
