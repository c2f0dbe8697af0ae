"""Telemetry on the detector it is said to come from: rows off it, and how well the rest covers it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.errors import RefusedInputError
from boresight.telemetry.quality import StarOff
from boresight.telemetry.read.checks import MOST_FAULTS, Faults
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: How far past the edge the centroid of a star cut by it may be fitted, pixels.
_CUT_STAR_PX = 2.0
#: Share of a set's matched stars that may lie farther out, and how many may in a small set, but never more than every second.
#: Rows and columns exchanged put tens of per cent off a detector that is not square; faults of single rows are rarer than 1 %.
MOST_OFF_SHARE, MOST_OFF_OF_FEW = 0.01, 3
_GRID_ROWS = 8
_ROWS_IN_SENTENCE = 5
_RADIAL_BINS = 20


def matched_rows(telemetry: Telemetry) -> BoolArray:
    """Return (n_rows,) whether the file says which star a row is, by its number or, without numbers, its direction."""
    if telemetry.star_id is not None:
        return telemetry.star_id > 0
    if telemetry.ra_rad is not None:
        return np.isfinite(telemetry.ra_rad)
    return np.zeros(len(telemetry), dtype=np.bool_)


def on_detector(telemetry: Telemetry, sensor: Sensor) -> BoolArray:
    """Return (n_rows,) whether the centroid lies on the detector."""
    row_px, col_px = telemetry.row_px, telemetry.col_px
    on_rows = (row_px >= -0.5) & (row_px <= sensor.rows - 0.5)
    return on_rows & (col_px >= -0.5) & (col_px <= sensor.columns - 0.5)


class OffDetectorError(RefusedInputError):
    """So many matched stars lie off the detector that sensor file and telemetry do not belong together as they stand."""


class OffDetector:
    """The matched stars of a set that lie off its detector, of all its parts one after the other."""

    def __init__(self) -> None:
        self.matched = 0
        self.stars = 0
        self.farthest_px = 0.0
        self.first: list[StarOff] = []
        self.beyond_cut = 0  # farther out than an image that the edge cuts
        self._faults = Faults("The telemetry does not match the sensor")

    @property
    def most(self) -> int:
        """How many stars may lie farther out than a star that the edge cuts, before the set is refused."""
        return min(max(int(MOST_OFF_SHARE * self.matched), MOST_OFF_OF_FEW), self.matched // 2)

    @property
    def too_many(self) -> bool:
        """Whether the set is to be refused."""
        return self.beyond_cut > self.most

    def look_at(self, telemetry: Telemetry, sensor: Sensor, rows: IntArray | None = None) -> None:
        """Take the next part; `rows` (n_rows,) are its row numbers where they do not follow on from its `first_row`."""
        matched = matched_rows(telemetry)
        off_px = _past_the_edge(telemetry, sensor)
        entries = np.flatnonzero(matched & (off_px > 0.0))
        self.matched += int(np.count_nonzero(matched))
        if not len(entries):
            return
        self.stars += len(entries)
        self.farthest_px = max(self.farthest_px, float(off_px[entries].max()))
        beyond = matched & (off_px > _CUT_STAR_PX)
        self.beyond_cut += int(np.count_nonzero(beyond))
        number = telemetry.first_row + np.arange(len(telemetry)) if rows is None else rows
        for entry in entries[: MOST_FAULTS - len(self.first)].tolist():
            star = None if telemetry.star_id is None else int(telemetry.star_id[entry])
            frame, exposure = int(telemetry.frame[entry]), int(telemetry.exposure[entry])
            self.first.append(
                StarOff(
                    row=int(number[entry]), frame=frame, exposure=exposure, star_id=star, off_px=float(off_px[entry])
                )
            )
        for column, values, size in (
            ("row_px", telemetry.row_px, sensor.rows),
            ("col_px", telemetry.col_px, sensor.columns),
        ):
            off = beyond & ((values < -0.5 - _CUT_STAR_PX) | (values > size - 0.5 + _CUT_STAR_PX))
            for entry in np.flatnonzero(off)[:MOST_FAULTS].tolist():
                detail = (
                    f"{values[entry]:g} is outside the detector (−0.5 to {size - 0.5:g}): swap rows and columns, "
                    "correct the sensor's rows and columns, or delete the row"
                )
                self._faults.add(detail, column=column, row=int(number[entry]))
            self._faults.count += max(int(np.count_nonzero(off)) - MOST_FAULTS, 0)

    def absorb(self, later: OffDetector) -> None:
        """Take over what was found in a later part."""
        self.matched += later.matched
        self.stars += later.stars
        self.farthest_px = max(self.farthest_px, later.farthest_px)
        self.first = (self.first + later.first)[:MOST_FAULTS]
        self.beyond_cut += later.beyond_cut
        self._faults.absorb(later._faults)

    def refuse(self) -> None:
        """Raise when too many stars lie off the detector."""
        if self.too_many:
            self._faults.subject = (
                f"The telemetry does not match the sensor: {self.beyond_cut:,} of its {self.matched:,} matched stars are outside "
                f"the detector; at most {self.most:,} may be"
            )
            raise OffDetectorError(str(refusal := self._faults.refusal()), refusal.faults)

    def document(self) -> dict[str, Any]:
        """Return what was left out for a JSON document: how many stars, by how much at most, and the first twenty."""
        return {
            "stars": self.stars,
            "farthest_px": self.farthest_px if self.stars else None,
            "rows": [asdict(star) for star in self.first],
        }

    def sentences(self, subject: str = "") -> list[str]:
        """Say in a sentence that a result lacks stars; none where all that is left out are images that the edge cuts."""
        return [self.sentence(subject)] if self.beyond_cut else []

    def sentence(self, subject: str = "") -> str:
        """Say what was left out, of at least one star."""
        listed = ", ".join(f"{star.row} by {star.off_px:.3g} px" for star in self.first[:_ROWS_IN_SENTENCE])
        more = ", ..." if self.stars > _ROWS_IN_SENTENCE else ""
        what, rows = ("star is", "the row") if self.stars == 1 else ("stars are", "these rows")
        told = f"{self.stars:,} matched {what} outside the detector and not used{subject} (row {listed}{more})"
        if not self.beyond_cut:
            return f"{told}: the edge cuts such an image and shifts its centroid."
        return f"{told}: correct or delete {rows}, and check the pixel origin if they are beyond one edge."


def check_against_sensor(telemetry: Telemetry, sensor: Sensor) -> OffDetector:
    """Return which matched stars lie off the sensor's detector and are left out of use."""
    off = OffDetector()
    off.look_at(telemetry, sensor)
    off.refuse()
    return off


def _past_the_edge(telemetry: Telemetry, sensor: Sensor) -> FloatArray:
    """How far each centroid lies past the edge of the detector, (n_rows,) pixels, at most 0 on it."""
    row, col = telemetry.row_px, telemetry.col_px
    by_row = np.maximum(-0.5 - row, row - (sensor.rows - 0.5))
    by_col = np.maximum(-0.5 - col, col - (sensor.columns - 0.5))
    return np.asarray(np.maximum(by_row, by_col))


def detector_coverage(telemetry: Telemetry, sensor: Sensor, rows: BoolArray) -> dict[str, Any]:
    """Count stars in cells of the detector.

    `rows`: (n_rows,) which rows count. Returns `row_edges_px` (n + 1), `col_edges_px` (m + 1) and `counts` (n, m), as
    lists; cells are about square.: .
    """
    columns = max(1, round(_GRID_ROWS * sensor.columns / sensor.rows))
    row_edges = np.linspace(-0.5, sensor.rows - 0.5, _GRID_ROWS + 1)
    col_edges = np.linspace(-0.5, sensor.columns - 0.5, min(columns, 64) + 1)
    counts, _, _ = np.histogram2d(telemetry.row_px[rows], telemetry.col_px[rows], bins=(row_edges, col_edges))
    return {
        "row_edges_px": row_edges.tolist(),
        "col_edges_px": col_edges.tolist(),
        "counts": counts.astype(np.int64).tolist(),
    }


def radial_coverage(telemetry: Telemetry, sensor: Sensor, rows: BoolArray) -> dict[str, Any]:
    """Count stars by their distance from the detector's centre."""
    centre_row, centre_col = (sensor.rows - 1) / 2.0, (sensor.columns - 1) / 2.0
    radius = np.hypot(telemetry.row_px[rows] - centre_row, telemetry.col_px[rows] - centre_col)
    corner = float(np.hypot(sensor.rows, sensor.columns)) / 2.0
    counts, edges = np.histogram(radius, bins=_RADIAL_BINS, range=(0.0, corner))
    return {
        "edges_px": edges.tolist(),
        "counts": counts.tolist(),
        "largest_radius_px": float(radius.max()) if len(radius) else None,
        "corner_radius_px": corner,
    }
