"""What matching did, as page and report print it: counts, reasons, and what the flight code would have accepted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.figures.chart import Result
from boresight.figures.numbers import MISSING, NARROW_SPACE, count, fixed, number, percent, urad

COUNTS = (
    ("Given", "given", "identified in the telemetry"),
    ("Kept", "kept", "of them, still the same star"),
    ("Removed", "removed", "of them, no longer matched"),
    ("Added", "added", "found by Boresight"),
    ("Matched", "matched", "used in the end"),
)
REASONS = (
    ("Where attitudes came from", "exposures", "starts"),
    ("Stars that were not matched", "stars", "row_reasons"),
    ("Exposures that were not valid", "exposures", "exposure_reasons"),
)
FLAGGED = (("doubles", "doubles"), ("unreliable", "of unreliable astrometry"), ("left_out", "left out"))


@dataclass(frozen=True)
class Reasons:
    """Phrases with their counts, the commonest first."""

    title: str
    unit: str
    rows: Sequence[tuple[str, int]]


@dataclass(frozen=True)
class FlightRow:
    """One measure before and after, each with its 95 % interval where there is one."""

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
    return [
        ("Cycles", f"{len(cycles)}: {rest}" if cycles else MISSING),
        ("Median tolerance", tolerances if tolerance else MISSING),
        ("Flagged in the catalogue", said or MISSING),
    ]


def reason_tables(matching: Mapping[str, Any]) -> list[Reasons]:
    """List starts and reasons, the commonest first; those that never occurred are left out."""
    tables = []
    for title, unit, key in REASONS:
        found = [(phrase, times) for phrase, times in (matching.get(key) or {}).items() if times]
        if found:
            tables.append(Reasons(title, unit, sorted(found, key=lambda row: -row[1])))
    return tables


def flight_rows(result: Result) -> list[FlightRow]:
    """List availability and matched stars before and after, of the calibration and of the validation set."""
    flight = (result.get("matching") or {}).get("flight") or {}
    validation = result.get("validation") or {}
    rows = [*_flight_rows("Calibration", flight), *_flight_rows("Validation", validation)]
    return [row for row in rows if (row.initial, row.final) != (MISSING, MISSING)]


def _flight_rows(whose: str, measured: Mapping[str, Any]) -> list[FlightRow]:
    intervals = measured.get("intervals") or {}
    available, stars = measured.get("availability") or {}, measured.get("matched_stars") or {}
    reach = intervals.get("availability") or {}
    ratio = measured.get("matched_star_ratio")
    if ratio is None and stars.get("initial"):
        ratio = (stars.get("final") or 0) / stars["initial"]
    return [
        FlightRow(f"{whose} frames available", *(_share(available.get(k), reach.get(k)) for k in ("initial", "final"))),
        FlightRow(f"{whose} stars matched", *(count(stars.get(key)) for key in ("initial", "final"))),
        FlightRow(f"{whose} matched star ratio", MISSING, _ratio(ratio, intervals.get("matched_star_ratio"))),
    ]


def _share(value: Any, reach: Sequence[float] | None) -> str:
    bounds = f" ({fixed(100 * reach[0], 1)} to {fixed(100 * reach[1], 1)})" if reach and None not in reach else ""
    return f"{percent(value)}{bounds}" if value is not None else MISSING


def _ratio(value: Any, reach: Sequence[float] | None) -> str:
    bounds = f" ({fixed(reach[0], 2)} to {fixed(reach[1], 2)})" if reach and None not in reach else ""
    return f"{fixed(value, 2)}{bounds}" if value is not None else MISSING


def flight_tolerance(matching: Mapping[str, Any]) -> str:
    """Print the tolerance at which the flight code accepts an arc, with its unit."""
    tolerance_rad = (matching.get("flight") or {}).get("tolerance_rad")
    return f"{urad(tolerance_rad, 3)}{NARROW_SPACE}µrad" if tolerance_rad is not None else MISSING
