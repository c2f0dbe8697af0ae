"""Matching a set in files under any state, a range of frames at a time.

The ranges are those of a set in memory (`matched.MATCHED_FRAMES`), wherever a piece ends, so the same neighbours are looked at.
What depends on the whole set travels with each range: the stars that may be matched, which follow from the faintest that it names
or from how many it detects, and its first time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.calibration.matching.detections import compute_magnitude_limit
from boresight.calibration.matching.flight_check import check_flight, compute_flight_tolerance
from boresight.calibration.matching.rematch import Matches, MatchingSky, Rematcher, blend_rad, matching_sky
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.streaming.sample import MatchedRows
from boresight.calibration.streaming.stored_arcs import OrderedPiece, read_catalogue, write_ordered
from boresight.calibration.streaming.telemetry_pieces import FrameRange, TelemetryPiece
from boresight.columns import Columns, write_columns
from boresight.estimation.executor import Executor
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import TimelessError
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

_MATCHES = tuple(item.name for item in fields(Matches))


@dataclass(frozen=True)
class MatchingState:
    """What a set is matched under: x, SI, its covariance P, SI, and centroid errors so many times the stated ones."""

    x: FloatArray
    P: FloatArray
    noise: float = 1.0


@dataclass(frozen=True)
class Matching:
    """How a set in files is matched, the same for all its ranges."""

    sensor: Sensor
    catalogue: Columns
    settings: CalibrationSettings
    cache_folder: Path | None
    magnitude_limit: float
    epoch: np.datetime64 | None


@dataclass(frozen=True)
class MatchedRange:
    """A range as matched under some state: its rows with their matches, and where it is in files its arcs.

    `unidentified` of its exposures want the lost-in-space extra, which is not installed.
    """

    held: MatchedRows | tuple[FrameRange, Columns]
    unidentified: int = 0
    ordered: OrderedPiece | None = None

    def rows(self) -> MatchedRows:
        """The telemetry, the matches and the kept stars; maps them where they are in files."""
        if isinstance(self.held, MatchedRows):
            return self.held
        of, matches = self.held
        arrays: dict[str, Any] = matches.read()
        return MatchedRows(of.read()[0], Matches(**{name: arrays[name] for name in _MATCHES}), arrays["kept"])


def match_range(how: Matching, of: FrameRange, under: MatchingState, path: str) -> MatchedRange:
    """Match one range and write what comes out."""
    telemetry, begins = of.read()
    rows, matches, timeless = matched_range(how, telemetry, under)
    arrays = {name: getattr(matches, name) for name in _MATCHES} | {"kept": rows.kept}
    problem = build_problem(rows.named(), how.sensor, read_catalogue(how.catalogue), how.settings.minimum_stars)
    ordered = write_ordered(problem, begins, Path(f"{path}-arcs"), timeless)
    return MatchedRange((of, write_columns(Path(f"{path}-matches"), arrays)), matches.unidentified, ordered)


def matched_range(how: Matching, telemetry: Telemetry, under: MatchingState) -> tuple[MatchedRows, Matches, int]:
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


def _rematcher(how: Matching, telemetry: Telemetry, stars: Catalogue, sky: MatchingSky) -> Rematcher:
    """Make rows of a set ready to be matched."""
    return Rematcher(telemetry, how.sensor, stars, how.settings, how.cache_folder, sky, how.epoch)


@lru_cache(maxsize=1)
def _sky(catalogue: Columns, magnitude_limit: float, blend: float) -> MatchingSky:
    """The stars that may be matched; those asked for last are kept."""
    return matching_sky(read_catalogue(catalogue), magnitude_limit, blend)


def magnitude_limit(pieces: Sequence[TelemetryPiece], sensor: Sensor, catalogue: Columns, spread: Executor) -> float:
    """Faintest star that may be matched, Hp, as `detections.magnitude_limit` finds it of a set in memory."""
    parts: list[tuple[int, NDArray[np.int64]]] = spread.map(seen_in_piece, [(piece, catalogue) for piece in pieces])
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
