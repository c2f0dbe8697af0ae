"""The quality report of a telemetry set: what an operator should know before a run, as a JSON-able document.

::

    schema              "boresight.quality/1"
    verdict             NORMAL | CAUTION | SERIOUS, the worst of the findings
    warnings            sentences of the findings that are not NORMAL, worst first
    findings            [{code, severity, sentence, count, rows}], worst first; rows are the first 20, as an editor counts
    frames exposures stars matched unmatched unmatched_share usable
                        counts; usable = can take part in a calibration
    usable_exposures usable_frames
                        exposures with four usable stars or more, and frames with such an exposure
    time                {start_utc, end_utc, span_s, median_interval_s, gap_count,
                        gaps [{row, frame, seconds}] (first 20; row and frame after the gap)} or null
    stars_per_exposure  {detected, usable}, each {smallest, median, largest, stars[], exposures[] with so many}
    detector_coverage   {row_edges_px, col_edges_px, counts} of usable stars, `detected` the same of all detections
    radial_coverage     {edges_px, counts, largest_radius_px, corner_radius_px} of usable stars, from the detector's centre
    magnitudes          {edges, counts, brightest, faintest} or null
    unknown_ids         {count, ids (first 20)} or null without a catalogue
    repeats             {stars, centroids} rows that repeat one of their exposure
    out_of_order        rows at which the frame number descends
    off_detector        rows
    stars_off_detector  {stars, farthest_px, rows [{row, frame, exposure, star_id, off_px}]} matched stars that are left out for
                        it; rows are the first 20
    temperature_c       {smallest, largest} or null
    diagnosis           "boresight.diagnosis/1" of a set whose names do not suffice, else absent
    unknown_columns     names

The quality report of a set that comes in parts: of all of it what can be added up, and findings of what can be held.

Counts, times, gaps, stars an exposure, coverage, magnitudes and temperatures are those of the whole set, whatever its size, for
parts are whole frames and these add up. Findings look across the set (a hot pixel returns, a brightness is off the median), so
they are taken of rows in memory: of all of them up to `MOST_ROWS`, and of a larger set of whole stretches spread evenly over
it. Which stretches is decided on the way: when there are too many, every second one is let go, and from then on only every
second, fourth, ... is kept. The report of such a set says so in a finding of its own (`PART_OF_THE_SET`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.estimation import MINIMUM_STARS
from boresight.telemetry.quality.detector import OffDetector, detector_coverage, radial_coverage
from boresight.telemetry.quality.findings import FINDINGS, SEVERITIES, Finding
from boresight.telemetry.quality.findings.centroids import off_detector_finding
from boresight.telemetry.quality.findings.columns import gaps_finding
from boresight.telemetry.quality.inputs import QualityInputs, StarNumbers
from boresight.telemetry.sampling import Intervals, compute_intervals, compute_sampling
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.sensors import Sensor

MOST_LISTED = 20
MAGNITUDE_STEP = 0.5


@dataclass(frozen=True, kw_only=True)
class Gap:
    """A gap in time, by the row and frame after it."""

    row: int
    frame: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class TimeSpan:
    """From when to when a set was taken, and the gaps in it, the first of them listed."""

    start_utc: str
    end_utc: str
    span_s: float | None = None
    median_interval_s: float | None = None
    gap_count: int = 0
    gaps: list[Gap] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Extremes:
    """The smallest and the largest of numbers."""

    smallest: float
    largest: float


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """How many exposures have so many stars."""

    smallest: int
    median: float
    largest: int
    stars: list[int]
    exposures: list[int]


@dataclass(frozen=True, kw_only=True)
class StarsPerExposure:
    """Stars in an exposure, all and those that can take part."""

    detected: Distribution
    usable: Distribution


@dataclass(frozen=True, kw_only=True)
class DetectorCoverage:
    """Usable stars in cells of the detector, and all detections in the same cells."""

    row_edges_px: list[float]
    col_edges_px: list[float]
    counts: list[list[int]]
    detected: list[list[int]] | None = None


@dataclass(frozen=True, kw_only=True)
class RadialCoverage:
    """Usable stars by their distance from the detector's centre."""

    edges_px: list[float]
    counts: list[int]
    largest_radius_px: float | None = None
    corner_radius_px: float | None = None


@dataclass(frozen=True, kw_only=True)
class Magnitudes:
    """Detections by magnitude."""

    edges: list[float]
    counts: list[int]
    brightest: float | None = None
    faintest: float | None = None


@dataclass(frozen=True, kw_only=True)
class UnknownIds:
    """Star numbers that the catalogue does not have, the first of them listed."""

    count: int
    ids: list[int] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class QualityReport:
    """The report as it is read again, see the top of this file; what an older one does not say is None or empty."""

    verdict: str | None = None
    warnings: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    frames: int | None = None
    exposures: int | None = None
    stars: int | None = None
    matched: int | None = None
    unmatched_share: float | None = None
    usable: int | None = None
    usable_exposures: int | None = None
    usable_frames: int | None = None
    time: TimeSpan | None = None
    stars_per_exposure: StarsPerExposure | None = None
    detector_coverage: DetectorCoverage | None = None
    radial_coverage: RadialCoverage | None = None
    magnitudes: Magnitudes | None = None
    unknown_ids: UnknownIds | None = None
    off_detector: int | None = None
    temperature_c: Extremes | None = None
    unknown_columns: list[str] = field(default_factory=list)
    diagnosis: dict[str, Any] | None = None


def quality_report(telemetry: Telemetry, sensor: Sensor, catalogue: StarNumbers | None = None) -> dict[str, Any]:
    """Report on a telemetry set."""
    inputs = QualityInputs(telemetry, sensor, catalogue)
    off = inputs.off_detector
    return make_document(list_findings(inputs), compute_totals(inputs), _time(inputs), _unknown_ids(inputs), off)


def make_document(
    findings: list[Finding],
    totals: dict[str, Any],
    time: dict[str, Any] | None,
    unknown_ids: dict[str, Any] | None,
    off: OffDetector,
) -> dict[str, Any]:
    """Put a report together from its parts, see the module docstring."""
    by_code = {finding.code: finding.count for finding in findings}
    return {
        "schema": "boresight.quality/1",
        "verdict": max((finding.severity for finding in findings), key=SEVERITIES.index, default=SEVERITIES[0]),
        "warnings": [finding.sentence for finding in findings if finding.severity != SEVERITIES[0]],
        "findings": [finding.document() for finding in findings],
        **totals,
        "time": time,
        "unknown_ids": unknown_ids,
        "repeats": {"stars": by_code.get("REPEATED_STARS", 0), "centroids": by_code.get("REPEATED_CENTROIDS", 0)},
        "out_of_order": by_code.get("FRAME_ORDER", 0),
        "stars_off_detector": off.document(),
    }


def put_finding_first(document: Mapping[str, Any], finding: Finding, without: Collection[str]) -> dict[str, Any]:
    """Return a report with a finding more, first of its severity, and without those of some codes."""
    kept = [one for one in document["findings"] if one["code"] not in without]
    found = sorted([finding.document(), *kept], key=lambda one: -SEVERITIES.index(one["severity"]))
    return {
        **document,
        "verdict": max((one["severity"] for one in found), key=SEVERITIES.index),
        "warnings": [one["sentence"] for one in found if one["severity"] != SEVERITIES[0]],
        "findings": found,
    }


def compute_totals(inputs: QualityInputs) -> dict[str, Any]:
    """Return what of a report adds up over parts of whole frames, see `QualityParts`."""
    telemetry, sensor = inputs.telemetry, inputs.sensor
    return {
        **_counts(inputs),
        "stars_per_exposure": {
            "detected": distribution(*np.unique(inputs.exposures.count, return_counts=True)),
            "usable": distribution(*np.unique(inputs.usable_per_exposure, return_counts=True)),
        },
        "detector_coverage": _coverage(inputs),
        "radial_coverage": radial_coverage(telemetry, sensor, inputs.usable),
        "magnitudes": _magnitudes(telemetry.magnitude),
        "off_detector": int(np.count_nonzero(~inputs.on_detector)),
        "temperature_c": _range(telemetry.temperature_c),
        "unknown_columns": list(telemetry.unknown),
    }


def list_findings(inputs: QualityInputs) -> list[Finding]:
    """Return what was found, the worst first, else in the registry's order."""
    found = [finding for look in FINDINGS if (finding := look(inputs)) is not None]
    return worst_first(found)


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Return findings by their severity, else in their order."""
    return sorted(findings, key=lambda finding: -SEVERITIES.index(finding.severity))


def _counts(inputs: QualityInputs) -> dict[str, Any]:
    rows, matched = len(inputs.telemetry), int(inputs.matched.sum())
    full = inputs.usable_per_exposure >= MINIMUM_STARS
    return {
        "frames": len(np.unique(inputs.telemetry.frame)),
        "exposures": len(inputs.exposures),
        "stars": rows,
        "matched": matched,
        "unmatched": rows - matched,
        "unmatched_share": (rows - matched) / rows if rows else 0.0,
        "usable": int(inputs.usable.sum()),
        "usable_exposures": int(full.sum()),
        "usable_frames": len(np.unique(inputs.exposures.frame[full])),
    }


def _time(inputs: QualityInputs) -> dict[str, Any] | None:
    """Return span, interval and gaps; None when no row has a time."""
    sampling = compute_sampling(inputs)
    time_utc = inputs.telemetry.time_utc
    if sampling is None or time_utc is None:
        return None
    timed = time_utc[~inputs.untimed]
    after = sampling.entry[sampling.gaps + 1][:MOST_LISTED]
    intervals = (sampling.interval_s, sampling.median_s, sampling.gaps)
    rows, frames = after + inputs.telemetry.first_row, inputs.telemetry.frame[after]
    return time_document(timed.min(), timed.max(), intervals, rows, frames)


def time_document(
    start: np.datetime64, end: np.datetime64, intervals: Intervals, rows: IntArray, frames: IntArray
) -> dict[str, Any]:
    """Return the `time` of a report; rows and frames (n_listed,) are those after the first gaps."""
    interval_s, median_s, gaps = intervals
    listed = zip(rows.tolist(), frames.tolist(), interval_s[gaps].tolist(), strict=False)
    return {
        "start_utc": f"{start}Z",
        "end_utc": f"{end}Z",
        "span_s": float((end - start) / np.timedelta64(1, "s")),
        "median_interval_s": median_s,
        "gap_count": len(gaps),
        "gaps": [{"row": row, "frame": frame, "seconds": seconds} for row, frame, seconds in listed],
    }


def distribution(stars: IntArray, exposures: IntArray) -> dict[str, Any]:
    """Return how numbers of stars are distributed: (n,) numbers, ascending, and (n,) exposures with so many."""
    ends = np.cumsum(exposures)
    middle = [int(np.searchsorted(ends, place, side="right")) for place in ((ends[-1] - 1) // 2, ends[-1] // 2)]
    return {
        "smallest": int(stars[0]),
        "median": float(np.mean(stars[middle])),
        "largest": int(stars[-1]),
        "stars": stars.tolist(),
        "exposures": exposures.tolist(),
    }


def _coverage(inputs: QualityInputs) -> dict[str, Any]:
    """Return the usable stars in cells of the detector, and all detections in the same cells."""
    every = np.ones(len(inputs.telemetry), dtype=np.bool_)
    detected = detector_coverage(inputs.telemetry, inputs.sensor, every)["counts"]
    return detector_coverage(inputs.telemetry, inputs.sensor, inputs.usable) | {"detected": detected}


def _magnitudes(magnitude: FloatArray | None) -> dict[str, Any] | None:
    """Return the histogram of believable magnitudes in half magnitudes; None when there are none."""
    if magnitude is None:
        return None
    believable = magnitude[(magnitude >= -2.0) & (magnitude <= 20.0)]
    if not len(believable):
        return None
    low = np.floor(believable.min() / MAGNITUDE_STEP) * MAGNITUDE_STEP
    bins = int((believable.max() - low) / MAGNITUDE_STEP) + 1
    counts, edges = np.histogram(believable, bins=bins, range=(low, low + bins * MAGNITUDE_STEP))
    return {
        "edges": edges.tolist(),
        "counts": counts.tolist(),
        "brightest": float(believable.min()),
        "faintest": float(believable.max()),
    }


def _unknown_ids(inputs: QualityInputs) -> dict[str, Any] | None:
    """Return how many different numbers the catalogue does not have, and the first of them; None if nobody can say."""
    if inputs.catalogue is None or inputs.telemetry.star_id is None:
        return None
    ids = np.unique(inputs.telemetry.star_id[inputs.unknown])
    return {"count": len(ids), "ids": ids[:MOST_LISTED].tolist()}


def _range(values: FloatArray | None) -> dict[str, float] | None:
    if values is None or np.isnan(values).all():
        return None
    return {"smallest": float(np.nanmin(values)), "largest": float(np.nanmax(values))}


#: Rows held in memory for the findings; about 150 MB.
MOST_ROWS = 1_000_000


class QualityParts:
    """A quality report on its way."""

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
        inputs = QualityInputs(part, self._sensor, self._catalogue)
        self._frames.add(inputs)
        self._off.absorb(inputs.off_detector)
        totals = compute_totals(inputs)
        self._totals = totals if self._totals is None else _added(self._totals, totals)
        if inputs.index is not None and part.star_id is not None:
            self._unknown_ids = np.union1d(self._unknown_ids, part.star_id[inputs.unknown])
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
        inputs = QualityInputs(telemetry, self._sensor, self._catalogue, rows)
        found = [finding for finding in list_findings(inputs) if finding.code not in {"GAPS", "OFF_DETECTOR"}]
        of_all = (self._frames.gaps(), off_detector_finding(self._off, self._sensor))
        found += [self._report_part(telemetry), *(finding for finding in of_all if finding is not None)]
        ids = self._unknown_ids
        unknown = {"count": len(ids), "ids": ids[:MOST_LISTED].tolist()} if inputs.index is not None else None
        return make_document(worst_first(found), self._totals, self._frames.document(), unknown, self._off)

    def _report_part(self, looked_at: Telemetry) -> Finding:
        """Say of how much of the set the findings are."""
        frames, of = len(np.unique(looked_at.frame)), 0 if self._totals is None else self._totals["frames"]
        sentence = (
            f"Findings are based on {frames:,} of {of:,} frames, in stretches spread evenly over the set, and counts refer to "
            "these frames; totals, times and coverage use all frames."
        )
        return Finding("PART_OF_THE_SET", "NORMAL", sentence, frames)


class _FrameTimes:
    """When the frames of a set were taken, put together part by part."""

    def __init__(self) -> None:
        self._time: list[NDArray[np.datetime64]] = []
        self._row: list[IntArray] = []
        self._frame: list[IntArray] = []
        self._span: list[np.datetime64] = []

    def add(self, inputs: QualityInputs) -> None:
        """Take the first time of every frame of a part."""
        time_utc, telemetry = inputs.telemetry.time_utc, inputs.telemetry
        timed = np.flatnonzero(~inputs.untimed)
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
        intervals = compute_intervals(np.concatenate(self._time))
        return gaps_finding(intervals, tuple(np.concatenate(self._row)[intervals[2] + 1][:MOST_LISTED].tolist()))

    def document(self) -> dict[str, Any] | None:
        """The `time` of the report."""
        if not self._time:
            return None
        intervals = compute_intervals(np.concatenate(self._time))
        after = intervals[2][:MOST_LISTED] + 1
        row, frame = (np.concatenate(values)[after] for values in (self._row, self._frame))
        return time_document(self._span[0], self._span[1], intervals, row, frame)


def _added(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Add the totals of two sets of frames, see `compute_totals`."""
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
        "magnitudes": _magnitudes_of_both(one["magnitudes"], other["magnitudes"]),
        "temperature_c": _temperatures(one["temperature_c"], other["temperature_c"]),
    }


def _distributions(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Add the numbers of exposures that have so many stars."""
    stars, place = np.unique(one["stars"] + other["stars"], return_inverse=True)
    return distribution(stars, np.bincount(place, one["exposures"] + other["exposures"]).astype(np.int64))


def _with_counts(one: dict[str, Any], other: dict[str, Any], *names: str) -> dict[str, Any]:
    """Add histograms of the same edges."""
    return one | {name: (np.array(one[name]) + np.array(other[name])).tolist() for name in names}


def _magnitudes_of_both(one: dict[str, Any] | None, other: dict[str, Any] | None) -> dict[str, Any] | None:
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
    if one is None or other is None:
        return one or other
    return {"smallest": min(one["smallest"], other["smallest"]), "largest": max(one["largest"], other["largest"])}


def _largest(*values: float | None) -> float | None:
    """The largest of what is there."""
    return max((value for value in values if value is not None), default=None)
