"""Where an estimator ended, in one shape for batch and sequential methods, and how they are run on a problem."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boresight.calibration.comparison import compared
from boresight.calibration.problem import Problem, weighed
from boresight.calibration.robust import Robustness
from boresight.calibration.settings import CalibrationSettings
from boresight.errors import CancelledError
from boresight.estimation import batch, cosine
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters import FILTERS, FilterHistory, Tuning
from boresight.estimation.filters.history import FilterState, start

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: A filter's first update pools frames until it holds this many arcs a free parameter: from one thin frame ten sigmas off, the
#: posterior has other minima (3 of 60 simulated sets fell into one at a single frame, none of 240 at 12 or more arcs).
START_ARCS_PER_PARAMETER = 20
#: Weights are taken anew at the solution so often; the second time changes sigmas by the square of the first change.
WEIGHINGS = 2
#: A filter reports, and takes its weights anew, at least so often over a set.
CHUNKS = 40


@dataclass(frozen=True)
class Parameters:
    """The free parameters of a calibration: places in the state and typical sigmas, both (n_free,)."""

    free: IntArray
    scale: FloatArray


@dataclass(frozen=True)
class Estimate:
    """An estimate on its way or at its end.

    Parameters
    ----------
    x
        (n_parameters,) state, SI.
    A
        (n_free, n_free) information of the data alone, in typical sigmas.
    P
        (n_free, n_free) covariance of the estimate in typical sigmas; a filter's includes its start.
    chi2
        Whitened sum of squares of the set at x.
    status
        As in the contract, or `running`.
    iterations
        Batch iterations, or linearisations of a filter in all.
    steps
        Batch iterates, empty for a filter.
    history
        A filter's frames so far; None for the batch.
    updated
        (n_updates,) frame number of each entry of the history.
    robust
        What Huber's loss changed; None for any other estimate.
    remarks
        Sentences that a person should read beside the numbers.
    """

    x: FloatArray
    A: FloatArray
    P: FloatArray
    chi2: float
    status: str
    iterations: int
    steps: tuple[batch.Step, ...] = ()
    history: FilterHistory | None = None
    updated: IntArray | None = None
    robust: Robustness | None = None
    remarks: tuple[str, ...] = ()


Listener = Callable[[Estimate, float, str], None]
Asked = Callable[[], bool]


def run_batch(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, listen: Listener, cancelled: Asked
) -> Estimate:
    """Fit, take the weights at the solution, and fit again."""
    steps: list[batch.Step] = []

    def report(step: batch.Step) -> None:
        steps.append(step)
        _listen_batch(tuple(steps), listen)

    fitted = _fit(problem, problem.sensor.initial, parameters, settings, report, cancelled)
    for _ in range(WEIGHINGS - 1):
        if fitted.status != "diverged":
            fitted = _fit(problem, fitted.x, parameters, settings, report, cancelled)
    estimate = Estimate(
        fitted.x, fitted.A, covariance(fitted.A), fitted.chi2, fitted.status, max(len(steps) - 1, 0), tuple(steps)
    )
    if settings.robust != "none":
        return replace(estimate, robust=_robustness(problem, parameters, settings, fitted))
    return _of_cosine(problem, parameters, estimate) if settings.error == "cosine" else estimate


def _fit(
    problem: Problem,
    x: FloatArray,
    parameters: Parameters,
    settings: CalibrationSettings,
    report: Callable[[batch.Step], None] | None,
    cancelled: Asked,
) -> batch.BatchFit:
    """Fit once from x, with weights taken there."""
    arcs = problem.weighed(x)
    return batch.fit(
        cosine.unweighted(arcs) if settings.error == "cosine" else arcs, x, parameters.free, parameters.scale,
        max_iterations=settings.max_iterations, report=report, cancelled=cancelled,
        threshold=settings.huber_threshold if settings.robust == "huber" else np.inf,
    )  # fmt: skip


def _robustness(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, fitted: batch.BatchFit
) -> Robustness:
    """Set a robust fit beside least squares on the same arcs, started where it ended."""
    plain = _fit(problem, fitted.x, parameters, replace(settings, robust="none"), None, _never)
    n_arcs = 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures
    return Robustness(settings.huber_threshold, fitted.beyond, n_arcs, fitted.x, plain.x)


def _never() -> bool:
    """Nobody cancels."""
    return False


def _of_cosine(problem: Problem, parameters: Parameters, estimate: Estimate) -> Estimate:
    """Give a cosine fit the information that the arcs' true covariance leaves it."""
    judged = compared(problem.weighed(estimate.x), estimate.x, parameters.free, parameters.scale)
    if judged is None:
        return estimate
    return replace(estimate, A=judged.A, P=covariance(judged.A), chi2=judged.chi2, remarks=(judged.remark,))


def _listen_batch(steps: tuple[batch.Step, ...], listen: Listener) -> None:
    """Tell the listener of the iterates so far; the fraction is a guess, for a fit does not know its length."""
    step, iteration = steps[-1], len(steps) - 1
    unknown = np.full((len(step.sigma), len(step.sigma)), np.nan)
    estimate = Estimate(step.x, unknown, np.diag(step.sigma**2), step.chi2, "running", iteration, steps)
    listen(estimate, 1 - 0.7**iteration, f"iteration {iteration}: chi-square {step.chi2:.6g}")


def run_sequential(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, listen: Listener, cancelled: Asked
) -> Estimate:
    """Run a filter over the set, a chunk of frames at a time; each chunk's weights are taken at the state before it."""
    run_filter = FILTERS[settings.method]
    tuning = Tuning(settings.linearisations, settings.process_noise, settings.forgetting_factor)
    state = start(problem.sensor.initial, len(parameters.free), settings.initial_sigma_scale)
    # the filter as printed takes one frame at a time from the first
    pooled = (
        pool_start(problem.arcs, START_ARCS_PER_PARAMETER * len(parameters.free))
        if tuning.linearisations > 1
        else problem.arcs
    )
    parts: list[FilterHistory] = []
    began = time.perf_counter()
    for first, last in _chunks(pooled.n_frames, settings.replay_frames_per_s > 0):
        if cancelled():
            raise CancelledError(f"Stopped as asked after {first} of {pooled.n_frames} updates")
        chunk = weighed(pooled.frames(first, last), problem.camera, state.x)
        parts.append(run_filter(chunk, state, parameters.free, parameters.scale, tuning))
        state = parts[-1].last
        history = _joined(parts, state)
        estimate = _sequential_estimate(history, pooled.frame, "running")
        listen(estimate, last / pooled.n_frames, f"frame {pooled.frame[last - 1]}: {last} of {pooled.n_frames} updates")
        if not parts[-1].finite:
            break
        _keep_pace(began, last, settings.replay_frames_per_s, cancelled)
    return _finished(problem, parameters, _joined(parts, state), pooled.frame)


def _finished(problem: Problem, parameters: Parameters, history: FilterHistory, frame: IntArray) -> Estimate:
    """Judge a filter's end by the whole set: its information, its chi-square and whether it improved on the start."""
    x = history.last.x
    ended = batch.normal_equations(problem.weighed(x), x, parameters.free, parameters.scale)
    x_0 = problem.sensor.initial
    began = batch.normal_equations(problem.weighed(x_0), x_0, parameters.free, parameters.scale)
    if not (history.finite and ended.finite()) or ended.chi2 > 2 * began.chi2:
        status = "diverged"
    elif not batch.determined(ended.A)[2].all():
        status = "rank_deficient"
    else:
        status = "converged"
    return Estimate(
        x, ended.A, history.last.P, ended.chi2, status, int(history.linearisations.sum()),
        history=history, updated=frame[: len(history.nis)],
    )  # fmt: skip


def _sequential_estimate(history: FilterHistory, frame: IntArray, status: str) -> Estimate:
    """Make an estimate of a filter on its way; the set's information and chi-square are not known yet."""
    unknown = np.full_like(history.last.P, np.nan)
    return Estimate(
        history.last.x, unknown, history.last.P, float("nan"), status, int(history.linearisations.sum()),
        history=history, updated=frame[: len(history.nis)],
    )  # fmt: skip


def pool_start(arcs: ArcSet, n_arcs: int) -> ArcSet:
    """Merge the first frames until they hold `n_arcs` arcs; the merged frame bears the number of its last."""
    ends = 2 * arcs.star_start[arcs.frame_start[1:]] - 3 * arcs.frame_start[1:]
    k = min(int(np.searchsorted(ends, n_arcs)), arcs.n_frames - 1)
    starts = np.concatenate([[0], arcs.frame_start[k + 1 :]])
    return replace(arcs, frame=arcs.frame[k:], frame_start=starts)


def _chunks(n_frames: int, one_by_one: bool) -> Iterator[tuple[int, int]]:
    """Cut frames into chunks: one, then doubling up to a fortieth of the set; or one frame each for a replay."""
    first, size = 0, 1
    most = 1 if one_by_one else max(1, n_frames // CHUNKS)
    while first < n_frames:
        last = min(first + size, n_frames)
        yield first, last
        first, size = last, min(2 * size, most)


def _joined(parts: list[FilterHistory], state: FilterState) -> FilterHistory:
    """Join the histories of consecutive chunks."""
    names = ("states", "sigmas", "nis", "dof", "sum_of_squares", "linearisations")
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return FilterHistory(**arrays, last=state, finite=parts[-1].finite)


def _keep_pace(began: float, frames_done: int, frames_per_s: float, cancelled: Asked) -> None:
    """Wait until a replay may take the next frame, looking for a cancel meanwhile."""
    if frames_per_s <= 0:
        return
    due = began + frames_done / frames_per_s
    while (wait := due - time.perf_counter()) > 0:
        if cancelled():
            raise CancelledError(f"Stopped as asked after {frames_done} updates")
        time.sleep(min(wait, 0.2))


def covariance(A: FloatArray) -> FloatArray:
    """Invert the information over its determined directions; `batch.sigma_in_scale` says where that is infinite."""
    if not np.isfinite(A).all():
        return np.full_like(A, np.nan)
    values, vectors, known = batch.determined(A)
    return np.asarray((vectors[:, known] / values[known]) @ vectors[:, known].T)
