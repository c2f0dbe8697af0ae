"""Every minimum of chi-square within reach, and how far a parameter may go by profile likelihood: for sets with few stars.

Levenberg-Marquardt ends in the minimum that its start drains into. With a thousand stars there is one; with a hundred, where
principal point and tilts are hardly told apart, the valley along them bends and may hold several, tens of claimed sigmas apart and
a few units of chi-square from each other. So the fit begins again from starts about the lowest minimum x known so far: normal
deviates of `SPREADS` typical sigmas in every parameter, and steps of `STEPS` sigmas both ways along the weakest directions v_i of
A, sigma_i = 1 / s_i. What ends lower is searched about once more.

Profile likelihood. With J_p(v) the least cost while parameter p is held at v, the parameter lies, with confidence 1 - alpha, where

    J_p(v) - J(x) <= q s,        q the quantile 1 - alpha of chi-square with one degree of freedom                       (Wilks)

and s the variance of the whitened residuals, 1 where they are as large as stated. Every piece of that set holds a local minimum of
J, for J attains its least value over the part of {J <= J(x) + q s} that lies over the piece. So from each minimum below the level p
is moved outwards, the others fitted again each time, until the level is crossed; the union of what lies between is the set. Where J
is the quadratic of A the ends are x_p +- sqrt(q s) sigma_p.

Huber's loss rises by m d^2 / sigma^2 where least squares rises by d^2 / sigma^2 / w, m the share of arcs inside the threshold and w
the share of information that the estimate keeps (`robust`): there s = m / w.

Where the set is so sparse that the surface bends within the interval, J_p(truth) - J(x) is larger on average than the 1 of Wilks'
theorem, and an interval at its quantile holds the truth in 85 to 90 of 100 sets. So sets like this one are drawn with the estimate
as their truth (the measured places are taken for the true ones, so that no attitude is needed, and noise is added to them), and the
mean of J_p(truth) - J over them and over the parameters multiplies q (Bartlett's correction by simulation).

Spread. Where the valley bends or there are several minima, A^-1 tells neither how far nor along which line the estimate may be off.
What does is the mean of (z - z_0)(z - z_0)^T over all states, each as likely as the data make it, exp(-(J - J_0) / 2 s), and none
likelier before: no covariance holds fewer errors of its size. The integral is taken by importance sampling. States z_i are drawn
from a mixture of t distributions, whose parts lie at the minima and at the fits along the profiles, which follow the valley, each
with the information A of its place; with q the density of the mixture

    spread = c sum_i w_i (z_i - z_0)(z_i - z_0)^T / sum_i w_i        w_i = exp(-(J(z_i) - J_0) / 2 s) / q(z_i).

The weights leave as much as m = (sum w)^2 / sum w^2 equal draws would, and a covariance of p parameters that is known from m draws
is too narrow for their squared errors by c = m / (m - p - 1) on average, the mean of an inverse Wishart matrix. Where m is next to
nothing the minima with their covariances, weighed by their height, stand for the integral.

References
----------
Bartlett, "Properties of sufficiency and statistical tests", Proc. R. Soc. A 160, 1937. Kloek, van Dijk, "Bayesian estimates of
equation system parameters: an application of integration by Monte Carlo", Econometrica 46, 1978. Venzon, Moolgavkar, "A method for
computing profile-likelihood-based confidence intervals", Applied Statistics 37, 1988.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet, angular_sigma, whiten
from boresight.estimation.batch import BatchFit, NormalEquations
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.prior import Prior

#: Spreads of the starts about a minimum, typical sigmas, and how many starts have each.
SPREADS, STARTS_EACH = (1.0, 3.0, 10.0), 8
#: Steps along the weakest directions, sigmas, and how many directions; steps are at most so many typical sigmas long.
STEPS, DIRECTIONS, LONGEST = (2.0, 5.0, 15.0), 3, 50.0
#: Times the search begins again about a lower minimum.
ROUNDS = 2
MOST_ITERATIONS = 60
#: Distance in sigmas from which two minima are two, and cost by which one must be lower to be taken for it.
SAME_PLACE, LOWER = 0.3, 0.01
#: Typical sigmas beyond which a profile is not followed and a minimum not taken, and its largest sigma where the first fit's is
#: larger.
REACH, LARGEST_SIGMA = 50.0, 1e3
#: Sets drawn to see how far Wilks' theorem holds.
DRAWN = 15
#: Growth of the steps of a profile, most steps to its end, and accuracy of the rise there.
GROWTH, MOST_STEPS, RISE_TOLERANCE = 1.4, 40, 0.01
#: States drawn at a time for the spread and in all, and how many equal draws' worth the weights are to leave: enough, and fewest.
DRAWS, MOST_DRAWS, ENOUGH, FEWEST = 500, 4_000, 250.0, 20.0
#: Most parts of the mixture, their distance from each other in sigmas, their degrees of freedom, how much wider they are than A^-1.
MOST_PARTS, APART, TAIL, WIDER = 64, 0.7, 6, 1.2


@dataclass(frozen=True)
class CostSurface:
    """A cost to be searched.

    Parameters
    ----------
    whiten
        The arcs of a set, whitened at a state (n_parameters,).
    free, scale
        (n_free,) places of the free parameters, and their typical sigmas, SI.
    threshold
        Of Huber's loss, in whitened sigmas; infinite for least squares.
    allowed
        Whether a state (n_parameters,) can be.
    cancelled
        Asked before each iteration of a fit and each cost.
    prior
        What was known before; its share is part of the cost.
    """

    whiten: Callable[[FloatArray], ArcSet]
    free: IntArray
    scale: FloatArray
    threshold: float = np.inf
    allowed: Callable[[FloatArray], bool] = field(default=lambda _: True)
    cancelled: Callable[[], bool] | None = None
    prior: Prior | None = None

    def fit(self, arcs: ArcSet, x: FloatArray, held: int | None = None) -> BatchFit:
        """Fit whitened arcs from a state x (n_parameters,), all free parameters or all but one, by its place among them."""
        chosen = np.arange(len(self.free)) if held is None else np.delete(np.arange(len(self.free)), held)
        prior = self.prior if self.prior is None or held is None else self.prior.at(x, self.free, self.scale, held)
        return batch.fit(
            arcs, x, self.free[chosen], self.scale[chosen],
            threshold=self.threshold, max_iterations=MOST_ITERATIONS, cancelled=self.cancelled, prior=prior,
        )  # fmt: skip

    def equations(self, x: FloatArray, threshold: float = np.inf) -> NormalEquations:
        """A, b and costs of a state (n_parameters,) under its own R, with what was known before."""
        refuse_cancelled(self.cancelled, "while minima were looked for")
        data = batch.normal_equations(self.whiten(x), x, self.free, self.scale, threshold)
        return data.with_prior(self.prior, x, self.free, self.scale)

    def cost(self, x: FloatArray) -> float:
        """Cost of a state (n_parameters,) under its own R; infinite where there is none."""
        if np.isfinite(self.threshold):
            cost = self.equations(x, self.threshold).chi2
        else:
            cost = batch.compute_chi2(self.whiten(x), x)
            if self.prior is not None:
                z = (x - self.prior.x)[self.free] / self.scale
                cost += float(z @ self.prior.A @ z)
        return cost if np.isfinite(cost) else np.inf

    def settle(self, x: FloatArray) -> BatchFit:
        """Fit from a state (n_parameters,) near a minimum, with R taken at its end."""
        near = self.fit(self.whiten(x), x)
        ended = self.fit(self.whiten(near.x), near.x)
        return replace(ended, cost=self.cost(ended.x))

    def is_minimum(self, fitted: BatchFit) -> bool:
        """Whether a fit ended in a minimum that can be."""
        return fitted.status == "converged" and self.allowed(fitted.x)

    def same(self, one: BatchFit, other: BatchFit) -> bool:
        """Whether two fits ended in one minimum."""
        step = (one.x - other.x)[self.free] / self.scale
        return bool(min(step @ one.A @ step, step @ other.A @ step) < SAME_PLACE**2)


@dataclass(frozen=True)
class Search:
    """What a search found: what was searched, how many starts it made, and the minima, (n_minima,), the lowest first."""

    surface: CostSurface
    starts: int
    found: tuple[BatchFit, ...]

    def lower_minimum(self, x: FloatArray) -> BatchFit | None:
        """The minimum that a state (n_parameters,) drains into, where it is one to take up in place of the lowest."""
        settled, lowest = self.surface.settle(x), self.found[0]
        lower = self.surface.is_minimum(settled) and settled.cost < lowest.cost - LOWER
        return settled if lower and is_within_reach(self.surface, settled, lowest) else None


def search(surface: CostSurface, fitted: BatchFit, rng: np.random.Generator) -> Search:
    """Look for every minimum about a fit.

    Parameters
    ----------
    surface
        What is searched.
    fitted
        Where the fit from the usual start ended; the search begins about it, be it a minimum or not.
    rng
        Draws the starts.

    Returns
    -------
    The minima; none where no fit came to rest in one.
    """
    about = surface.settle(fitted.x) if np.isfinite(fitted.x).all() else fitted
    found = [about] if surface.is_minimum(about) else []
    starts = 0
    for _ in range(ROUNDS):
        arcs = surface.whiten(about.x)
        for x in _starts(surface, about, rng):
            starts += 1
            _add(surface, found, surface.fit(arcs, x), fitted)
        found.sort(key=lambda one: one.cost)
        if not found or found[0] is about:
            break
        about = found[0]
    return Search(surface, starts, tuple(found))


def _add(surface: CostSurface, found: list[BatchFit], ended: BatchFit, first: BatchFit) -> None:
    """Add a minimum within reach of the first fit that is not among those found."""
    if not surface.is_minimum(ended) or any(surface.same(ended, one) for one in found):
        return
    settled = surface.settle(ended.x)
    if not surface.is_minimum(settled) or any(surface.same(settled, one) for one in found):
        return
    if is_within_reach(surface, settled, first):
        found.append(settled)


def is_within_reach(surface: CostSurface, one: BatchFit, first: BatchFit) -> bool:
    """Whether a minimum is not far from the first fit, nor a plain without end where that is none."""
    step = (one.x - first.x)[surface.free] / surface.scale
    near = not np.isfinite(first.x).all() or bool(np.abs(step).max() <= REACH)
    weakest = float(batch.sigma_in_scale(first.A).max()) if np.isfinite(first.A).all() else 0.0
    return near and bool(batch.sigma_in_scale(one.A).max() <= max(REACH, min(weakest, LARGEST_SIGMA)))


def _starts(surface: CostSurface, about: BatchFit, rng: np.random.Generator) -> Iterator[FloatArray]:
    """States (n_parameters,) spread about a fit, and along its weakest directions both ways."""
    n_free = len(surface.free)
    for spread in SPREADS:
        for z in spread * rng.normal(size=(STARTS_EACH, n_free)):
            yield _moved(surface, about.x, z)
    values, vectors, known = batch.determined(about.A)
    for value, v in list(zip(values[known], vectors[:, known].T, strict=True))[:DIRECTIONS]:
        for step in STEPS:
            length = min(step / np.sqrt(value), LONGEST)
            yield _moved(surface, about.x, length * v)
            yield _moved(surface, about.x, -length * v)


def _moved(surface: CostSurface, x: FloatArray, z: FloatArray) -> FloatArray:
    """A state (n_parameters,) moved by z (n_free,) typical sigmas."""
    moved = x.copy()
    moved[surface.free] += surface.scale * z
    return moved


#: Ends of a piece, SI; None beyond what was followed.
Piece = tuple[float | None, float | None]


@dataclass(frozen=True)
class ProfileLikelihood:
    """Where a parameter may lie.

    `pieces`: in ascending order. `path`: the fits on the way. `lower`: a minimum below the lowest, where the way led to one.
    """

    pieces: tuple[Piece, ...]
    path: tuple[BatchFit, ...] = ()
    lower: BatchFit | None = None


def profile(searched: Search, place: int, rise: float) -> ProfileLikelihood:
    """Find where a parameter may lie.

    Parameters
    ----------
    searched
        What was found.
    place
        Of the parameter among the free ones.
    rise
        Of the cost over the lowest minimum's at the ends, q s.
    """
    surface, minima = searched.surface, searched.found
    level, p = minima[0].cost + rise, int(surface.free[place])
    pieces: list[tuple[float, float]] = []
    path: list[BatchFit] = []
    lower: BatchFit | None = None
    for one in (m for m in minima if m.cost < level):
        ends = [_end(surface, one, place, sign, level) for sign in (-1.0, 1.0)]
        path += [fitted for end in ends for fitted in end.path]
        lowest = min((fitted for end in ends for fitted in end.path), key=lambda fitted: fitted.cost)
        if lower is None and lowest.cost < minima[0].cost - LOWER:
            lower = searched.lower_minimum(lowest.x)
        pieces.append((ends[0].value, ends[1].value))
    low, high = minima[0].x[p] - REACH * surface.scale[place], minima[0].x[p] + REACH * surface.scale[place]
    ends_of = tuple((a if a > low else None, b if b < high else None) for a, b in _joined(pieces))
    return ProfileLikelihood(ends_of, tuple(path), lower)


@dataclass(frozen=True)
class _End:
    """Where a profile crosses its level, SI, infinite where it does not within reach, and the fits on the way from a minimum."""

    value: float
    path: tuple[BatchFit, ...]


def _end(surface: CostSurface, minimum: BatchFit, place: int, sign: float, level: float) -> _End:
    """Follow the profile from a minimum one way until its cost crosses the level."""
    scale, p = float(surface.scale[place]), int(surface.free[place])
    sigma = float(batch.sigma_in_scale(minimum.A)[place])
    t, step = 0.0, 0.4 * np.sqrt(max(level - minimum.cost, RISE_TOLERANCE)) * (sigma if np.isfinite(sigma) else 1.0)
    path = [minimum]
    while t < REACH:
        t = min(t + step, REACH)
        path.append(_held(surface, path[-1], place, minimum.x[p] + sign * t * scale))
        if not path[-1].cost < level:
            return _End(_cross(surface, minimum, path[-2], path[-1], place, level), tuple(path))
        step *= GROWTH
    return _End(sign * np.inf, tuple(path))


def _cross(
    surface: CostSurface, minimum: BatchFit, inner: BatchFit, outer: BatchFit, place: int, level: float
) -> float:
    """Close in on the crossing between a fit below the level and one above, by the chord and by halving in turn.

    The chord is that of the root of the rise from the minimum, which of a parabola is a straight line.
    """
    p = int(surface.free[place])
    a, b = inner, outer
    for turn in range(MOST_STEPS):
        at_a, at_level, at_b = (float(np.sqrt(max(cost - minimum.cost, 0.0))) for cost in (a.cost, level, b.cost))
        share = (at_level - at_a) / (at_b - at_a) if turn % 2 == 0 and np.isfinite(at_b) else 0.5
        value = float(a.x[p] + share * (b.x[p] - a.x[p]))
        here = _held(surface, a, place, value)
        if abs(here.cost - level) < RISE_TOLERANCE:
            return value
        a, b = (here, b) if here.cost < level else (a, here)
    return float(a.x[p])


def _held(surface: CostSurface, near: BatchFit, place: int, value: float) -> BatchFit:
    """Fit the others while a parameter is held at a value, SI, beginning at the nearest fit."""
    x = near.x.copy()
    x[surface.free[place]] = value
    fitted = surface.fit(surface.whiten(near.x), x, held=place)
    return replace(fitted, cost=surface.cost(fitted.x))


def measure_spread(search: Search, path: Sequence[BatchFit], variance: float, rng: np.random.Generator) -> FloatArray:
    """Mean square distance of what can be from the lowest minimum, (n_free, n_free) in typical sigmas; see the module.

    Parameters
    ----------
    search
        What was found.
    path
        Fits along the profiles.
    variance
        Of the whitened residuals, s.
    rng
        Draws the states.
    """
    surface, best = search.surface, search.found[0]
    n = len(surface.free)
    parts = _parts(surface, [*search.found, *sorted(path, key=lambda one: one.cost)], best)
    middle, root = np.array([one.z for one in parts]), np.array([one.root for one in parts])
    share = np.exp(-np.array([one.rise for one in parts]) / (4 * variance))
    share /= share.sum()
    z, weight, worth = np.empty((0, n)), np.empty(0), 0.0
    while worth < ENOUGH and len(z) < MOST_DRAWS:
        of = rng.choice(len(parts), size=DRAWS, p=share)
        t = rng.normal(size=(DRAWS, n)) * np.sqrt(WIDER * TAIL / rng.chisquare(TAIL, DRAWS))[:, None]
        drawn = middle[of] + np.linalg.solve(root[of].transpose(0, 2, 1), t[:, :, None])[:, :, 0]
        rise = np.array([_rise(surface, best, one) for one in drawn])
        z = np.concatenate([z, drawn])
        weight = np.concatenate([weight, np.exp(-rise / (2 * variance) - _log_density(drawn, middle, root, share))])
        worth = float(weight.sum() ** 2 / np.sum(weight**2)) if weight.any() else 0.0
    if not worth > n + FEWEST:
        return _spread_of_minima(surface, search.found, variance)
    return np.asarray((z * (weight / weight.sum())[:, None]).T @ z * worth / (worth - n - 1))


def _spread_of_minima(surface: CostSurface, found: Sequence[BatchFit], variance: float) -> FloatArray:
    """The same where so few draws carry the weight that they tell nothing: each minimum with its covariance, by its height."""
    share = np.exp(-np.array([one.cost - found[0].cost for one in found]) / (2 * variance))
    total = np.zeros((len(surface.free), len(surface.free)))
    for one, weight in zip(found, share / share.sum(), strict=True):
        z = (one.x - found[0].x)[surface.free] / surface.scale
        total += weight * (np.outer(z, z) + batch.covariance(surface.equations(one.x).A) * variance)
    return total


def _log_density(z: FloatArray, middle: FloatArray, root: FloatArray, share: FloatArray) -> FloatArray:
    """Logarithm of the mixture's density at z (n_draws, n_free), less a constant; parts as `_Part`, and their shares."""
    n = z.shape[1]
    distance = np.sum(((z[:, None] - middle)[:, :, None] @ root) ** 2, axis=(2, 3)) / WIDER
    density = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) - (TAIL + n) / 2 * np.log1p(distance / TAIL)
    largest = density.max(axis=1)
    return np.asarray(largest + np.log(np.exp(density - largest[:, None]) @ share))


@dataclass(frozen=True)
class _Part:
    """One part of the mixture: its middle z (n_free,) from the lowest minimum, the lower root of its information, its rise."""

    z: FloatArray
    root: FloatArray
    rise: float


def _parts(surface: CostSurface, fits: Sequence[BatchFit], best: BatchFit) -> list[_Part]:
    """Parts at fits, in their order, that lie apart from each other."""
    parts: list[_Part] = []
    for one in fits:
        z = (one.x - best.x)[surface.free] / surface.scale
        A = surface.equations(one.x).A
        if not np.isfinite(A).all() or any((z - other.z) @ A @ (z - other.z) < APART**2 for other in parts):
            continue
        try:
            parts.append(_Part(z, np.asarray(np.linalg.cholesky(A)), one.cost - best.cost))
        except np.linalg.LinAlgError:  # singular there
            continue
        if len(parts) == MOST_PARTS:
            break
    return parts


def _rise(surface: CostSurface, best: BatchFit, z: FloatArray) -> float:
    """Rise of the cost at z (n_free,) typical sigmas from the lowest minimum; infinite out of reach and where nothing can be."""
    x = _moved(surface, best.x, z)
    return surface.cost(x) - best.cost if np.abs(z).max() <= REACH and surface.allowed(x) else np.inf


def measure_wilks_factor(search: Search, rng: np.random.Generator) -> float:
    """Mean of J_p(truth) - J(x), of least squares, over sets drawn with the estimate as their truth; 1 at least.

    `rng`: draws the noise.
    """
    surface, x = search.surface, search.found[0].x
    measured = surface.whiten(x)
    s_i = measured.camera.directions(x, measured.row_px, measured.col_px, measured.pitch)
    rises = []
    for _ in range(DRAWN):
        row, col = (
            place + measured.sigma_px * rng.normal(size=len(place)) for place in (measured.row_px, measured.col_px)
        )
        arcs = replace(measured, s_i=np.ascontiguousarray(s_i), row_px=row, col_px=col)
        arcs = whiten(arcs, angular_sigma(arcs.camera, x, arcs))[0]
        rises += _rises(replace(surface, threshold=np.inf), arcs, search.found)
    return max(float(np.mean(rises)), 1.0) if rises else 1.0


def _rises(surface: CostSurface, arcs: ArcSet, minima: tuple[BatchFit, ...]) -> list[float]:
    """J_p(truth) - J of every parameter on a set whose truth is the first of some minima; none where no fit came to rest."""
    held = [surface.fit(arcs, minima[0].x, held=place) for place in range(len(surface.free))]
    starts = [one.x for one in (*minima, *held)]
    fits = [fitted for fitted in (surface.fit(arcs, x) for x in starts) if surface.is_minimum(fitted)]
    if not fits:
        return []
    least = min(fitted.cost for fitted in fits)
    return [one.cost - least for one in held if one.status == "converged"]


def _joined(pieces: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Join pieces that overlap, in ascending order."""
    joined: list[tuple[float, float]] = []
    for low, high in sorted(pieces):
        if joined and low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], high))
        else:
            joined.append((low, high))
    return joined
