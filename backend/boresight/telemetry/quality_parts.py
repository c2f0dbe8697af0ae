"""The quality report of a set that comes in parts: of all of it what can be added up, and findings of what can be held.

Counts, times, gaps, stars an exposure, coverage, magnitudes and temperatures are those of the whole set, whatever its size, for
parts are whole frames and these add up. Findings look across the set (a hot pixel returns, a brightness is off the median), so
they are taken of rows in memory: of all of them up to `MOST_ROWS`, and of a larger set of whole stretches spread evenly over
it. Which stretches is decided on the way: when there are too many, every second one is let go, and from then on only every
second, fourth, ... is kept. The report of such a set says so in a finding of its own (`PART_OF_THE_SET`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.telemetry.detector import OffDetector
from boresight.telemetry.evidence import Evidence, StarNumbers
from boresight.telemetry.findings import Finding
from boresight.telemetry.findings.centroids import off_detector_finding
from boresight.telemetry.findings.times import gaps_finding
from boresight.telemetry.quality import (
    MAGNITUDE_STEP,
    MOST_LISTED,
    distribution,
    document_of,
    findings_of,
    quality_report,
    time_document,
    totals_of,
    worst_first,
)
from boresight.telemetry.sampling import intervals_of
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.sensors import Sensor

#: Rows held in memory for the findings; about 150 MB.
MOST_ROWS = 1_000_000


class QualityParts:
    """A quality report on its way.

    Parameters
    ----------
    sensor
        Whose the set is.
    catalogue
        Says which stars exist; None leaves unknown stars out of the report.
    """

    def __init__(self, sensor: Sensor, catalogue: StarNumbers | None = None) -> None:
        self._sensor, self._catalogue = sensor, catalogue
        self._kept: list[Telemetry] = []
        self._stride, self._seen = 1, 0
        self._totals: dict[str, Any] | None = None
        self._unknown_ids = np.empty(0, np.int64)
        self._frames = _FrameTimes()
        self._off = OffDetector()

    def add(self, part: Telemetry) -> None:
        """Take the next whole frames."""
        if self._seen % self._stride == 0:
            self._kept.append(replace(part, unknown={name: cells.slice(0, 0) for name, cells in part.unknown.items()}))
        self._seen += 1
        evidence = Evidence(part, self._sensor, self._catalogue)
        self._frames.add(evidence)
        self._off.absorb(evidence.off_detector)
        totals = totals_of(evidence)
        self._totals = totals if self._totals is None else _added(self._totals, totals)
        if evidence.index is not None and part.star_id is not None:
            self._unknown_ids = np.union1d(self._unknown_ids, part.star_id[evidence.unknown])
        while sum(map(len, self._kept)) > MOST_ROWS and len(self._kept) > 1:
            self._kept, self._stride = self._kept[::2], 2 * self._stride

    @property
    def off_detector(self) -> OffDetector:
        """The matched stars off the detector, of all parts."""
        return self._off

    def report(self) -> dict[str, Any]:
        """Return the document of `quality_report`, of at least one part."""
        telemetry = joined(self._kept)
        if len(self._kept) == self._seen or self._totals is None:
            return quality_report(telemetry, self._sensor, self._catalogue)
        rows = np.concatenate([part.first_row + np.arange(len(part)) for part in self._kept])
        evidence = Evidence(telemetry, self._sensor, self._catalogue, rows)
        found = [finding for finding in findings_of(evidence) if finding.code not in {"GAPS", "OFF_DETECTOR"}]
        of_all = (self._frames.gaps(), off_detector_finding(self._off, self._sensor))
        found += [self._of_a_part(telemetry), *(finding for finding in of_all if finding is not None)]
        ids = self._unknown_ids
        unknown = {"count": len(ids), "ids": ids[:MOST_LISTED].tolist()} if evidence.index is not None else None
        return document_of(worst_first(found), self._totals, self._frames.document(), unknown, self._off)

    def _of_a_part(self, looked_at: Telemetry) -> Finding:
        """Say of how much of the set the findings are."""
        frames, of = len(np.unique(looked_at.frame)), 0 if self._totals is None else self._totals["frames"]
        sentence = (
            f"Findings were looked for in {frames:,} of {of:,} frames, whole stretches spread evenly over the set, and count "
            "rows of these; totals, times and coverage are of all frames."
        )
        return Finding("PART_OF_THE_SET", "NORMAL", sentence, frames)


class _FrameTimes:
    """When the frames of a set were taken, put together part by part."""

    def __init__(self) -> None:
        self._time: list[NDArray[np.datetime64]] = []
        self._row: list[IntArray] = []
        self._frame: list[IntArray] = []
        self._span: list[np.datetime64] = []

    def add(self, evidence: Evidence) -> None:
        """Take the first time of every frame of a part."""
        time_utc, telemetry = evidence.telemetry.time_utc, evidence.telemetry
        timed = np.flatnonzero(~evidence.untimed)
        if time_utc is None or not len(timed):
            return
        entry = timed[np.diff(telemetry.frame[timed], prepend=telemetry.frame[timed[0]] - 1) != 0]
        self._time.append(time_utc[entry])
        self._row.append(entry + telemetry.first_row)
        self._frame.append(telemetry.frame[entry])
        self._span = [min([*self._span[:1], time_utc[timed].min()]), max([*self._span[1:], time_utc[timed].max()])]

    def gaps(self) -> Finding | None:
        """The finding of gaps between frames."""
        if not self._time:
            return None
        intervals = intervals_of(np.concatenate(self._time))
        return gaps_finding(intervals, tuple(np.concatenate(self._row)[intervals[2] + 1][:MOST_LISTED].tolist()))

    def document(self) -> dict[str, Any] | None:
        """The `time` of the report."""
        if not self._time:
            return None
        intervals = intervals_of(np.concatenate(self._time))
        after = intervals[2][:MOST_LISTED] + 1
        row, frame = (np.concatenate(values)[after] for values in (self._row, self._frame))
        return time_document(self._span[0], self._span[1], intervals, row, frame)


def _added(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Add the totals of two sets of frames, see `quality.totals_of`."""
    counts = {key: one[key] + value for key, value in other.items() if isinstance(value, int)}
    spread, more = one["stars_per_exposure"], other["stars_per_exposure"]
    return {
        **one,
        **counts,
        "unmatched_share": counts["unmatched"] / counts["stars"],
        "stars_per_exposure": {name: _distributions(spread[name], more[name]) for name in spread},
        "detector_coverage": _with_counts(one["detector_coverage"], other["detector_coverage"], "counts", "detected"),
        "radial_coverage": _with_counts(one["radial_coverage"], other["radial_coverage"], "counts")
        | {"largest_radius_px": _largest(*(part["radial_coverage"]["largest_radius_px"] for part in (one, other)))},
        "magnitudes": _magnitudes(one["magnitudes"], other["magnitudes"]),
        "temperature_c": _temperatures(one["temperature_c"], other["temperature_c"]),
    }


def _distributions(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Add the numbers of exposures that have so many stars."""
    stars, place = np.unique(one["stars"] + other["stars"], return_inverse=True)
    return distribution(stars, np.bincount(place, one["exposures"] + other["exposures"]).astype(np.int64))


def _with_counts(one: dict[str, Any], other: dict[str, Any], *names: str) -> dict[str, Any]:
    """Add histograms of the same edges."""
    return one | {name: (np.array(one[name]) + np.array(other[name])).tolist() for name in names}


def _magnitudes(one: dict[str, Any] | None, other: dict[str, Any] | None) -> dict[str, Any] | None:
    """Add histograms whose edges are whole steps."""
    if one is None or other is None:
        return one or other
    low = min(one["edges"][0], other["edges"][0])
    high = max(one["edges"][-1], other["edges"][-1])
    edges = low + MAGNITUDE_STEP * np.arange(round((high - low) / MAGNITUDE_STEP) + 1)
    counts = np.zeros(len(edges) - 1, np.int64)
    for part in (one, other):
        first = round((part["edges"][0] - low) / MAGNITUDE_STEP)
        counts[first : first + len(part["counts"])] += part["counts"]
    return {
        "edges": edges.tolist(),
        "counts": counts.tolist(),
        "brightest": min(one["brightest"], other["brightest"]),
        "faintest": max(one["faintest"], other["faintest"]),
    }


def _temperatures(one: dict[str, float] | None, other: dict[str, float] | None) -> dict[str, float] | None:
    """The range of both."""
    if one is None or other is None:
        return one or other
    return {"smallest": min(one["smallest"], other["smallest"]), "largest": max(one["largest"], other["largest"])}


def _largest(*values: float | None) -> float | None:
    """The largest of what is there."""
    return max((value for value in values if value is not None), default=None)
