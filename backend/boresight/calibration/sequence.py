"""How a filter is run over a set: pooled start, chunks, matching again on the way, and evaluation on the whole set at its end.

A filter takes its frames from a `Frames`: those of a problem whose matches stand, or frames matched again with the
state that the filter has when it comes to them (E section II-D.2). Weights, and matches where they are made again, are taken for a
chunk of frames at the state before it: single frames first, then twice as many each time, at most a fortieth of the set or
`MOST_IN_CHUNK`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import IntArray
from boresight.calibration.advice_kinds import make_advice
from boresight.calibration.estimate import Asked, Estimate, Parameters, ReportEstimate, claim
from boresight.calibration.history_recorder import RecordedHistory
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, whiten_at
from boresight.calibration.process_noise import FrameSteps, choose_drift, free_names
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import FilterHistory, FilterState
from boresight.estimation.singular_values import Selection

#: A filter's first update pools frames until it holds this many arcs a free parameter: from one thin frame ten sigmas off, the
#: posterior has other minima (3 of 60 simulated sets fell into one at a single frame, none of 240 at 12 or more arcs).
START_ARCS_PER_PARAMETER = 20
#: Most linearisations of that update, whose way is the longest: on five real fields of a hundred stars singular values took 13, and
#: stopped at 6 they kept information from far off, which made the end claim 11 times what the data held along one direction.
START_LINEARISATIONS = 50
#: The pool is doubled while what it tells of a direction changes by more than this one sigma off: no later frame mends that. Of
#: simulated sets of E's sensor none needs it (1.2 to 1.7 at 20 arcs a parameter); five fields of 120 stars in 11 degrees, where
#: (m0, a2) and (n0, a1) are told apart by a weak distortion alone, have 6 to 27, and a mean NEES of 50 where the batch has 15.
BENT = 2.0
#: Where doubling ends: the extended filter inverts a matrix as large as the pool.
MOST_START_ARCS_PER_PARAMETER = 160
#: A filter reports, and takes its weights again, at least so often over a set.
CHUNKS = 40
#: Most frames of a chunk, for what a filter computes of one is in memory.
MOST_IN_CHUNK = 4096


@dataclass(frozen=True)
class Frames:
    """The frames of a set as a filter takes them in.

    `number`: (n_frames,) their numbers. `arcs`: unwhitened arcs of the frames first <= k < last, for a filter at this state;
    frames without usable stars are not in it.
    """

    number: IntArray
    arcs: Callable[[int, int, FilterState], ArcSet]

    @property
    def n_frames(self) -> int:
        """How many there are."""
        return len(self.number)

    def find_place(self, frame: int) -> int:
        """Place of a frame number among them."""
        return int(np.searchsorted(self.number, frame))


def standing_frames(problem: Problem) -> Frames:
    """Take the frames of a problem whose matches stand."""
    return Frames(problem.arcs.frame, lambda first, last, _: problem.arcs.frames(first, last))


def run_sequential(
    frames: Frames,
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    listen: ReportEstimate,
    cancelled: Asked,
) -> RecordedHistory:
    """Run a filter over frames; returns its history, empty where no frame has stars."""
    n_frames = frames.n_frames
    first_tuning, tuning = _tunings(settings)
    steps = FrameSteps(problem, choose_drift(parameters, free_names(problem, parameters), settings))
    state = parameters.start(problem.sensor.initial, settings)
    history = RecordedHistory(state)
    began = time.perf_counter()
    pooled, done = _first_frames(frames, problem, parameters, settings, state)
    for first, last in ((0, done), *_chunks(done, n_frames, settings.replay_frames_per_s > 0)):
        refuse_cancelled(cancelled, f"after {first} of {n_frames} frames")
        arcs = pooled if first == 0 else frames.arcs(first, last, history.last)
        if arcs.n_exposures:
            chunk = whiten_at(arcs, problem.camera, history.last.x)
            for run, step in steps.in_runs(chunk):
                tuned = replace(tuning if history else first_tuning, process_noise=step)
                history.append(_filtered(run, history.last, parameters, settings, tuned), run.frame)
                if not history.finite:
                    break
            listen(_on_its_way(history), last / n_frames, f"frame {arcs.frame[-1]}: {last} of {n_frames} frames")
            if not history.finite:
                break
        _keep_pace(began, last, settings.replay_frames_per_s, cancelled)
    return history


def _filtered(
    arcs: ArcSet, state: FilterState, parameters: Parameters, settings: CalibrationSettings, tuning: Tuning
) -> FilterHistory:
    """Run the filter over frames; one that runs away ends at numbers that are none, which its history says."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return FILTERS[settings.method](arcs, state, parameters.free, parameters.scale, tuning)


def _tunings(settings: CalibrationSettings) -> tuple[Tuning, Tuning]:
    """How the first update is made, which an iterated filter leaves time to rest, and how all others are."""
    tuning = Tuning(
        settings.linearisations, forgetting=settings.forgetting_factor,
        selection=Selection(settings.star_model, settings.singular_values), gain_form=settings.gain_form,
    )  # fmt: skip
    most = max(settings.linearisations, START_LINEARISATIONS) if settings.linearisations > 1 else 1
    return replace(tuning, linearisations=most), tuning


def finished(problem: Problem, parameters: Parameters, history: RecordedHistory) -> Estimate:
    """Judge a filter's end by a whole set: its information, its chi-square and whether it improved on the start."""
    x = history.last.x
    ended = batch.normal_equations(problem.whitened(x), x, parameters.free, parameters.scale)
    x_0 = problem.sensor.initial
    began = batch.normal_equations(problem.whitened(x_0), x_0, parameters.free, parameters.scale)
    if not (history.finite and ended.finite()) or ended.chi2 > 2 * began.chi2:
        status: batch.Status = "diverged"
    elif not batch.determined(parameters.with_prior(ended.A))[2].all():
        status = "rank_deficient"
    else:
        status = "converged"
    remarks = (
        *make_advice("filter_states", _say_blindness(problem, parameters, history)),
        *make_advice("one_update", _say_one_update(problem, history)),
    )
    return Estimate(
        x, ended.A, history.last.P, ended.chi2, status, history.linearisations_sum, history=history, remarks=remarks
    )  # fmt: skip


def _say_one_update(problem: Problem, history: RecordedHistory) -> Iterator[str]:
    """Say that a set was too small to be taken in frame by frame."""
    n_frames = problem.arcs.n_frames
    if history.finite and len(history) == 1 and n_frames > 1:
        yield (
            f"All {n_frames} frames were used in one update, because fewer would not determine the parameters: "
            "add frames to see a history."
        )


def _say_blindness(problem: Problem, parameters: Parameters, history: RecordedHistory) -> Iterator[str]:
    """Say whose spread took a filter beyond the range of the lens, and what can be done."""
    names = [problem.camera.parameter_names[parameters.free[place]] for place in history.blind]
    if names:
        yield (
            f"The filter diverged because it samples states {np.sqrt(len(parameters.free)):.1f} sigmas away, where "
            f"{' or '.join(names)} make{'s' * (len(names) == 1)} the distortion fold back before reaching some stars. Choose sqrf, "
            "which does not sample states, allow more linearisations, or lower typical_sigma or initial_sigma_scale."
        )


def _on_its_way(history: RecordedHistory) -> Estimate:
    """Make an estimate of a filter on its way; the set's information and chi-square are not known yet."""
    unknown = np.full_like(history.last.P, np.nan)
    return Estimate(
        history.last.x, unknown, history.last.P, float("nan"), "running", history.linearisations_sum, history=history
    )  # fmt: skip


def _first_frames(
    frames: Frames, problem: Problem, parameters: Parameters, settings: CalibrationSettings, state: FilterState
) -> tuple[ArcSet, int]:
    """Take the frames of the first update as one; returns them and their number."""
    tuning, n_free = _tunings(settings)[0], len(parameters.free)
    if tuning.linearisations == 1:  # the filter as printed takes one frame at a time from the first
        return _pooled(frames, state, 1)
    wanted = START_ARCS_PER_PARAMETER * n_free
    while True:
        pooled, done = _pooled(frames, state, wanted)
        if done == frames.n_frames or wanted >= MOST_START_ARCS_PER_PARAMETER * n_free:
            return pooled, done
        chunk = whiten_at(pooled, problem.camera, state.x)
        step = FrameSteps(problem, choose_drift(parameters, free_names(problem, parameters), settings)).take(
            pooled.frame
        )
        ended = _filtered(chunk, state, parameters, settings, replace(tuning, process_noise=step[0]))
        if not ended.finite or _bend(pooled, problem, parameters, settings, ended.last) < BENT:
            return pooled, done
        wanted *= 2


def _bend(
    arcs: ArcSet, problem: Problem, parameters: Parameters, settings: CalibrationSettings, state: FilterState
) -> float:
    """Largest ratio of a filter's information to that of its arcs and start one sigma off along its weakest direction."""
    variances, directions = np.linalg.eigh(state.P)
    widest, ratios = np.sqrt(variances[-1]) * directions[:, -1], []
    for step in (widest, -widest):
        x = state.x.copy()
        x[parameters.free] += parameters.scale * step
        there = batch.normal_equations(whiten_at(arcs, problem.camera, x), x, parameters.free, parameters.scale)
        if not there.finite():
            return np.inf
        ratios.append(claim(there.A, state.P, parameters.known_at_start(settings)))
    return max(ratios)


def _pooled(frames: Frames, state: FilterState, n_arcs: int) -> tuple[ArcSet, int]:
    """Take so many first frames that they hold `n_arcs` arcs, as one; returns them and their number."""
    n_frames, last = frames.n_frames, 1
    while True:
        arcs = frames.arcs(0, last, state)
        enough = 2 * arcs.n_stars - 3 * arcs.n_exposures >= n_arcs
        if enough or last == n_frames:
            break
        last = min(2 * last, n_frames)
    if not arcs.n_exposures:
        return arcs, n_frames
    pooled = pool_start(arcs, n_arcs).frames(0, 1)
    return pooled, frames.find_place(int(pooled.frame[0])) + 1 if enough else n_frames


def pool_start(arcs: ArcSet, n_arcs: int) -> ArcSet:
    """Merge the first frames until they hold `n_arcs` arcs; the merged frame bears the number of its last."""
    ends = 2 * arcs.star_start[arcs.frame_start[1:]] - 3 * arcs.frame_start[1:]
    k = min(int(np.searchsorted(ends, n_arcs)), arcs.n_frames - 1)
    starts = np.concatenate([[0], arcs.frame_start[k + 1 :]])
    return replace(arcs, frame=arcs.frame[k:], frame_start=starts)


def _chunks(done: int, n_frames: int, one_by_one: bool) -> Iterator[tuple[int, int]]:
    """Cut the frames from `done` on into chunks that double, as the module says; or one frame each for a replay."""
    first, size = done, 1
    most = 1 if one_by_one else max(1, min(n_frames // CHUNKS, MOST_IN_CHUNK))
    while first < n_frames:
        last = min(first + size, n_frames)
        yield first, last
        first, size = last, min(2 * size, most)


def _keep_pace(began: float, frames_done: int, frames_per_s: float, cancelled: Asked) -> None:
    """Wait until a replay may take the next frame, looking for a cancel meanwhile."""
    if frames_per_s <= 0:
        return
    due = began + frames_done / frames_per_s
    while (wait := due - time.perf_counter()) > 0:
        refuse_cancelled(cancelled, f"after {frames_done} updates")
        time.sleep(min(wait, 0.2))
