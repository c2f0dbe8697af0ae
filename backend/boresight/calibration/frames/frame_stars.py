"""What became of every detection of a frame: used, left out, rejected or unmatched, and why.

==========  ==================================================================================================
used        matched, and in the arcs that the run was fitted to
left out    matched, but its exposure takes no part, or its centroid is off the detector
rejected    the file names a star for it that matching, or the flight code's check, does not accept
unmatched   no star was found for it, and the file names none
==========  ==================================================================================================

An attitude rests on the used and the left out stars that lie on the detector. A rejected one has a place all the same, where
the star that the file names would be: how far away that is says why it was rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.frames.frame_states import MatchedFrame
from boresight.calibration.matching.detections import given_stars
from boresight.calibration.matching.match_report import NOT_ACCEPTED
from boresight.calibration.matching.matched import Matched
from boresight.calibration.matching.rematch import Matches
from boresight.sky.catalogue import Catalogue
from boresight.sky.guide_stars import phrases
from boresight.sky.matching import EXPOSURE_REASONS, OFF_DETECTOR, ROW_REASONS, STARTS
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.sensors import Sensor

USED, LEFT_OUT, REJECTED, UNMATCHED = "used", "left out", "rejected", "unmatched"


@dataclass(frozen=True)
class FrameStars:
    """The detections of a frame in file order; leading dimension n_rows.

    `s_i`: (n_rows, 3) apparent direction, of a rejected star that of the named one.
    """

    star_id: IntArray
    given_id: IntArray
    old_id: IntArray
    s_i: FloatArray
    magnitude: FloatArray
    kept: BoolArray
    fate: list[str]
    reason: list[str | None]
    flags: list[list[str]]


def frame_stars(found: MatchedFrame, sensor: Sensor, catalogue: Catalogue, minimum_stars: int) -> FrameStars:
    """Tell what became of each detection."""
    telemetry, rows, new = found.telemetry, found.rows, found.new
    given, given_s, _ = given_stars(telemetry, catalogue)
    matched = _matched_rows(new)
    star_id = np.where(matched, new.matches.star_id, 0)[rows]
    s_i = np.where(matched[:, None], new.matches.s_i, given_s)[rows]
    off = ~on_detector(telemetry, sensor)[rows]
    used = np.isin(np.arange(rows.start, rows.stop), new.problem.arcs.whole().source_row)
    matched = matched[rows]
    off &= matched | (given[rows] > 0)
    fate = np.select([used, matched | off, given[rows] > 0], [USED, LEFT_OUT, REJECTED], UNMATCHED).tolist()
    few = f"its exposure has fewer than {minimum_stars} usable stars, or all of them on one line"
    reasons = [
        None if used[k] else ROW_REASONS[OFF_DETECTOR] if off[k] else few if matched[k] else why
        for k, why in enumerate(_why_unmatched(new, given)[rows])
    ]
    return FrameStars(
        star_id=star_id,
        given_id=given[rows],
        old_id=np.where(_matched_rows(found.old), found.old.matches.star_id, 0)[rows],
        s_i=s_i,
        magnitude=_magnitudes(catalogue, np.where(star_id > 0, star_id, given[rows])),
        kept=matched & ~off & np.isfinite(s_i[:, 0]),
        fate=fate,
        reason=reasons,
        flags=[phrases(int(flag)) for flag in _flags(new)[rows]],
    )


def _matched_rows(seen: Matched) -> BoolArray:
    """(n_rows,) which detections have a star that counts: a direction, and not taken out by the flight code's rule."""
    known = np.isfinite(seen.matches.s_i[:, 0])
    if not isinstance(seen.matches, Matches) or seen.telemetry.star_id is None:
        return known
    return np.asarray(known & (seen.telemetry.star_id > 0))


def _magnitudes(catalogue: Catalogue, star_id: IntArray) -> FloatArray:
    """Catalogue magnitudes of stars by number, Hp, NaN where unknown."""
    index = catalogue.find_index(star_id)
    return np.where(index >= 0, catalogue.magnitude[index], np.nan)


def _why_unmatched(seen: Matched, given: IntArray) -> NDArray[np.object_]:
    """(n_rows,) phrases for detections without a star."""
    if isinstance(seen.matches, Matches):
        phrase = np.array(ROW_REASONS, object)[seen.matches.row_reason]
        return np.where(seen.matches.star_id > 0, NOT_ACCEPTED, phrase)
    return np.where(
        given > 0, "no direction: its number is not in the catalogue, or it has no time", "the file names no star"
    )


def _flags(seen: Matched) -> NDArray[np.int8]:
    """(n_rows,) flags of the matched stars; those of given matches were not looked up."""
    if isinstance(seen.matches, Matches):
        return seen.matches.flags
    return np.zeros(len(seen.telemetry), np.int8)


def exposure_words(seen: Matched, k: int) -> tuple[str, str | None]:
    """Where the attitude of exposure k came from, and why matching does not call it valid, None where it does."""
    if not isinstance(seen.matches, Matches):
        return "given matches", None
    reason = int(seen.matches.reason[k])
    return STARTS[seen.matches.start[k]], EXPOSURE_REASONS[reason] if reason else None
