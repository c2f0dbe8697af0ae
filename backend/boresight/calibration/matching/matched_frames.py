"""Matched frames: a telemetry set with its matches under one state, and what the flight check accepts of them.

With `match` "rematch" the stars are found again, as E section II-B does with "a ground-based implementation of the sensor flight
software"; with "given" they are those the file names, and the flight code's check alone tells the states apart.

Two states are compared on the arcs among the matches that one of them accepts (E section III: "common pairs"). An exposure of
which every star of an ordered set is accepted, and no other, keeps the order it has there: the order depends on its stars alone,
and finding it is most of the work. The others are ordered again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.matching.flight_check import (
    FLIGHT_REASONS,
    FlightCheck,
    check_flight,
    compute_flight_tolerance,
)
from boresight.calibration.matching.rematch import Matches, Rematcher, ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import make_problem
from boresight.estimation.arcs import ArcSet
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.sky.matching import EXPOSURE_REASONS
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Why a frame may not be available, phrases; the first says that it is.
REASONS_OF_FRAMES = np.array([*FLIGHT_REASONS, *EXPOSURE_REASONS], dtype=object)


@dataclass(frozen=True)
class GivenMatches:
    """The matches that a file gives; arrays as in `rematch.Matches`."""

    star_id: IntArray
    s_i: FloatArray
    exposure_start: IntArray
    frame: IntArray
    reason: NDArray[np.int8]


@dataclass(frozen=True)
class MatchedFrames:
    """A set under one state.

    `x`: (n_parameters,) the state, SI. `matches`: which star each detection is. `view`: what the flight code accepts of them.
    `tolerance_rad`: with which tolerance of an arc.
    """

    x: FloatArray
    matches: Matches | GivenMatches
    view: FlightCheck
    tolerance_rad: float

    def taken(self) -> NDArray[np.bool_]:
        """(n_rows,) accepted matches of valid exposures: what N(x) counts."""
        return self.view.accepted & np.repeat(self.view.valid, np.diff(self.matches.exposure_start))

    def exposure_reason(self, k: int) -> str:
        """Why exposure k is not valid, a phrase: of matching where it found too few stars, else of the flight code's check."""
        flight, found = int(self.view.reason[k]), int(self.matches.reason[k])
        return EXPOSURE_REASONS[found] if flight == 1 and found > 0 else FLIGHT_REASONS[flight]

    @cached_property
    def reasons(self) -> IntArray:
        """Why each frame is not available, (n_frames,) places in `REASONS_OF_FRAMES`: of the exposure that came farthest."""
        _, first, of = np.unique(self.matches.frame, return_index=True, return_inverse=True)
        farthest = np.flatnonzero(self.view.reason == np.maximum.reduceat(self.view.reason, first)[of])
        _, place = np.unique(of[farthest], return_index=True)
        exposure = farthest[place]
        flight, found = self.view.reason[exposure].astype(np.int64), self.matches.reason[exposure]
        code = np.where((flight == 1) & (found > 0), len(FLIGHT_REASONS) + found, flight)
        return np.where(self.view.valid_frames, 0, code)

    def count_reasons(self) -> dict[str, int]:
        """How many frames are not available for each reason, the first met first."""
        codes, first, counts = np.unique(self.reasons, return_index=True, return_counts=True)
        met = [place for place in np.argsort(first) if codes[place] != 0]
        return {REASONS_OF_FRAMES[codes[place]]: int(counts[place]) for place in met}


def match_under_states(
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    states: Sequence[tuple[FloatArray, FloatArray | None]],
    settings: CalibrationSettings,
    cache_folder: Path | None = None,
) -> list[MatchedFrames]:
    """See a set under each of some states.

    `states`: (n_parameters,) x and (n_parameters, n_parameters) P each, SI: a state and what is known of its error; with P None
    as little as of a ground calibration. `settings`: `match`, `minimum_stars`, `flight_tolerance_urad`, and what matching looks
    at. The matches of a file that gives directions but names no stars stand in any case. `cache_folder`: where lost-in-space
    identification keeps its tables. Raises RefusedInputError when rows that name stars can be given no direction at all, see
    `sky.directions`.
    """
    if settings.match == "given" or (telemetry.star_id is None and telemetry.ra_rad is not None):
        given = read_given_matches(telemetry, sensor, catalogue)
        return [apply_flight_check(telemetry, sensor, given, x, settings) for x, _ in states]
    matcher = Rematcher(telemetry, sensor, catalogue, settings, cache_folder)
    ground = ground_covariance(sensor, settings.initial_sigma_scale)
    return [
        apply_flight_check(telemetry, sensor, matcher(x, ground if P is None else P), x, settings) for x, P in states
    ]


def apply_flight_check(
    telemetry: Telemetry, sensor: Sensor, matches: Matches | GivenMatches, x: FloatArray, settings: CalibrationSettings
) -> MatchedFrames:
    """Apply the flight code's check to matches that are there already, under state x (n_parameters,)."""
    tolerance = compute_flight_tolerance(sensor, settings)
    view = check_flight(telemetry, sensor, matches, x, tolerance, settings.minimum_stars)
    return MatchedFrames(x, matches, view, tolerance)


def read_given_matches(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue) -> GivenMatches:
    """Take the matches of a file as they are, but for stars off the detector.

    A row with a direction but no star number counts as matched, with number 0.
    """
    exposures = find_exposures(telemetry)
    s_i = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue,
        telemetry.site,
    )  # fmt: skip
    s_i = np.where(on_detector(telemetry, sensor)[:, None], s_i, np.nan)
    named = np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id
    return GivenMatches(
        star_id=np.where(np.isfinite(s_i[:, 0]), named, 0),
        s_i=s_i,
        exposure_start=np.append(exposures.start, len(telemetry)).astype(np.int64),
        frame=exposures.frame,
        reason=np.zeros(len(exposures), np.int8),
    )


#: Directions of one star in one exposure that differ by less are the same, rad.
_SAME_RAD = 1e-12


def common_arcs(
    telemetry: Telemetry, sensor: Sensor, seen: MatchedFrames, minimum_stars: int, ordered: ArcSet | None = None
) -> list[ArcSet]:
    """Arcs among the accepted matches of the valid exposures."""
    s_i = np.where(seen.taken()[:, None], seen.matches.s_i, np.nan)
    found = list[ArcSet]()
    if ordered is not None:
        same = _unchanged(ordered, seen, s_i)
        found.append(ordered.exposures(same))
        s_i[found[0].source_row] = np.nan
    found.append(make_problem(replace(telemetry, star_id=None), sensor, s_i, minimum_stars).arcs.whole())
    return [arcs for arcs in found if arcs.n_exposures]


def _unchanged(ordered: ArcSet, seen: MatchedFrames, s_i: FloatArray) -> BoolArray:
    """Which exposures of an ordered set hold just the stars (n_rows, 3) that are taken, (n_exposures,)."""
    if not ordered.n_exposures:
        return np.zeros(0, np.bool_)
    starts = ordered.star_start[:-1]
    taken = np.isfinite(s_i[:, 0])
    counts = np.add.reduceat(taken, seen.matches.exposure_start[:-1], dtype=np.int64)
    exposure = np.searchsorted(seen.matches.exposure_start, ordered.source_row[starts], side="right") - 1
    away = np.abs(s_i[ordered.source_row] - ordered.s_i)
    same = (away[:, 0] < _SAME_RAD) & (away[:, 1] < _SAME_RAD) & (away[:, 2] < _SAME_RAD)  # NaN is not
    whole = np.logical_and.reduceat(same, starts)
    return np.asarray(whole & (counts[exposure] == np.diff(ordered.star_start)))
