"""What every trust number stands on: a finished estimate, the set's whitened rows, and the frames' sums of them.

The rows are taken at x, the best fit of the whole set. A batch ends there; a filter with process noise follows its last frames
instead, and drift or displaced stars can only be told from its wandering where the wandering is taken out. There each frame k
has the whitened residual e_k and scaled Jacobian H_k (E Eqs 80-82), so that for all frames together

    A = sum_k H_k^T H_k      b_k = H_k^T e_k, the frame's score      chi2_k = e_k^T e_k      l_k = tr(H_k A^-1 H_k^T), its leverage.

They come from one pass over the set; everything that is linear in the data follows from them without another. What needs more
than a pass a frame takes frames spaced evenly over the set (`thinned`), and its part of the result says how many.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import BoolArray, FloatArray
from boresight.calibration.estimate import Asked, Estimate, Parameters, never
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import covariance
from boresight.estimation.blocks import in_blocks
from boresight.kernels.frame_sums import frame_sums
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry

MOST_ITERATIONS = 20
#: Chance that any test calls a sound set into question, half of the 1 % that is promised, for no probability is exact; and what one
#: test of the whole table must fall below alone.
FAMILY_LEVEL = 0.005
UNLIKELY = FAMILY_LEVEL / 33
#: Arrays so small are rounded one number at a time.
FEW = 64
#: Powers of ten that are numbers of double precision, and how far from a half a digit is that rounding may turn either way.
LARGEST_POWER = 22
POWERS = 10.0 ** np.arange(LARGEST_POWER + 1)
NEAR_HALF = 1e-6


class Unavailable(Exception):  # noqa: N818 - an answer, not an error
    """A trust number that cannot be had; its text is the sentence that says why."""


@dataclass(frozen=True)
class FrameSums:
    """What the rows of every frame add up to.

    `chi2`: (n_frames,) chi2_k. `scores`, `squares`: (n_frames, n_free) b_k, and the diagonal of H_k^T H_k. `leverage`:
    (n_frames,) l_k. `dof`: (n_frames,) arcs less leverage.
    """

    chi2: FloatArray
    scores: FloatArray
    squares: FloatArray
    leverage: FloatArray
    dof: FloatArray


@dataclass(frozen=True)
class FittedSet:
    """A finished estimate with its data.

    `problem`, `parameters`, `settings`, `estimate`, `telemetry`, `catalogue`: as `calibrate` has them at its end. `x`:
    (n_parameters,) best fit of the whole set, SI. `arcs`: the arcs, whitened there. `e`, `H`: (n_arcs,) whitened residuals and
    (n_arcs, n_free) scaled Jacobian there. `cancelled`: asked by what takes long.
    """

    problem: Problem
    parameters: Parameters
    settings: CalibrationSettings
    estimate: Estimate
    telemetry: Telemetry
    catalogue: Catalogue | None
    x: FloatArray
    arcs: ArcSet
    e: FloatArray
    H: FloatArray
    cancelled: Asked = never

    @property
    def names(self) -> list[str]:
        """Names of the free parameters."""
        return [self.problem.camera.parameter_names[p] for p in self.parameters.free]

    @property
    def symbols(self) -> list[str]:
        """Their letters."""
        return [self.problem.camera.symbols[p] for p in self.parameters.free]

    @cached_property
    def A(self) -> FloatArray:
        """Information of the data alone, in typical sigmas."""
        return np.asarray(self.H.T @ self.H)

    @property
    def threshold(self) -> float:
        """Of Huber's loss, infinite for least squares: what is fitted again is fitted as the estimate was."""
        return self.settings.huber_threshold if self.settings.robust == "huber" else np.inf

    @property
    def determined(self) -> bool:
        """Whether the data determine every free parameter."""
        return self.estimate.status != "rank_deficient"

    @cached_property
    def computed(self) -> dict[str, Any]:
        """What one part has computed and another wants too."""
        return {}

    def full_covariance(self, P: FloatArray) -> FloatArray:
        """P (n_free, n_free) in typical sigmas as (n_parameters, n_parameters) in SI, zero for fixed parameters."""
        return self.parameters.full_covariance(P, n=len(self.estimate.x))

    @cached_property
    def sums(self) -> FrameSums:
        """What the frames' rows add up to."""
        arc_start, P = self.arcs.frame_arcs, covariance(self.A)
        n, n_free = self.arcs.n_frames, len(P)
        chi2, leverage = np.empty(n), np.empty(n)
        scores, squares = np.empty((n, n_free)), np.empty((n, n_free))

        def add(first: int, last: int) -> None:
            frames, rows = slice(first, last), slice(int(arc_start[first]), int(arc_start[last]))
            starts = arc_start[first : last + 1] - rows.start
            frame_sums(
                starts, self.e[rows], self.H[rows], P, chi2[frames], scores[frames], squares[frames], leverage[frames]
            )

        in_blocks(add, n)
        return FrameSums(chi2, scores, squares, leverage, np.diff(arc_start) - leverage)

    def thinned(self, most: int) -> ArcSet:
        """The arcs of at most so many frames, evenly spaced."""
        n = self.arcs.n_frames
        if n <= most:
            return self.arcs
        taken = np.zeros(n, np.bool_)
        taken[np.linspace(0, n - 1, most).round().astype(int)] = True
        return chosen(self.arcs, taken)


def fit_best(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    telemetry: Telemetry,
    catalogue: Catalogue | None,
    cancelled: Asked = never,
) -> FittedSet:
    """Find the best fit of the set and take the rows there.

    Raises Unavailable when there is nothing to stand on, with the sentence that says why.
    """
    if estimate.status == "diverged" or not np.isfinite(estimate.x).all():
        raise Unavailable("The fit diverged, so there is no estimate to judge: free fewer parameters or start closer.")
    x, arcs = _best_fit(problem, parameters, settings, estimate, cancelled)
    if arcs.n_arcs <= len(parameters.free):
        raise Unavailable("There are no more arcs than free parameters, so nothing can be checked: add frames.")
    e, H = np.empty(arcs.n_arcs), np.empty((arcs.n_arcs, len(parameters.free)))
    kernels.whitened_rows(
        arcs.camera.kind, x, arcs.pitch, arcs.star_start, arcs.row_px, arcs.col_px, arcs.known_phi, arcs.band,
        parameters.free, parameters.scale, e, H,
    )  # fmt: skip
    if not (np.isfinite(e).all() and np.isfinite(H).all()):
        raise Unavailable("The camera model has no finite value at this estimate: free fewer parameters.")
    return FittedSet(problem, parameters, settings, estimate, telemetry, catalogue, x, arcs, e, H, cancelled)


def _best_fit(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate, cancelled: Asked
) -> tuple[FloatArray, ArcSet]:
    """State and arcs whitened there; the estimate itself where it is the best fit, or Huber's."""
    arcs = problem.whitened(estimate.x).whole()
    by_batch = not settings.sequential and settings.error == "arclength" and settings.robust != "stars"
    if by_batch and parameters.prior is None:
        return estimate.x, arcs
    fitted = batch.fit(
        arcs, estimate.x, parameters.free, parameters.scale, max_iterations=MOST_ITERATIONS, cancelled=cancelled
    )
    if fitted.status == "diverged":
        return estimate.x, arcs
    return fitted.x, problem.whitened(fitted.x).whole()


def chosen(arcs: ArcSet, frames: BoolArray) -> ArcSet:
    """Only those frames (n_frames,) of a set, whitened or not, as a set of their own."""
    return arcs.exposures(np.repeat(frames, np.diff(arcs.frame_start)))


def grid(rows: int, columns: int, n_rows: int, n_columns: int) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of places spread over the detector, edges included, pixels."""
    return np.linspace(0, rows - 1.0, n_rows), np.linspace(0, columns - 1.0, n_columns)


def nested(values: NDArray[Any]) -> list[Any]:
    """Nested lists of five significant digits, with null for what is not finite: for drawing, not for computing on."""
    if values.size < FEW:
        return _written(values)
    size = np.abs(values)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        digits = 4 - np.floor(np.log10(size))  # after the point, where they are that many; less than none before it
        safe = np.abs(digits) <= LARGEST_POWER
        power = POWERS[np.where(safe, np.abs(digits), 0.0).astype(np.int64)]
        whole = np.where(digits < 0, size / power, size * power)
        near = np.rint(whole)
        rounded = np.copysign(np.where(digits < 0, near * power, near / power), values)
        clear = safe & (np.abs(np.abs(whole - near) - 0.5) > NEAR_HALF)  # of which digit is the last there is no doubt
    if clear.all():
        return list(rounded.tolist())
    found = rounded.astype(object)
    found[~clear] = _written(values[~clear])
    return list(found.tolist())


def _written(values: NDArray[Any]) -> list[Any]:
    """The same by way of text, which is exact and slow."""
    if values.ndim > 1:
        return [_written(row) for row in values]
    written = ("%.5g " * len(values) % tuple(values.tolist())).split()
    return [float(text) if known else None for text, known in zip(written, np.isfinite(values).tolist(), strict=True)]


def probability(p: float) -> str:
    """A probability as a person reads it."""
    return f"p = {p:.2g}" if p >= 1e-4 else "p < 0.0001"
