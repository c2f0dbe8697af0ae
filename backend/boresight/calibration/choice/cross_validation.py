"""How well each candidate does on frames that it was not fitted to, with intervals.

Held out are the frames of a validation set, whose stars are matched once for all candidates; or, where there is none, each of
`FOLDS` stretches of frames in turn, predicted by the others (cross-validation by whole stretches, for neighbouring frames share
stars). With A = sum A_k and b = sum b_k the normal equations of the stretches at the optimum, the fit to all but stretch k lies at

    z - (A - A_k)^-1 (b - b_k)      to the second order of what the stretch pulls, a share of a sigma.

The score is the unweighted RMS of arcs. Frames are resampled in blocks (`evaluation.bootstrap`), the same blocks for every
candidate, so the ratio of two candidates' scores has an interval of its own, much narrower than what the two scores' would make.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.choice.fits import Fits, FittedSubset, seen_by
from boresight.calibration.choice.result import HeldOutBy
from boresight.calibration.evaluation import bootstrap
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.metrics import arc_errors

FOLDS = 5


@dataclass(frozen=True)
class Score:
    """RMS of held-out arcs, rad, or a ratio of two, and its 95 % interval; an end is None where too few frames tell."""

    value: float
    interval: tuple[float | None, float | None]


@dataclass(frozen=True)
class HeldOutScores:
    """Held-out squares of every candidate, frame by frame.

    `source`: what they were held out by. `frames`: how many. `squares`: (n_frames, n_candidates) sums of squared arc
    errors, rad^2; NaN where a candidate could not be judged. `arcs`: (n_frames,). `drawn`: (replicates, n_candidates + 1) resampled
    sums, arcs last. `blocks`: independent blocks in the set.
    """

    source: HeldOutBy
    frames: int
    squares: FloatArray
    arcs: FloatArray
    drawn: FloatArray
    blocks: float

    def score(self, candidate: int) -> Score | None:
        """Score one candidate; None where it could not be judged."""
        return self._interval(candidate, -1)

    def ratio(self, candidate: int, against: int) -> Score | None:
        """RMS of one candidate over that of another on the same frames."""
        return self._interval(candidate, against)

    def _interval(self, over: int, under: int) -> Score | None:
        sums = np.append(self.squares.sum(axis=0), self.arcs.sum())
        if not np.isfinite(sums[over]) or not sums[under] > 0:
            return None
        value = float(np.sqrt(sums[over] / sums[under]))
        values = np.sqrt(self.drawn[:, over] / self.drawn[:, under])
        low, high = bootstrap.interval(value, values, self.blocks)
        return Score(value, (low, high))


def cross_validate(fits: Fits, candidates: list[FittedSubset], rng: np.random.Generator) -> HeldOutScores | None:
    """Predict each stretch of frames by fits to the others; None where there is one frame only."""
    n = fits.arcs.n_frames
    folds = min(FOLDS, n)
    if folds < 2:
        return None
    edges = np.linspace(0, n, folds + 1).round().astype(int).tolist()
    parts = [fits.arcs.frames(first, last) for first, last in pairwise(edges)]
    squares = np.full((n, len(candidates)), np.nan)
    for k, one in enumerate(candidates):
        if one.usable:
            states = _without_each(parts, fits, one)
            squares[:, k] = np.concatenate([_squares(part, one, x) for part, x in zip(parts, states, strict=True)])
    return _resampled(HeldOutBy.CROSS_VALIDATION, squares, np.diff(fits.arcs.frame_arcs), rng)


def _without_each(parts: list[ArcSet], fits: Fits, one: FittedSubset) -> list[FloatArray]:
    """State (n_parameters,) of a candidate without each part, by one step from where all of them put it."""
    free = one.subset.free
    scale = fits.scale(one.camera)[free]
    each = [batch.normal_equations(seen_by(part, one.camera), one.x, free, scale) for part in parts]
    whole = batch.NormalEquations.added(each, len(free))
    states = []
    for of_part in each:
        x = one.x.copy()
        try:
            x[free] -= scale * np.linalg.solve(whole.A - of_part.A, whole.b - of_part.b)
        except np.linalg.LinAlgError:
            x[:] = np.nan
        states.append(x)
    return states


def validate(arcs: ArcSet, candidates: list[FittedSubset], rng: np.random.Generator) -> HeldOutScores:
    """Judge every candidate on another set, whitened."""
    squares = np.full((arcs.n_frames, len(candidates)), np.nan)
    for k, one in enumerate(candidates):
        if one.usable:
            squares[:, k] = _squares(arcs, one, one.x)
    return _resampled(HeldOutBy.VALIDATION, squares, np.diff(arcs.frame_arcs), rng)


def _squares(arcs: ArcSet, one: FittedSubset, x: FloatArray) -> FloatArray:
    """Sums of squared arc errors of each frame, (n_frames,)."""
    return np.asarray(np.add.reduceat(arc_errors(seen_by(arcs, one.camera), x) ** 2, arcs.frame_arcs[:-1]))


def _resampled(source: HeldOutBy, squares: FloatArray, arcs: FloatArray, rng: np.random.Generator) -> HeldOutScores:
    columns = np.column_stack([squares, arcs]).astype(np.float64)
    length = 1
    for column in columns.T[:-1]:
        if np.isfinite(column).all():
            length = max(length, bootstrap.block_length(column - column.sum() / arcs.sum() * arcs))
    drawn = bootstrap.resampled_sums(columns, length, rng)
    return HeldOutScores(source, len(arcs), squares, np.asarray(arcs, dtype=np.float64), drawn, len(arcs) / length)
