"""Sigmas that tell the truth about misfit: what noise alone leaves in the parameters, widened by what the model does not hold.

The covariance A^-1 of a fit is right when every centroid errs by the stated noise alone, and the model is linear over it. What is
wrong with the model shows in four ways, and what bends in a fifth, each of which may only widen it.

1. Level. Where chi-square per degree of freedom, s, is above its 95 % bound, residuals are larger than stated: s A^-1.

2. Blocks. What changes slowly (focal length with temperature, another sky, another rate) makes frames that follow each other err
   alike. With g_b the sum of the scores of the frames of block b, and B blocks,

       P_B = c A^-1 (sum_b g_b g_b^T) A^-1,        c = B / (B - 1) (n - 1) / (n - p) (B - 1) / (B - 3)     (White, Liang and Zeger)

   is the covariance of an estimate whose blocks are independent, whatever happens inside them; the first two factors correct for
   scores that add up to zero and for the arcs that the p parameters have used up, the third for a variance that is known from
   B - 1 numbers only. Whitened by the level's covariance, P_B is a Wishart matrix over B - 1 when nothing is wrong. It is taken
   only where its trace or its largest eigenvalue (Johnstone) is beyond what noise gives once in 200 sets, and only along the
   eigenvectors where it is wider: so clean sets keep their sigmas. Blocks of several lengths are tried, for slow changes must fit
   inside: what is correlated over a tenth of a block is still underestimated by a tenth.

3. Departures. What is the same in all frames (a lens, the phase of the pixels) leaves the scores of the blocks alone. Of each
   departure that the tests notice, `displacements` expects how far the parameters are off if it is real, d. The departure that
   explains most for its number of coefficients (Schwarz's criterion) is taken first, others only while they explain what is left;
   together they widen by d d^T + cov(d), and each parameter by a share `CURVATURE` of its own d besides, for d is of first order.
   What stays with a star's place and is not noticed, but less likely chance than `SUSPECTED`, widens too, and is told with the
   sigmas alone: a test that is silent at 1 % is no evidence of a sound lens.
   Two kinds of departure leave d small though the camera is wrong by more. One that changes it over the set (`drift`, `exposure`,
   `time`, `trend`, `temperature`): a fit ends between its states, and each of these is off by up to the change's amplitude a, along
   the parameters that change, or the focal length: a a^T. One that goes with the magnitude or the colour m of a star about the
   mean: the star at which it is zero need not be the mean one. If that is the brightest or the faintest, all stars are displaced
   alike besides, by c times the reach of m, and the parameters by -A^-1 H^T G c of that: d d^T.

4. Selection. A filter that matches by the tolerance of the flight code takes in, frame by frame, the arcs that agree with where it
   stands. From a start that is off by more than that tolerance it keeps few, and those lean to the start. The fit of the whole set
   as it is matched in the end does not; the distance between the two, d, widens by d d^T.

5. Bends. Where chi-square of a small set has several minima, or rises along a valley that bends, `estimation.minima` has the mean
   square distance of all that can be from the estimate. The covariance is widened to be nowhere narrower than that.

A filter's estimate has its start in it too; it is widened by as much as the fit of the whole set is. An estimate that stands on a
prior follows the fit of the set by K = P A only, and is widened by K times that from both sides: what the data err does not widen
what they were not asked for.

References
----------
White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48, 1980. Liang, Zeger, "Longitudinal data
analysis using generalized linear models", Biometrika 73, 1986. Johnstone, "On the distribution of the largest eigenvalue in
principal components analysis", Annals of Statistics 29, 2001.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legval

from boresight.arrays import FloatArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import Covariance, ModelMisfit, TrustTest, Values
from boresight.calibration.trust.departures import SOUGHT, find_quantities, half_diagonal
from boresight.calibration.trust.displacements import Score, ScoreSums, expect, find_score
from boresight.calibration.trust.fitted_set import FittedSet
from boresight.calibration.trust.trust_tests import STAYING, get_test_gate
from boresight.cameras.model import Role
from boresight.estimation.batch import covariance
from boresight.estimation.robust import measure_huber_effect
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.special import chdtrc

#: Numbers of blocks that are tried; fewer frames are as many blocks as there are frames.
BLOCKS = (96, 48, 24)
#: Chance of a clean set's trace, and quantile of the Tracy-Widom law of the same chance, from which on blocks are taken.
LEVEL, TRACY_WIDOM = 0.005, 2.4224
#: Chance, over all tests, below which what stays with a star's place widens though nobody need be told.
SUSPECTED = 0.05
#: Gate of the lens and the detector, and what else either may do where one of its tests counts.
LENS, SMOOTH = "lens-structure", ("lens", "radial", "seam", "trail", "edges")
#: Share of d by which it may be wrong because the camera is not linear over it.
CURVATURE = 0.1
#: Departures that change every free parameter during the set, and those that change the scale alone.
WHOLE_CAMERA, SCALE_ALONE = ("drift", "exposure"), ("trend", "time", "temperature")
#: Quantiles of magnitude or colour between which the star lies that is not displaced.
REACH = (0.02, 0.98)
#: Factor below which nobody need hear of a widening, and from which on it belongs among the advice.
SAME, WIDE = 1.05, 2.0


@dataclass(frozen=True)
class Widening:
    """What was found: the covariance with it, (n_free, n_free) in typical sigmas, and what it came from.

    `level`: s above. `blocks`: how many were taken, 0 where none were. `departures`: taken, the first first. `suspected`: those
    among them that no test noticed. `selected`: distance of a filter that selects its arcs from the fit of the whole set, in
    claimed sigmas of its worst parameter. `bends`: whether chi-square does, so that the sigmas alone tell too little.
    """

    P: FloatArray
    level: float = 1.0
    blocks: int = 0
    departures: tuple[str, ...] = ()
    suspected: tuple[str, ...] = ()
    selected: float = 0.0
    bends: bool = False


def widen(
    fitted: FittedSet,
    sums: ScoreSums | None = None,
    scores: Mapping[str, Score] | None = None,
    tests: Sequence[TrustTest] = (),
    spread: FloatArray | None = None,
) -> Widening:
    """Find by how much the sigmas of a fit are to be widened.

    Parameters
    ----------
    fitted
        The fit of the whole set.
    sums, scores
        What `displacements` found of departures; None where they were not tested.
    tests
        The tests that were made of them.
    spread
        (n_free, n_free) mean square distance of all that can be, in typical sigmas; None where chi-square does not bend.
    """
    noise = covariance(fitted.A)
    level = _level(fitted)
    widest, blocks = _widen_by_blocks(fitted, noise, level)
    shift, taken = np.zeros_like(noise), tuple[str, ...]()
    if sums is not None and scores:
        counted = [one.name for one in tests if _counts(one)]
        shift, taken = _measure_departures(sums, scores, counted)
        shift = shift + _measure_changes(fitted, scores, taken) + _measure_zero_points(fitted, sums, taken)
    lean = _lean(fitted)
    excess = np.asarray(widest - noise + shift)
    if fitted.parameters.prior is not None:
        K = fitted.estimate.P @ fitted.A
        excess = K @ excess @ K.T
    P = fitted.estimate.P + excess + np.outer(lean, lean)
    if spread is not None:
        P = _envelope(P, spread)
    selected = float(np.max(np.abs(lean) / np.sqrt(np.diag(fitted.estimate.P))))
    noticed = {one.name for one in tests if one.noticed}
    suspected = tuple(name for name in taken if name not in noticed)
    return Widening(P, level, blocks, taken, suspected, selected, spread is not None)


def _counts(test: TrustTest) -> bool:
    """Whether a departure widens."""
    return test.noticed or (test.name in STAYING and test.adjusted < SUSPECTED)


def _lean(fitted: FittedSet) -> FloatArray:
    """How far a filter that selects its arcs ended from the fit of the whole set, (n_free,) typical sigmas; none of the others."""
    settings, parameters = fitted.settings, fitted.parameters
    if not settings.sequential or settings.match_rule != "flight":
        return np.zeros(len(parameters.free))
    lean = (fitted.estimate.x - fitted.x)[parameters.free] / parameters.scale
    if (prior := parameters.prior) is not None:
        pulled = (prior.x - fitted.x)[parameters.free] / parameters.scale
        lean -= np.linalg.solve(parameters.with_prior(fitted.A), prior.A @ pulled)
    return np.asarray(lean)


def _level(fitted: FittedSet) -> float:
    """Chi-square per degree of freedom where it is above its bound, else 1; a robust estimate has measured its own already."""
    dof = fitted.arcs.n_arcs - len(fitted.A)
    if np.isfinite(fitted.threshold):
        effect = measure_huber_effect(fitted.arcs, fitted.x, len(fitted.A), fitted.threshold)
        return float(1 / effect.information_share) if effect.information_share > 0 else 1.0
    test = chi_square(float(fitted.sums.chi2.sum()), dof)
    return test.mean if test.mean > test.upper else 1.0


def _widen_by_blocks(fitted: FittedSet, noise: FloatArray, level: float) -> tuple[FloatArray, int]:
    """A covariance `noise` (n_free, n_free) times s, widened by every number of blocks that shows more, and the first that does."""
    widest, taken = level * noise, 0
    if np.isfinite(fitted.threshold):
        return widest, taken
    root, n = np.linalg.cholesky(noise), fitted.arcs.n_frames
    for B in sorted({min(wanted, n) for wanted in BLOCKS if min(wanted, n) >= len(noise) + 4}):
        M = root.T @ sum_of_squares(fitted.sums.scores, B, fitted.arcs.n_arcs) @ root / level
        if not is_wider(M, B):
            continue
        taken = taken or B
        values, vectors = np.linalg.eigh(M)
        half = root @ (vectors * np.sqrt(level * np.maximum(values * (B - 1) / (B - 3), 1.0)))
        widest = _envelope(widest, half @ half.T)
    return widest, taken


def sum_of_squares(scores: FloatArray, B: int, n_arcs: int) -> FloatArray:
    """Sum over B blocks of frames of g_b g_b^T with its corrections, (n_free, n_free), of scores (n_frames, n_free)."""
    n, p = scores.shape
    starts = np.arange(B) * n // B
    g = np.add.reduceat(scores, starts, axis=0)
    return np.asarray(B / (B - 1) * (n_arcs - 1) / (n_arcs - p) * (g.T @ g))


def is_wider(M: FloatArray, B: int) -> bool:
    """Whether (B - 1) M, M (p, p), is more than a Wishart matrix of B - 1 degrees of freedom is once in 200."""
    p, n = len(M), B - 1
    total = n * float(np.trace(M))
    a, b = np.sqrt(n - 1), np.sqrt(p)
    largest = (a + b) ** 2 + TRACY_WIDOM * (a + b) * (1 / a + 1 / b) ** (1 / 3)
    return bool(chdtrc(n * p, total) < LEVEL or n * np.linalg.eigvalsh(M)[-1] > largest)


def _envelope(P: FloatArray, other: FloatArray) -> FloatArray:
    """The smallest covariance that is nowhere narrower than either, both (n, n) and positive definite."""
    root = np.linalg.cholesky(P)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ other @ inverse.T)
    half = root @ (vectors * np.sqrt(np.maximum(values, 1.0)))
    return np.asarray(half @ half.T)


def _measure_departures(
    sums: ScoreSums, scores: Mapping[str, Score], counted: list[str]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Find the departures that explain what the tests noticed, and d d^T + cov(d) (n_free, n_free) of them together."""
    taken: list[str] = []
    noticed = [name for name in counted if name in scores]
    best: Score | None = None
    price = float(np.log(sums.n_arcs))  # of a degree of freedom, as Schwarz has it
    while left := [name for name in noticed if name not in taken]:
        joint = [find_score(sums, *taken, name) for name in left]
        worth = [one.statistic - price * (one.dof + SOUGHT.get(name, 0)) for name, one in zip(left, joint, strict=True)]
        place = int(np.argmax(worth))
        more = 0 if best is None else joint[place].dof - best.dof + SOUGHT.get(left[place], 0)
        if best is not None and joint[place].fall - best.fall < price * max(more, 1) * _noise(sums, joint[place]):
            break
        best = joint[place]
        taken.append(left[place])
    of_lens = any(get_test_gate(one) == LENS for one in counted)
    others = [name for name in SMOOTH if of_lens and name in scores and name not in taken]
    if not taken and not others:
        return np.zeros_like(sums.A), ()
    d, uncertainty = expect(sums, taken, others)
    return np.outer(d, d) + uncertainty + np.diag((CURVATURE * d) ** 2), tuple(taken)


def _measure_changes(fitted: FittedSet, scores: Mapping[str, Score], taken: Sequence[str]) -> FloatArray:
    """Sum of a a^T (n_free, n_free) over the departures that change the camera during the set."""
    total = np.zeros_like(fitted.A)
    for name in taken:
        if name in WHOLE_CAMERA:
            a = scores[name].c
            total += np.outer(a, a) + scores[name].covariance
        elif name in SCALE_ALONE:
            a = _measure_scale(fitted, scores[name].clear)
            total += np.outer(a, a)
    return total


def _measure_scale(fitted: FittedSet, c: FloatArray) -> FloatArray:
    """Largest change (n_free,) by a scale of the Legendre coefficients c, pixels at half a diagonal: that of the focal length."""
    camera, free = fitted.problem.camera, fitted.parameters.free
    place = camera.place(Role.FOCAL)
    largest = float(np.abs(legval(np.linspace(-1, 1, 201), [0.0, *c])).max())
    a = np.asarray(fitted.x[free] / fitted.parameters.scale * largest / half_diagonal(fitted))
    return np.where(np.asarray(free) == place, a, 0.0)


def _measure_zero_points(fitted: FittedSet, sums: ScoreSums, taken: Sequence[str]) -> FloatArray:
    """Sum of d d^T (n_free, n_free) where the star that is not displaced may be any of the set."""
    total = np.zeros_like(sums.A)
    known = find_quantities(fitted)
    for name, values in (("magnitude", known.magnitude), ("colour", known.colour)):
        if name not in taken or values is None or "alike" not in sums.places:
            continue
        both = find_score(sums, name, f"{name} stretch")
        reach = float(np.abs(np.quantile(values, REACH)).max())
        d = reach * sums.P @ sums.G_H[sums.places["alike"]].T @ both.clear
        shift, uncertainty = expect(sums, [name, f"{name} stretch"])
        total += np.outer(d, d) + np.outer(shift, shift) + uncertainty
    return total


def _noise(sums: ScoreSums, score: Score) -> float:
    """Variance of the whitened residuals that a departure leaves."""
    return score.left / max(sums.n_arcs - len(sums.A) - score.dof, 1)


def find_misfit(
    fitted: FittedSet,
    sums: ScoreSums,
    scores: Mapping[str, Score],
    tests: Sequence[TrustTest],
    spread: FloatArray | None = None,
) -> tuple[Values[float | None], ModelMisfit] | None:
    """Widen the sigmas of a fit: those with misfit, SI, and where they come from; None where a direction is not determined."""
    if not fitted.determined or not np.isfinite(fitted.estimate.P).all():
        return None
    try:
        return describe_misfit(fitted, widen(fitted, sums, scores, tests, spread))
    except np.linalg.LinAlgError:  # too near to singular
        return None


def describe_misfit(fitted: FittedSet, found: Widening) -> tuple[Values[float | None], ModelMisfit]:
    """Put a widening into the form of a calibration."""
    parameters, names = fitted.parameters, fitted.problem.camera.parameter_names
    noise = np.sqrt(np.diag(fitted.estimate.P))
    wide = np.sqrt(np.maximum(np.diag(found.P), noise**2))
    factor = wide / noise
    sigma: dict[str, float | None] = dict.fromkeys(names)
    by_name: dict[str, float | None] = dict.fromkeys(names)
    for p, one, times in zip(parameters.free, wide * parameters.scale, factor, strict=True):
        sigma[names[p]], by_name[names[p]] = float(one), float(times)
    matrix = parameters.covariance(found.P).tolist()
    return Values(sigma), ModelMisfit(
        covariance=Covariance(names=fitted.names, matrix=matrix),
        factor=Values(by_name),
        blocks=found.blocks,
        sentence=_sentence(fitted, found, factor),
        departures=list(found.departures),
        suspected=list(found.suspected),
        level=found.level,
        selected=found.selected,
        bends=found.bends,
    )


def misfit_advice(found: ModelMisfit | None) -> list[Advice]:
    """What a person should know of a widening that changes decisions; nothing of one that rests on suspicion alone."""
    if found is None:
        return []
    other_reason = found.blocks or found.bends or found.level > 1 or found.selected > 1
    if found.suspected == found.departures != [] and not other_reason:
        return []
    factors = [one for one in found.factor.values() if one is not None]
    return [Advice(found.sentence, "misfit")] if max(factors, default=1.0) >= WIDE else []


def _sentence(fitted: FittedSet, found: Widening, factor: FloatArray) -> str:
    """Say by how much the sigmas widen, why, and what to do."""
    most = int(np.argmax(factor))
    if factor[most] < SAME:
        return "These data give no reason to widen the sigmas beyond noise alone."
    reasons = []
    seen, unlikely = (
        ", ".join(one.replace("_", " ") for one in found.departures if (one in found.suspected) == wanted)
        for wanted in (False, True)
    )
    if seen:
        reasons.append(
            f"the detected deviations ({seen}) affect the parameters if they are real: remove their cause, or choose a camera "
            "model that describes them"
        )
    if unlikely:
        reasons.append(
            f"deviations that are suspected but not significant ({unlikely}) affect the parameters if they are real: "
            "take more frames, or choose a camera model that describes them"
        )
    if found.blocks:
        reasons.append(
            f"{found.blocks} blocks of frames disagree by more than the noise explains: check for drift, a temperature effect or "
            "wrong matches"
        )
    if found.selected > 1:
        reasons.append(
            f"the filter used only arcs that agreed with its state, and its result is {found.selected:.2g} sigmas from the fit "
            "of the whole set: choose the statistical tolerance, or the batch"
        )
    if found.bends:
        reasons.append(
            "chi-square is not quadratic or has other minima: use the profile-likelihood intervals, hold a known parameter fixed, "
            "or add frames"
        )
    if found.level > 1:
        reasons.append(
            f"the residuals are {np.sqrt(found.level):.2f} times as large as the stated noise: correct the stated noise"
        )
    opening = f"With misfit the sigmas are up to {factor[most]:.2g} times those of noise alone ({fitted.names[most]})"
    return f"{opening}, because {'; '.join(reasons)}." if reasons else f"{opening}."
