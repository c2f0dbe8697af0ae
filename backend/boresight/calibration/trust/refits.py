"""Whether each free parameter is needed: one is held at its start, the others are fitted again, and the cost shows.

Near the optimum z_0 of all parameters the chi-square is quadratic with Hessian A, so holding parameter p a distance d from its
optimum costs d^2 / (A^-1)_pp and moves the others by (A^-1)_:p d / (A^-1)_pp. Starts lie a thousand sigmas off and the camera
is not linear over that far, so this step is only where a true fit begins. By Wilks' theorem the increase is chi-square with one
degree of freedom when the start is the truth; beyond its 99 % point, 6.63, the data ask for the parameter.

The true fits run on at most `MOST_FRAMES` frames, and at most some `MOST_ARCS` arcs, spaced evenly over the set: how far the camera
is from linear is the same in each part of it. The increase over all frames is then the quadratic one over all, times the ratio of
true to quadratic on those frames, which is one for a start that is near; other parameters move by the same on either, told in
sigmas of all. A fit that does not
come to rest in `MOST_ITERATIONS` is not `settled`: the increase is then at most what is told.

Where a fit with a parameter held ends below the fit of all, that was a minimum and not the lowest. All are fitted again from there,
and where that is lower on the whole set too, it is handed back to be taken up as the estimate (`LowerMinimum`). A filter's estimate
has its start and its order of frames in it and is not moved: there the evidence is told against the lower minimum, and the sentence
says so.

Two halves of a set, fitted apart: whether they agree within what both claim.

The frames are cut into some 40 consecutive blocks, dealt out in turn, so that both halves cover the same sky, temperatures and
time. Each is fitted alone from the joint estimate. Their data are independent, so the difference d = x_a - x_b has covariance
P_a + P_b, and

    d^T (P_a + P_b)^-1 d     is chi-square with n_free degrees of freedom

when stars, noise and model are what they are said to be. It is not, when some frames hold wrong matches, when the noise is
understated or when the camera changed from block to block. What neither half can show is an error both share: a model that is
wrong everywhere. Whatever the method, the halves are fitted by the batch estimator, without any start's information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.calibration import DroppedParameter, HalvesMap, HalvesTest, TwoHalves
from boresight.calibration.minima import MOST_RESTARTS, LowerMinimum
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, chosen, grid, nested, probability
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import covariance
from boresight.estimation.minima import LOWER, CostSurface, is_within_reach
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.special import chdtrc, chdtri
from boresight.estimation.statistics.uncertainty import difference_over_detector, expected_difference
from boresight.wording import join_words

BLOCKS = 40
ROWS, COLUMNS = 13, 17
HALF_ITERATIONS = 20


def two_halves(fitted: FittedSet) -> TwoHalves:
    """Fit both halves and compare them."""
    if not fitted.determined:
        raise Unavailable(
            "The whole set does not determine every free parameter, so neither does a half: hold some fixed."
        )
    n = fitted.arcs.n_frames
    if n < 2:
        raise Unavailable("One frame has no halves: add frames.")
    in_first = (np.arange(n) * min(n, BLOCKS) // n) % 2 == 0
    first, second = _fitted(fitted, in_first), _fitted(fitted, ~in_first)
    return _compared(fitted, first, second)


def _fitted(ground: FittedSet, frames: NDArray[np.bool_]) -> batch.BatchFit:
    arcs = chosen(ground.arcs, frames)
    if arcs.n_arcs <= len(ground.names):
        raise Unavailable("A half of the set has no more arcs than there are free parameters: add frames.")
    refusal = "A half of the set does not determine the free parameters by itself: add frames, or free fewer."
    return _fit_all(ground, arcs, HALF_ITERATIONS, refusal, _summed(ground, frames))


def _summed(ground: FittedSet, frames: NDArray[np.bool_]) -> batch.NormalEquations | None:
    """A, b and chi-square of some frames (n_frames,) at the joint estimate, from its rows; None with Huber's weights."""
    if np.isfinite(ground.threshold):
        return None
    n_free = len(ground.names)
    A, b, chi2 = np.zeros((n_free, n_free)), np.zeros(n_free), 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], frames, [False]])))
    for first, last in ground.arcs.frame_arcs[edges].reshape(-1, 2):
        e, H = ground.e[first:last], ground.H[first:last]
        A += H.T @ H
        b += H.T @ e
        chi2 += float(e @ e)
    return batch.NormalEquations(A, b, chi2, np.nan)


def _fit_all(
    ground: FittedSet, arcs: ArcSet, max_iterations: int, refusal: str, begun: batch.NormalEquations | None = None
) -> batch.BatchFit:
    """Fit all free parameters to some frames from the joint estimate; what does not come to rest is refused."""
    free, scale = ground.parameters.free, ground.parameters.scale
    fitted = batch.fit(
        arcs, ground.x, free, scale,
        threshold=ground.threshold, max_iterations=max_iterations, begun=begun, cancelled=ground.cancelled,
    )  # fmt: skip
    if fitted.status != "converged":
        raise Unavailable(refusal)
    return fitted


def _compared(fitted: FittedSet, first: batch.BatchFit, second: batch.BatchFit) -> TwoHalves:
    """Their difference in units of its covariance, and over the detector."""
    scale = fitted.parameters.scale
    P = covariance(first.A) + covariance(second.A)
    d = (first.x - second.x)[fitted.parameters.free] / scale
    dof, value = len(d), float(d @ np.linalg.solve(P, d))
    test = chi_square(value, dof)
    sensor, camera = fitted.problem.sensor, fitted.problem.camera
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    places = (np.repeat(row, COLUMNS), np.tile(col, ROWS))
    difference = ARCSEC_PER_RAD * difference_over_detector(camera, first.x, second.x, places, sensor.pixel_pitch_m)
    expected = ARCSEC_PER_RAD * expected_difference(
        camera, fitted.x, fitted.full_covariance(P), places, sensor.pixel_pitch_m
    )
    return TwoHalves(
        names=fitted.names,
        difference_in_sigma=nested(d / np.sqrt(np.diag(P))),
        chi2=HalvesTest(
            value=value,
            dof=dof,
            lower=test.lower * dof,
            upper=test.upper * dof,
            p=float(chdtrc(dof, value)),
            consistent=test.consistent,
        ),
        map=HalvesMap(
            row_px=nested(row),
            col_px=nested(col),
            difference_arcsec=nested(difference.reshape(ROWS, COLUMNS)),
            expected_arcsec=nested(expected.reshape(ROWS, COLUMNS)),
        ),
        sentence=_sentence(value, dof, (test.lower * dof, test.upper * dof), _rms(difference), _rms(expected)),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _sentence(value: float, dof: int, bounds: tuple[float, float], found: float, expected: float) -> str:
    lower, upper = bounds
    numbers = (
        f"chi-square {value:.3g} for {dof}, {lower:.2g} to {upper:.3g} expected, {probability(chdtrc(dof, value))}"
    )
    over = f"over the detector they differ by {found:.2g} arcsec (RMS), {expected:.2g} expected"
    if value > upper:
        return (
            f"Two halves of the set disagree by more than their sigmas allow ({numbers}); {over}: "
            "check for wrong matches, understated noise or a camera that changed."
        )
    if value < lower:
        return (
            f"Two halves of the set agree better than their sigmas allow ({numbers}); {over}: the noise is overstated."
        )
    return f"Two halves of the set, fitted separately, agree ({numbers}); {over}."


MOST_FRAMES = 200
MOST_ARCS = 2_000
MOST_ITERATIONS = 30
NEEDED = float(chdtri(1, 0.01))


@dataclass(frozen=True)
class Optimum:
    """The fit of all free parameters: state (n_parameters,), covariance (n_free, n_free) in typical sigmas, and its cost."""

    x: FloatArray
    P: FloatArray
    cost: float


def drop_one(ground: FittedSet) -> list[DroppedParameter]:
    """One entry a free parameter, in parameter order."""
    if len(ground.names) < 2:
        raise Unavailable("Only one parameter is free, so nothing can be fitted without it: free more parameters.")
    if not ground.determined:
        raise Unavailable("The data do not determine one direction of the parameters: hold some fixed and run again.")
    arcs = ground.thinned(min(MOST_FRAMES, -(-MOST_ARCS * ground.arcs.n_frames // ground.arcs.n_arcs)))
    refusal = "The fit of all parameters does not converge, so none can be compared with it: free fewer parameters."
    fitted = _fit_all(ground, arcs, MOST_ITERATIONS, refusal)
    best = Optimum(fitted.x, covariance(fitted.A), fitted.cost)
    whole = best if arcs.n_frames == ground.arcs.n_frames else Optimum(ground.x, covariance(ground.A), np.nan)
    for _ in range(MOST_RESTARTS + 1):
        held = [_hold(ground, arcs, place, best) for place in range(len(ground.names))]
        lowest = min(range(len(held)), key=lambda place: held[place].cost)
        if held[lowest].cost > best.cost - LOWER:
            break
        _hand_back(ground, held[lowest], ground.names[lowest])
        best = _refitted(ground, arcs, held[lowest], best)
        whole = best if whole.x is ground.x and arcs.n_frames == ground.arcs.n_frames else whole
    return [_describe_held(ground, arcs, place, fit, best, whole) for place, fit in enumerate(held)]


def _hand_back(ground: FittedSet, held: batch.BatchFit, name: str) -> None:
    """Raise LowerMinimum where all parameters, fitted to the whole set from a fit with one held, end below the estimate."""
    parameters, restarts = ground.parameters, ground.estimate.searched.restarts
    ended = batch.fit(
        ground.arcs, held.x, parameters.free, parameters.scale, threshold=ground.threshold, cancelled=ground.cancelled
    )
    fall = _equations(ground, ground.arcs, ground.x).chi2 - ended.cost
    surface = CostSurface(
        lambda _: ground.arcs, parameters.free, parameters.scale, ground.threshold, ground.problem.can_be
    )
    here = replace(ended, x=ground.x, A=ground.A)
    if fall < LOWER or not surface.is_minimum(ended) or not is_within_reach(surface, ended, here):
        return
    if not ground.settings.sequential and restarts < MOST_RESTARTS:
        raise LowerMinimum(ended.x, f"the fit with {name} held", fall)
    ground.computed["lower_minimum"] = (
        f"a minimum {fall:.3g} lower in chi-square, found by starting from the fit with {name} held fixed"
    )


def _refitted(ground: FittedSet, arcs: ArcSet, held: batch.BatchFit, best: Optimum) -> Optimum:
    """The fit of all parameters from one with a parameter held; the former where that is none."""
    free, scale = ground.parameters.free, ground.parameters.scale
    fitted = batch.fit(
        arcs, held.x, free, scale,
        threshold=ground.threshold, max_iterations=MOST_ITERATIONS, cancelled=ground.cancelled,
    )  # fmt: skip
    if fitted.status != "converged":
        return replace(best, cost=min(held.cost, best.cost))
    return Optimum(fitted.x, covariance(fitted.A), fitted.cost)


def _equations(fitted: FittedSet, arcs: ArcSet, x: FloatArray) -> batch.NormalEquations:
    """A, b and the cost at a state: chi-square, or Huber's loss."""
    free, scale = fitted.parameters.free, fitted.parameters.scale
    return batch.normal_equations(arcs, x, free, scale, fitted.threshold)


def quadratic_increase(fitted: FittedSet, place: int, best: Optimum) -> tuple[float, FloatArray]:
    """Increase of chi-square and step (n_free,) in typical sigmas that the quadratic model foresees."""
    p = fitted.parameters.free[place]
    d = (fitted.problem.sensor.initial[p] - best.x[p]) / fitted.parameters.scale[place]
    return float(d * d / best.P[place, place]), best.P[:, place] * d / best.P[place, place]


def _hold(ground: FittedSet, arcs: ArcSet, place: int, best: Optimum) -> batch.BatchFit:
    """Hold one parameter at its start and fit the others."""
    free, scale = ground.parameters.free, ground.parameters.scale
    others = np.delete(np.arange(len(free)), place)
    step = quadratic_increase(ground, place, best)[1]
    x = best.x.copy()
    x[free] += scale * step
    start, begun = _start(arcs, x, best, ground, place)
    return batch.fit(
        arcs, start, free[others], scale[others],
        threshold=ground.threshold, max_iterations=MOST_ITERATIONS, begun=begun.select(others), cancelled=ground.cancelled,
    )  # fmt: skip


def _describe_held(
    ground: FittedSet, arcs: ArcSet, place: int, fitted: batch.BatchFit, best: Optimum, whole: Optimum
) -> DroppedParameter:
    """Say what holding a parameter cost, of all frames where only some were fitted."""
    free, scale = ground.parameters.free, ground.parameters.scale
    others = np.delete(np.arange(len(free)), place)
    increase = fitted.cost - best.cost
    if whole is not best:
        foreseen, foreseen_of_all = (quadratic_increase(ground, place, one)[0] for one in (best, whole))
        increase = foreseen_of_all * (increase / foreseen if foreseen > NEEDED else 1.0)
    moved = np.abs((fitted.x - best.x)[free[others]]) / (scale[others] * np.sqrt(np.diag(whole.P)[others]))
    most = int(np.argmax(moved))
    return DroppedParameter(
        name=ground.names[place],
        chi2_increase=increase,
        rms_arc_rad=float(np.sqrt(fitted.sum_of_squares / arcs.n_arcs)),
        shift_in_sigma_of_others=float(moved[most]),
        most_shifted=ground.names[others[most]],
        needed=increase > NEEDED,
        frames_used=arcs.n_frames,
        settled=fitted.status == "converged",
    )


def _start(
    arcs: ArcSet, foreseen: FloatArray, best: Optimum, fitted: FittedSet, place: int
) -> tuple[FloatArray, batch.NormalEquations]:
    """The state foreseen, or the optimum with only this parameter held where that is nearer, with A, b and the cost there."""
    p = fitted.parameters.free[place]
    held = best.x.copy()
    held[p] = foreseen[p] = fitted.problem.sensor.initial[p]
    there = _equations(fitted, arcs, foreseen)
    if np.isinf(fitted.threshold) and there.chi2 <= batch.compute_chi2(arcs, held):
        return foreseen, there
    here = _equations(fitted, arcs, held)
    return (foreseen, there) if there.chi2 <= here.chi2 else (held, here)


def drop_one_sentence(fitted: FittedSet, entries: list[DroppedParameter]) -> str:
    """Which parameters the data ask for."""
    symbols = dict(zip(fitted.names, fitted.symbols, strict=True))
    spare = [symbols[entry.name] for entry in entries if not entry.needed]
    weakest = min(entries, key=lambda entry: entry.chi2_increase)
    rise, symbol = f"{weakest.chi2_increase:.3g}", symbols[weakest.name]
    other = ""
    if lower := fitted.computed.get("lower_minimum"):
        other = f"; there is {lower}: run the batch, which takes the lowest"
    if not spare:
        return (
            f"The data require every free parameter: {symbol} costs least when held fixed, {rise} in chi-square{other}; a "
            f"parameter is required above {NEEDED:.3g} (1 % level)."
        )
    if len(spare) == 1:
        return (
            f"These data give no evidence that {spare[0]} changed: with it fixed at its initial value, chi-square increases by "
            f"{rise}, less than {NEEDED:.3g} (1 % level){other}. It may be held fixed."
        )
    return (
        f"These data give no evidence that {join_words(spare)} changed: with any one of them fixed at its initial value, "
        f"chi-square increases by less than {NEEDED:.3g} (1 % level), least for {symbol}, by {rise}{other}. They may be held "
        "fixed, one at a time."
    )
