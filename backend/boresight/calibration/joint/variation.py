"""Parameters that change from pass to pass beside those that do not: fitted together, and the last pass judged in their light.

First the passes are matched and fitted as one camera (`passes`). From there every pass gets its own values of the parameters that
vary, by themselves, as a random walk between the middles of the passes or linear in their mean temperature, and all are fitted
again as one least-squares problem (`estimation.block_bordered`), R taken at each pass's own state. How far a walk steps is either
told, or estimated from the passes (`estimation.walk`) and the fit repeated with it, until it changes by less than its tenth.

What a person loads is the camera as it is now, so a calibration's numbers are those of the last pass. All that the others know of
it, P_K of the whole problem less A_K of that pass,

    A_0 = P_K^-1 - A_K        z_0 = z_K + A_0^-1 b_K

is a prior of that pass (`estimation.prior`), with its mean where the fit of the pass beside it ends at z_K. So the last pass is
calibrated with it by the chosen method, and matches, tests, halves, widening and validation are those of any calibration with
a prior; they are of that pass. A direction of which the others know nothing is open in A_0: there it has the information of
`OPEN_SIGMAS` typical sigmas, or of a filter's own start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn, TypeVar

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibration import InputPass, PassState, PassVariation, Values, VariationTest, WalkSigma
from boresight.calibration.estimate import WHITENING_ROUNDS, Asked, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, whiten_part
from boresight.calibration.times import parse_times, to_days
from boresight.errors import CancelledError, RefusedInputError
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Linked, OfTemperature, Solution, Variation
from boresight.estimation.blocks import FRAMES
from boresight.estimation.prior import Prior
from boresight.estimation.statistics.special import chdtrc
from boresight.estimation.stored_arcs import BLOCKS_A_RANGE, over_range
from boresight.estimation.walk import Walk, find_walk, link_by_walk

Ends = Sequence[tuple[int, int]]
T = TypeVar("T")
#: Distance from the optimum, in sigmas, at which a fit of passes rests, and below which it has converged.
REST, CONVERGED = 1e-10, 1e-4
#: Share of the cost that rounding hides.
ROUNDING = 1e-12
MOST_HALVINGS = 10
#: Typical sigmas of what nobody knows.
OPEN_SIGMAS = 1e4
#: Drift where its estimate begins, typical sigmas a square root of a day; rounds of it, and the change of its log that ends them.
FIRST_WALK, WALK_ROUNDS, WALK_RESTS = 0.1, 4, 0.1
#: Chance below which a change from pass to pass is called one.
CHANGES = 1e-3


class WhitenedPasses:
    """The arcs of every pass with R at its own state: frames k0 <= k < k1 of a set each, in memory or in files."""

    def __init__(self, problem: Problem, ends: Ends, states: FloatArray) -> None:
        self._arcs, self._ends, self._at = problem.arcs, ends, states
        self._camera = problem.camera.name
        self.held = self._whitened(problem.arcs) if isinstance(problem.arcs, ArcSet) else ()

    def _whitened(self, arcs: ArcSet) -> Sequence[ArcSet | None]:
        return [
            whiten_part(arcs.frames(*end), self._camera, x) if end[0] < end[1] else None
            for end, x in zip(self._ends, self._at, strict=True)
        ]

    def sums(self, states: FloatArray, parameters: Parameters) -> list[NormalEquations]:
        """Return A, b and chi-square of each pass at its state, (n_passes, n_parameters)."""
        free, scale = parameters.free, parameters.scale
        if self.held:
            return [
                NormalEquations.added([], len(free)) if part is None else batch.normal_equations(part, x, free, scale)
                for part, x in zip(self.held, states, strict=True)
            ]
        return self._in_files(states, parameters)

    def counts(self) -> list[tuple[int, int]]:
        """Return the stars and the arcs of each pass."""
        if self.held:
            return [(0, 0) if part is None else count_block(part) for part in self.held]
        found = self._over_files(count_block, [()] * len(self._ends))
        return [(sum(stars for stars, _ in blocks), sum(arcs for _, arcs in blocks)) for blocks in found]

    def _in_files(self, states: FloatArray, parameters: Parameters) -> list[NormalEquations]:
        """The same of a set in files, ranges of all passes together wherever the executor computes them."""
        arguments = [(x, parameters.free, parameters.scale, np.inf) for x in states]
        found = self._over_files(batch.equations_of_block, arguments)
        return [NormalEquations.added(blocks, len(parameters.free)) for blocks in found]

    def _over_files(self, function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[list[T]]:
        """Return what a function says of every block of each pass, with the pass's arguments."""
        arcs = self._arcs
        assert not isinstance(arcs, ArcSet)  # noqa: S101 - what is in memory is held
        work, of = [], []
        for number, ((first, last), at, given) in enumerate(zip(self._ends, self._at, arguments, strict=True)):
            steps = (*arcs.steps, (whiten_part, (self._camera, at)))
            for begin in range(first, last, FRAMES * BLOCKS_A_RANGE):
                part = arcs.part(begin, min(begin + FRAMES * BLOCKS_A_RANGE, last))
                work.append((*part, steps, function, given))
                of.append(number)
        found: list[list[T]] = [[] for _ in self._ends]
        for number, blocks in zip(of, arcs.executor.map(over_range, work), strict=True):
            found[number] += blocks
        return found


def count_block(block: ArcSet) -> tuple[int, int]:
    """Return the stars and the arcs of a block."""
    return block.n_stars, block.n_arcs


def judge_passes(
    problem: Problem, passes: Sequence[InputPass], parameters: Parameters, x: FloatArray
) -> list[InputPass]:
    """Say of each pass what of it is in a fit that ended at one x (n_parameters,) for all, and its chi-square there."""
    states = np.tile(x, (len(passes), 1))
    arcs = WhitenedPasses(problem, places_of(problem, passes), states)
    return _judged(passes, arcs, arcs.sums(states, parameters))


def _judged(passes: Sequence[InputPass], arcs: WhitenedPasses, sums: Sequence[NormalEquations]) -> list[InputPass]:
    return [
        replace(one, stars=stars, pairs=pairs, chi2=of.chi2)
        for one, (stars, pairs), of in zip(passes, arcs.counts(), sums, strict=True)
    ]


@dataclass(frozen=True)
class PassesFit:
    """Where a fit of passes ended.

    `states`: (n_passes, n_parameters), SI. `arcs`: as whitened last. `sums`: of each pass there. `solution`: the covariances there.
    `chi2_alike`: chi-square of one state for all, whitened as at the end. `converged`: whether it rests.
    """

    states: FloatArray
    arcs: WhitenedPasses
    sums: list[NormalEquations]
    solution: Solution
    chi2_alike: float
    converged: bool

    def judge(self, passes: Sequence[InputPass]) -> list[InputPass]:
        """Say of each pass what of it is in the fit, and its chi-square there."""
        return _judged(passes, self.arcs, self.sums)

    @property
    def chi2(self) -> float:
        """Of all passes, without what links them."""
        return sum(one.chi2 for one in self.sums)

    def prior_of_last(self, parameters: Parameters, open_sigmas: float) -> Prior:
        """What the other passes know of the last, see the module."""
        last = self.sums[-1]
        values, vectors = np.linalg.eigh(np.linalg.inv(self.solution.P[-1]) - last.A)
        A_0 = (vectors * np.maximum(values, 0.0)) @ vectors.T + np.eye(len(values)) / open_sigmas**2
        x = self.states[-1].copy()
        x[parameters.free] += parameters.scale * np.linalg.solve(A_0, last.b)
        return Prior(x, np.asarray(np.linalg.inv(A_0)), A_0)


def fit_passes(
    problem: Problem,
    ends: Ends,
    parameters: Parameters,
    x: FloatArray,
    link: Variation,
    cancelled: Asked,
    most: int = 50,
) -> PassesFit:
    """Fit every pass's state from one x (n_parameters,) for all; raises LinAlgError where something is open."""
    z = np.zeros((len(ends), len(parameters.free)))

    def states_at(z: FloatArray) -> FloatArray:
        states = np.tile(x, (len(z), 1))
        states[:, parameters.free] += parameters.scale * z
        return states

    converged = False
    for _ in range(WHITENING_ROUNDS):
        arcs = WhitenedPasses(problem, ends, states_at(z))
        sums = arcs.sums(states_at(z), parameters)
        for iteration in range(most):
            if cancelled():
                raise CancelledError(f"Stopped as asked after {iteration} iterations over the passes")
            found = link.solve(sums, z)
            converged = found.decrement < CONVERGED**2
            if found.decrement < REST**2:
                break
            cost, share = sum(one.chi2 for one in sums) + link.cost(z), 1.0
            for _ in range(MOST_HALVINGS):
                tried = z + share * found.step
                there = arcs.sums(states_at(tried), parameters)
                if sum(one.chi2 for one in there) + link.cost(tried) <= cost * (1 + ROUNDING):
                    break
                share /= 2
            else:
                break
            z, sums = tried, there
    alike = sum(one.chi2 for one in arcs.sums(states_at(np.zeros_like(z)), parameters))
    return PassesFit(states_at(z), arcs, sums, link.solve(sums, z), alike, converged)


def places_of(problem: Problem, passes: Sequence[InputPass]) -> list[tuple[int, int]]:
    """Return the places of each pass's frames among those that take part."""
    frame = problem.arcs.frame
    return [tuple(np.searchsorted(frame, [one.first_frame, one.last_frame + 1]).tolist()) for one in passes]


def refuse_one_pass() -> NoReturn:
    """Refuse what varies from pass to pass of one set."""
    raise RefusedInputError(
        "What varies from pass to pass needs several telemetry sets: name more, or leave --vary out."
    )


def check_variation(names: Sequence[str], settings: CalibrationSettings) -> None:
    """Refuse parameters of a pass that are not free, and errors that are not least squares."""
    unknown = [name for name in settings.vary or () if name not in names]
    if unknown:
        raise RefusedInputError(f"{', '.join(unknown)} is not free, so it cannot vary: choose from {', '.join(names)}.")
    if settings.error != "arclength" or settings.robust != "none":
        raise RefusedInputError(
            "Passes are fitted by least squares on arcs: set error to 'arclength' and robust to 'none'."
        )


def make_link(passes: Sequence[InputPass], own: IntArray, settings: CalibrationSettings) -> Variation:
    """Return how the parameters at the places `own` among the free ones hang together from pass to pass."""
    if settings.vary_as == "pass":
        return Linked(own, np.zeros((len(passes), len(own))))
    if settings.vary_as == "temperature":
        known = [one.temperature_c for one in passes if one.temperature_c is not None]
        if len(known) < len(passes) or np.ptp(known) == 0.0:
            raise RefusedInputError(
                "Passes of one temperature, or without temperature_c, tell no slope: add the column, or choose --vary-as pass."
            )
        return OfTemperature(own, np.array(known) - np.mean(known))
    sigma = np.full(len(own), FIRST_WALK if settings.walk_sigma is None else settings.walk_sigma)
    return link_by_walk(own, _days_between(passes), sigma)


def _days_between(passes: Sequence[InputPass]) -> FloatArray:
    """Days between the middles of the passes, (n_passes - 1,)."""
    days = middle_days(passes)
    if not np.isfinite(days).all():
        raise RefusedInputError("A walk needs to know when each pass was: add time_utc, or choose --vary-as pass.")
    return np.maximum(np.diff(days), 0.0)


def middle_days(passes: Sequence[InputPass]) -> FloatArray:
    """The middles of passes in days, (n_passes,); NaN where one has no time."""
    starts, ends = (
        to_days(parse_times(times)) for times in zip(*((one.start_utc, one.end_utc) for one in passes), strict=True)
    )
    return (starts + ends) / 2


def fit_variation(
    problem: Problem, passes: Sequence[InputPass], parameters: Parameters, x: FloatArray, settings: CalibrationSettings,
    cancelled: Asked,
) -> tuple[PassesFit, PassVariation]:  # fmt: skip
    """Fit the passes with the parameters that vary, and describe it."""
    names = [problem.camera.parameter_names[p] for p in parameters.free]
    own = np.array([place for place, name in enumerate(names) if name in (settings.vary or ())], np.int64)
    ends = places_of(problem, passes)
    walk: Walk | None = None
    try:
        link = make_link(passes, own, settings)
        fitted = fit_passes(problem, ends, parameters, x, link, cancelled, settings.max_iterations)
        if settings.vary_as == "walk" and settings.walk_sigma is None:
            fitted, walk = fit_walk(
                problem, ends, _days_between(passes), parameters, x, own, fitted, cancelled, settings.max_iterations
            )
    except np.linalg.LinAlgError as error:
        few = min(range(len(ends)), key=lambda k: ends[k][1] - ends[k][0])
        raise RefusedInputError(
            f"A pass does not determine {', '.join(settings.vary or ())} by itself (fewest frames: {passes[few].name}): choose "
            "--vary-as walk, leave such passes out, or vary fewer parameters."
        ) from error
    if not fitted.converged:
        raise RefusedInputError(
            "The fit of the passes does not settle: choose --vary-as walk, or vary fewer parameters."
        )
    return fitted, _describe(problem, passes, parameters, own, fitted, settings, walk)


def fit_walk(  # noqa: PLR0913, PLR0917 - a fit of passes, and the walk that it goes on with
    problem: Problem, ends: Ends, days: FloatArray, parameters: Parameters, x: FloatArray, own: IntArray, fitted: PassesFit,
    cancelled: Asked, most: int,
) -> tuple[PassesFit, Walk]:  # fmt: skip
    """Estimate the drift, days (n_passes - 1,) between passes, and fit the passes with it, in turn."""
    before = np.full(len(own), FIRST_WALK)
    for _ in range(WALK_ROUNDS):
        z = (fitted.states[:, parameters.free] - x[parameters.free]) / parameters.scale
        walk = find_walk(fitted.sums, z, own, days)
        link = link_by_walk(own, days, walk.sigma)
        fitted = fit_passes(problem, ends, parameters, x, link, cancelled, most)
        if np.abs(np.log(walk.sigma / before)).max() < WALK_RESTS:
            break
        before = walk.sigma
    return fitted, walk


def _describe(
    problem: Problem, passes: Sequence[InputPass], parameters: Parameters, own: IntArray, fitted: PassesFit,
    settings: CalibrationSettings, walk: Walk | None,
) -> PassVariation:  # fmt: skip
    names = [problem.camera.parameter_names[p] for p in parameters.free]
    states = []
    for one, x, P, sums in zip(passes, fitted.states, fitted.solution.P, fitted.sums, strict=True):
        sigma = np.sqrt(np.diag(P)) * parameters.scale
        values = x[parameters.free]
        states.append(
            PassState(
                name=one.name,
                parameters=Values(dict(zip(names, values.tolist(), strict=True))),
                sigma=Values(dict(zip(names, sigma.tolist(), strict=True))),
                chi2=sums.chi2,
            )
        )
    scale, of = parameters.scale[own], [names[place] for place in own]
    slope = fitted.solution.slope * scale if len(fitted.solution.slope) else np.full(len(own), np.nan)
    slope_sigma = np.sqrt(np.diag(fitted.solution.slope_covariance)) * scale if np.isfinite(slope).all() else slope
    by_temperature = settings.vary_as == "temperature"
    found = PassVariation(
        vary=of,
        vary_as=settings.vary_as,
        walk=_write_walk(of, walk, settings) if settings.vary_as == "walk" else None,
        reference_temperature_c=float(np.mean([one.temperature_c for one in passes])) if by_temperature else None,
        slope=Values(dict(zip(of, slope.tolist(), strict=True))) if by_temperature else None,
        slope_sigma=Values(dict(zip(of, slope_sigma.tolist(), strict=True))) if by_temperature else None,
        states=states,
        chi2=fitted.chi2,
        test=_test(fitted, len(own), settings.vary_as),
        sentence="",
    )
    return PassVariation(**{**vars(found), "sentence": _sentence(found)})


def _write_walk(names: Sequence[str], walk: Walk | None, settings: CalibrationSettings) -> dict[str, WalkSigma]:
    if walk is None:
        return {name: WalkSigma(sigma=settings.walk_sigma or FIRST_WALK) for name in names}
    rows = zip(names, walk.sigma.tolist(), walk.low.tolist(), walk.high.tolist(), strict=True)
    return {name: WalkSigma(sigma=sigma, interval=[low, high]) for name, sigma, low, high in rows}


def _test(fitted: PassesFit, n_own: int, vary_as: str) -> VariationTest | None:
    """Hold what varying them takes from chi-square against chance; a walk is held back, and its fall has no such law."""
    if vary_as == "walk":
        return None
    dof = n_own * (1 if vary_as == "temperature" else len(fitted.states) - 1)
    fall = max(fitted.chi2_alike - fitted.chi2, 0.0)
    return VariationTest(fall=fall, dof=dof, p_value=float(chdtrc(dof, fall)))


def _sentence(found: PassVariation) -> str:
    how = {"pass": "one value in each", "walk": "a random walk over each", "temperature": "linear in the temperature"}
    opening = f"{', '.join(found.vary)}: {how[found.vary_as]} of {len(found.states)} passes"
    if found.test is None:
        return f"{opening}{_drifts(found)}; the numbers are those of the last, {found.states[-1].name}."
    real = "beyond chance" if found.test.p_value < CHANGES else "no more than chance has it"
    return (
        f"{opening}, {real} (chi-square falls by {found.test.fall:.3g} for {found.test.dof} parameters); the numbers are those of "
        f"the last, {found.states[-1].name}."
    )


def _drifts(found: PassVariation) -> str:
    """Say how far each parameter drifts, where that was estimated."""
    said = [
        f"{name} {one.sigma:.2g} ({one.interval[0]:.2g} to {one.interval[1]:.2g})"
        for name, one in (found.walk or {}).items()
        if one.interval is not None and one.interval[0] is not None and one.interval[1] is not None
    ]
    return f" by the most likely drift, typical sigmas a square root of a day: {', '.join(said)}" if said else ""
