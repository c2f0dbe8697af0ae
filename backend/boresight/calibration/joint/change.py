"""Change that something known of a pass explains: its temperature, its time, or that it came after an event.

Parameters that vary are polynomials in the mean temperature of a pass or in its time, of a degree that is told or that their own
evidence chooses, or step at dates: those of events that a person names, or those that the data propose. Each model is one
least-squares problem of all passes (`estimation.block_bordered`), what is needed of it is tested there, where it is linear
(`estimation.change`), and what is left is fitted again.

Steps without events are sought one after the other, each beside those that were found, until none is beyond chance. Then each has
the dates that it may have beside the others. A slow drift looks like a step to a search that knows steps alone: look at both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from boresight.arrays import DAY_US, FloatArray, IntArray, TimeArray, parse_times
from boresight.calibration.calibration import InputPass, ParameterStep, PassVariation, Values, VariationTest
from boresight.calibration.joint.passes_fit import PassesFit, PassesProblem, judge_fall, middle_days
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.change import LEVEL, Equations, drop_powers, step_falls
from boresight.estimation.statistics.special import chdtrc

#: Values of `vary_as` that stand here.
CHANGES_OF = ("temperature", "drift", "step")
#: Highest power that evidence may choose, and most steps that are sought.
HIGHEST, MOST_STEPS = 3, 10
#: Share of their range within which two temperatures or times are one.
SAME = 1e-3
#: Days between the ends of a date's interval from which dates suffice to write it.
BY_DATE_DAYS = 1.0


def check_change(settings: CalibrationSettings) -> None:
    """Refuse a degree without a polynomial, and events without steps."""
    if settings.degree != "1" and settings.vary_as not in {"temperature", "drift"}:
        raise RefusedInputError(
            "--degree applies only to polynomials: choose --vary-as temperature or drift, or omit --degree."
        )
    if settings.events is not None and settings.vary_as != "step":
        raise RefusedInputError("--events applies only to steps: choose --vary-as step, or omit --events.")


def fit_change(of: PassesProblem, own: IntArray) -> tuple[PassesFit, PassVariation]:
    """Fit the passes with the free parameters at the places `own` changing; raises LinAlgError where that is open."""
    if of.settings.vary_as != "step":
        return _fit_polynomials(of, own)
    return _propose_steps(of, own) if of.settings.events is None else _fit_events(of, own, of.settings.events)


def noise_variance(of: PassesProblem, chi2: float, columns: int) -> float:
    """Variance of the arcs over the stated one, where a model with so many further columns leaves this chi-square."""
    arcs = of.problem.arcs
    n_arcs = 2 * arcs.n_stars - 3 * arcs.n_exposures
    return chi2 / max(n_arcs - len(of.parameters.free) - columns, 1)


def temperatures(passes: Sequence[InputPass]) -> FloatArray:
    """Return the mean temperature of each pass, (n_passes,); refuses passes of which these tell no slope."""
    known = [one.temperature_c for one in passes if one.temperature_c is not None]
    if len(known) < len(passes) or np.ptp(known) == 0.0:
        raise RefusedInputError(
            "A slope cannot be determined because all passes have the same temperature or no temperature_c: add the column, "
            "or choose --vary-as pass."
        )
    return np.array(known)


def _fit_polynomials(of: PassesProblem, own: IntArray) -> tuple[PassesFit, PassVariation]:
    """Fit polynomials of the degree that is told, or of those that their evidence chooses."""
    settings = of.settings
    known = middle_days(of.passes) if settings.vary_as == "drift" else temperatures(of.passes)
    reference = float(np.mean(known))
    t = known - reference
    half = float(np.abs(t).max())
    distinct = len(np.unique(np.round(t / (half or 1.0) / SAME)))
    highest = min(HIGHEST, distinct - 1) if settings.degree == "auto" else int(settings.degree)
    if highest > distinct - 1 or highest < 1:
        what = "temperatures" if settings.vary_as == "temperature" else "times"
        raise RefusedInputError(
            f"{distinct} {what} cannot determine a polynomial of degree {max(highest, 1)}: give more passes, or a lower --degree.",
            code="too-few-passes",
        )
    if highest == 1:
        half = 1.0
    power = np.tile(np.arange(1, highest + 1), len(own))
    places = np.repeat(own, highest)
    fitted = of.fit(Regressed(places, (t[:, None] / half) ** power))
    if settings.degree == "auto":
        solution = fitted.solution
        variance = noise_variance(of, fitted.chi2, len(places))
        kept = drop_powers(solution.slope, solution.slope_covariance, places, power, variance)
        places, power = places[kept], power[kept]
        fitted = of.fit(Regressed(places, (t[:, None] / half) ** power))
    units = of.parameters.scale[places] / half**power
    coefficient = fitted.solution.slope * units
    sigma = np.sqrt(np.diag(fitted.solution.slope_covariance)) * units
    mine = {name: np.flatnonzero(places == place) for name, place in zip(of.list_names(own), own, strict=True)}
    slopes = {name: at[0] for name, at in mine.items() if len(at)}
    by_temperature = settings.vary_as == "temperature"
    return fitted, PassVariation(
        vary=of.list_names(own),
        vary_as=settings.vary_as,
        reference_temperature_c=reference if by_temperature else None,
        reference_utc=None if by_temperature else f"{np.datetime64(round(reference * DAY_US), 'us')}Z",
        slope=Values({name: float(coefficient[at]) for name, at in slopes.items()}),
        slope_sigma=Values({name: float(sigma[at]) for name, at in slopes.items()}),
        degree={name: len(at) for name, at in mine.items()},
        coefficients={name: coefficient[at].tolist() for name, at in mine.items()},
        coefficient_sigma={name: sigma[at].tolist() for name, at in mine.items()},
        tests={name: judge_columns(fitted, at) for name, at in mine.items() if len(at)},
        chi2=fitted.chi2,
        test=judge_fall(fitted, len(places)),
    )


def judge_columns(fitted: PassesFit, columns: IntArray) -> VariationTest:
    """Hold what some columns take from chi-square against chance."""
    c, C = fitted.solution.slope[columns], fitted.solution.slope_covariance[np.ix_(columns, columns)]
    fall = float(c @ np.linalg.solve(C, c))
    return VariationTest(fall=fall, dof=len(columns), p_value=float(chdtrc(len(columns), fall)))


class Step(NamedTuple):
    """A step of the parameter at a place among the free ones, in the gap after a pass."""

    place: int
    gap: int


def link_steps(n_passes: int, steps: Sequence[Step]) -> Regressed:
    """Return the columns of steps: 1 from the pass after the gap on."""
    k = np.arange(n_passes)
    values = np.array([k > step.gap for step in steps], np.float64).reshape(len(steps), len(k))
    return Regressed(np.array([step.place for step in steps], np.int64), values.T)


def _propose_steps(of: PassesProblem, own: IntArray) -> tuple[PassesFit, PassVariation]:
    """Seek steps one after the other, until none is beyond chance, then the dates that each may have beside the others."""
    middle_days(of.passes)  # refuses passes without times, of which nobody could say when
    steps: list[Step] = []
    chances: list[float] = []
    fitted, n = of.fit(link_steps(len(of.passes), steps)), len(of.parameters.free)
    while len(steps) < min(MOST_STEPS, len(own) * (len(of.passes) - 1)):
        equations = Equations.of(fitted.sums, of.departures(fitted))
        B = link_steps(len(of.passes), steps).design(n)
        falls = {int(place): step_falls(equations, B, int(place)) for place in own}
        place = max(falls, key=lambda one: float(falls[one].fall.max()))
        best = falls[place]
        chance = len(own) * best.p_value(noise_variance(of, fitted.chi2 - float(best.fall.max()), len(steps) + 1))
        if chance >= LEVEL:
            break
        steps.append(Step(place, int(best.fall.argmax())))
        chances.append(chance)
        fitted = of.fit(link_steps(len(of.passes), steps))
    variance = noise_variance(of, fitted.chi2, len(steps))
    equations = Equations.of(fitted.sums, of.departures(fitted))
    told = []
    for number, (step, chance) in enumerate(zip(steps, chances, strict=True)):
        others = link_steps(len(of.passes), steps[:number] + steps[number + 1 :]).design(n)
        gaps = step_falls(equations, others, step.place).interval(variance)
        told.append(describe_step(of, step, _size(fitted, number), gaps, chance))
    return fitted, _steps(of, own, fitted, told)


def _fit_events(of: PassesProblem, own: IntArray, events: Sequence[str]) -> tuple[PassesFit, PassVariation]:
    """Fit a step of every parameter at each event, and again those that are beyond chance."""
    days, times = middle_days(of.passes), read_events(events)
    gaps = [int(np.count_nonzero(days <= time.astype(np.int64) / DAY_US)) - 1 for time in times]
    for gap, event in zip(gaps, events, strict=True):
        if not 0 <= gap < len(days) - 1:
            raise RefusedInputError(
                f"No pass is on both sides of the event {event}: give passes before and after it, or omit it."
            )
        if gaps.count(gap) > 1:
            raise RefusedInputError(
                f"No pass lies between the event {event} and another: name one of them, or give more passes."
            )
    steps = [Step(int(place), gap) for place in own for gap in gaps]
    at = dict(zip(gaps, events, strict=True))
    fitted = of.fit(link_steps(len(of.passes), steps))
    s, C = fitted.solution.slope, fitted.solution.slope_covariance
    alone = np.arange(len(steps))
    kept = drop_powers(s, C, alone, np.ones_like(alone), noise_variance(of, fitted.chi2, len(steps)))
    looked_at = len(steps)
    steps = [step for step, needed in zip(steps, kept, strict=True) if needed]
    fitted = of.fit(link_steps(len(of.passes), steps))
    told = []
    for number, step in enumerate(steps):
        chance = looked_at * judge_columns(fitted, np.array([number])).p_value
        at_event = (step.gap, step.gap)
        told.append(describe_step(of, step, _size(fitted, number), at_event, min(chance, 1.0), at[step.gap]))
    return fitted, _steps(of, own, fitted, told)


def read_events(events: Sequence[str]) -> TimeArray:
    """Read the times of events, (n,)."""
    try:
        return parse_times(events)
    except ValueError as error:
        raise RefusedInputError(
            f"The time of an event cannot be read ({error}): write times as 2026-11-21T03:04:05Z."
        ) from error


def _steps(of: PassesProblem, own: IntArray, fitted: PassesFit, told: list[ParameterStep]) -> PassVariation:
    return PassVariation(
        vary=of.list_names(own), vary_as="step", chi2=fitted.chi2, steps=told, test=judge_fall(fitted, len(told))
    )


def describe_step(
    of: PassesProblem,
    step: Step,
    size: tuple[float, float],
    gaps: tuple[int, int],
    chance: float,
    event: str | None = None,
) -> ParameterStep:
    """Describe a step: its size and sigma (typical sigmas), the gaps it may be in, and by what chance it would look so large."""
    scale = float(of.parameters.scale[step.place])
    found = ParameterStep(
        parameter=of.names[step.place],
        step=size[0] * scale,
        sigma=size[1] * scale,
        event_utc=event,
        from_utc=of.passes[min(gaps[0], step.gap)].end_utc,
        to_utc=of.passes[max(gaps[1], step.gap) + 1].start_utc,
        p_value=chance,
    )
    return replace(found, sentence=_sentence(of, found, step.place))


def _size(fitted: PassesFit, number: int) -> tuple[float, float]:
    """Size of a step of a regression and its sigma, typical sigmas."""
    solution = fitted.solution
    return float(solution.slope[number]), float(np.sqrt(solution.slope_covariance[number, number]))


def _sentence(of: PassesProblem, found: ParameterStep, place: int) -> str:
    """Say what stepped, how far and when."""
    camera, p = of.problem.camera, of.parameters.free[place]
    moved = camera.parameters[p]
    factor, unit = (1e6 / of.x[p], "ppm") if moved.role is Role.FOCAL else (1.0, moved.written_unit)
    size = f"{moved.symbol} stepped by {found.step * factor:+.3g} ± {found.sigma * factor:.2g} {unit}".rstrip()
    if found.event_utc is not None:
        return f"{size} at {found.event_utc}"
    begin, end = parse_times([found.from_utc, found.to_utc])
    unit_of_time: Literal["D", "m"] = "D" if (end - begin) / np.timedelta64(1, "D") >= BY_DATE_DAYS else "m"
    first, last = (np.datetime_as_string(time, unit=unit_of_time) for time in (begin, end))
    return f"{size} between {first} and {last} (95 %)"
