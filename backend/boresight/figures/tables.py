"""The tables of a calibration as pages, reports and terminals print them: parameters, matches, stars.

`delta / sigma` says whether the change can be seen in the noise, `delta / typical` whether it is a change that such a
sensor is known to make: forty sigma and three typical sigmas is a real and ordinary one, forty and ninety is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

from boresight.calibration.calibration import (
    Calibration,
    Change,
    CountChange,
    Evaluation,
    EvaluationIntervals,
    IntervalChange,
    Matching,
    ProfileInterval,
    ShadowOfSet,
    TrustTest,
)
from boresight.calibration.parameter_set import ParameterSetDocument
from boresight.calibration.trust.trust_tests import KIND_OF_TEST, get_test_title
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import FAR_TYPICAL_SIGMAS
from boresight.figures.chart import Table
from boresight.verdicts.gates.measurements import sigma_of_difference
from boresight.verdicts.numbers import (
    MISSING,
    NARROW_SPACE,
    Quantity,
    count,
    find_power,
    fixed,
    grouped,
    number,
    percent,
    power,
    quantity,
    signed,
    to_second_digit,
    urad,
)

#: Numbers by the parameter's name.
Numbers = Mapping[str, float | None]
#: Smallest probability that is written out.
LEAST_PROBABILITY = 1e-12
FAR_SIGMAS = 4.0  # of the eight parameters of an honest run one in 2,000 is so far from the truth


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of a result; values are SI, None where nothing was estimated.

    `old`, `new`, `delta`, `sigma`, `sigma_with_misfit`: in the parameter's SI unit; the last is `sigma` where misfit is not known.
    `sigma_of_difference`: of a set against the one that it replaces, as the gate Parameter shift has it; else None.
    """

    name: str
    old: float | None
    new: float | None
    delta: float | None
    sigma: float | None
    sigma_with_misfit: float | None
    typical_sigma: float | None
    truth: float | None
    sigma_of_difference: float | None = None

    @property
    def estimated(self) -> bool:
        """Tell whether this run estimated the parameter."""
        return self.sigma is not None

    @property
    def power(self) -> int:
        """Return the power of ten that its numbers share on a page."""
        return power(self.name, self.old, self.new, self.delta, self.sigma_with_misfit, self.truth)

    @property
    def delta_over_sigma(self) -> float | None:
        """Return the change in sigmas, with misfit."""
        return _ratio(self.delta, self.sigma_with_misfit)

    @property
    def sigma_to_judge_by(self) -> float | None:
        """Return the sigma that the change is judged by: of the difference from another set, else with misfit."""
        return self.sigma_of_difference or self.sigma_with_misfit

    @property
    def delta_to_judge(self) -> float | None:
        """Return the change in the sigmas that it is judged by."""
        return _ratio(self.delta, self.sigma_to_judge_by)

    @property
    def delta_over_noise(self) -> float | None:
        """Return the change in sigmas of noise alone."""
        return _ratio(self.delta, self.sigma)

    @property
    def delta_over_typical(self) -> float | None:
        """Return the change in unit-to-unit sigmas."""
        return _ratio(self.delta, self.typical_sigma)

    @property
    def error_over_sigma(self) -> float | None:
        """Return how many sigmas, with misfit, the estimate is off the truth."""
        return _ratio(_difference(self.new, self.truth), self.sigma_with_misfit)

    @property
    def off_truth(self) -> bool:
        """Tell whether the estimate is farther from the truth than its sigma allows."""
        off = self.error_over_sigma
        return off is not None and abs(off) > FAR_SIGMAS

    @property
    def unexpected(self) -> bool:
        """Tell whether the change is larger than such sensors are known to make."""
        worth = self.delta_over_typical
        return worth is not None and abs(worth) > FAR_TYPICAL_SIGMAS


def _difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


def _ratio(value: float | None, scale: float | None) -> float | None:
    return None if value is None or not scale else value / scale


def parameter_rows(result: Calibration) -> list[ParameterRow]:
    """Lay out every parameter of a calibration, in model order."""
    names = _model_order(result.camera_model, result.parameters)
    sigmas = result.sigma, result.reliable_sigma
    return _lay_out(names, result.initial, result.parameters, sigmas, result.typical_sigma, result.truth or {})


def _model_order(camera_model: str, values: Numbers) -> list[str]:
    """Name the parameters that have values, in the model's order where it is known."""
    model = CAMERA_MODELS.get(camera_model)
    return [name for name in (model.parameter_names if model else values) if name in values]


def _lay_out(
    names: Sequence[str], old: Numbers, new: Numbers, sigmas: tuple[Numbers, Numbers], typical: Numbers, truth: Numbers
) -> list[ParameterRow]:
    return [
        ParameterRow(
            name=name,
            old=old.get(name),
            new=new[name],
            delta=_difference(new[name], old.get(name)),
            sigma=sigmas[0].get(name),
            sigma_with_misfit=sigmas[1].get(name),
            typical_sigma=typical.get(name),
            truth=truth.get(name),
        )
        for name in names
    ]


def set_rows(
    found: ParameterSetDocument, incumbent: ParameterSetDocument | None, typical_sigma: Mapping[str, float]
) -> list[ParameterRow]:
    """Lay out a parameter set's values against the set it replaces, on the scale of its sensor's typical sigmas."""
    old = incumbent.parameters if incumbent else {}
    names = _model_order(found.camera_model, found.parameters)
    sigmas: tuple[Numbers, Numbers] = found.sigma or {}, found.reliable_sigma
    rows = _lay_out(names, old, found.parameters, sigmas, typical_sigma, found.truth or {})
    return rows if incumbent is None else [_against(row, incumbent.reliable_sigma.get(row.name)) for row in rows]


def _against(row: ParameterRow, sigma_0: float | None) -> ParameterRow:
    """Give a row the sigma of its difference from a set with such a sigma of its own."""
    variance = (row.sigma_with_misfit or 0.0) ** 2 + (sigma_0 or 0.0) ** 2
    return replace(row, sigma_of_difference=float(sigma_of_difference(variance, row.typical_sigma or 0.0)) or None)


def most_changed(rows: Sequence[ParameterRow], most: int = 4) -> list[ParameterRow]:
    """Return the parameters that change most in the sigmas that they are judged by, the greatest change first."""
    changed = [(abs(ratio), row) for row in rows if (ratio := row.delta_to_judge)]
    return [row for _, row in sorted(changed, key=lambda pair: -pair[0])[:most]]


LARGE = 1e5  # the width of a terminal's column
HEADINGS = (
    "parameter",
    "unit",
    "initial",
    "final",
    "change",
    "± σ",
    "noise σ",
    "change / σ",
    "change / typical σ",
)


@dataclass(frozen=True)
class PrintedRow:
    """One parameter, ready to print: beside its change the sigma with misfit, then that of noise alone."""

    symbol: str
    unit: str
    initial: str
    final: str
    change: str
    with_misfit: str
    sigma: str
    worth: str
    typical: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The row under `HEADINGS`."""
        return astuple(self)


def printed_rows(result: Calibration) -> list[PrintedRow]:
    """Print every parameter of a result, in model order."""
    return [_printed(row, quantity(row.name, result)) for row in parameter_rows(result)]


def _printed(row: ParameterRow, item: Quantity) -> PrintedRow:
    old, new, delta, sigma, wide = (
        _scaled(value, item.factor) for value in (row.old, row.new, row.delta, row.sigma, row.sigma_with_misfit)
    )
    power = find_power(old, new, delta, wide, large=LARGE)
    return PrintedRow(
        symbol=item.symbol,
        unit=item.unit,
        initial=digits(old, sigma, power),
        final=digits(new, sigma, power),
        change=_changed(delta, sigma, power),
        with_misfit=digits(wide, wide, power),
        sigma=digits(sigma, sigma, power),
        worth=_signed(row.delta_over_sigma),
        typical=_signed(row.delta_over_typical) if row.estimated else MISSING,
    )


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def digits(value: float | None, sigma: float | None, power: int | None = None) -> str:
    """Print a value to the second significant digit of its sigma; six significant digits where there is none.

    `power`: that of its row; the value's own where None.
    """
    if value is None:
        return MISSING
    if not sigma or not math.isfinite(sigma):
        return grouped(f"{value:.6g}")
    return grouped(to_second_digit(value, sigma, LARGE, power))


def _changed(change: float | None, sigma: float | None, power: int) -> str:
    text = digits(change, sigma, power)
    return text if change is None or change < 0 or sigma is None else f"+{text}"


def _signed(value: float | None) -> str:
    return MISSING if value is None else f"{'+' if value > 0 else ''}{fixed(value, 1)}"


@dataclass(frozen=True)
class MinimumRow:
    """Another minimum: how far above the estimate it lies in chi-square, and its parameters in their page units."""

    above: str
    values: str


def minimum_rows(result: Calibration) -> list[MinimumRow]:
    """Lay out the minima besides the estimate, the lowest first."""
    others = result.minima.found[1:] if result.minima else []
    names = [name for name in result.parameters if name in result.free]
    return [
        MinimumRow(
            above=signed(one.chi2_above_best),
            values=", ".join(_with_unit(name, one.parameters.get(name), result) for name in names),
        )
        for one in others
    ]


def _with_unit(name: str, value: float | None, result: Calibration) -> str:
    item = quantity(name, result)
    number_of = digits(_scaled(value, item.factor), _scaled(result.sigma.get(name), item.factor))
    return f"{item.symbol} {number_of}{NARROW_SPACE + item.unit if item.unit else ''}"


@dataclass(frozen=True)
class IntervalRow:
    """Where a parameter may be by profile likelihood, beside what its sigma says, both with its unit."""

    name: str
    symbol: str
    confidence: str
    interval: str
    by_sigma: str
    unit: str


#: Sigmas on either side of an estimate that hold 95 of 100 errors, as intervals by profile likelihood do.
OF_95 = 1.96


def interval_rows(result: Calibration) -> list[IntervalRow]:
    """Lay out the intervals that are not those of the sigmas: not symmetric, in pieces, or open."""
    return [_interval_row(one, result) for one in (result.minima.intervals if result.minima else [])]


def _interval_row(one: ProfileInterval, result: Calibration) -> IntervalRow:
    item, sigma, value = quantity(one.name, result), result.sigma.get(one.name), result.parameters.get(one.name)
    known = _scaled(sigma, item.factor)

    def end(number_of: float | None) -> str:
        return digits(_scaled(number_of, item.factor), known)

    pieces = [
        f"{end(low) if low is not None else 'any'} to {end(high) if high is not None else 'any'}"
        for low, high in one.pieces
    ]
    by_sigma = (
        MISSING if sigma is None or value is None else f"{end(value - OF_95 * sigma)} to {end(value + OF_95 * sigma)}"
    )
    return IntervalRow(one.name, item.symbol, f"{100 * one.confidence:.0f} %", " or ".join(pieces), by_sigma, item.unit)


VALID = "valid"  # the reason of an exposure that needs none
NO_INTERVALS = IntervalChange(initial=[], final=[])


@dataclass(frozen=True)
class Reasons:
    """Phrases with their counts, the commonest first."""

    title: str
    unit: str
    rows: Sequence[tuple[str, int]]


@dataclass(frozen=True)
class RemovedRow:
    """One proposed star that does not stand, as it is shown."""

    cells: tuple[str, ...]
    reason: str
    probability: str


def removed_rows(result: Calibration, most: int) -> list[RemovedRow]:
    """Lay out the first removed stars: row, frame, exposure, star; why, and the probability of a right star so far off."""
    return [
        RemovedRow(
            (count(one.row), count(one.frame), count(one.exposure), "–" if one.star_id is None else str(one.star_id)),
            one.reason,
            "–" if one.probability is None else printed_probability(one.probability),
        )
        for one in result.removed[:most]
    ]


def printed_probability(probability: float, equals: str = "") -> str:
    """Write a probability, after `equals`; below what a test can tell apart its bound."""
    return (
        f"{equals}{number(probability, 2)}" if probability >= LEAST_PROBABILITY else f"< {number(LEAST_PROBABILITY, 1)}"
    )


def removed_count(result: Calibration) -> str:
    """Say how many of how many proposed stars were removed."""
    of = result.removed_of
    return "" if of is None else f"{count(of.removed)} of {count(of.proposed)}"


def removed_table(result: Calibration) -> Table:
    """Return the removed stars as columns, for a file."""
    stars = result.removed
    return {
        "row": [one.row for one in stars],
        "frame": [one.frame for one in stars],
        "exposure": [one.exposure for one in stars],
        "star_id": [one.star_id for one in stars],
        "reason": [one.reason for one in stars],
        "probability": [one.probability for one in stars],
    }


@dataclass(frozen=True)
class FlightRow:
    """One measure of a set before and after, each with its 95 % interval where there is one."""

    whose: str
    name: str
    initial: str
    final: str


def match_counts(matching: Matching) -> list[tuple[str, str, str]]:
    """List the counts of matches: name, number, what it counts."""
    return [
        ("Given", count(matching.given), "identified in the telemetry"),
        ("Kept", count(matching.kept), "of them, still the same star"),
        ("Removed", count(matching.removed), "of them, unmatched or of another star"),
        ("Added", count(matching.added), "found by Boresight"),
        ("Matched", count(matching.matched), "used in the end"),
    ]


def match_facts(matching: Matching) -> list[tuple[str, str]]:
    """List what else there is to know: cycles, tolerance, flagged stars."""
    tolerance, flagged = matching.tolerance_px, matching.flagged
    rest = "the matches settled" if matching.rested else "the matches had not settled"
    said = (
        f"{count(flagged.doubles)} doubles, {count(flagged.unreliable)} of unreliable astrometry, "
        f"{count(flagged.left_out)} left out; {count(flagged.blended)} left out as blended"
        if flagged
        else MISSING
    )
    return [
        ("Cycles", f"{len(matching.cycles)}: {rest}" if matching.cycles else MISSING),
        ("Given another star", count(matching.renamed)),
        ("Median tolerance", f"{number(tolerance.median, 3)} px, 95 % below {number(tolerance.p95, 3)} px"),
        ("Flagged in the catalogue", said),
    ]


def reason_tables(matching: Matching) -> list[Reasons]:
    """List starts and reasons, the commonest first; those that never occurred are left out."""
    tables = []
    for title, unit, counts in (
        ("Source of attitudes", "exposures", matching.starts),
        ("Stars that were not matched", "stars", matching.row_reasons),
        ("Given matches that were rejected", "stars", matching.removed_reasons),
        ("Exposures that were not valid", "exposures", matching.exposure_reasons),
    ):
        found = [(phrase, times) for phrase, times in counts.items() if times and phrase != VALID]
        if found:
            tables.append(Reasons(title, unit, sorted(found, key=lambda row: -row[1])))
    return tables


def flight_rows(result: Calibration) -> list[FlightRow]:
    """List availability, matched stars and error before and after, of the calibration and of the validation set."""
    flight = result.matching.flight if result.matching else None
    rows: list[FlightRow] = []
    if result.evaluation is not None:
        rows += _evaluation_rows("Calibration set", result.evaluation)
    elif flight is not None:
        rows += _flight_rows("Calibration set", flight.availability, flight.matched_stars)
    if result.validation is not None:
        rows += _evaluation_rows("Validation set", result.validation)
    return [row for row in rows if (row.initial, row.final) != (MISSING, MISSING)]


def _evaluation_rows(whose: str, scores: Evaluation) -> list[FlightRow]:
    return _flight_rows(
        whose,
        scores.availability,
        scores.matched_stars,
        scores.matched_star_ratio,
        scores.rms_arc_rad,
        scores.intervals,
    )


def _flight_rows(
    whose: str,
    available: Change,
    stars: CountChange | None,
    ratio: float | None = None,
    rms: Change = Change(),  # noqa: B008 - frozen
    intervals: EvaluationIntervals | None = None,
) -> list[FlightRow]:
    reach, rms_reach = (intervals.availability, intervals.rms_arc_rad) if intervals else (NO_INTERVALS, NO_INTERVALS)
    ratio_reach = intervals.matched_star_ratio if intervals else []
    if ratio is None and stars is not None and stars.initial:
        ratio = stars.final / stars.initial
    counts = (MISSING, MISSING) if stars is None else (count(stars.initial), count(stars.final))
    shares = _share(available.initial, reach.initial), _share(available.final, reach.final)
    errors = _error(rms.initial, rms_reach.initial), _error(rms.final, rms_reach.final)
    return [
        FlightRow(whose, "Frames available", *shares),
        FlightRow(whose, "Stars matched", *counts),
        FlightRow(whose, "Matched star ratio", MISSING, _printed_ratio(ratio, ratio_reach)),
        FlightRow(whose, "RMS arc (µrad)", *errors),
    ]


def _within(reach: Sequence[float | None], factor: float, decimals: int) -> str:
    """Print a 95 % interval in brackets; nothing where there is none."""
    low, high = reach or (None, None)
    if low is None or high is None:
        return ""
    return f" ({fixed(factor * low, decimals)} to {fixed(factor * high, decimals)})"


def _share(value: float | None, reach: Sequence[float | None]) -> str:
    return f"{percent(value)}{_within(reach, 100, 1)}" if value is not None else MISSING


def _printed_ratio(value: float | None, reach: Sequence[float | None]) -> str:
    return f"{fixed(value, 2)}{_within(reach, 1, 2)}" if value is not None else MISSING


def _error(value_rad: float | None, reach: Sequence[float | None]) -> str:
    return f"{fixed(1e6 * value_rad, 1)}{_within(reach, 1e6, 1)}" if value_rad is not None else MISSING


def flight_tolerance(result: Calibration) -> str:
    """Print the tolerance at which the flight code accepts an arc, with its unit."""
    flight = result.matching.flight if result.matching else None
    tolerance_rad = flight.tolerance_rad if flight else None
    if result.evaluation is not None:
        tolerance_rad = result.evaluation.flight_tolerance_rad
    return f"{urad(tolerance_rad, 3)}{NARROW_SPACE}µrad" if tolerance_rad is not None else MISSING


def find_shown_set(result: Calibration) -> tuple[str, ShadowOfSet] | None:
    """Return which set is shown side by side under baseline and candidate, and its view; None where there is none.

    The validation set where the run has one, for it took no part in the estimate; else the calibration set.
    """
    sets = {"validation": result.shadow.validation, "calibration": result.shadow.calibration}
    return next(((name, view) for name, view in sets.items() if view is not None and view.frames), None)


def side_by_side(result: Calibration) -> str:
    """Say in a sentence what baseline and candidate would each lose; empty where they were not set side by side."""
    found = find_shown_set(result)
    return found[1].summary.sentence if found else ""


@dataclass(frozen=True)
class StarRow:
    """One star: its Hipparcos number, how often it was seen, and its residual."""

    star_id: int
    sightings: int
    mean_px: float
    rms_px: float
    z: float
    suspect: bool
    flags: str

    @property
    def numbers(self) -> tuple[float, ...]:
        """What the columns of `cells` are sorted by."""
        return self.sightings, self.mean_px, self.rms_px, abs(self.z)

    @property
    def cells(self) -> tuple[str, ...]:
        """The numbers as they are printed, after the star's own."""
        return count(self.sightings), fixed(self.mean_px, 3), fixed(self.rms_px, 3), fixed(self.z, 1)


def star_rows(result: Calibration) -> list[StarRow]:
    """Read the stars of a result, worst first; none where they were not examined."""
    return [
        StarRow(
            star_id=star.star_id,
            sightings=star.sightings,
            mean_px=star.mean_residual_px,
            rms_px=star.rms_px,
            z=star.z,
            suspect=star.suspect,
            flags=", ".join(star.flags),
        )
        for star in (result.trust.stars if result.trust else None) or ()
    ]


def to_flag(result: Calibration) -> str:
    """List the suspects' Hipparcos numbers, ready to paste; empty where there are none."""
    return ", ".join(map(str, result.trust.suspects if result.trust else ()))


@dataclass(frozen=True)
class ModelTestRow:
    """A test of the model in words; `numbers` are what its cells sort by."""

    title: str
    noticed: bool
    cells: tuple[str, ...]
    numbers: tuple[float | None, ...]
    gate: str
    sentence: str


def model_test_rows(result: Calibration) -> list[ModelTestRow]:
    """Lay the tests of a result out, the least probable first."""
    return [_model_test_row(test) for test in sorted(result.tests, key=lambda test: test.probability)]


def _model_test_row(test: TrustTest) -> ModelTestRow:
    kind = KIND_OF_TEST.get(test.name)
    values = (test.probability, test.adjusted, test.effect)
    return ModelTestRow(
        title=kind.title if kind else test.name.replace("_", " "),
        noticed=test.noticed,
        cells=tuple(number(value, 2) for value in values),
        numbers=values,
        gate=kind.gate if kind else "",
        sentence=test.sentence,
    )


@dataclass(frozen=True)
class CauseRow:
    """A cause in words, with the tests that it explains."""

    name: str
    likelihood: str
    sentence: str
    remedy: str
    tests: str


def cause_rows(result: Calibration) -> list[CauseRow]:
    """Lay the causes of a result out, the likeliest first."""
    return [
        CauseRow(cause.name, percent(cause.likelihood), cause.sentence, cause.remedy, ", ".join(_titles(cause.tests)))
        for cause in result.causes
    ]


@dataclass(frozen=True)
class UnseenRow:
    """What the tests may miss of one kind of displacement, in words; `numbers` are what its cells sort by."""

    name: str
    kind: str
    parameter: str
    cells: tuple[str, ...]
    numbers: tuple[float | None, ...]


def unseen_rows(result: Calibration) -> list[UnseenRow]:
    """Lay what the tests may miss out, first what moves a parameter most."""
    found = list(result.trust.unseen if result.trust else ())
    found.sort(key=lambda one: (one.sigmas is not None, -(one.sigmas or 0.0)))
    return [
        UnseenRow(
            one.name,
            get_test_title(one.name),
            one.parameter,
            (number(one.size_px, 2), number(one.sigmas, 2)),
            (one.size_px, one.sigmas),
        )
        for one in found
    ]


def _titles(names: list[str]) -> list[str]:
    return [get_test_title(name) for name in names]
