"""What a quality report looks at, computed once, and a finding: one thing that it has found."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.telemetry.quality.detector import OffDetector, matched_rows, on_detector
from boresight.telemetry.schema import Exposures, Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor


class StarNumbers(Protocol):
    """What the report needs of a star catalogue."""

    @property
    def magnitude(self) -> FloatArray:
        """(n_stars,) magnitudes."""

    def find_index(self, hip: IntArray, /) -> IntArray:
        """Return (n,) positions of (n,) numbers, -1 where unknown."""


@dataclass(frozen=True)
class QualityInputs:
    """A telemetry set with its sensor and, where there is one, the catalogue.

    `rows`: (n_rows,) number of every row in the file, where the set is only stretches of it.
    """

    telemetry: Telemetry
    sensor: Sensor
    catalogue: StarNumbers | None = None
    rows: IntArray | None = None

    @cached_property
    def exposures(self) -> Exposures:
        """The exposures in file order."""
        return find_exposures(self.telemetry)

    @cached_property
    def matched(self) -> BoolArray:
        """(n_rows,) whether the file says which star it is."""
        return matched_rows(self.telemetry)

    @cached_property
    def on_detector(self) -> BoolArray:
        """(n_rows,) whether the centroid lies on the detector."""
        return on_detector(self.telemetry, self.sensor)

    @cached_property
    def off_detector(self) -> OffDetector:
        """The matched stars off the detector."""
        off = OffDetector()
        off.look_at(self.telemetry, self.sensor, self.rows)
        return off

    @cached_property
    def directed(self) -> BoolArray:
        """(n_rows,) whether the file gives the star's direction."""
        ra_rad = self.telemetry.ra_rad
        return np.zeros(len(self.telemetry), dtype=np.bool_) if ra_rad is None else np.isfinite(ra_rad)

    @cached_property
    def index(self) -> IntArray | None:
        """(n_rows,) place of each row's star in the catalogue, -1 = none; None without catalogue or numbers."""
        if self.catalogue is None or self.telemetry.star_id is None:
            return None
        return np.where(self.matched, self.catalogue.find_index(self.telemetry.star_id), -1)

    @cached_property
    def unknown(self) -> BoolArray:
        """(n_rows,) whether the row names a star that the catalogue does not have."""
        return np.zeros(len(self.telemetry), dtype=np.bool_) if self.index is None else self.matched & (self.index < 0)

    @cached_property
    def untimed(self) -> BoolArray:
        """(n_rows,) whether the row has no time."""
        time_utc = self.telemetry.time_utc
        return np.ones(len(self.telemetry), dtype=np.bool_) if time_utc is None else np.isnat(time_utc)

    @cached_property
    def unmoving(self) -> BoolArray:
        """(n_rows,) whether the file gives velocities but not for this row."""
        velocity = self.telemetry.velocity_m_s
        return np.zeros(len(self.telemetry), dtype=np.bool_) if velocity is None else np.isnan(velocity[:, 0])

    @cached_property
    def from_catalogue(self) -> BoolArray:
        """(n_rows,) whether the direction must come from the catalogue."""
        return self.matched & ~self.directed

    @cached_property
    def usable(self) -> BoolArray:
        """(n_rows,) whether the row can take part in a calibration."""
        lookup = self.from_catalogue & ~self.unknown & ~self.untimed & ~self.unmoving
        return self.matched & self.on_detector & (self.directed | lookup)

    @cached_property
    def usable_per_exposure(self) -> IntArray:
        """(n_exposures,) usable rows of each exposure."""
        return self.count_per_exposure(self.usable)

    @cached_property
    def spread_per_exposure(self) -> tuple[FloatArray, FloatArray]:
        """(n_exposures,) standard deviation of the usable centroids across and along their main direction, pixels."""
        which, n = self.exposures.of_entry[self.usable], len(self.exposures)
        row, col = self.telemetry.row_px[self.usable], self.telemetry.col_px[self.usable]
        count = np.maximum(np.bincount(which, minlength=n), 1)

        def mean(values: FloatArray) -> FloatArray:
            return np.bincount(which, values, minlength=n) / count

        row, col = row - mean(row)[which], col - mean(col)[which]
        half_sum, half_difference = (mean(row * row) + mean(col * col)) / 2, (mean(row * row) - mean(col * col)) / 2
        radius = np.hypot(half_difference, mean(row * col))
        return np.sqrt(np.maximum(half_sum - radius, 0.0)), np.sqrt(half_sum + radius)

    def count_per_exposure(self, rows: BoolArray) -> IntArray:
        """Count the marked (n_rows,) rows of each exposure, (n_exposures,)."""
        return np.bincount(self.exposures.of_entry[rows], minlength=len(self.exposures)).astype(np.int64)


Severity = Literal["NORMAL", "CAUTION", "SERIOUS"]

#: From harmless to unusable.
SEVERITIES: tuple[Severity, ...] = ("NORMAL", "CAUTION", "SERIOUS")

_MOST_ROWS = 20


@dataclass(frozen=True)
class Finding:
    """A fact about a telemetry set that an operator should know."""

    code: str
    severity: Severity
    sentence: str
    count: int
    rows: tuple[int, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the finding for a JSON document."""
        return {
            "code": self.code,
            "severity": self.severity,
            "sentence": self.sentence,
            "count": self.count,
            "rows": list(self.rows),
        }


def row_numbers(inputs: QualityInputs, marked: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the numbers, as an editor counts, of the first twenty marked rows of (n_rows,)."""
    entries = np.flatnonzero(marked)[:_MOST_ROWS]
    rows = entries + inputs.telemetry.first_row if inputs.rows is None else inputs.rows[entries]
    return tuple(rows.tolist())


def counted(count: int, one: str, many: str) -> str:
    """Return how many, and what of them in agreement: `1 row names`, `1,204 rows name`."""
    return f"{count:,} {one if count == 1 else many}"


def marked_rows(
    inputs: QualityInputs, code: str, severity: Severity, marked: BoolArray, nouns: tuple[str, str], said: str
) -> Finding | None:
    """The finding of marked rows (n_rows,), None where there are none; the sentence: how many of which noun, and what is said."""
    count = int(marked.sum())
    if not count:
        return None
    return Finding(code, severity, f"{counted(count, *nouns)} {said}", count, row_numbers(inputs, marked))
