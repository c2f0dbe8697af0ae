"""What the data can tell apart: the singular value decomposition of the scaled Jacobian, in words.

With H' whitened by R and scaled by the typical sigmas (E Eqs 22-24), U S V^T = H'. Column v_i of V is a direction in parameter
space, and 1 / s_i is its standard deviation in typical sigmas: a direction with 1 / s_i of 1 is known no better than the spread
from unit to unit that was known before any star was seen. H' is tall, so S and V come from the eigenvectors of A = H'^T H'.

The paper's weak directions are (m0, a2) and (n0, a1). Moving the principal point while tilting the detector so that the axis
follows leaves the arcs all but unchanged: a2 = (Delta/f) dm0, of the *same* sign (erratum to III-A).

A covariance holds where chi-square is the quadratic that A says: one sigma along a direction it rises by 1. Where two parameters do
nearly the same, the way along which the data hardly tell them apart bends: a long straight step leaves it, chi-square rises by
hundreds, and the truth lies on the bend, tens of sigmas off along directions that A calls well known. That is the parameter-effects
curvature of Bates and Watts (1980), no rounding: a QR of H' gives the same covariance. `chi2_rise` shows it by steps.
For a bend that adds K well known sigmas at one sigma the rise is 1 + K^2, and the mean of the squared error in sigmas is 3 K^2 too
large; beyond `CURVED` that is more than its scatter for four parameters hides.

The covariance after further frames of the same kind, before they are taken.

Each frame brings on average the information a = A / n of the n frames that are there. A batch, or a filter without process
noise, ends at P_k^-1 = P^-1 + k a; a filter's P^-1 holds its start once, which further frames leave as it is.

With process noise Q = q^2 I and a forgetting factor l, a frame takes P to ((P / l + Q)^-1 + a)^-1. A run of such steps is again

    P -> F (I + P G)^-1 P F^T + C,

and two runs, 1 then 2, join to one (Särkkä & García-Fernández 2021, Eq 10):

    F = F_2 (I + C_1 G_2)^-1 F_1      C = F_2 (I + C_1 G_2)^-1 C_1 F_2^T + C_2      G = F_1^T (I + G_2 C_1)^-1 G_2 F_1 + G_1.

Q is a multiple of I, so in the eigenvectors of a all of these stay diagonal: three numbers a direction, and k steps by repeated
doubling. Only P itself is full. One step has F = 1 / (sqrt(l) (1 + q^2 a)), C = q^2 / (1 + q^2 a), G = a / (l (1 + q^2 a)).

References
----------
Bates, Watts, "Relative curvature measures of nonlinearity", J. R. Statist. Soc. B 42, 1980.
Särkkä, García-Fernández, "Temporal parallelization of Bayesian smoothers", IEEE TAC 66, 2021.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.estimation.batch import compute_chi2, determined, normal_equations
from boresight.estimation.stored_arcs import Arcs
from boresight.wording import join_words

#: A direction known worse than this many typical sigmas is called weak; the data then say little that was not known before.
WEAK = 0.5
#: Components of a direction smaller than this are left out of its sentence.
NAMED = 0.25
#: Share by which chi-square may rise otherwise than the covariance says, one sigma along a direction.
CURVED = 0.5
#: A rise beyond which nothing more is said, such as where the camera has no directions left.
LARGEST_RISE = 1e6


@dataclass(frozen=True)
class Observability:
    """Singular values and directions of the free parameters.

    Parameters
    ----------
    names, symbols
        (n_free,) of the free parameters.
    singular_values
        (n_free,) descending.
    V
        (n_free, n_free) right singular vectors as columns, in typical sigmas.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    singular_values: FloatArray
    V: FloatArray

    @property
    def condition_number(self) -> float | None:
        """Largest over smallest singular value; None when the smallest is rounding."""
        s = self.singular_values
        return float(s[0] / s[-1]) if s[-1] > 0 else None

    @property
    def sigma_of_direction(self) -> FloatArray:
        """(n_free,) one-sigma along each direction, in typical sigmas; infinite when undetermined."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.singular_values)

    def weak(self) -> list[int]:
        """Directions known worse than `WEAK` typical sigmas, weakest first."""
        return [i for i in range(len(self.names) - 1, -1, -1) if self.sigma_of_direction[i] > WEAK]

    def direction(self, i: int) -> dict[str, float]:
        """Components of direction i by parameter name, largest component positive."""
        v = self.V[:, i] * np.sign(self.V[np.argmax(np.abs(self.V[:, i])), i])
        return {name: float(value) for name, value in zip(self.names, v, strict=True)}

    def named(self, i: int) -> list[tuple[str, float]]:
        """Symbols and components of direction i that are large enough to be named, largest first."""
        parts = sorted(zip(self.symbols, self.direction(i).values(), strict=True), key=lambda part: -abs(part[1]))
        return [(symbol, value) for symbol, value in parts if abs(value) >= NAMED]

    def sentence(self, i: int) -> str:
        """Say in words what direction i is and how well it is known."""
        named = self.named(i)
        sigma = self.sigma_of_direction[i]
        known = f"is known to {sigma:.2g} typical sigmas" if np.isfinite(sigma) else "is not determined by these data"
        if len(self.names) == 1:
            return f"{self.symbols[0]} is the only free parameter: it {known}."
        if len(named) == 1:
            return f"{named[0][0]} is nearly independent of the others: it {known}."
        first, *rest = named
        ratio = f"{first[1]:.2f} {first[0]}" + "".join(
            f" {'+' if v > 0 else '−'} {abs(v):.2f} {name}" for name, v in rest
        )
        together = join_words([symbol for symbol, _ in named])
        return f"{together} move together: the combination {ratio} (in typical sigmas) {known}."


def observability(A: FloatArray, names: tuple[str, ...], symbols: tuple[str, ...]) -> Observability:
    """Decompose the information A (n_free, n_free), in typical sigmas."""
    values, vectors, known = determined(A)
    s = np.sqrt(np.where(known, values, 0.0))
    return Observability(names, symbols, s[::-1], vectors[:, ::-1])


def chi2_rise(arcs: Arcs, x: FloatArray, free: NDArray[np.int64], scale: FloatArray, A: FloatArray) -> float | None:
    """Rise of chi-square one sigma from an estimate, over the rise that its quadratic has, where that is farthest from 1.

    Parameters
    ----------
    arcs
        The whitened arcs of a set.
    x
        (n_parameters,) estimate, SI.
    free, scale
        (n_free,) places of the free parameters, and their typical sigmas, SI.
    A
        (n_free, n_free) information that the estimate claims, in typical sigmas. Steps go both ways along its weakest direction,
        and along every other that is weak.

    Returns
    -------
    The rise, at most `LARGEST_RISE`; None where A determines nothing.
    """
    values, vectors, known = determined(A)
    values, vectors = values[known], vectors[:, known]
    here = normal_equations(arcs, x, free, scale)
    rises = []
    for place in range(max(int((values < WEAK**-2).sum()), min(1, len(values)))):
        for step in (vectors[:, place] / np.sqrt(values[place]), -vectors[:, place] / np.sqrt(values[place])):
            moved = x.copy()
            moved[free] += scale * step
            rise = compute_chi2(arcs, moved) - here.chi2 - 2 * float(here.b @ step)
            rises.append(rise / float(step @ here.A @ step))
    rises = [min(rise, LARGEST_RISE) if np.isfinite(rise) else LARGEST_RISE for rise in rises]
    return max(rises, key=lambda rise: abs(rise - 1.0), default=None)


def is_curved(rise: float | None) -> bool:
    """Whether a rise of chi-square says that a covariance does not hold."""
    return rise is not None and abs(rise - 1.0) > CURVED


#: Share of what a filter knew that is nothing: further frames are like those before, where a direction is seen at all.
FORGOTTEN = 1e-100
Run = tuple[FloatArray, FloatArray, FloatArray]


def further_covariance(
    P: FloatArray, per_frame: FloatArray, frames: int, process_noise: float = 0.0, forgetting_factor: float = 1.0
) -> FloatArray:
    """Covariance after so many further frames.

    Parameters
    ----------
    P
        (n_free, n_free) covariance now, in typical sigmas.
    per_frame
        (n_free, n_free) mean information of a frame.
    frames
        How many more; 0 gives P back.
    process_noise
        Standard deviation added a frame to each free parameter, in typical sigmas.
    forgetting_factor
        Share of the information carried from frame to frame.
    """
    if frames <= 0:
        return P
    if forgetting_factor < 1.0:
        frames = min(frames, math.ceil(math.log(FORGOTTEN) / math.log(forgetting_factor)))
    values, vectors = np.linalg.eigh(per_frame)
    F, C, G = _repeated(_one_step(np.maximum(values, 0.0), process_noise**2, forgetting_factor), frames)
    here = vectors.T @ P @ vectors
    after = np.linalg.solve(np.eye(len(P)) + here * G, here)
    return np.asarray(vectors @ (F[:, None] * after * F + np.diag(C)) @ vectors.T)


def _one_step(a: FloatArray, q2: float, forgetting_factor: float) -> Run:
    """Forget, add noise, take a frame in."""
    damp = 1 / (1 + q2 * a)
    return damp / np.sqrt(forgetting_factor), q2 * damp, a * damp / forgetting_factor


def _joined(one: Run, two: Run) -> Run:
    (F_1, C_1, G_1), (F_2, C_2, G_2) = one, two
    damp = 1 / (1 + C_1 * G_2)
    return F_2 * damp * F_1, F_2 * damp * C_1 * F_2 + C_2, F_1 * damp * G_2 * F_1 + G_1


def _repeated(step: Run, times: int) -> Run:
    """A step taken `times` times, by doubling."""
    nothing = np.zeros_like(step[0])
    whole: Run = (nothing + 1, nothing, nothing)
    while times:
        if times & 1:
            whole = _joined(whole, step)
        step, times = _joined(step, step), times >> 1
    return whole
