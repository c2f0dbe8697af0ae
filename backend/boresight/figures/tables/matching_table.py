"""What matching did, as page and report print it: counts, reasons, and what the flight code would have accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.figures.chart import Result
from boresight.figures.charts.shadow import shown
from boresight.verdicts.numbers import MISSING, NARROW_SPACE, count, fixed, number, percent, urad

COUNTS = (
    ("Given", "given", "identified in the telemetry"),
    ("Kept", "kept", "of them, still the same star"),
    ("Removed", "removed", "of them, unmatched or of another star"),
    ("Added", "added", "found by Boresight"),
    ("Matched", "matched", "used in the end"),
)
REASONS = (
    ("Where attitudes came from", "exposures", "starts"),
    ("Stars that were not matched", "stars", "row_reasons"),
    ("Given matches that were taken back", "stars", "removed_reasons"),
    ("Exposures that were not valid", "exposures", "exposure_reasons"),
)
VALID = "valid"  # the reason of an exposure that needs none
ENDS = ("initial", "final")
FLAGGED = (("doubles", "doubles"), ("unreliable", "of unreliable astrometry"), ("left_out", "left out"))


@dataclass(frozen=True)
class Reasons:
    """Phrases with their counts, the commonest first."""

    title: str
    unit: str
    rows: Sequence[tuple[str, int]]


@dataclass(frozen=True)
class FlightRow:
    """One measure of a set before and after, each with its 95 % interval where there is one."""

    whose: str
    name: str
    initial: str
    final: str


def match_counts(matching: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """List the counts of matches: name, number, what it counts."""
    return [(name, count(matching.get(key)), meaning) for name, key, meaning in COUNTS]


def match_facts(matching: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List what else there is to know: cycles, tolerance, flagged stars."""
    cycles = matching.get("cycles") or ()
    tolerance = matching.get("tolerance_px") or {}
    flagged = matching.get("flagged") or {}
    said = ", ".join(f"{count(flagged[key])} {word}" for key, word in FLAGGED if flagged.get(key) is not None)
    tolerances = f"{number(tolerance.get('median'), 3)} px, 95 % below {number(tolerance.get('p95'), 3)} px"
    rest = "the matches rested" if matching.get("rested") else "the matches had not rested"
    renamed = count(matching.get("renamed"))
    return [
        ("Cycles", f"{len(cycles)}: {rest}" if cycles else MISSING),
        ("Given another star", renamed),
        ("Median tolerance", tolerances if tolerance else MISSING),
        ("Flagged in the catalogue", said or MISSING),
    ]


def reason_tables(matching: Mapping[str, Any]) -> list[Reasons]:
    """List starts and reasons, the commonest first; those that never occurred are left out."""
    tables = []
    for title, unit, key in REASONS:
        found = [(phrase, times) for phrase, times in (matching.get(key) or {}).items() if times and phrase != VALID]
        if found:
            tables.append(Reasons(title, unit, sorted(found, key=lambda row: -row[1])))
    return tables


def flight_rows(result: Result) -> list[FlightRow]:
    """List availability, matched stars and error before and after, of the calibration and of the validation set."""
    rows = [
        *_flight_rows("Calibration set", _scores(result)),
        *_flight_rows("Validation set", result.get("validation") or {}),
    ]
    return [row for row in rows if (row.initial, row.final) != (MISSING, MISSING)]


def _scores(result: Result) -> Mapping[str, Any]:
    """Read the scores of the calibration set, with intervals where they were resampled."""
    return result.get("evaluation") or (result.get("matching") or {}).get("flight") or {}


def _flight_rows(whose: str, measured: Mapping[str, Any]) -> list[FlightRow]:
    intervals = measured.get("intervals") or {}
    available, stars, rms = (measured.get(key) or {} for key in ("availability", "matched_stars", "rms_arc_rad"))
    reach, rms_reach = (intervals.get(key) or {} for key in ("availability", "rms_arc_rad"))
    ratio = measured.get("matched_star_ratio")
    if ratio is None and stars.get("initial"):
        ratio = (stars.get("final") or 0) / stars["initial"]
    return [
        FlightRow(whose, "Frames available", *(_share(available.get(k), reach.get(k)) for k in ENDS)),
        FlightRow(whose, "Stars matched", *(count(stars.get(k)) for k in ENDS)),
        FlightRow(whose, "Matched star ratio", MISSING, _ratio(ratio, intervals.get("matched_star_ratio"))),
        FlightRow(whose, "RMS arc (µrad)", *(_error(rms.get(k), rms_reach.get(k)) for k in ENDS)),
    ]


def _within(reach: Sequence[float] | None, factor: float, decimals: int) -> str:
    """Print a 95 % interval in brackets; nothing where there is none."""
    if not reach or None in reach:
        return ""
    return f" ({fixed(factor * reach[0], decimals)} to {fixed(factor * reach[1], decimals)})"


def _share(value: Any, reach: Sequence[float] | None) -> str:
    return f"{percent(value)}{_within(reach, 100, 1)}" if value is not None else MISSING


def _ratio(value: Any, reach: Sequence[float] | None) -> str:
    return f"{fixed(value, 2)}{_within(reach, 1, 2)}" if value is not None else MISSING


def _error(value_rad: Any, reach: Sequence[float] | None) -> str:
    return f"{fixed(1e6 * value_rad, 1)}{_within(reach, 1e6, 1)}" if value_rad is not None else MISSING


def flight_tolerance(result: Result) -> str:
    """Print the tolerance at which the flight code accepts an arc, with its unit."""
    scores = _scores(result)
    tolerance_rad = scores.get("flight_tolerance_rad", scores.get("tolerance_rad"))
    return f"{urad(tolerance_rad, 3)}{NARROW_SPACE}µrad" if tolerance_rad is not None else MISSING


def side_by_side(result: Result) -> str:
    """Say in a sentence what baseline and candidate would each lose; empty where they were not set side by side."""
    found = shown(result)
    return str(found[1]["summary"].get("sentence") or "") if found else ""
