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

from boresight.calibration.detections import limit_of
from boresight.calibration.matched import Matched, Under, matched_under
from boresight.calibration.rematch import Matches, MatchingSky, Rematcher, blend_rad, matching_sky
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.spread import Spread
from boresight.calibration.streaming.columns import Columns, write_columns
from boresight.calibration.streaming.ordering import OrderedPiece, read_catalogue, write_ordered
from boresight.calibration.streaming.sample import MatchedRows
from boresight.calibration.streaming.telemetry_pieces import TelemetryPiece
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import TimelessError
from boresight.telemetry.exposures import exposures_of
from boresight.telemetry.schema import Telemetry, joined, rows_of
from boresight.telemetry.sensors import Sensor

_MATCHES = tuple(item.name for item in fields(Matches))


@dataclass(frozen=True)
class Matching:
    """How a set is matched, the same for all its ranges.

    Parameters
    ----------
    sensor, catalogue, settings, cache_folder
        As of a `Rematcher`.
    magnitude_limit
        Of the whole set, Hp.
    epoch
        First known time of the set; None where it has none.
    """

    sensor: Sensor
    catalogue: Columns
    settings: CalibrationSettings
    cache_folder: Path | None
    magnitude_limit: float
    epoch: np.datetime64 | None


@dataclass(frozen=True)
class FrameRange:
    """The frames first <= k < last of consecutive pieces, whose first row is at `begins` of the set."""

    pieces: tuple[TelemetryPiece, ...]
    first: int
    last: int

    def read(self) -> tuple[Telemetry, int]:
        """Map its rows; returns them and the place of the first in the set."""
        parts, done, begins = [], 0, -1
        for piece in self.pieces:
            telemetry = piece.read()
            starts = np.append(np.unique(telemetry.frame, return_index=True)[1], len(telemetry))
            rows = slice(*(int(starts[np.clip(k - done, 0, len(starts) - 1)]) for k in (self.first, self.last)))
            if rows.start < rows.stop:
                begins = begins if begins >= 0 else piece.begins + rows.start
                parts.append(rows_of(telemetry, rows))
            done += len(starts) - 1
        return joined(parts), begins


@dataclass(frozen=True)
class MatchedRange:
    """A range as matched under some state: its arcs, its matches, and its stars after the flight code's check.

    `unidentified` of its exposures want the lost-in-space extra, which is not installed.
    """

    of: FrameRange
    ordered: OrderedPiece
    matches: Columns
    unidentified: int


def match_range(how: Matching, of: FrameRange, under: Under, path: str) -> MatchedRange:
    """Match one range and write what comes out."""
    telemetry, begins = of.read()
    matched, timeless = matched_range(how, telemetry, under)
    arrays = {name: getattr(matched.matches, name) for name in _MATCHES} | {"kept": matched.telemetry.star_id}
    ordered = write_ordered(matched.problem, begins, Path(f"{path}-arcs"), timeless)
    return MatchedRange(of, ordered, write_columns(Path(f"{path}-matches"), arrays), matched.unidentified)


def matched_range(how: Matching, telemetry: Telemetry, under: Under) -> tuple[Matched, int]:
    """Match rows in memory; returns how many stars wanted a time where none of these rows has one, too."""
    stars, timeless = read_catalogue(how.catalogue), 0
    sky = _sky(how.catalogue, how.magnitude_limit, blend_rad(how.sensor))
    try:
        matcher = _rematcher(how, telemetry, stars, sky)
    except TimelessError as refusal:
        timeless, matcher = refusal.stars, _rematcher(how, telemetry, stars.brighter_than(-np.inf), sky)
    frames = slice(0, matcher.n_frames)
    return matched_under(telemetry, matcher, frames, under, how.sensor, stars, how.settings), timeless


def _rematcher(how: Matching, telemetry: Telemetry, stars: Catalogue, sky: MatchingSky) -> Rematcher:
    """Make rows of a set ready to be matched."""
    return Rematcher(telemetry, how.sensor, stars, how.settings, how.cache_folder, sky, how.epoch)


@lru_cache(maxsize=1)
def _sky(catalogue: Columns, magnitude_limit: float, blend: float) -> MatchingSky:
    """The stars that may be matched; those asked for last are kept."""
    return matching_sky(read_catalogue(catalogue), magnitude_limit, blend)


def magnitude_limit(pieces: Sequence[TelemetryPiece], sensor: Sensor, catalogue: Columns, spread: Spread) -> float:
    """Faintest star that may be matched, Hp, as `detections.magnitude_limit` finds it of a set in memory."""
    parts: list[tuple[int, NDArray[np.int64]]] = spread.map(seen_in_piece, [(piece, catalogue) for piece in pieces])
    longest = max(len(counts) for _, counts in parts)
    counts = np.sum([np.pad(part, (0, longest - len(part))) for _, part in parts], axis=0)
    faintest = np.array(sorted({star for star, _ in parts if star > 0}), np.int64)
    return limit_of(sensor, read_catalogue(catalogue), faintest, _median(counts))


def seen_in_piece(piece: TelemetryPiece, catalogue: Columns) -> tuple[int, NDArray[np.int64]]:
    """The faintest known star that a piece names, 0 = none, and how many of its exposures have 0, 1, 2, ... detections."""
    telemetry, stars = piece.read(), read_catalogue(catalogue)
    counts = np.bincount(exposures_of(telemetry).count)
    if telemetry.star_id is None:
        return 0, counts
    index = stars.index_of(np.unique(telemetry.star_id[telemetry.star_id > 0]))
    index = index[index >= 0]
    return (int(stars.hip[index[np.argmax(stars.magnitude[index])]]) if len(index) else 0), counts


def _median(counts: NDArray[np.int64]) -> float:
    """Median of values of which 0, 1, 2, ... occur so often."""
    ends, n = np.cumsum(counts), int(counts.sum())
    middle = np.searchsorted(ends, [(n - 1) // 2, n // 2], side="right")
    return float(middle.mean())


def changed_in_range(before: MatchedRange, after: MatchedRange) -> int:
    """Count the detections of a range whose star differs."""
    stars = [matched.matches.read()["kept"] for matched in (before, after)]
    return int(np.sum(stars[0] != stars[1]))


def rows_of_range(part: MatchedRange) -> MatchedRows:
    """Map the telemetry, the matches and the kept stars of a range."""
    telemetry, _ = part.of.read()
    arrays: dict[str, Any] = part.matches.read()
    return telemetry, Matches(**{name: arrays[name] for name in _MATCHES}), arrays["kept"]
