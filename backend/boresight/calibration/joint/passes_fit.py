"""A fit of passes that have states of their own: every pass linearised where it is, whatever links them.

From one state for all, damped Gauss-Newton steps of the whole problem (`estimation.block_bordered`) until it rests, with R taken
at each pass's own state, and taken again at the end. A and b of each pass are all that is needed of it: in memory, or summed by the
workers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from boresight.arrays import FloatArray, IntArray, parse_times, to_days
from boresight.calibration.calibration import InputPass, VariationTest
from boresight.calibration.estimate import WHITENING_ROUNDS, Asked, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem, whiten_part
from boresight.errors import RefusedInputError
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Solution, Variation
from boresight.estimation.blocks import FRAMES
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.prior import Prior
from boresight.estimation.statistics.special import chdtrc
from boresight.estimation.stored_arcs import BLOCKS_A_RANGE, over_range

Ends = Sequence[tuple[int, int]]
T = TypeVar("T")
#: Distance from the optimum, in sigmas, at which a fit of passes rests, and below which it has converged.
REST, CONVERGED = 1e-10, 1e-4
#: Share of the cost that rounding hides.
ROUNDING = 1e-12
MOST_HALVINGS = 10
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
    arcs = WhitenedPasses(problem, list_places(problem, passes), states)
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
            refuse_cancelled(cancelled, f"after {iteration} iterations over the passes")
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


def list_places(problem: Problem, passes: Sequence[InputPass]) -> list[tuple[int, int]]:
    """Return the places of each pass's frames among those that take part."""
    frame = problem.arcs.frame
    return [tuple(np.searchsorted(frame, [one.first_frame, one.last_frame + 1]).tolist()) for one in passes]


def middle_days(passes: Sequence[InputPass]) -> FloatArray:
    """The middles of passes in days, (n_passes,); refuses where one has no time."""
    times = zip(*((one.start_utc, one.end_utc) for one in passes), strict=True)
    starts, ends = (to_days(parse_times(those)) for those in times)
    if not np.isfinite(starts + ends).all():
        raise RefusedInputError(
            "A change over time requires the time of each pass: add time_utc, or choose --vary-as pass."
        )
    return np.asarray((starts + ends) / 2)


@dataclass(frozen=True)
class PassesProblem:
    """Passes, or stretches of a set, to be fitted from one state x (n_parameters,) for all; `ends`: places of their frames."""

    problem: Problem
    passes: Sequence[InputPass]
    parameters: Parameters
    x: FloatArray
    settings: CalibrationSettings
    cancelled: Asked
    ends: Ends

    @property
    def names(self) -> list[str]:
        """Names of the free parameters."""
        return [self.problem.camera.parameter_names[p] for p in self.parameters.free]

    def list_names(self, own: IntArray) -> list[str]:
        """Names of some of the free parameters, by their places."""
        return [self.names[place] for place in own]

    def fit(self, link: Variation) -> PassesFit:
        """Fit the passes with what links them."""
        return fit_passes(
            self.problem, self.ends, self.parameters, self.x, link, self.cancelled, self.settings.max_iterations
        )

    def departures(self, fitted: PassesFit) -> FloatArray:
        """How far each pass's free parameters are from x, (n_passes, n_free) typical sigmas."""
        free = self.parameters.free
        return np.asarray((fitted.states[:, free] - self.x[free]) / self.parameters.scale)


def judge_fall(fitted: PassesFit, dof: int) -> VariationTest | None:
    """Hold what so many further parameters take from chi-square against chance; None where there are none."""
    if dof == 0:
        return None
    fall = max(fitted.chi2_alike - fitted.chi2, 0.0)
    return VariationTest(fall=fall, dof=dof, p_value=float(chdtrc(dof, fall)))
