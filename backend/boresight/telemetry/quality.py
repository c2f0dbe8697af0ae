"""The quality report of a telemetry set: what an operator should know before a run, as a JSON-able document.

::

    schema              "boresight.quality/1"
    verdict             NORMAL | CAUTION | SERIOUS, the worst of the findings
    warnings            sentences of the findings that are not NORMAL, worst first
    findings            [{code, severity, sentence, count, rows}], worst first; rows are the first 20, as an editor counts
    frames exposures stars matched unmatched unmatched_share usable
                        counts; usable = can take part in a calibration (`evidence`)
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
    unknown_columns     names
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation import MINIMUM_STARS
from boresight.telemetry.detector import OffDetector, detector_coverage, radial_coverage
from boresight.telemetry.evidence import Evidence, StarNumbers
from boresight.telemetry.findings import FINDINGS, SEVERITIES, Finding
from boresight.telemetry.sampling import Intervals, sampling_of
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

MOST_LISTED = 20
MAGNITUDE_STEP = 0.5


def quality_report(telemetry: Telemetry, sensor: Sensor, catalogue: StarNumbers | None = None) -> dict[str, Any]:
    """Report on a telemetry set.

    Parameters
    ----------
    telemetry
        The set.
    sensor
        Whose it is.
    catalogue
        Says which stars exist; None leaves unknown stars out of the report.

    Returns
    -------
    The document of the module docstring.
    """
    evidence = Evidence(telemetry, sensor, catalogue)
    off = evidence.off_detector
    return document_of(findings_of(evidence), totals_of(evidence), _time(evidence), _unknown_ids(evidence), off)


def document_of(
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


def totals_of(evidence: Evidence) -> dict[str, Any]:
    """Return what of a report adds up over parts of whole frames, see `quality_parts`."""
    telemetry, sensor = evidence.telemetry, evidence.sensor
    return {
        **_counts(evidence),
        "stars_per_exposure": {
            "detected": distribution(*np.unique(evidence.exposures.count, return_counts=True)),
            "usable": distribution(*np.unique(evidence.usable_per_exposure, return_counts=True)),
        },
        "detector_coverage": _coverage(evidence),
        "radial_coverage": radial_coverage(telemetry, sensor, evidence.usable),
        "magnitudes": _magnitudes(telemetry.magnitude),
        "off_detector": int(np.count_nonzero(~evidence.on_detector)),
        "temperature_c": _range(telemetry.temperature_c),
        "unknown_columns": list(telemetry.unknown),
    }


def findings_of(evidence: Evidence) -> list[Finding]:
    """Return what was found, the worst first, else in the registry's order."""
    found = [finding for look in FINDINGS if (finding := look(evidence)) is not None]
    return worst_first(found)


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Return findings by their severity, else in their order."""
    return sorted(findings, key=lambda finding: -SEVERITIES.index(finding.severity))


def _counts(evidence: Evidence) -> dict[str, Any]:
    rows, matched = len(evidence.telemetry), int(evidence.matched.sum())
    full = evidence.usable_per_exposure >= MINIMUM_STARS
    return {
        "frames": len(np.unique(evidence.telemetry.frame)),
        "exposures": len(evidence.exposures),
        "stars": rows,
        "matched": matched,
        "unmatched": rows - matched,
        "unmatched_share": (rows - matched) / rows if rows else 0.0,
        "usable": int(evidence.usable.sum()),
        "usable_exposures": int(full.sum()),
        "usable_frames": len(np.unique(evidence.exposures.frame[full])),
    }


def _time(evidence: Evidence) -> dict[str, Any] | None:
    """Return span, interval and gaps; None when no row has a time."""
    sampling = sampling_of(evidence)
    time_utc = evidence.telemetry.time_utc
    if sampling is None or time_utc is None:
        return None
    timed = time_utc[~evidence.untimed]
    after = sampling.entry[sampling.gaps + 1][:MOST_LISTED]
    intervals = (sampling.interval_s, sampling.median_s, sampling.gaps)
    rows, frames = after + evidence.telemetry.first_row, evidence.telemetry.frame[after]
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


def _coverage(evidence: Evidence) -> dict[str, Any]:
    """Return the usable stars in cells of the detector, and all detections in the same cells."""
    every = np.ones(len(evidence.telemetry), dtype=np.bool_)
    detected = detector_coverage(evidence.telemetry, evidence.sensor, every)["counts"]
    return detector_coverage(evidence.telemetry, evidence.sensor, evidence.usable) | {"detected": detected}


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


def _unknown_ids(evidence: Evidence) -> dict[str, Any] | None:
    """Return how many different numbers the catalogue does not have, and the first of them; None if nobody can say."""
    if evidence.catalogue is None or evidence.telemetry.star_id is None:
        return None
    ids = np.unique(evidence.telemetry.star_id[evidence.unknown])
    return {"count": len(ids), "ids": ids[:MOST_LISTED].tolist()}


def _range(values: FloatArray | None) -> dict[str, float] | None:
    if values is None or np.isnan(values).all():
        return None
    return {"smallest": float(np.nanmin(values)), "largest": float(np.nanmax(values))}
