"""All minima of a calibration: when they are looked for, which is taken up, and what is told of them.

`estimation.minima` derives the search. It is made where a set is small or bends: of at most `FEW_STARS` stars always, of up to
`MOST_STARS` where a direction is weak or chi-square rises along it otherwise than the covariance says. Beyond, a set has one
minimum within reach, and nothing is done. The starts are drawn from a fixed seed, so a calibration repeats.

Of minima that can be, the lowest is the maximum-likelihood estimate, so it is taken up; how far above it the others lie, and where
each parameter may be by profile likelihood, tells what a covariance cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import Covariance, Minima, Minimum, ProfileInterval, Values
from boresight.calibration.problem import Problem, whiten_at
from boresight.estimation import batch, minima
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import BatchFit, determined, sigma_in_scale
from boresight.estimation.minima import LOWER, CostSurface, Piece, ProfileLikelihood, Search
from boresight.estimation.prior import Prior
from boresight.estimation.robust import measure_huber_effect
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.observability import WEAK, chi2_rise, is_curved
from boresight.estimation.statistics.special import chdtri

#: Stars up to which minima are always looked for, and up to which they are where the set bends or is weak.
FEW_STARS, MOST_STARS = 400, 3_000
SEED = 73
CONFIDENCE = 0.95
#: Share by which an end of an interval may lie elsewhere than the covariance says.
ASYMMETRY = 0.25
#: Rise of chi-square up to which another minimum is told; beyond, its likelihood is below one in twenty thousand.
TOLD = 20.0
#: Rise up to which it is a caution: its likelihood is above one in a hundred and fifty.
CLOSE = 10.0
#: Sigmas of a filter's estimate from the lowest minimum from which on it is in another.
ELSEWHERE = 6.0
MULTI_START = "a search from many starts"


#: Times a calibration begins again from a lower minimum that judging it met.
MOST_RESTARTS = 2


class LowerMinimum(Exception):  # noqa: N818 - a find, not an error
    """A state x (n_parameters,), SI, from which the fit ends lower than the estimate, by `fall`; `taken_from`: what led to it."""

    def __init__(self, x: FloatArray, taken_from: str, fall: float) -> None:
        super().__init__(taken_from)
        self.x, self.taken_from, self.fall = x, taken_from, fall


@dataclass(frozen=True)
class Searched:
    """What a search found, and how the estimate came by its minimum.

    `search`: None where nothing was searched. `taken_from`: what led to the minimum that was taken up, empty where the
    fit from the usual start ended in it, and `fall` by how much it lies lower. `restarts`: so often judging the estimate led lower.
    """

    search: Search | None = None
    taken_from: str = ""
    fall: float = 0.0
    restarts: int = 0

    @property
    def lowest(self) -> BatchFit | None:
        """The minimum to take up, where it is another than the fit ended in."""
        return self.search.found[0] if self.search is not None and self.taken_from == MULTI_START else None

    def begun_from(self, lower: LowerMinimum | None, restarts: int) -> Searched:
        """The same of a fit that began at what judging an estimate led to."""
        if lower is None or self.taken_from:
            return replace(self, restarts=restarts)
        return replace(self, taken_from=lower.taken_from, fall=lower.fall, restarts=restarts)


#: Where nothing was searched.
NOT_SEARCHED = Searched()


def look_for_minima(
    problem: Problem,
    free: IntArray,
    scale: FloatArray,
    threshold: float,
    fitted: BatchFit,
    cancelled: Callable[[], bool] | None,
    prior: Prior | None = None,
) -> Searched:
    """Search about a fit, where that is worth it.

    `free`, `scale`: (n_free,) places of the free parameters and their typical sigmas, SI. `threshold`: of Huber's loss. `prior`:
    what was known before.
    """
    if not _is_worth_it(problem, free, scale, fitted):
        return NOT_SEARCHED
    arcs = problem.arcs.whole()

    def whiten(x: FloatArray) -> ArcSet:
        return whiten_at(arcs, problem.camera, x)

    surface = CostSurface(whiten, free, scale, threshold, problem.can_be, cancelled, prior)
    found = minima.search(surface, fitted, np.random.default_rng(SEED))
    if not found.found:
        return NOT_SEARCHED
    fall = _fall(surface, found.found[0], fitted)
    return Searched(found, MULTI_START if fall > LOWER else "", max(fall, 0.0))


def _is_worth_it(problem: Problem, free: IntArray, scale: FloatArray, fitted: BatchFit) -> bool:
    """Whether a set is small, or bends and is not large."""
    n_stars = problem.arcs.n_stars
    n_arcs = 2 * n_stars - 3 * problem.arcs.n_exposures  # they are filled in where they are whitened
    if fitted.status == "rank_deficient" or n_stars > MOST_STARS or n_arcs <= len(free):
        return False
    if n_stars <= FEW_STARS or fitted.status != "converged":
        return True
    values, _, _ = determined(fitted.A)
    return values[0] < WEAK**-2 or is_curved(chi2_rise(problem.whitened(fitted.x), fitted.x, free, scale, fitted.A))


def _fall(surface: CostSurface, lowest: BatchFit, fitted: BatchFit) -> float:
    """By how much a minimum lies below where a fit ended; infinite where that was none."""
    return surface.cost(fitted.x) - lowest.cost if surface.is_minimum(fitted) else np.inf


def look_about_filter(
    problem: Problem,
    free: IntArray,
    scale: FloatArray,
    x: FloatArray,
    cancelled: Callable[[], bool] | None,
    prior: Prior | None,
) -> Searched:
    """Search about the fit of the set on which a filter ended at x (n_parameters,), SI; nothing is taken up."""
    if problem.arcs.n_stars > MOST_STARS:  # before the fit, which only the search needs
        return NOT_SEARCHED
    arcs = problem.whitened(x)
    fitted = batch.fit(arcs, x, free, scale, prior=prior, cancelled=cancelled)
    found = look_for_minima(problem, free, scale, np.inf, fitted, cancelled, prior)
    return replace(found, taken_from="", fall=0.0, restarts=MOST_RESTARTS)


def describe_minima_of_filter(problem: Problem, searched: Searched, x: FloatArray, A: FloatArray) -> Minima | None:
    """Say which minima the set has on which a filter ended at x (n_parameters,), SI, with information A (n_free, n_free)."""
    if searched.search is None:
        return None
    surface, best = searched.search.surface, searched.search.found[0]
    sigma = np.full(len(x), np.nan)
    sigma[surface.free] = surface.scale * sigma_in_scale(surface.equations(best.x).A)
    described = describe_minima(problem, searched, best.x, sigma)
    step = (x - best.x)[surface.free] / surface.scale
    if described is None or float(step @ A @ step) < ELSEWHERE**2:
        return described
    where = _farthest(_describe(problem.camera.parameter_names, best, best), x, sigma)
    sentence = (
        f"The filter did not converge to the lowest minimum ({where}): run the batch method. {described.sentence}"
    )
    return replace(described, elsewhere=True, sentence=sentence)


def describe_minima(problem: Problem, searched: Searched, x: FloatArray, sigma: FloatArray) -> Minima | None:
    """Say which minima there are, and where parameters may lie that their sigmas do not tell of.

    None where there is nothing to say. `x`, `sigma`: (n_parameters,) estimate and one-sigma, SI. Raises LowerMinimum where a
    profile leads below the lowest.
    """
    names, search = problem.camera.parameter_names, searched.search
    if search is None:
        alone = Minima(starts=0, taken_from=searched.taken_from, sentence=" ".join(_say_taken(searched)))
        return alone if searched.taken_from else None
    best = search.found[0]
    rise = find_rise(problem, search)
    profiles = _profile(names, search, rise, follow=searched.restarts < MOST_RESTARTS)
    found = [_describe(names, one, best) for one in search.found if one.cost - best.cost <= TOLD]
    intervals = [
        ProfileInterval(name=names[p], confidence=CONFIDENCE, pieces=[list(piece) for piece in one.pieces])
        for p, one in zip(search.surface.free, profiles, strict=True)
        if not is_symmetric(one.pieces, x[p], np.sqrt(rise) * sigma[p])
    ]
    bends = len(found) > 1 or bool(intervals)
    described = Minima(
        starts=search.starts,
        found=found,
        intervals=intervals,
        spread=_find_spread(names, search, profiles) if bends else None,
        taken_from=searched.taken_from,
    )
    return replace(described, sentence=_sentence(described, searched, x, sigma))


def _profile(names: Sequence[str], search: Search, rise: float, *, follow: bool) -> list[ProfileLikelihood]:
    """Profile every free parameter; `follow` what leads lower."""
    profiles = list[ProfileLikelihood]()
    for place, p in enumerate(search.surface.free):
        found = minima.profile(search, place, rise)
        if found.lower is not None and follow:
            fall = search.found[0].cost - found.lower.cost
            raise LowerMinimum(found.lower.x, f"the profile of {names[p]}", fall)
        profiles.append(found)
    return profiles


def _find_spread(names: Sequence[str], search: Search, profiles: Sequence[ProfileLikelihood]) -> Covariance:
    """How far the estimate may be off where the set bends."""
    surface = search.surface
    variance = _residual_variance(surface, search.found[0])
    path = [fitted for one in profiles for fitted in one.path]
    spread = minima.measure_spread(search, path, variance, np.random.default_rng(SEED))
    matrix = (spread * np.outer(surface.scale, surface.scale)).tolist()
    return Covariance(names=[names[p] for p in surface.free], matrix=matrix)


def find_rise(problem: Problem, search: Search) -> float:
    """Rise of the cost at the ends of an interval: the quantile of Wilks, times the residuals' variance, times how far it holds."""
    best = search.found[0]
    rise = float(chdtri(1, 1 - CONFIDENCE)) * _residual_variance(search.surface, best)
    values, _, _ = determined(best.A)
    bends = len(search.found) > 1 or values[0] < WEAK**-2
    if not bends or problem.arcs.n_stars > FEW_STARS:
        return rise
    return rise * minima.measure_wilks_factor(search, np.random.default_rng(SEED))


def _residual_variance(surface: CostSurface, best: BatchFit) -> float:
    """By how much the cost rises where it would rise by 1 if the noise were as stated; see `estimation.minima`."""
    arcs, n_free = surface.whiten(best.x), len(surface.free)
    if np.isfinite(surface.threshold):
        effect = measure_huber_effect(arcs, best.x, n_free, surface.threshold)
        return (1 - effect.beyond / arcs.n_arcs) / effect.information_share
    fit = chi_square(best.chi2, arcs.n_arcs - n_free)
    return fit.mean if fit.mean > fit.upper else 1.0


def is_symmetric(pieces: Sequence[Piece], x: float, half: float) -> bool:
    """Whether an interval is x +- half, to a share of `ASYMMETRY`."""
    if len(pieces) != 1:
        return False
    low, high = pieces[0]
    if low is None or high is None or not np.isfinite(half):
        return False
    return max(abs(x - low - half), abs(high - x - half)) <= ASYMMETRY * half


def _describe(names: Sequence[str], one: BatchFit, best: BatchFit) -> Minimum:
    """Put a minimum into the form of a calibration."""
    values = Values(dict(zip(names, one.x.tolist(), strict=True)))
    return Minimum(parameters=values, chi2_above_best=float(one.cost - best.cost))


def _sentence(described: Minima, searched: Searched, x: FloatArray, sigma: FloatArray) -> str:
    """Say what was found, and what to do about it."""
    parts = [*_say_taken(searched), *_say_others(described, x, sigma), *_say_intervals(described)]
    if len(parts) == 0:
        return (
            f"{described.starts} other starting points gave no other minimum within {TOLD:.0f} in chi-square, and profile "
            "likelihood gives the same intervals as the sigmas."
        )
    return " ".join(parts)


def _say_taken(searched: Searched) -> list[str]:
    if not searched.taken_from:
        return []
    how_much = f", lower by {searched.fall:.3g} in chi-square" if np.isfinite(searched.fall) else ""
    sentence = (
        f"The fit from the sensor file's start did not end in the lowest minimum: the lowest was found by "
        f"{searched.taken_from}{how_much}."
    )
    return [sentence]


def _say_others(described: Minima, x: FloatArray, sigma: FloatArray) -> list[str]:
    others = described.found[1:]
    if not others:
        return []
    count = f"{len(others)} other {'minimum is' if len(others) == 1 else 'minima are'}"
    where = "; ".join(f"+{one.chi2_above_best:.2g}, {_farthest(one, x, sigma)}" for one in others[:3])
    caution = (
        " These data alone do not show which is the camera's: hold a known parameter fixed, or add frames with stars "
        "elsewhere on the detector."
    )
    close = others[0].chi2_above_best <= CLOSE
    return [f"{count} up to {TOLD:.0f} in chi-square above the estimate ({where}).{caution if close else ''}"]


def _farthest(one: Minimum, x: FloatArray, sigma: FloatArray) -> str:
    """The parameter that another minimum moves most, in sigmas."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = (np.array(list(one.parameters.values()), float) - x) / sigma
    place = int(np.nanargmax(np.where(np.isfinite(shift), np.abs(shift), -1.0)))
    return f"{list(one.parameters)[place]} shifted by {shift[place]:+.0f} sigma"


def _say_intervals(described: Minima) -> list[str]:
    if not described.intervals:
        return []
    names = ", ".join(one.name for one in described.intervals)
    broken = ", ".join(one.name for one in described.intervals if len(one.pieces) > 1)
    pieces = f", and those of {broken} have several parts" if broken else ""
    sentence = (
        f"The {CONFIDENCE:.0%} intervals of {names} by profile likelihood are not symmetric about the estimate{pieces}: use "
        "them instead of the sigmas."
    )
    return [sentence]


def minima_advice(found: Minima | None) -> list[Advice]:
    """What a person should know: that another minimum was taken up, or that one is close."""
    if found is None:
        return []
    close = len(found.found) > 1 and found.found[1].chi2_above_best <= CLOSE
    return [Advice(found.sentence, "minima")] if found.taken_from or found.elsewhere or close else []
