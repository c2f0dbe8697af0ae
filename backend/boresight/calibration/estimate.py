"""Where an estimator ended, in one shape for batch and sequential methods, how they are run, and what their losses cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import Robust, Status, Values
from boresight.calibration.history_recorder import RecordedHistory
from boresight.calibration.minima import NOT_SEARCHED, LowerMinimum, Searched, look_for_minima
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, find_parity
from boresight.estimation import batch, cosine
from boresight.estimation.filters.history import FilterState, start
from boresight.estimation.prior import Prior
from boresight.estimation.robust import (
    MOST_ROUNDS,
    REST_OF_ROUNDS,
    SCALE_RESTS,
    TUNING,
    StarWeights,
    measure_scale,
    measure_star_effect,
    whiten_even,
    whiten_weighted,
)
from boresight.estimation.statistics.special import ndtr
from boresight.estimation.stored_arcs import Arcs


@dataclass(frozen=True)
class Compared:
    """A cosine estimate judged by the arcs' true covariance.

    `A`: (n_free, n_free) the information it has, in typical sigmas. `chi2`: whitened sum of squares of the arcs at the
    estimate. `remark`: what a person should know, one sentence or two.
    """

    A: FloatArray
    chi2: float
    remark: str


def compared(arcs: Arcs, x: FloatArray, free: NDArray[np.int64], scale: FloatArray) -> Compared | None:
    """Judge the cosine estimate x (n_parameters,) of whitened arcs; None where the model cannot be evaluated."""
    best = batch.normal_equations(arcs, x, free, scale)
    if not best.finite():
        return None
    worth = cosine.compute_information(arcs, x, free, scale)
    sigma, claimed, of_arcs = (batch.sigma_in_scale(A) for A in (worth.held, worth.claimed, best.A))
    known = np.isfinite(sigma) & np.isfinite(claimed) & np.isfinite(of_arcs)
    return Compared(worth.held, best.chi2, _remark(sigma[known], claimed[known], of_arcs[known]))


def _remark(sigma: FloatArray, claimed: FloatArray, of_arcs: FloatArray) -> str:
    """Say by how much the fit's own sigmas would mislead, and how much better arclengths do."""
    opening = "The unweighted cosine error is only for comparison, and the sigmas from its sum of squares are not valid"
    if not len(sigma):
        return f"{opening}."
    ratio = sigma / claimed
    cost = np.exp(np.mean(np.log(sigma / of_arcs)))
    return (
        f"{opening}. The correct sigmas, shown here, are {ratio.min():.2f} to {ratio.max():.2f} times as large. Arclengths with "
        f"their covariance give sigmas {cost:.2f} times smaller from the same data: use those for decisions."
    )


#: Move from least squares, in sigmas of the estimate, from which it is called one.
MOVED = 1.0


@dataclass(frozen=True)
class Robustness:
    """A robust loss beside least squares.

    `threshold`: in sigmas of what the loss judges. `downweighted`, `judged`: how many are beyond it at the estimate, and all;
    whitened arcs, or stars (`by`). `x`, `x_without`: (n_parameters,) the estimate, and where least squares ends on the same arcs,
    SI.
    """

    threshold: float
    downweighted: int
    judged: int
    x: FloatArray
    x_without: FloatArray
    by: Literal["arcs", "stars"] = "arcs"

    @property
    def expected_share(self) -> float:
        """Share beyond the threshold under Gaussian noise: of one whitened arc, or of a star's two residuals."""
        if self.by == "stars":
            return float(np.exp(-(self.threshold**2) / 2))
        return 2 * float(ndtr(-self.threshold))


def robust_view(found: Robustness, names: Sequence[str], sigma: FloatArray) -> Robust:
    """Say what the loss changed.

    `names`: all parameters of the camera, in order. `sigma`: (n_parameters,) one-sigma of the estimate, SI; NaN where not
    estimated.
    """
    shift = (found.x - found.x_without) / np.where(sigma > 0, sigma, np.nan)
    share, expected = found.downweighted / found.judged, found.expected_share
    return Robust(
        threshold=found.threshold,
        downweighted=found.downweighted,
        share=share,
        expected_share=expected,
        parameters_without=Values({name: float(x) for name, x in zip(names, found.x_without, strict=True)}),
        shift_in_sigma=Values(
            {name: float(z) if np.isfinite(z) else None for name, z in zip(names, shift, strict=True)}
        ),
        sentence=_sentence(found, share, dict(zip(names, shift, strict=True))),
    )


def _sentence(found: Robustness, share: float, shift: dict[str, float]) -> str:
    """Say what the loss did, against what it does to noise alone."""
    did = "Huber's loss down-weighted" if found.by == "arcs" else "The loss by stars left out"
    counted = (
        f"{did} {found.downweighted:,} {found.by}, {share:.2%} of all; Gaussian noise alone would give {found.expected_share:.2%}"
        if found.by == "stars"
        else f"{did} {found.downweighted:,} arcs, {share:.1%} of them; Gaussian noise alone would give {found.expected_share:.1%}"
    )
    moved = {name: z for name, z in shift.items() if np.isfinite(z)}
    if not moved:
        return f"{counted}."
    name = max(moved, key=lambda key: abs(moved[key]))
    if abs(moved[name]) < MOVED:
        return f"{counted}; least squares agrees within {abs(moved[name]):.1f} sigma."
    return (
        f"{counted}; it moved the estimate by up to {abs(moved[name]):.1f} sigma ({name}) from least squares: "
        "check for wrong matches before you trust either."
    )


#: Weights are taken again at the solution so often; the second time changes sigmas by the square of the first change.
WHITENING_ROUNDS = 2


@dataclass(frozen=True)
class Drift:
    """How far free parameters step, `sigma` (n_free,) typical sigmas, each frame, or a square root of a day as `per` says.

    `source`: `given`, `usual` or `estimated`, then from so many `stretches` of data and with the ends of its intervals.
    """

    sigma: FloatArray
    per: str
    source: str
    low: FloatArray | None = None
    high: FloatArray | None = None
    stretches: int = 0


@dataclass(frozen=True)
class Parameters:
    """The free parameters of a calibration: places in the state and typical sigmas, both (n_free,).

    `prior`: what was known before. `drift`: how far they step, where that was estimated.
    """

    free: IntArray
    scale: FloatArray
    prior: Prior | None = None
    drift: Drift | None = None

    def start(self, x: FloatArray, settings: CalibrationSettings) -> FilterState:
        """State of a filter before any frame: the prior's, or at x (n_parameters,) with the settings' sigma."""
        if self.prior is None:
            return start(x, len(self.free), settings.initial_sigma_scale)
        return FilterState(self.prior.x.copy(), np.zeros(len(self.free)), self.prior.S)

    def known_at_start(self, settings: CalibrationSettings) -> FloatArray:
        """Information of a filter's start, (n_free, n_free) in typical sigmas."""
        if self.prior is None:
            return np.eye(len(self.free)) / settings.initial_sigma_scale**2
        return self.prior.A

    def with_prior(self, A: FloatArray) -> FloatArray:
        """Information of data and prior together, from that of the data, both (n_free, n_free) in typical sigmas."""
        return A if self.prior is None else A + self.prior.A

    def covariance(self, P: FloatArray) -> FloatArray:
        """A covariance (n_free, n_free) in typical sigmas, in SI."""
        return np.asarray(P * np.outer(self.scale, self.scale))

    def full_covariance(self, P: FloatArray, held: FloatArray | float = 0.0, *, n: int) -> FloatArray:
        """The same among all n parameters, (n, n) SI; of those held fixed it is `held`."""
        full = np.full((n, n), held)
        full[np.ix_(self.free, self.free)] = self.covariance(P)
        return full


@dataclass(frozen=True)
class Estimate:
    """An estimate on its way or at its end.

    `x`: (n_parameters,) state, SI. `A`: (n_free, n_free) information of the data alone, in typical sigmas. `P`: (n_free,
    n_free) covariance of the estimate in typical sigmas, with a prior or a filter's start in it. `chi2`: whitened sum of squares of
    the set at x. `status`: as in the contract, or `running`. `iterations`: batch iterations, or linearisations of a filter in all.
    `steps`: batch iterates, empty for a filter. `history`: a filter's updates so far; None for the batch. `robust`: what
    Huber's loss changed; None for any other estimate. `remarks`: sentences that a person should read beside the numbers.
    `searched`: what the search for other minima found.
    """

    x: FloatArray
    A: FloatArray
    P: FloatArray
    chi2: float
    status: Status
    iterations: int
    steps: tuple[batch.Step, ...] = ()
    history: RecordedHistory | None = None
    robust: Robustness | None = None
    remarks: tuple[Advice, ...] = ()
    searched: Searched = NOT_SEARCHED

    @property
    def updated(self) -> IntArray | None:
        """(n_updates,) frame number of each update of a filter; None for the batch."""
        return None if self.history is None else self.history.frame


ReportEstimate = Callable[[Estimate, float, str], None]
Asked = Callable[[], bool]


def run_batch(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: ReportEstimate,
    cancelled: Asked,
    begin: LowerMinimum | None = None,
    restarts: int = 0,
) -> Estimate:
    """Fit, take the weights at the solution, and fit again; of a small set look for other minima too and take up the lowest.

    `begin`: where judging a former estimate led to, in place of the sensor's start; `restarts`: how often it has.
    """
    steps: list[batch.Step] = []

    def report(step: batch.Step) -> None:
        steps.append(step)
        _report_batch(tuple(steps), listen)

    if settings.robust == "stars":
        plain = run_batch(
            problem, parameters, replace(settings, robust="none"), lambda *_: None, cancelled, begin, restarts
        )
        return replace(
            _run_by_star(problem, parameters, settings, plain, report, steps, cancelled), searched=plain.searched
        )

    def fit(x: FloatArray) -> batch.BatchFit:
        return _fit(problem, x, parameters, settings, report, cancelled)

    fitted = _rewhitened(fit, problem.sensor.initial if begin is None else begin.x)
    searched = _search(problem, parameters, settings, fitted, cancelled).begun_from(begin, restarts)
    if searched.lowest is not None:
        fitted = _rewhitened(fit, searched.lowest.x)
    P = batch.covariance(parameters.with_prior(fitted.A))
    estimate = Estimate(
        fitted.x, fitted.A, P, fitted.chi2, fitted.status, max(len(steps) - 1, 0), tuple(steps), searched=searched
    )
    if settings.robust != "none":
        return replace(estimate, robust=_robustness(problem, parameters, settings, fitted))
    return _finish_cosine_fit(problem, parameters, estimate) if settings.error == "cosine" else estimate


def _rewhitened(fit: Callable[[FloatArray], batch.BatchFit], x: FloatArray) -> batch.BatchFit:
    """Fit from x, and again with the weights of where that ended."""
    fitted = fit(x)
    for _ in range(WHITENING_ROUNDS - 1):
        if fitted.status != "diverged":
            fitted = fit(fitted.x)
    return fitted


def _search(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    fitted: batch.BatchFit,
    cancelled: Asked,
) -> Searched:
    """Look for other minima; the cosine error is there for comparison only, and has none looked for."""
    if settings.error == "cosine":
        return NOT_SEARCHED
    return look_for_minima(
        problem, parameters.free, parameters.scale, _threshold(settings), fitted, cancelled, parameters.prior
    )


def _threshold(settings: CalibrationSettings) -> float:
    """The threshold of Huber's loss, in whitened sigmas; infinite for least squares."""
    return settings.huber_threshold if settings.robust == "huber" else np.inf


def _fit(
    problem: Problem,
    x: FloatArray,
    parameters: Parameters,
    settings: CalibrationSettings,
    report: Callable[[batch.Step], None] | None,
    cancelled: Asked,
) -> batch.BatchFit:
    """Fit once from x, with weights taken there."""
    arcs = problem.whitened(x)
    return batch.fit(
        cosine.unweighted(arcs) if settings.error == "cosine" else arcs, x, parameters.free, parameters.scale,
        max_iterations=settings.max_iterations, report=report, cancelled=cancelled,
        threshold=_threshold(settings), prior=parameters.prior,
    )  # fmt: skip


def _run_by_star(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    plain: Estimate,
    report: Callable[[batch.Step], None],
    steps: list[batch.Step],
    cancelled: Asked,
) -> Estimate:
    """Weigh every star and fit again, from the fit by least squares, until the weights reproduce themselves."""
    fitted = plain
    if fitted.status == "diverged":
        return fitted
    parity = find_parity(problem.arcs, fitted.x, problem.sensor.parity)
    how = StarWeights(parity, fitted.x, 1.0, settings.minimum_stars)
    x, rested = fitted.x, False
    for _ in range(MOST_ROUNDS):
        scale = measure_scale(problem.arcs, replace(how, x=x))
        rested = rested and abs(scale / how.scale - 1) < SCALE_RESTS
        if rested:
            break
        how = replace(how, x=x, scale=scale)
        arcs = problem.arcs.each(whiten_weighted, how)
        found = batch.fit(
            arcs, x, parameters.free, parameters.scale,
            max_iterations=settings.max_iterations, report=report, cancelled=cancelled, rest=REST_OF_ROUNDS,
            prior=parameters.prior,
        )  # fmt: skip
        if found.status == "diverged":
            break
        step = (found.x - x)[parameters.free] / parameters.scale
        rested, x = float(step @ parameters.with_prior(found.A) @ step) < REST_OF_ROUNDS**2, found.x
    return _finish_star_fit(problem, parameters, replace(how, x=x), found, plain, steps, rested=rested)


def _finish_star_fit(
    problem: Problem,
    parameters: Parameters,
    how: StarWeights,
    found: batch.BatchFit,
    plain: Estimate,
    steps: Sequence[batch.Step],
    *,
    rested: bool,
) -> Estimate:
    """Give an estimate by stars its own information, and the chi-square that shows what it did not follow."""
    even = problem.arcs.each(whiten_even, how)
    effect = measure_star_effect(problem.arcs, how, len(parameters.free))
    A = effect.information_share * batch.normal_equations(even, how.x, parameters.free, parameters.scale).A
    chi2 = batch.normal_equations(problem.whitened(how.x), how.x, parameters.free, parameters.scale).chi2
    status = found.status if rested or found.status != "converged" else "max_iterations"
    robust = Robustness(TUNING, effect.left_out, effect.stars, how.x, plain.x, "stars")
    P = batch.covariance(parameters.with_prior(A))
    return Estimate(how.x, A, P, chi2, status, max(len(steps) - 1, 0), tuple(steps), robust=robust)


def _robustness(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, fitted: batch.BatchFit
) -> Robustness:
    """Set a robust fit beside least squares on the same arcs, started where it ended."""
    plain = _fit(problem, fitted.x, parameters, replace(settings, robust="none"), None, never)
    n_arcs = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures
    return Robustness(settings.huber_threshold, fitted.beyond, n_arcs, fitted.x, plain.x)


def never() -> bool:
    """Nobody cancels."""
    return False


def _finish_cosine_fit(problem: Problem, parameters: Parameters, estimate: Estimate) -> Estimate:
    """Give a cosine fit the information that the arcs' true covariance leaves it."""
    judged = compared(problem.whitened(estimate.x), estimate.x, parameters.free, parameters.scale)
    if judged is None:
        return estimate
    return replace(
        estimate, A=judged.A, P=batch.covariance(judged.A), chi2=judged.chi2, remarks=(Advice(judged.remark, "cosine"),)
    )


def _report_batch(steps: tuple[batch.Step, ...], listen: ReportEstimate) -> None:
    """Tell the listener of the iterates so far; the fraction is a guess, for a fit does not know its length."""
    step, iteration = steps[-1], len(steps) - 1
    unknown = np.full((len(step.sigma), len(step.sigma)), np.nan)
    estimate = Estimate(step.x, unknown, np.diag(step.sigma**2), step.chi2, "running", iteration, steps)
    listen(estimate, 1 - 0.7**iteration, f"iteration {iteration}: chi-square {step.chi2:,.6g}")


def claim(A: FloatArray, P: FloatArray, start: FloatArray) -> float:
    """Largest ratio, over all directions, of the information that a filter claims to what data and start together hold.

    The claim is P^-1; data of information A and start of information `start`, both (n_free, n_free), hold their sum. Linearising
    early frames at states far away collects information that is not there, chiefly along weak directions, and this shows it
    without the truth.
    """
    held = A + start
    smallest = np.linalg.eigvals(P @ held).real.min()
    return float(1.0 / smallest) if smallest > 0 else np.inf  # lost in rounding: more than a float can tell
