"""Change as far as the passes show it: a random walk about temperature and time, with the steps that are beyond chance.

A camera in orbit has a season, ages, wanders, and now and then steps. A model that has some of these takes the others for what it
has: a walk alone has to walk as far as the season leads, and lags behind it; a step looks like a walk that is fast forever; a slow
drift looks like steps. So all are in one problem. With T_k and t_k of pass k from their means, each parameter that varies is

    z_k = p_k + a T_k + b t_k + c T_k^2        p_k - p_k-1 ~ N(0, sigma^2 days_k), and free where a step was found

A term is there as soon as there are so many passes that it leaves `walk.FEWEST_STEPS` steps to the walk, and nothing tests it
first: what is known of the last pass is to bear all that is not known of them, and one that was dropped for lack of evidence would
be claimed to be known. It costs little, for a term that is not needed is found near zero. Steps are sought one after the other,
each where one would take most from chi-square beside all that was found, and the drift estimated again with it, until none is
beyond chance over all parameters and gaps (Bonferroni; `estimation.walk`). All of that is linear at one linearisation, and repeated
at the next until drift and steps stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.calibration import PassVariation, Values, WalkSigma
from boresight.calibration.joint.change import SAME, Step, describe_step, judge_columns, noise_variance
from boresight.calibration.joint.passes_fit import PassesFit, PassesProblem, middle_days
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.change import LEVEL, Falls
from boresight.estimation.walk import CAUTION, FEWEST_STEPS, Walk, WalkedPasses, find_walk, link_by_walk, most_likely

#: Drift where its estimate begins, typical sigmas a square root of a day.
FIRST_WALK = 0.1
#: Rounds of linearisation, and the change of the drift's log that ends them.
ROUNDS, RESTS = 4, 0.1
MOST_STEPS = 10


@dataclass(frozen=True)
class _Terms:
    """Columns of one parameter, (n_passes, n_terms), their names, units (n_terms,) and what they are from."""

    values: FloatArray
    names: list[str] = field(default_factory=list)
    unit: FloatArray = field(default_factory=lambda: np.empty(0))
    reference_temperature_c: float | None = None


def find_terms(of: PassesProblem, days: FloatArray) -> _Terms:
    """Return what is known of the passes, each column from its mean and to its half range, as far as they tell it apart."""
    known = [one.temperature_c for one in of.passes if one.temperature_c is not None]
    warm = np.array(known) if len(known) == len(days) else None
    candidates = [("drift", days - days.mean())]
    if warm is not None:
        T = warm - warm.mean()
        candidates = [("temperature", T), *candidates, ("temperature squared", T**2)]
    kept, names, units = [np.ones(len(days))], [], []
    for name, column in candidates:
        half = float(np.abs(column).max())
        if not half or len(days) - 1 - len(kept) < FEWEST_STEPS:
            continue
        X = np.column_stack(kept)
        left = column / half - X @ np.linalg.lstsq(X, column / half, rcond=None)[0]
        if np.abs(left).max() > SAME:
            kept.append(column / half)
            names.append(name)
            units.append(half)
    of_all = np.column_stack(kept)[:, 1:]
    return _Terms(of_all, names, np.array(units), None if warm is None else float(warm.mean()))


def fit_evidence(of: PassesProblem, own: IntArray) -> tuple[PassesFit, PassVariation]:
    """Fit the passes with the free parameters at the places `own` changing; raises LinAlgError where that is open."""
    days = middle_days(of.passes)
    between, terms = np.maximum(np.diff(days), 0.0), find_terms(of, days)
    places = np.repeat(own, len(terms.names))
    trend = Regressed(places, np.tile(terms.values, (1, len(own)))) if len(places) else None
    stepped = np.zeros((len(between), len(own)), bool)
    chances: dict[tuple[int, int], float] = {}
    sigma = np.full(len(own), FIRST_WALK)
    fitted = of.fit(link_by_walk(own, between, sigma, trend))
    for _ in range(ROUNDS):
        before = (sigma, stepped)
        sigma, stepped, chances = _search(of, fitted, own, between, trend, sigma)
        fitted = of.fit(link_by_walk(own, between, sigma, trend, stepped))
        if (stepped == before[1]).all() and np.abs(np.log(sigma / before[0])).max() < RESTS:
            break
    passes = WalkedPasses(fitted.sums, of.departures(fitted), own, between, trend, stepped)
    walk = find_walk(passes)
    found = PassVariation(
        vary=of.list_names(own),
        vary_as="evidence",
        walk=write_walk(of.list_names(own), walk),
        chi2=fitted.chi2,
        steps=[
            describe_step(of, Step(int(own[j]), gap), *_dated(of, passes, fitted, sigma, gap, j), chances[gap, j])
            for gap, j in np.argwhere(stepped).tolist()
        ],
    )
    return fitted, found if trend is None else _with_terms(found, of, own, fitted, terms)


def _search(
    of: PassesProblem, fitted: PassesFit, own: IntArray, days: FloatArray, trend: Regressed | None, begin: FloatArray
) -> tuple[FloatArray, BoolArray, dict[tuple[int, int], float]]:
    """Estimate the drift and seek steps in turn at one linearisation; returns the chance of each step too, by gap and parameter."""
    stepped = np.zeros((len(days), len(own)), bool)
    chances: dict[tuple[int, int], float] = {}
    z, variance = of.departures(fitted), noise_variance(of, fitted.chi2, 0)
    starts = [begin, np.full(len(own), begin.min())]
    while True:
        passes = WalkedPasses(fitted.sums, z, own, days, trend, stepped)
        sigma = most_likely(passes, starts, CAUTION)
        starts = [sigma]
        if len(chances) == min(MOST_STEPS, len(days)):
            return sigma, stepped, chances
        falls, _ = passes.step_falls(sigma)
        gap, j = (int(k) for k in np.unravel_index(int(falls.argmax()), falls.shape))
        best = Falls(falls[:, j], falls[:, j], np.zeros(len(days) - 1))
        chance = len(own) * best.p_value(variance)
        if not chance < LEVEL:
            return sigma, stepped, chances
        stepped = stepped.copy()
        stepped[gap, j] = True
        chances[gap, j] = chance


def _dated(
    of: PassesProblem, passes: WalkedPasses, fitted: PassesFit, sigma: FloatArray, gap: int, j: int
) -> tuple[tuple[float, float], tuple[int, int]]:
    """Size of a step with its sigma, and the first and last gap that it may be in, beside all that was found."""
    falls, sizes = passes.without_step(gap, j).step_falls(sigma)
    size = float(sizes[gap, j])
    found = Falls(falls[:, j], sizes[:, j], np.zeros(len(falls) - 1))
    return (size, abs(size) / float(np.sqrt(falls[gap, j]))), found.interval(noise_variance(of, fitted.chi2, 0))


def write_walk(names: Sequence[str], walk: Walk) -> dict[str, WalkSigma]:
    """Write the drift of each parameter with its interval."""
    rows = zip(names, walk.sigma.tolist(), walk.low.tolist(), walk.high.tolist(), strict=True)
    return {name: WalkSigma(sigma=sigma, interval=[low, high]) for name, sigma, low, high in rows}


def _with_terms(
    found: PassVariation, of: PassesProblem, own: IntArray, fitted: PassesFit, terms: _Terms
) -> PassVariation:
    """Say what temperature and time do to each parameter, in SI."""
    solution, n = fitted.solution, len(terms.names)
    units = of.parameters.scale[np.repeat(own, n)] / np.tile(terms.unit, len(own))
    value = (solution.slope * units).reshape(-1, n)
    sigma = (np.sqrt(np.diag(solution.slope_covariance)) * units).reshape(-1, n)

    def name_values(of_all: FloatArray, term: str) -> Values[float]:
        return Values(dict(zip(found.vary, of_all[:, terms.names.index(term)].tolist(), strict=True)))

    if "temperature" in terms.names:
        warm = [k for k, name in enumerate(terms.names) if name != "drift"]
        found = replace(
            found,
            reference_temperature_c=terms.reference_temperature_c,
            slope=name_values(value, "temperature"),
            slope_sigma=name_values(sigma, "temperature"),
            coefficients=dict(zip(found.vary, value[:, warm].tolist(), strict=True)),
            coefficient_sigma=dict(zip(found.vary, sigma[:, warm].tolist(), strict=True)),
            tests={name: judge_columns(fitted, k * n + np.array(warm)) for k, name in enumerate(found.vary)},
        )
    return (
        replace(found, rate=name_values(value, "drift"), rate_sigma=name_values(sigma, "drift"))
        if "drift" in terms.names
        else found
    )
