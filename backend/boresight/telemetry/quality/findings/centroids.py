"""Findings about centroids: off the detector, doubled, too close, always in one place, and what they cover."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.telemetry.quality.detector import OffDetector, detector_coverage, radial_coverage
from boresight.telemetry.quality.inputs import Finding, QualityInputs, counted, marked_rows, row_numbers
from boresight.telemetry.read.checks import repeats_within
from boresight.telemetry.sensors import Sensor

_CLOSE_PX = 2.0
#: A cell whose diagonal is the limit, and the cells around one that come as near.
_CELL_PX = _CLOSE_PX / 2**0.5
_AROUND = [(row, col) for row in range(-2, 3) for col in range(-2, 3) if (row, col) != (0, 0)]
#: Detections that are sorted together, of whole exposures.
_TOGETHER = 100_000
#: Beyond this a number is no place on a detector.
_FARTHEST_PX = 1e9
_STUCK_EXPOSURES = 5
_STUCK_SHARE = 0.05
_POOR_CELLS = 0.5
_POOR_RADIUS = 0.8


def stars_off_detector(inputs: QualityInputs) -> Finding | None:
    """Find matched stars off the detector."""
    return off_detector_finding(inputs.off_detector, inputs.sensor)


def off_detector_finding(off: OffDetector, sensor: Sensor) -> Finding | None:
    """The finding of matched stars off the detector: left out while they are few, SERIOUS where the set is refused for them."""
    if not off.stars:
        return None
    rows = tuple(star.row for star in off.first)
    if not off.too_many:
        return Finding("OFF_DETECTOR", "CAUTION" if off.beyond_cut else "NORMAL", off.sentence(), off.stars, rows)
    sentence = (
        f"{counted(off.stars, 'matched star is', 'matched stars are')} up to {off.farthest_px:.3g} px outside the detector of "
        f"{sensor.name}. Calibrations allow at most {off.most:,}, so the set would be refused: swap "
        "rows and columns, correct the sensor's, or delete the rows."
    )
    return Finding("OFF_DETECTOR", "SERIOUS", sentence, off.stars, rows)


def detections_off_detector(inputs: QualityInputs) -> Finding | None:
    """Find unmatched detections off the detector."""
    off = ~inputs.matched & ~inputs.on_detector
    nouns = ("unmatched detection is", "unmatched detections are")
    said = f"outside the detector of {inputs.sensor.name} and not used: check row_px and col_px."
    return marked_rows(inputs, "OFF_DETECTOR_UNMATCHED", "CAUTION", off, nouns, said)


def repeated_stars(inputs: QualityInputs) -> Finding | None:
    """Find stars named twice in one exposure."""
    star_id = inputs.telemetry.star_id
    if star_id is None:
        return None
    matched = np.flatnonzero(inputs.matched)
    later, _ = repeats_within(inputs.exposures.of_entry[matched], star_id[matched])
    if not len(later):
        return None
    what = counted(len(later), "row names", "rows name")
    sentence = (
        f"{what} a star that the exposure already has: verification keeps the detection nearest to the star's place; "
        "leave star_id empty where it is wrong."
    )
    return Finding(
        "REPEATED_STARS", "CAUTION", sentence, len(later), row_numbers(inputs, _marked(inputs, matched[later]))
    )


def repeated_centroids(inputs: QualityInputs) -> Finding | None:
    """Find two detections of an exposure in the very same place."""
    later, _ = repeats_within(inputs.exposures.of_entry, inputs.telemetry.row_px, inputs.telemetry.col_px)
    if not len(later):
        return None
    sentence = (
        f"{counted(len(later), 'row repeats', 'rows repeat')} a centroid of the same exposure: delete one of the two."
    )
    return Finding("REPEATED_CENTROIDS", "SERIOUS", sentence, len(later), row_numbers(inputs, _marked(inputs, later)))


def close_pairs(inputs: QualityInputs) -> Finding | None:
    """Find detections so close to another that each pulls the other's centroid."""
    said = f"within {_CLOSE_PX:g} px of another in the exposure: blended images have biased centroids."
    nouns = ("detection lies", "detections lie")
    return marked_rows(inputs, "CLOSE_PAIRS", "NORMAL", _close_to_another(inputs), nouns, said)


def stuck_detections(inputs: QualityInputs) -> Finding | None:
    """Find unmatched detections that return on the same pixel while the stars move: hot pixels."""
    stuck = _returning(inputs, ~inputs.matched)
    staying_stars = _returning(inputs, inputs.matched)
    if staying_stars.sum() > 0.5 * inputs.matched.sum():
        return None
    nouns = ("unmatched detection returns", "unmatched detections return")
    said = "on the same pixels while the stars move, as hot pixels do, and are not used."
    return marked_rows(inputs, "HOT_PIXELS", "NORMAL", stuck, nouns, said)


def poor_coverage(inputs: QualityInputs) -> Finding | None:
    """Find a set whose usable stars leave most of the detector empty."""
    counts = np.array(detector_coverage(inputs.telemetry, inputs.sensor, inputs.usable)["counts"])
    filled = int(np.count_nonzero(counts))
    if not filled or filled >= _POOR_CELLS * counts.size:
        return None
    sentence = (
        f"Usable stars fill {filled} of {counts.size} cells of the detector: results are valid only there: add frames at other "
        "attitudes."
    )
    return Finding("POOR_COVERAGE", "CAUTION", sentence, counts.size - filled)


def poor_radius(inputs: QualityInputs) -> Finding | None:
    """Find a set whose usable stars stay near the centre."""
    radial = radial_coverage(inputs.telemetry, inputs.sensor, inputs.usable)
    largest, corner = radial["largest_radius_px"], radial["corner_radius_px"]
    if largest is None or largest >= _POOR_RADIUS * corner:
        return None
    sentence = (
        f"Usable stars reach {largest:.0f} px from the centre, the corner is at {corner:.0f}: distortion beyond that is "
        "extrapolated."
    )
    return Finding("POOR_RADIUS", "CAUTION", sentence, int(inputs.usable.sum()))


def _marked(inputs: QualityInputs, entries: NDArray[np.int64]) -> BoolArray:
    """Return the (n_rows,) mask of some entries."""
    marked = np.zeros(len(inputs.telemetry), dtype=np.bool_)
    marked[entries] = True
    return marked


def _close_to_another(inputs: QualityInputs) -> BoolArray:
    """Return (n_rows,) whether another detection of the exposure is nearer than the limit.

    Few have another in the same rows of pixels, and fewer in the same columns too. Those are sorted into cells in which any two
    are near each other; one that is alone in its cell is held against the 24 cells around, each of which has at most 24 such
    neighbours, so that the work is linear, however the detections crowd.
    """
    telemetry, exposure = inputs.telemetry, inputs.exposures.of_entry
    far = np.maximum(np.abs(telemetry.row_px), np.abs(telemetry.col_px)) > _FARTHEST_PX
    entries = np.flatnonzero(~far)
    for values in (telemetry.row_px, telemetry.col_px, telemetry.row_px):
        entries = entries[_near_in_line(exposure[entries], values[entries])]
    cuts = np.searchsorted(exposure[entries], exposure[entries[::_TOGETHER]])
    parts = np.split(entries, np.unique(cuts)[1:])
    near = [part[_near(exposure[part], telemetry.row_px[part], telemetry.col_px[part])] for part in parts]
    return _marked(inputs, np.concatenate(near))


def _near(of: IntArray, row: FloatArray, col: FloatArray) -> BoolArray:
    """Return (n,) whether another centroid of the exposure is nearer than the limit."""
    row_cell, col_cell = (np.floor(values / _CELL_PX).astype(np.int64) for values in (row, col))
    order = np.lexsort((col_cell, row_cell, of))
    row, col, of, row_cell, col_cell = row[order], col[order], of[order], row_cell[order], col_cell[order]
    ranks = _Ranks(of, row_cell, col_cell)
    near = ranks.count[ranks.of_entry] > 1
    alone = np.flatnonzero(~near)
    for row_step, col_step in _AROUND:
        begins, n = ranks.find(of[alone], row_cell[alone] + row_step, col_cell[alone] + col_step)
        one = np.repeat(alone, n)
        other = np.repeat(begins - np.cumsum(n) + n, n) + np.arange(len(one))
        near[one[np.hypot(row[one] - row[other], col[one] - col[other]) < _CLOSE_PX]] = True
    found = np.zeros(len(of), dtype=np.bool_)
    found[order] = near
    return found


def _near_in_line(exposure: IntArray, values: FloatArray) -> BoolArray:
    """Return (n,) whether another of the exposure is near along one axis."""
    order = np.lexsort((values, exposure))
    near = (np.diff(exposure[order]) == 0) & (np.diff(values[order]) < _CLOSE_PX)
    found = np.zeros(len(values), dtype=np.bool_)
    found[order[1:][near]] = True
    found[order[:-1][near]] = True
    return found


class _Ranks:
    """Cells of exposures that hold something, of entries sorted by exposure, row and column."""

    def __init__(self, exposure: IntArray, row_cell: IntArray, col_cell: IntArray) -> None:
        self._rows, row = np.unique(row_cell, return_inverse=True)
        self._cols, col = np.unique(col_cell, return_inverse=True)
        self._keys, self._begins, self.of_entry, self.count = np.unique(
            self._key(exposure, row, col), return_index=True, return_inverse=True, return_counts=True
        )

    def _key(self, exposure: IntArray, row: IntArray, col: IntArray) -> IntArray:
        return np.asarray((exposure * len(self._rows) + row) * len(self._cols) + col)

    def find(self, exposure: IntArray, row_cell: IntArray, col_cell: IntArray) -> tuple[IntArray, IntArray]:
        """First entry of cells (n,), and how many they hold."""
        (row, row_there), (col, col_there) = _look_up(self._rows, row_cell), _look_up(self._cols, col_cell)
        key, there = _look_up(self._keys, self._key(exposure, row, col))
        there &= row_there & col_there
        return self._begins[key], np.where(there, self.count[key], 0)


def _look_up(known: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    """Places of values among sorted ones, and whether they are there."""
    place = np.minimum(np.searchsorted(known, wanted), max(len(known) - 1, 0))
    return place, known[place] == wanted


def _returning(inputs: QualityInputs, rows: BoolArray) -> BoolArray:
    """Return (n_rows,) which of the given rows lie on a pixel that holds a detection in suspiciously many exposures."""
    entries = np.flatnonzero(rows & inputs.on_detector)
    pixel = np.rint(inputs.telemetry.row_px[entries]).astype(np.int64) * (inputs.sensor.columns + 1) + np.rint(
        inputs.telemetry.col_px[entries]
    ).astype(np.int64)
    _, place, count = np.unique(pixel, return_inverse=True, return_counts=True)
    enough = max(_STUCK_EXPOSURES, _STUCK_SHARE * len(inputs.exposures))
    return _marked(inputs, entries[count[place] >= enough])
