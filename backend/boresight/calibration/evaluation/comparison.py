"""What an estimate by the unweighted cosine error is worth, and what it costs against arclengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.estimation import batch, cosine
from boresight.estimation.stored_arcs import Arcs


@dataclass(frozen=True)
class Compared:
    """A cosine estimate judged by the arcs' true covariance.

    Parameters
    ----------
    A
        (n_free, n_free) the information it has, in typical sigmas.
    chi2
        Whitened sum of squares of the arcs at the estimate.
    remark
        What a person should know, one sentence or two.
    """

    A: FloatArray
    chi2: float
    remark: str


def compared(arcs: Arcs, x: FloatArray, free: NDArray[np.int64], scale: FloatArray) -> Compared | None:
    """Judge the cosine estimate x (n_parameters,) of weighed arcs; None where the model cannot be evaluated."""
    best = batch.normal_equations(arcs, x, free, scale)
    if not best.finite():
        return None
    worth = cosine.compute_information(arcs, x, free, scale)
    sigma, claimed, of_arcs = (batch.sigma_in_scale(A) for A in (worth.held, worth.claimed, best.A))
    known = np.isfinite(sigma) & np.isfinite(claimed) & np.isfinite(of_arcs)
    return Compared(worth.held, best.chi2, _remark(sigma[known], claimed[known], of_arcs[known]))


def _remark(sigma: FloatArray, claimed: FloatArray, of_arcs: FloatArray) -> str:
    """Say by how much the fit's own sigmas would mislead, and how much better arclengths do."""
    opening = "The unweighted cosine error is here for comparison, and sigmas from its own sum of squares are not valid"
    if not len(sigma):
        return f"{opening}."
    ratio = sigma / claimed
    cost = np.exp(np.mean(np.log(sigma / of_arcs)))
    return (
        f"{opening}: the true ones, which stand here, are {ratio.min():.2f} to {ratio.max():.2f} times as large. From the same "
        f"data arclengths with their covariance give sigmas {cost:.2f} times smaller: decide by those."
    )
