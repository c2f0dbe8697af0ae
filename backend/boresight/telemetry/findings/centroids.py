"""Findings about centroids: off the detector, doubled, too close, always in one place, and what they cover."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.telemetry.detector import OffDetector, detector_coverage, radial_coverage
from boresight.telemetry.evidence import Evidence
from boresight.telemetry.exposures import repeats_within
from boresight.telemetry.findings.finding import Finding, counted, row_numbers
from boresight.telemetry.sensors import Sensor

BoolArray = NDArray[np.bool_]

_CLOSE_PX = 2.0
_STUCK_EXPOSURES = 5
_STUCK_SHARE = 0.05
_POOR_CELLS = 0.5
_POOR_RADIUS = 0.8


def stars_off_detector(evidence: Evidence) -> Finding | None:
    """Find matched stars off the detector."""
    return off_detector_finding(evidence.off_detector, evidence.sensor)


def off_detector_finding(off: OffDetector, sensor: Sensor) -> Finding | None:
    """The finding of matched stars off the detector: left out while they are few, SERIOUS where the set is refused for them."""
    if not off.stars:
        return None
    rows = tuple(star.row for star in off.first)
    if not off.too_many:
        return Finding("OFF_DETECTOR", "CAUTION" if off.beyond_cut else "NORMAL", off.sentence(), off.stars, rows)
    sentence = (
        f"{counted(off.stars, 'matched star lies', 'matched stars lie')} off the detector of {sensor.name} by up to "
        f"{off.farthest_px:.3g} px, where at most {off.most:,} may be left out, so that no calibration takes the set: choose the "
        "right sensor, exchange rows and columns, or delete the rows."
    )
    return Finding("OFF_DETECTOR", "SERIOUS", sentence, off.stars, rows)


def detections_off_detector(evidence: Evidence) -> Finding | None:
    """Find unmatched detections off the detector."""
    off = ~evidence.matched & ~evidence.on_detector
    if not off.any():
        return None
    sentence = (
        f"{counted(int(off.sum()), 'unmatched detection is', 'unmatched detections are')} left out of use, off the detector "
        f"of {evidence.sensor.name}: check row_px and col_px."
    )
    return Finding("OFF_DETECTOR_UNMATCHED", "CAUTION", sentence, int(off.sum()), row_numbers(evidence, off))


def repeated_stars(evidence: Evidence) -> Finding | None:
    """Find stars named twice in one exposure."""
    star_id = evidence.telemetry.star_id
    if star_id is None:
        return None
    matched = np.flatnonzero(evidence.matched)
    later, _ = repeats_within(evidence.exposures.of_entry[matched], star_id[matched])
    if not len(later):
        return None
    what = counted(len(later), "row names", "rows name")
    sentence = f"{what} a star already named in the exposure: leave star_id empty where it is wrong."
    return Finding(
        "REPEATED_STARS", "SERIOUS", sentence, len(later), row_numbers(evidence, _marked(evidence, matched[later]))
    )


def repeated_centroids(evidence: Evidence) -> Finding | None:
    """Find two detections of an exposure in the very same place."""
    later, _ = repeats_within(evidence.exposures.of_entry, evidence.telemetry.row_px, evidence.telemetry.col_px)
    if not len(later):
        return None
    sentence = (
        f"{counted(len(later), 'row repeats', 'rows repeat')} a centroid of the same exposure: delete one of the two."
    )
    return Finding(
        "REPEATED_CENTROIDS", "SERIOUS", sentence, len(later), row_numbers(evidence, _marked(evidence, later))
    )


def close_pairs(evidence: Evidence) -> Finding | None:
    """Find detections so close to another that each pulls the other's centroid."""
    close = _close_to_another(evidence)
    if not close.any():
        return None
    what = counted(int(close.sum()), "detection lies", "detections lie")
    sentence = f"{what} within {_CLOSE_PX:g} px of another in the exposure: blended images have biased centroids."
    return Finding("CLOSE_PAIRS", "NORMAL", sentence, int(close.sum()), row_numbers(evidence, close))


def stuck_detections(evidence: Evidence) -> Finding | None:
    """Find unmatched detections that return on the same pixel while the stars move: hot pixels."""
    stuck = _returning(evidence, ~evidence.matched)
    staying_stars = _returning(evidence, evidence.matched)
    if not stuck.any() or staying_stars.sum() > 0.5 * evidence.matched.sum():
        return None
    what = counted(int(stuck.sum()), "unmatched detection returns", "unmatched detections return")
    sentence = f"{what} on the same pixels while the stars move, as hot pixels do: left out of use."
    return Finding("HOT_PIXELS", "NORMAL", sentence, int(stuck.sum()), row_numbers(evidence, stuck))


def poor_coverage(evidence: Evidence) -> Finding | None:
    """Find a set whose usable stars leave most of the detector empty."""
    counts = np.array(detector_coverage(evidence.telemetry, evidence.sensor, evidence.usable)["counts"])
    filled = int(np.count_nonzero(counts))
    if not filled or filled >= _POOR_CELLS * counts.size:
        return None
    sentence = (
        f"Usable stars fill {filled} of {counts.size} cells of the detector: what is found holds there only, add frames in other "
        "attitudes."
    )
    return Finding("POOR_COVERAGE", "CAUTION", sentence, counts.size - filled)


def poor_radius(evidence: Evidence) -> Finding | None:
    """Find a set whose usable stars stay near the centre."""
    radial = radial_coverage(evidence.telemetry, evidence.sensor, evidence.usable)
    largest, corner = radial["largest_radius_px"], radial["corner_radius_px"]
    if largest is None or largest >= _POOR_RADIUS * corner:
        return None
    sentence = f"Usable stars reach {largest:.0f} px from the centre, the corner is at {corner:.0f}: distortion beyond is a guess."
    return Finding("POOR_RADIUS", "CAUTION", sentence, int(evidence.usable.sum()))


def _marked(evidence: Evidence, entries: NDArray[np.int64]) -> BoolArray:
    """Return the (n_rows,) mask of some entries."""
    marked = np.zeros(len(evidence.telemetry), dtype=np.bool_)
    marked[entries] = True
    return marked


def _close_to_another(evidence: Evidence) -> BoolArray:
    """Return (n_rows,) whether another detection of the exposure is nearer than the limit; sweeps over sorted rows."""
    telemetry, exposure = evidence.telemetry, evidence.exposures.of_entry
    order = np.lexsort((telemetry.row_px, exposure))
    row_px, col_px, exposure = telemetry.row_px[order], telemetry.col_px[order], exposure[order]
    close = np.zeros(len(order), dtype=np.bool_)
    for step in range(1, len(order)):
        near = (exposure[step:] == exposure[:-step]) & (row_px[step:] - row_px[:-step] < _CLOSE_PX)
        if not near.any():
            break
        pair = near & (np.hypot(row_px[step:] - row_px[:-step], col_px[step:] - col_px[:-step]) < _CLOSE_PX)
        close[order[step:][pair]] = True
        close[order[:-step][pair]] = True
    return close


def _returning(evidence: Evidence, rows: BoolArray) -> BoolArray:
    """Return (n_rows,) which of the given rows lie on a pixel that holds a detection in suspiciously many exposures."""
    entries = np.flatnonzero(rows & evidence.on_detector)
    pixel = np.rint(evidence.telemetry.row_px[entries]).astype(np.int64) * (evidence.sensor.columns + 1) + np.rint(
        evidence.telemetry.col_px[entries]
    ).astype(np.int64)
    _, place, count = np.unique(pixel, return_inverse=True, return_counts=True)
    enough = max(_STUCK_EXPOSURES, _STUCK_SHARE * len(evidence.exposures))
    return _marked(evidence, entries[count[place] >= enough])
