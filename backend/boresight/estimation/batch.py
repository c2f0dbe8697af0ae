"""The batch estimator: Levenberg-Marquardt on whitened arcs, in scaled parameters (E section II-C).

The cost is J = 1/2 dphi^T R^-1 dphi (E Eq 14). The free parameters are scaled by their typical sigmas (E Eq 22, Table II),
z = (x - x_0) / sigma_p, so with H' the whitened, scaled Jacobian (E Eqs 23, 82) and e' the whitened residual

    A = H'^T H'     b = H'^T e'     (A + lambda I) dz = -b     covariance of z at the optimum = A^-1.

Damping follows Nielsen's rule on the ratio of actual to predicted decrease. Plain Gauss-Newton will not do: at b2 = b4 = a1 =
a2 = 0 the Jacobian has rank 6 of 8, because there (m0, a2) and (n0, a1) are pure rotations (erratum to II-C).

The fit has converged when the undamped Newton decrement over the determined directions, b^T A^+ b, is below `REST` squared: the
estimate then lies within `REST` of its own standard deviation from the optimum. R depends on f a little (sigma in rad is
sigma_px Delta / f), so the caller whitens the arcs again at the solution and fits once more.

What was known before (`prior`) adds A_0 and A_0 z to A and b; the information that a fit reports is of the data alone.

With Huber's loss (`robust`) both A and b carry its weights on the way, and A at the end is what that estimate is worth.

References
----------
Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.executor import refuse_cancelled
from boresight.estimation.robust import measure_huber_effect
from boresight.estimation.stored_arcs import Arcs

if TYPE_CHECKING:
    from boresight.estimation.prior import Prior

#: Distance from the optimum, in standard deviations, at which the fit rests.
REST = 1e-4
#: Eigenvalues of A below this share of the largest are rounding, not information.
RANK_TOLERANCE = 1e-13
FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e12
#: Fall of chi-square, as a share of one more than it, that the rounding of its residuals hides.
ROUNDING = 1e-11


#: Eigenvalues, eigenvectors and which of them are determined.
Spectrum = tuple[FloatArray, FloatArray, NDArray[np.bool_]]


@dataclass(frozen=True)
class Step:
    """One accepted iterate.

    Parameters
    ----------
    x
        (n_parameters,) state, SI.
    spectrum
        What `determined` says of A there.
    chi2
        Whitened sum of squares, or of Huber's loss.
    sum_of_squares
        Unweighted sum of squares, rad^2.
    damping
        lambda of the step that led here.
    """

    x: FloatArray
    spectrum: Spectrum
    chi2: float
    sum_of_squares: float
    damping: float

    @property
    def sigma(self) -> FloatArray:
        """(n_free,) one-sigma of the free parameters, in typical sigmas; infinite where not determined."""
        return _compute_sigma(*self.spectrum)


Status = Literal["converged", "max_iterations", "rank_deficient", "diverged"]


@dataclass(frozen=True)
class BatchFit:
    """Where the batch estimator ended.

    Parameters
    ----------
    x
        (n_parameters,) estimate, SI.
    A
        (n_free, n_free) information of the data in units of the typical sigmas.
    chi2, sum_of_squares
        Whitened, and unweighted in rad^2, at x.
    rank
        Directions of the free parameters that the data, with a prior where there is one, determine.
    status
        `converged`, `max_iterations`, `rank_deficient` or `diverged`.
    steps
        Every accepted iterate, the start first.
    beyond
        Arcs beyond the threshold of Huber's loss; 0 for least squares.
    cost
        What was minimised, at x: chi-square, or Huber's loss; with the prior's share of it.
    """

    x: FloatArray
    A: FloatArray
    chi2: float
    sum_of_squares: float
    rank: int
    status: Status
    steps: tuple[Step, ...]
    beyond: int = 0
    cost: float = np.nan


@dataclass(frozen=True)
class NormalEquations:
    """A, b and the costs at one state; see the module's derivation."""

    A: FloatArray
    b: FloatArray
    chi2: float
    sum_of_squares: float

    @classmethod
    def added(cls, parts: Iterable[NormalEquations], n_free: int) -> NormalEquations:
        """Add those of blocks, in their order."""
        A, b, chi2, total = np.zeros((n_free, n_free)), np.zeros(n_free), 0.0, 0.0
        for part in parts:
            A += part.A
            b += part.b
            chi2 += part.chi2
            total += part.sum_of_squares
        return cls(A, b, chi2, total)

    @cached_property
    def spectrum(self) -> Spectrum:
        """What `determined` says of A, once."""
        return determined(self.A)

    def select(self, places: NDArray[np.int64]) -> NormalEquations:
        """Those of some of the free parameters, the others held."""
        return NormalEquations(self.A[np.ix_(places, places)], self.b[places], self.chi2, self.sum_of_squares)

    def with_prior(
        self, prior: Prior | None, x: FloatArray, free: NDArray[np.int64], scale: FloatArray
    ) -> NormalEquations:
        """Those of the data at state x with what was known before."""
        if prior is None:
            return self
        z = (x - prior.x)[free] / scale
        pull = prior.A @ z
        return NormalEquations(self.A + prior.A, self.b + pull, self.chi2 + float(z @ pull), self.sum_of_squares)

    def finite(self) -> bool:
        """Whether the state is one the model can be evaluated at."""
        return bool(np.isfinite(self.chi2) and np.isfinite(self.A).all() and np.isfinite(self.b).all())


def normal_equations(
    arcs: Arcs, x: FloatArray, free: NDArray[np.int64], scale: FloatArray, threshold: float = np.inf
) -> NormalEquations:
    """Evaluate A and b.

    Parameters
    ----------
    x
        (n_parameters,) state, SI.
    free
        (n_free,) places of the free parameters in the state.
    scale
        (n_free,) their typical sigmas, SI.
    threshold
        Of Huber's loss, in whitened sigmas; infinite for least squares.
    """
    return NormalEquations.added(arcs.over_blocks(equations_of_block, x, free, scale, threshold), len(free))


def equations_of_block(
    block: ArcSet, x: FloatArray, free: NDArray[np.int64], scale: FloatArray, threshold: float
) -> NormalEquations:
    """Evaluate A and b of one block."""
    A, b = np.empty((len(free), len(free))), np.empty(len(free))
    chi2, total = kernels.normal_equations(*block.begin_whitened_loop(x), free, scale, threshold, A, b)
    return NormalEquations(A, b, float(chi2), float(total))


def compute_chi2(arcs: Arcs, x: FloatArray) -> float:
    """Whitened sum of squares at state x (n_parameters,) alone: a third of the time that A and b take."""
    return float(sum(arcs.over_blocks(_squares_of_block, x)))


def _squares_of_block(block: ArcSet, x: FloatArray) -> float:
    """Whitened sum of squares of one block."""
    return float(kernels.count_beyond(*block.begin_whitened_loop(x), np.inf)[1])


def determined(A: FloatArray) -> Spectrum:
    """Eigenvalues (ascending), eigenvectors and which of them carry information rather than rounding."""
    values, vectors = np.linalg.eigh(A)
    return values, vectors, values > RANK_TOLERANCE * max(values.max(initial=0.0), np.finfo(float).tiny)


def covariance(A: FloatArray) -> FloatArray:
    """Invert the information over its determined directions; `sigma_in_scale` says where that is infinite."""
    if not np.isfinite(A).all():
        return np.full_like(A, np.nan)
    values, vectors, known = determined(A)
    return np.asarray((vectors[:, known] / values[known]) @ vectors[:, known].T)


def sigma_in_scale(A: FloatArray) -> FloatArray:
    """One-sigma of each free parameter in typical sigmas; infinite where an undetermined direction touches it."""
    return _compute_sigma(*determined(A))


def _compute_sigma(values: FloatArray, vectors: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return the same from eigenvalues and eigenvectors."""
    variance = (vectors[:, known] ** 2 / values[known]).sum(axis=1)
    touched = (np.abs(vectors[:, ~known]) > 1e-4).any(axis=1)
    return np.asarray(np.where(touched, np.inf, np.sqrt(variance)))


def _decrement(equations: NormalEquations) -> float:
    """Squared distance to the optimum in standard deviations, over the determined directions."""
    values, vectors, known = equations.spectrum
    return float(((vectors.T @ equations.b)[known] ** 2 / values[known]).sum())


def fit(  # noqa: PLR0913 - what is fitted, and seven choices by name
    arcs: Arcs,
    x0: FloatArray,
    free: NDArray[np.int64],
    scale: FloatArray,
    *,
    max_iterations: int = 50,
    threshold: float = np.inf,
    rest: float = REST,
    begun: NormalEquations | None = None,
    prior: Prior | None = None,
    report: Callable[[Step], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> BatchFit:
    """Estimate the free parameters.

    Parameters
    ----------
    arcs
        The whitened arcs of a set.
    x0
        (n_parameters,) start, SI; fixed parameters keep these values.
    free
        (n_free,) places of the free parameters.
    scale
        (n_free,) typical sigmas, SI.
    threshold
        Of Huber's loss, in whitened sigmas; infinite for least squares.
    rest
        Distance from the optimum, in standard deviations, at which to rest.
    begun
        A, b and the costs of the data at the start, where they are known already.
    prior
        What was known before.
    report
        Told of each accepted iterate, the start included.
    cancelled
        Asked before each iteration.

    Returns
    -------
    BatchFit; a numeric failure is its status, never an exception.

    Raises
    ------
    CancelledError
        When `cancelled` says so.
    """
    x, damping, growth = x0.copy(), FIRST_DAMPING, 2.0
    data = begun or normal_equations(arcs, x, free, scale, threshold)
    here = data.with_prior(prior, x, free, scale)
    steps: list[Step] = []
    identity = np.eye(len(free))
    status: Status = "max_iterations" if here.finite() else "diverged"
    for iteration in range(max_iterations + 1):
        if not here.finite():
            break
        if not steps or steps[-1].chi2 != here.chi2:
            steps.append(Step(x.copy(), here.spectrum, here.chi2, here.sum_of_squares, damping))
            if report is not None:
                report(steps[-1])
        if _decrement(here) < rest**2:
            status = "converged"
            break
        refuse_cancelled(cancelled, f"after {iteration} iterations")
        if damping > LARGEST_DAMPING:
            status = "diverged"
            break
        dz = np.linalg.solve(here.A + damping * identity, -here.b)
        trial = x.copy()
        trial[free] += scale * dz
        data_there = normal_equations(arcs, trial, free, scale, threshold)
        there = data_there.with_prior(prior, trial, free, scale)
        predicted = float(dz @ (damping * dz - here.b))
        ratio = (here.chi2 - there.chi2) / predicted if there.finite() and predicted > 0 else -1.0
        if ratio > 0 or (there.finite() and abs(here.chi2 - there.chi2) <= 1e-13 * here.chi2):
            x, data, here = trial, data_there, there
            damping *= max(1 / 3, 1 - (2 * min(ratio, 1.0) - 1) ** 3) if ratio > 0 else 1.0
            growth = 2.0
        else:
            damping, growth = damping * growth, growth * 2
    rank = int(here.spectrum[2].sum()) if here.finite() else 0
    status = _ended(here, status, rank)
    fitted = BatchFit(x, data.A, data.chi2, here.sum_of_squares, rank, status, tuple(steps), cost=here.chi2)
    return fitted if np.isinf(threshold) or not here.finite() else _insured(fitted, arcs, free, scale, threshold)


def _ended(here: NormalEquations, status: Status, rank: int) -> Status:
    """How a fit ended: converged too where nothing lower can be told apart, whatever `rest` asks for."""
    if here.finite() and _decrement(here) < ROUNDING * (1 + here.chi2):
        status = "converged"
    return "rank_deficient" if status == "converged" and rank < len(here.b) else status


def _insured(fitted: BatchFit, arcs: Arcs, free: NDArray[np.int64], scale: FloatArray, threshold: float) -> BatchFit:
    """Give a robust fit its own information, and the chi-square that shows what it did not follow."""
    plain = normal_equations(arcs, fitted.x, free, scale)
    paid = measure_huber_effect(arcs, fitted.x, len(free), threshold)
    return replace(fitted, A=paid.information_share * plain.A, chi2=plain.chi2, beyond=paid.beyond)
