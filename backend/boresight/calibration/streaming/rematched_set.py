"""A set in files that is matched under any state, in the place of a `MatchedSet`."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.matched import MATCHED_FRAMES, Judged, Known, MatchedSet, Under
from boresight.calibration.problem import AnyProblem
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.spread import Told
from boresight.calibration.streaming.matching import (
    MatchedRange,
    Matching,
    changed_in_range,
    magnitude_limit,
    match_range,
    matched_range,
    rows_of_range,
)
from boresight.calibration.streaming.ordering import problem_of_parts, refuse_timeless, write_catalogue
from boresight.calibration.streaming.sample import judged_frames, judged_telemetry
from boresight.calibration.streaming.stored_problem import StoredProblem
from boresight.calibration.streaming.streamed_set import PREPARED, READING, Prepared, WorkingCopy
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterState
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import Sensor


@dataclass(frozen=True)
class RematchedSetState:
    """A set in files as matched under one state: its problem, and where the matches of its ranges are."""

    problem: StoredProblem
    ranges: tuple[MatchedRange, ...]
    folder: Path

    @property
    def unidentified(self) -> int:
        """Exposures that want the lost-in-space extra, which is not installed."""
        return sum(part.unidentified for part in self.ranges)


class RematchedSet:
    """A set in files whose matches follow the estimate.

    Parameters
    ----------
    copy
        The set.
    sensor, catalogue, parameters, settings, cache_folder
        As of a `MatchedSet`.
    told
        How far the first matching is.
    """

    def __init__(
        self,
        copy: WorkingCopy,
        sensor: Sensor,
        catalogue: Catalogue,
        parameters: Parameters,
        settings: CalibrationSettings,
        cache_folder: Path | None,
        told: Prepared,
    ) -> None:
        self.settings = settings
        self._copy, self._sensor, self._catalogue = copy, sensor, catalogue
        self._parameters, self._cache_folder, self._told = parameters, cache_folder, told
        self._known = Known(sensor, parameters, settings)
        stars = write_catalogue(catalogue, copy.folder)
        limit = magnitude_limit(copy.pieces, sensor, stars, copy.spread)
        self._how = Matching(sensor, stars, settings, cache_folder, limit, copy.epoch)
        self._ranges = [
            copy.frames(first, min(first + MATCHED_FRAMES, copy.n_frames))
            for first in range(0, copy.n_frames, MATCHED_FRAMES)
        ]
        self._states: list[RematchedSetState] = []

    @property
    def prepared(self) -> float:
        """Share of a calibration's progress that making it ready took."""
        return PREPARED

    @property
    def renewed(self) -> RematchedSet:
        """The set, whose matches follow the state."""
        return self

    def at_start(self) -> RematchedSetState:
        """Match with the sensor's own parameters."""
        return self._at(
            self._known.at_start(),
            lambda k, n: self._told(READING + (1 - READING) * k / n, f"matched {k} of {n} pieces"),
        )

    def at(self, estimate: Estimate, problem: AnyProblem) -> RematchedSetState:
        """Match with an estimate made from a problem; of matchings between the first and that one the files are removed."""
        for state in self._states[1:]:
            if state.problem is not problem:
                shutil.rmtree(state.folder, ignore_errors=True)
        return self._at(self._known.at(estimate, problem))

    def at_covariance(self, x: np.ndarray, P: np.ndarray) -> RematchedSetState:
        """Match with a state and its covariance in typical sigmas."""
        return self._at(self._known.at_covariance(x, P))

    def arcs(self, first: int, last: int, state: FilterState) -> ArcSet:
        """Arcs of the frames first <= k < last, matched with the state of a filter."""
        telemetry, _ = self._copy.frames(first, last).read()
        return matched_range(self._how, telemetry, self._known.at_covariance(state.x, state.P))[0].problem.arcs

    def matched_frames(self) -> RematchedStoredFrames:
        """Its frames for a filter, each matched with the state that the filter has when it comes to it."""
        return RematchedStoredFrames(self, self._copy)

    def changed(self, before: RematchedSetState, after: RematchedSetState) -> int:
        """Count the detections whose star differs between two of its matchings."""
        pairs = list(zip(before.ranges, after.ranges, strict=True))
        return sum(self._copy.spread.map(changed_in_range, pairs))

    def judged(self, first: RematchedSetState, last: RematchedSetState) -> Judged:
        """What of it is judged in memory."""
        ends = judged_frames(last.problem.arcs)
        telemetry = judged_telemetry(self._copy.parts(), ends)
        sets = MatchedSet(telemetry, self._sensor, self._catalogue, self._parameters, self.settings, self._cache_folder)
        matched = [sets.judged_from((rows_of_range(part) for part in state.ranges), ends) for state in (first, last)]
        return Judged(sets, *matched)

    def _at(self, under: Under, done: Told | None = None) -> RematchedSetState:
        """Match all ranges, wherever the spread does it, into a folder of their own."""
        folder = self._copy.folder / f"state-{len(self._states)}"
        folder.mkdir()
        work = [(self._how, part, under, str(folder / f"{k:06d}")) for k, part in enumerate(self._ranges)]
        ranges: Sequence[MatchedRange] = self._copy.spread.map(match_range, work, done=done)
        parts = [part.ordered for part in ranges]
        refuse_timeless(self._copy.pieces, sum(part.timeless for part in parts), self._how.catalogue, self._copy.spread)
        problem = problem_of_parts(parts, self._sensor, self._copy.spread)
        self._states.append(RematchedSetState(problem, tuple(ranges), folder))
        return self._states[-1]


class RematchedStoredFrames:
    """The frames of a set in files, matched again with the state of the filter that takes them; as `matched.RematchedFrames`."""

    def __init__(self, of: RematchedSet, copy: WorkingCopy) -> None:
        self.matching_s = 0.0
        self._set, self._copy = of, copy

    @property
    def n_frames(self) -> int:
        """How many there are."""
        return self._copy.n_frames

    def place_of(self, frame: int) -> int:
        """Place of a frame number among them."""
        return sum(int(np.searchsorted(np.unique(part.frame), frame)) for part in self._copy.parts())

    def arcs(self, first: int, last: int, state: FilterState) -> ArcSet:
        """Match the frames first <= k < last at this state."""
        began = time.thread_time()
        arcs = self._set.arcs(first, last, state)
        self.matching_s += time.thread_time() - began
        return arcs
