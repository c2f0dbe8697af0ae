"""Parameters that change from pass to pass beside those that do not: fitted together, and the last pass judged in their light.

First the passes are matched and fitted as one camera (`passes`). From there every pass gets its own values of the parameters that
vary, by themselves, as a random walk between the middles of the passes or by what is known of them (`change`), and all are fitted
again as one least-squares problem (`estimation.block_bordered`), R taken at each pass's own state. How far a walk steps is either
told, or estimated from the passes (`estimation.walk`) and the fit repeated with it, until it changes by less than its tenth.

What a person loads is the camera as it is now, so a calibration's numbers are those of the last pass. All that the others know of
it, P_K of the whole problem less A_K of that pass,

    A_0 = P_K^-1 - A_K        z_0 = z_K + A_0^-1 b_K

is a prior of that pass (`estimation.prior`), with its mean where the fit of the pass beside it ends at z_K. So the last pass is
calibrated with it by the chosen method, and matches, tests, halves, widening and validation are those of any calibration with
a prior; they are of that pass. A direction of which the others know nothing is open in A_0: there it has the information of
`OPEN_SIGMAS` typical sigmas, or of a filter's own start.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibration import InputPass, PassState, PassVariation, Values, WalkSigma
from boresight.calibration.estimate import Asked, Parameters
from boresight.calibration.joint.change import CHANGES_OF, check_change, fit_change, judge_columns, temperatures
from boresight.calibration.joint.comparison import compare_changes, say_comparison
from boresight.calibration.joint.evidence import fit_evidence, write_walk
from boresight.calibration.joint.passes_fit import (
    CHANGES,
    PassesFit,
    PassesProblem,
    judge_fall,
    list_places,
    middle_days,
)
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.errors import RefusedInputError
from boresight.estimation.block_bordered import Linked, Regressed
from boresight.estimation.walk import (
    CAUTION,
    FEWEST_STEPS,
    STARTS,
    Walk,
    WalkedPasses,
    find_walk,
    link_by_walk,
    most_likely,
)

#: Typical sigmas of what nobody knows.
OPEN_SIGMAS = 1e4
#: Values of `vary_as` that walk.
WALKS = ("walk", "walk-and-temperature")
#: Values of `vary_as` that are of change in time, the kinds of which are compared.
IN_TIME = ("walk", "walk-and-temperature", "drift", "step", "evidence")
#: Drift where its estimate begins, typical sigmas a square root of a day; rounds of it, and the change of its log that ends them.
FIRST_WALK, WALK_ROUNDS, WALK_RESTS = 0.1, 4, 0.1


def refuse_one_pass() -> NoReturn:
    """Refuse what varies from pass to pass of one set."""
    raise RefusedInputError(
        "What varies from pass to pass needs several telemetry sets: give more, or omit --vary.",
        code="one-set-cannot-vary",
    )


def check_variation(names: Sequence[str], settings: CalibrationSettings) -> None:
    """Refuse parameters of a pass that are not free, and errors that are not least squares."""
    unknown = [name for name in settings.vary or () if name not in names]
    if unknown:
        raise RefusedInputError(
            f"{', '.join(unknown)} is not free, so it cannot vary: choose from {', '.join(names)}.", code="not-free"
        )
    if settings.error != "arclength" or settings.robust != "none":
        raise RefusedInputError(
            "Passes are fitted by least squares on arcs: set error to 'arclength' and robust to 'none'."
        )
    check_change(settings)


def make_link(passes: Sequence[InputPass], own: IntArray, settings: CalibrationSettings) -> Linked:
    """Return how the parameters at the places `own` among the free ones hang together from pass to pass."""
    if settings.vary_as == "pass":
        return Linked(own, np.zeros((len(passes), len(own))))
    sigma = np.full(len(own), FIRST_WALK if settings.walk_sigma is None else settings.walk_sigma)
    return link_by_walk(own, days_between(passes), sigma, find_trend(passes, own, settings))


def find_trend(passes: Sequence[InputPass], own: IntArray, settings: CalibrationSettings) -> Regressed | None:
    """Return what parameters that walk are linear in beside: degrees from the mean temperature; None where nothing."""
    if settings.vary_as != "walk-and-temperature":
        return None
    known = temperatures(passes)
    return Regressed(own, np.tile((known - np.mean(known))[:, None], (1, len(own))))


def days_between(passes: Sequence[InputPass]) -> FloatArray:
    """Days between the middles of the passes, (n_passes - 1,)."""
    return np.maximum(np.diff(middle_days(passes)), 0.0)


def fit_variation(
    problem: Problem, passes: Sequence[InputPass], parameters: Parameters, x: FloatArray, settings: CalibrationSettings,
    cancelled: Asked,
) -> tuple[PassesFit, PassVariation]:  # fmt: skip
    """Fit the passes with the parameters that vary, and describe it."""
    names = [problem.camera.parameter_names[p] for p in parameters.free]
    own = np.array([place for place, name in enumerate(names) if name in (settings.vary or ())], np.int64)
    of = PassesProblem(problem, passes, parameters, x, settings, cancelled, list_places(problem, passes))
    try:
        if settings.vary_as in CHANGES_OF:
            fitted, changed = fit_change(of, own)
        elif settings.vary_as == "evidence":
            fitted, changed = fit_evidence(of, own)
        else:
            fitted, changed = _fit_linked(of, own)
    except np.linalg.LinAlgError as error:
        few = min(range(len(of.ends)), key=lambda k: of.ends[k][1] - of.ends[k][0])
        raise RefusedInputError(
            f"A single pass cannot determine {', '.join(settings.vary or ())} (fewest frames: {passes[few].name}): choose "
            "--vary-as walk, leave such passes out, or vary fewer parameters.",
            code="pass-too-short",
        ) from error
    if not fitted.converged:
        raise RefusedInputError(
            "The fit of the passes does not converge: choose --vary-as walk, or vary fewer parameters."
        )
    compared = None
    if settings.vary_as in IN_TIME:
        with suppress(np.linalg.LinAlgError):  # a kind that the passes leave open is not compared
            compared = compare_changes(of, fitted, own, middle_days(passes))
    found = replace(changed, states=_describe_states(of, fitted), chi2=fitted.chi2, compared=compared)
    return fitted, replace(found, sentence=_sentence(found))


def _fit_linked(of: PassesProblem, own: IntArray) -> tuple[PassesFit, PassVariation]:
    """Fit passes by themselves or as a walk, the drift of which may be to be estimated."""
    settings, walk, names = of.settings, None, of.list_names(own)
    fitted = of.fit(make_link(of.passes, own, settings))
    if settings.vary_as in WALKS and settings.walk_sigma is None:
        fitted, walk = fit_walk(of, days_between(of.passes), own, fitted, find_trend(of.passes, own, settings))
    varies = PassVariation(vary=names, vary_as=settings.vary_as, chi2=fitted.chi2)
    if settings.vary_as == "pass":
        return fitted, replace(varies, test=judge_fall(fitted, len(own) * (len(of.passes) - 1)))
    varies = replace(varies, walk=_write_walk(names, walk, settings))
    if settings.vary_as == "walk":
        return fitted, varies
    scale, solution = of.parameters.scale[own], fitted.solution
    slope, sigma = solution.slope * scale, np.sqrt(np.diag(solution.slope_covariance)) * scale
    return fitted, replace(
        varies,
        reference_temperature_c=float(np.mean(temperatures(of.passes))),
        slope=Values(dict(zip(names, slope.tolist(), strict=True))),
        slope_sigma=Values(dict(zip(names, sigma.tolist(), strict=True))),
        tests={name: judge_columns(fitted, np.array([k])) for k, name in enumerate(names)},
    )


def fit_walk(
    of: PassesProblem, days: FloatArray, own: IntArray, fitted: PassesFit, trend: Regressed | None = None
) -> tuple[PassesFit, Walk]:
    """Estimate the drift, days (n_passes - 1,) between passes, and fit the passes with it, in turn."""
    before, caution = np.full(len(own), FIRST_WALK), CAUTION if len(days) >= FEWEST_STEPS else 0.0
    starts = [np.full(len(own), start) for start in STARTS]
    for _ in range(WALK_ROUNDS):
        sigma = most_likely(WalkedPasses(fitted.sums, of.departures(fitted), own, days, trend), starts, caution)
        fitted = of.fit(link_by_walk(own, days, sigma, trend))
        if np.abs(np.log(sigma / before)).max() < WALK_RESTS:
            break
        before, starts = sigma, [sigma]
    return fitted, find_walk(WalkedPasses(fitted.sums, of.departures(fitted), own, days, trend))


def _describe_states(of: PassesProblem, fitted: PassesFit) -> list[PassState]:
    """Write every pass's free parameters with their sigmas."""
    free, states = of.parameters.free, []
    for one, x, P, sums in zip(of.passes, fitted.states, fitted.solution.P, fitted.sums, strict=True):
        sigma = np.sqrt(np.diag(P)) * of.parameters.scale
        states.append(
            PassState(
                name=one.name,
                parameters=Values(dict(zip(of.names, x[free].tolist(), strict=True))),
                sigma=Values(dict(zip(of.names, sigma.tolist(), strict=True))),
                chi2=sums.chi2,
            )
        )
    return states


def _write_walk(names: Sequence[str], walk: Walk | None, settings: CalibrationSettings) -> dict[str, WalkSigma]:
    if walk is None:
        return {name: WalkSigma(sigma=settings.walk_sigma or FIRST_WALK) for name in names}
    return write_walk(names, walk)


def _sentence(found: PassVariation) -> str:
    how = {"pass": "one value in each", "walk": "a random walk over each"}
    how |= {"temperature": "linear in the temperature", "drift": "linear in time"}
    how |= {"walk-and-temperature": "a random walk around a linear temperature trend over each"}
    last = f"values are those of the last pass, {found.states[-1].name}."
    if found.compared:
        last = f"{say_comparison(found.compared)}; {last}"
    if found.vary_as == "evidence":
        steps = "; ".join(one.sentence for one in found.steps or ()) or "no significant step"
        about = [what for what, of in (("temperature", found.slope), ("time", found.rate)) if of is not None]
        opening = f"{', '.join(found.vary)}: a random walk{' around linear trends in ' + ' and '.join(about) if about else ''} over"
        return f"{opening} {len(found.states)} passes{_drifts(found)}; {steps}; {last}"
    if found.steps is not None:
        none = f"{', '.join(found.vary)}: no significant step over {len(found.states)} passes"
        return f"{'; '.join(one.sentence for one in found.steps) or none}; {last}"
    if found.degree is not None and set(found.degree.values()) != {1}:
        how[found.vary_as] = f"polynomial in {'the temperature' if found.vary_as == 'temperature' else 'time'}"
        degrees = ", ".join(f"{name} of degree {degree}" for name, degree in found.degree.items())
        opening = f"{how[found.vary_as].capitalize()} of {len(found.states)} passes: {degrees}"
    else:
        opening = f"{', '.join(found.vary)}: {how[found.vary_as]} of {len(found.states)} passes"
    if found.test is None:
        return f"{opening}{_drifts(found)}; {last}"
    real = "significant" if found.test.p_value < CHANGES else "not significant"
    return f"{opening}, {real} (chi-square decreases by {found.test.fall:.3g} for {found.test.dof} parameters); {last}"


def _drifts(found: PassVariation) -> str:
    """Say how far each parameter drifts, where that was estimated."""
    said = [
        f"{name} {one.sigma:.2g} ({one.interval[0]:.2g} to {one.interval[1]:.2g})"
        for name, one in (found.walk or {}).items()
        if one.interval is not None and one.interval[0] is not None and one.interval[1] is not None
    ]
    return f" with the most likely drift, in typical sigmas per square root of a day: {', '.join(said)}" if said else ""
