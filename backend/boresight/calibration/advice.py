"""What a person should know before believing a calibration: one sentence each, the gravest first.

What contradicts the model, and why, is told before all of these (`trust.causes`): a fit that does not come to rest or ends far from
its start mostly does so because of it.

A weak direction is made known by a parameter to hold fixed, more frames, or stars elsewhere on the detector. Holding parameter p
strikes its row and column from the information A. The direction that is left open longest goes first: of all parameters the one
is held whose absence leaves the least known direction known best, until none is weak. Frames like these add to A in proportion,
so a direction known to s typical sigmas needs (s / `WEAK`)^2 times as many. What the detector shows of its own coverage is how
far out stars lie and how many of its parts hold any.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.estimate import Estimate, Parameters, claim
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.cameras.model import FAR_TYPICAL_SIGMAS
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import determined
from boresight.estimation.filters.angular import MOST_PAIRS
from boresight.estimation.statistics.consistency import ChiSquare
from boresight.estimation.statistics.observability import WEAK, Observability, is_curved
from boresight.wording import join_words

#: Shift beyond which it is another sensor: no launch moves a focal length by a hundred times the spread of its make.
ANOTHER_SENSOR = 100.0
#: Chi-square per degree of freedom up to which stars and camera agree: a sensor that is another's does not fit its stars.
FITS = 9.0
#: Sigma of a direction, in typical sigmas, from which on a bend in it does not show: its departure goes with the fourth power.
STRAIGHT = WEAK / 4
#: Claimed over available information beyond which a filter is called over-confident.
OVERCLAIM = 1.5


def advice(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    fit: ChiSquare,
    nis: ChiSquare,
    observed: Observability,
    rise: float | None,
) -> list[Advice]:
    """Collect every sentence that applies; `rise` is what `chi2_rise` found of a batch."""
    return [
        *_advise_on_status(estimate, observed, settings),
        *_advise_on_shift(problem, parameters, estimate, fit),
        *_advise_on_curvature(observed, estimate, rise),
        *_advise_on_weak_directions(observed, estimate),
        *_advise_on_consistency(fit, nis, parameters, settings, estimate),
        *estimate.remarks,
        *_advise_on_data(problem),
        *_advise_on_gain_form(problem, settings),
    ]


def too_few(problem: Problem, minimum_stars: int) -> list[Advice]:
    """Say that nothing can be estimated, and what was missing."""
    reasons = [
        f"{item.count} {item.what[: -1 if item.count == 1 else None]}: {item.reason}" for item in problem.left_out
    ]
    missing = "; ".join(reasons) or "the set is empty"
    found = f"No exposure has {minimum_stars} usable matched stars that are not on one line, so nothing was estimated"
    return [Advice.begin("too_few_stars", found, f"; match more stars or use other frames ({missing}).")]


def _advise_on_status(estimate: Estimate, observed: Observability, settings: CalibrationSettings) -> Iterator[Advice]:
    if estimate.status == "diverged":
        named = (
            "match the stars again, because wrong identities are the likeliest cause; or "
            if settings.match == "given"
            else ""
        )
        rest = f": do not use these results; {named}free fewer parameters, or start closer to the true values."
        yield Advice.begin("diverged", "The fit diverged", rest)
    if estimate.status == "max_iterations":
        rest = ": allow more iterations, or free fewer parameters."
        yield Advice.begin("max_iterations", "The fit had not converged at its last iteration", rest)
    if estimate.status == "rank_deficient":
        lost = [i for i in range(len(observed.names)) if observed.singular_values[i] == 0]
        parts = [part for i in lost for part in zip(observed.symbols, observed.direction(i).values(), strict=True)]
        symbols = sorted({symbol for symbol, value in parts if abs(value) > 0.1})
        rest = f": hold at least {len(lost)} of them fixed and run again."
        yield Advice.begin("rank_deficient", f"These data do not determine {', '.join(symbols)}", rest)


def _advise_on_weak_directions(observed: Observability, estimate: Estimate) -> Iterator[Advice]:
    if estimate.status == "diverged":
        return
    for i in observed.weak():
        if observed.singular_values[i] > 0:
            alone = len(observed.named(i)) == 1
            caution = (
                "Hold it fixed" if alone else "Use these parameters together, not one by one; hold one of them fixed"
            )
            rest = f": {observed.sentence(i)} {caution}, or add frames that cover more of the detector."
            yield Advice.begin("weakest_direction", "Weakly determined", rest)


def _advise_on_curvature(observed: Observability, estimate: Estimate, rise: float | None) -> Iterator[Advice]:
    """Say that a covariance does not hold, and which parameters leave the rest known best when they are held."""
    if rise is None or not is_curved(rise):
        return
    finding = "The covariance is wrong along the weakest direction"
    size = f": at one sigma, chi-square rises by {rise:.3g} instead of 1"
    if len(observed.names) == 1:
        rest = f"{size}, because the fit is not linear there: add frames before relying on its sigma."
        yield Advice.begin("curved", finding, rest)
        return
    alike = join_words([symbol for symbol, _ in observed.named(len(observed.names) - 1)])
    held = to_hold(estimate.A, STRAIGHT) or [_hold_first(estimate.A, list(range(len(observed.names))))]
    yield Advice.begin(
        "curved",
        finding,
        f"{size}, because the data barely separate {alike} and the fit is not linear there; hold "
        f"{join_words([observed.symbols[p] for p in held])} fixed and run again before relying on its sigmas.",
    )


def is_overconfident(innovations: float, most: float, chi2_per_dof: float) -> bool:
    """Whether a filter's mean normalised innovation is above its bound `most`, and above what the residuals themselves explain."""
    return innovations > max(most, chi2_per_dof * 1.05)


def _advise_on_consistency(
    fit: ChiSquare, nis: ChiSquare, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate
) -> Iterator[Advice]:
    """Say where a filter claims too much; what the size of the residuals says is one of the tests of trust."""
    if estimate.status == "diverged":
        return
    if settings.sequential and is_overconfident(nis.mean, nis.upper, fit.mean):
        yield Advice.begin(
            "nis",
            f"The filter is over-confident (normalised innovations {nis.mean:.3g} per degree of freedom, at most "
            f"{nis.upper:.3g} expected)",
            ": do not rely on its sigmas; compare it with a batch run.",
        )
    claimed = claim(estimate.A, estimate.P, parameters.known_at_start(settings)) if settings.sequential else 1.0
    if claimed > OVERCLAIM:
        times = f"{claimed:.2g} times" if np.isfinite(claimed) else "far more than"
        yield Advice.begin(
            "overclaim",
            f"Along one direction the filter claims {times} the information in the data, because it used early frames while "
            "far from its final state",
            ": its sigmas there are too small; run the batch, or start from its result.",
        )
    if settings.sequential and settings.linearisations == 1:
        yield Advice.begin(
            "distant_start",
            "One linearisation per frame, as published, makes the filter over-confident from a distant start",
            ": its sigmas are too small.",
        )


def _advise_on_shift(problem: Problem, parameters: Parameters, estimate: Estimate, fit: ChiSquare) -> Iterator[Advice]:
    if estimate.status == "diverged":
        return
    shift = (estimate.x - problem.sensor.initial)[parameters.free] / parameters.scale
    moved = [(problem.camera.symbols[p], steps) for p, steps in zip(parameters.free, shift, strict=True)]
    far = ", ".join(f"{symbol} {steps:+.0f}" for symbol, steps in moved if abs(steps) > FAR_TYPICAL_SIGMAS)
    if not far:
        return
    if np.abs(shift).max() > ANOTHER_SENSOR and fit.mean > FITS:
        rest = f" (change in typical sigmas: {far}): diagnose it, or choose the right sensor."
        yield Advice.begin("wrong_sensor", "This telemetry is probably not from this sensor", rest)
    else:
        finding = f"Large change from the initial values, in typical sigmas: {far}"
        yield Advice.begin("large_change", finding, "; check the sensor file's start and typical_sigma.")


def _advise_on_data(problem: Problem) -> Iterator[Advice]:
    if problem.arcs.n_frames < 20:
        finding = f"Only {problem.arcs.n_frames} frames were used"
        yield Advice.begin("few_frames", finding, ": the result depends strongly on these few fields.")


def _advise_on_gain_form(problem: Problem, settings: CalibrationSettings) -> Iterator[Advice]:
    """Say where the printed inverse of all pairs gave way to a smaller one."""
    if settings.method != "angular" or settings.gain_form != "gain":
        return
    parts = problem.arcs.over_blocks(_pairs_in_block)
    most, many = max(part[0] for part in parts), sum(part[1] for part in parts)
    if many:
        yield Advice.begin(
            "gain_form",
            f"{many} of {problem.arcs.n_exposures} exposures have more than {MOST_PAIRS:,} pairs (up to {most:,})",
            ": for these, the gain was computed from two numbers per star, which gives the same result faster than the inverse in "
            "the paper.",
        )


def _pairs_in_block(block: ArcSet) -> tuple[int, int]:
    """Most pairs of an exposure of one block, and how many exposures have more than `MOST_PAIRS`."""
    stars = np.diff(block.star_start)
    pairs = stars * (stars - 1) // 2
    return int(pairs.max()), int(np.sum(pairs > MOST_PAIRS))


#: More frames are worth naming up to so many times those that are there.
MOST_TIMES = 100.0
#: Parts of the detector a side, for coverage.
PARTS = 6
#: Share of the parts, and of the way to the corner, below which coverage is called thin.
ENOUGH = 0.95


def remedies(
    A: FloatArray, observed: Observability, problem: Problem, frames: int, settings: CalibrationSettings
) -> list[str]:
    """Sentences that say what would help, the surest first; none where nothing is weak.

    `A`: (n_free, n_free) information of the set, in typical sigmas.
    """
    if not observed.weak():
        return []
    held = to_hold(A)
    forgets = settings.sequential and (settings.process_noise > 0 or settings.forgetting_factor < 1)
    return [
        *_say_holding(held, A, observed),
        *_say_coverage(problem),
        *([] if forgets else _say_frames(observed, frames)),
    ]


def to_hold(A: FloatArray, enough: float = WEAK) -> list[int]:
    """Places of the parameters to hold so that every direction is known to `enough`, the first first; all but one at most."""
    left, held = list(range(len(A))), list[int]()
    while len(left) > 1 and _worst(A, left) > enough:
        best = _hold_first(A, left)
        left.remove(best)
        held.append(best)
    return held


def _hold_first(A: FloatArray, places: list[int]) -> int:
    """The one of some parameters whose absence leaves the least known direction of the others known best."""
    return min(places, key=lambda p: _worst(A, [q for q in places if q != p]))


def _worst(A: FloatArray, places: list[int]) -> float:
    """Sigma of the least known direction of some parameters alone, in typical sigmas; infinite where undetermined."""
    values, _, known = determined(A[np.ix_(places, places)])
    return float(1 / np.sqrt(values[0])) if known.all() else np.inf


def _say_holding(held: list[int], A: FloatArray, observed: Observability) -> list[str]:
    left = [p for p in range(len(A)) if p not in held]
    worst = _worst(A, left)
    if not held or worst > WEAK:
        return []
    names = [observed.symbols[p] for p in held]
    fixed = "value" if len(names) == 1 else "values"
    sentence = (
        f"Hold {join_words(names)} fixed: every direction of the others is then known to {worst:.2g} typical sigmas or better, "
        f"but any error in the fixed {fixed} goes into the others."
    )
    return [sentence]


def _say_coverage(problem: Problem) -> list[str]:
    sensor, arcs = problem.sensor, problem.arcs.whole()
    row, col = arcs.row_px - (sensor.rows - 1) / 2, arcs.col_px - (sensor.columns - 1) / 2
    reach = float(np.hypot(row, col).max() / (np.hypot(sensor.rows, sensor.columns) / 2))
    counts, _, _ = np.histogram2d(
        arcs.row_px, arcs.col_px, bins=PARTS, range=((-0.5, sensor.rows - 0.5), (-0.5, sensor.columns - 0.5))
    )
    filled = int(np.count_nonzero(counts))
    if reach >= ENOUGH and filled >= ENOUGH * PARTS**2:
        return []
    sentence = (
        f"Stars reach {100 * min(reach, 1.0):.0f} % of the way to the corner and lie in {filled} of {PARTS**2} regions of "
        "the detector: frames with stars in the empty regions would help most."
    )
    return [sentence]


def _say_frames(observed: Observability, frames: int) -> list[str]:
    times = float((observed.sigma_of_direction.max() / WEAK) ** 2)
    if not np.isfinite(times):
        return ["More frames like these would not determine this direction either."]
    if times > MOST_TIMES:
        return [f"More frames like these would not help enough: it would take {times:,.0f} times as many."]
    return [
        f"About {int(np.ceil(times * frames)):,} frames like these, instead of {frames:,}, would leave no weak direction."
    ]
