"""The tables of a calibration as pages, reports and terminals print them: parameters, matches, stars.

`delta / sigma` says whether the change can be seen in the noise, `delta / typical` whether it is a change that such a
sensor is known to make: forty sigma and three typical sigmas is a real and ordinary one, forty and ninety is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from decimal import Decimal
from typing import Any

from boresight.calibration.result import Result
from boresight.cameras import CAMERA_MODELS
from boresight.verdicts.numbers import (
    MINUS,
    MISSING,
    NARROW_SPACE,
    Quantity,
    count,
    fixed,
    number,
    percent,
    quantity,
    to_second_digit,
    urad,
)
from boresight.verdicts.verdict import read_part

# The six sensors of E Table III moved by up to 9.8: more asks for a look at the matches.
UNEXPECTED_TYPICAL_SIGMAS = 10.0
FAR_SIGMAS = 4.0  # of the eight parameters of an honest run one in 2,000 is so far from the truth


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of a result; values are SI, None where nothing was estimated.

    `old`, `new`, `delta`, `sigma`: In the parameter's SI unit.
    """

    name: str
    old: float | None
    new: float | None
    delta: float | None
    sigma: float | None
    typical_sigma: float | None
    truth: float | None

    @property
    def estimated(self) -> bool:
        """Tell whether this run estimated the parameter."""
        return self.sigma is not None

    @property
    def delta_over_sigma(self) -> float | None:
        """Return the change in sigmas."""
        return _ratio(self.delta, self.sigma)

    @property
    def delta_over_typical(self) -> float | None:
        """Return the change in unit-to-unit sigmas."""
        return _ratio(self.delta, self.typical_sigma)

    @property
    def error_over_sigma(self) -> float | None:
        """Return how many sigmas the estimate is off the truth."""
        return _ratio(_difference(self.new, self.truth), self.sigma)

    @property
    def off_truth(self) -> bool:
        """Tell whether the estimate is farther from the truth than its sigma allows."""
        off = self.error_over_sigma
        return off is not None and abs(off) > FAR_SIGMAS

    @property
    def unexpected(self) -> bool:
        """Tell whether the change is larger than such sensors are known to make."""
        worth = self.delta_over_typical
        return worth is not None and abs(worth) > UNEXPECTED_TYPICAL_SIGMAS


def _difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


def _ratio(value: float | None, scale: float | None) -> float | None:
    return None if value is None or not scale else value / scale


def parameter_rows(result: Mapping[str, Any]) -> list[ParameterRow]:
    """Lay out every parameter of a calibration JSON, in model order."""
    old, new, sigma = (result.get(key) or {} for key in ("initial", "parameters", "sigma"))
    model = CAMERA_MODELS.get(str(result.get("camera_model")))
    typical, truth = (result.get(key) or {} for key in ("typical_sigma", "truth"))
    return [
        ParameterRow(
            name=name,
            old=old.get(name),
            new=new[name],
            delta=_difference(new[name], old.get(name)),
            sigma=sigma.get(name),
            typical_sigma=typical.get(name),
            truth=truth.get(name),
        )
        for name in (model.parameter_names if model else new)
        if name in new
    ]


def set_rows(
    document: Mapping[str, Any], incumbent: Mapping[str, Any] | None, sensor: Mapping[str, Any]
) -> list[ParameterRow]:
    """Lay out a parameter set's values against the set it replaces, on the scale of its sensor's typical sigmas."""
    old = (incumbent or {}).get("parameters") or {}
    return parameter_rows({**document, "initial": old, "typical_sigma": sensor.get("typical_sigma")})


LARGE = 1e5  # the width of a terminal's column
HEADINGS = ("parameter", "unit", "initial", "final", "change", "sigma", "unit", "change / sigma", "typical sigmas")


@dataclass(frozen=True)
class PrintedRow:
    """One parameter, ready to print; the first unit is of the values, the second of change and sigma."""

    symbol: str
    unit: str
    initial: str
    final: str
    change: str
    sigma: str
    change_unit: str
    worth: str
    typical: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The row under `HEADINGS`."""
        return astuple(self)


def printed_rows(result: Result) -> list[PrintedRow]:
    """Print every parameter of a result, in model order."""
    return [_printed(row, quantity(row.name, result)) for row in parameter_rows(result)]


def _printed(row: ParameterRow, item: Quantity) -> PrintedRow:
    known, change_sigma = _scaled(row.sigma, item.factor), _scaled(row.sigma, item.change_factor)
    return PrintedRow(
        symbol=item.symbol,
        unit=item.unit,
        initial=digits(_scaled(row.old, item.factor), known),
        final=digits(_scaled(row.new, item.factor), known),
        change=_changed(_scaled(row.delta, item.change_factor), change_sigma),
        sigma=digits(change_sigma, change_sigma),
        change_unit=item.change_unit,
        worth=_signed(row.delta_over_sigma),
        typical=_signed(row.delta_over_typical) if row.estimated else MISSING,
    )


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def digits(value: float | None, sigma: float | None) -> str:
    """Print a value to the second significant digit of its sigma; six significant digits where there is none."""
    if value is None:
        return MISSING
    if not sigma or not math.isfinite(sigma):
        return f"{value:.6g}".replace("-", MINUS)
    text = to_second_digit(value, sigma, LARGE)
    return (text if "e" in text else f"{Decimal(text):,}").replace("-", MINUS)


def _changed(change: float | None, sigma: float | None) -> str:
    text = digits(change, sigma)
    return text if change is None or change < 0 or sigma is None else f"+{text}"


def _signed(value: float | None) -> str:
    return MISSING if value is None else f"{value:+,.1f}".replace("-", MINUS)


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
        FlightRow(whose, "Matched star ratio", MISSING, _printed_ratio(ratio, intervals.get("matched_star_ratio"))),
        FlightRow(whose, "RMS arc (µrad)", *(_error(rms.get(k), rms_reach.get(k)) for k in ENDS)),
    ]


def _within(reach: Sequence[float] | None, factor: float, decimals: int) -> str:
    """Print a 95 % interval in brackets; nothing where there is none."""
    if not reach or None in reach:
        return ""
    return f" ({fixed(factor * reach[0], decimals)} to {fixed(factor * reach[1], decimals)})"


def _share(value: Any, reach: Sequence[float] | None) -> str:
    return f"{percent(value)}{_within(reach, 100, 1)}" if value is not None else MISSING


def _printed_ratio(value: Any, reach: Sequence[float] | None) -> str:
    return f"{fixed(value, 2)}{_within(reach, 1, 2)}" if value is not None else MISSING


def _error(value_rad: Any, reach: Sequence[float] | None) -> str:
    return f"{fixed(1e6 * value_rad, 1)}{_within(reach, 1e6, 1)}" if value_rad is not None else MISSING


def flight_tolerance(result: Result) -> str:
    """Print the tolerance at which the flight code accepts an arc, with its unit."""
    scores = _scores(result)
    tolerance_rad = scores.get("flight_tolerance_rad", scores.get("tolerance_rad"))
    return f"{urad(tolerance_rad, 3)}{NARROW_SPACE}µrad" if tolerance_rad is not None else MISSING


def shown(result: Result) -> tuple[str, Mapping[str, Any]] | None:
    """Return which set is shown side by side under baseline and candidate, and its view; None where there is none.

    The validation set where the run has one, for it took no part in the estimate; else the calibration set.
    """
    shadow = result.get("shadow") or {}
    sets = ("validation", "calibration")
    return next(((name, shadow[name]) for name in sets if (shadow.get(name) or {}).get("frames")), None)


def side_by_side(result: Result) -> str:
    """Say in a sentence what baseline and candidate would each lose; empty where they were not set side by side."""
    found = shown(result)
    return str(found[1]["summary"].get("sentence") or "") if found else ""


@dataclass(frozen=True)
class StarRow:
    """One star: its Hipparcos number, how often it was seen, and its residual."""

    star_id: int
    sightings: int | None
    mean_px: float | None
    rms_px: float | None
    z: float | None
    suspect: bool
    flags: str

    @property
    def numbers(self) -> tuple[float | str, ...]:
        """What the columns of `cells` are sorted by; an empty word where there is no number."""
        return tuple("" if n is None else n for n in (self.sightings, self.mean_px, self.rms_px, abs(self.z or 0.0)))

    @property
    def cells(self) -> tuple[str, ...]:
        """The numbers as they are printed, after the star's own."""
        return count(self.sightings), fixed(self.mean_px, 3), fixed(self.rms_px, 3), fixed(self.z, 1)


def star_rows(result: Result) -> list[StarRow]:
    """Read the stars of a result, worst first; none where they were not examined."""
    return [
        StarRow(
            star_id=row["star_id"],
            sightings=row.get("sightings"),
            mean_px=row.get("mean_residual_px"),
            rms_px=row.get("rms_px"),
            z=row.get("z"),
            suspect=bool(row.get("suspect")),
            flags=", ".join(map(str, row.get("flags") or ())),
        )
        for row in read_part(result, "stars") or ()
    ]


def to_flag(result: Result) -> str:
    """List the suspects' Hipparcos numbers, ready to paste; empty where there are none."""
    return ", ".join(str(star) for star in (result.get("trust") or {}).get("suspects") or ())
