"""The cosine of an arc as its error, unweighted: the comparison that E section II-A argues against.

Calibrations that take dot products of star vectors minimise the sum of (cos phi - cos phi_catalogue)^2. To first order

    d cos phi = - sin phi d phi,

so that is the arclength cost with a diagonal factor in the place of R's: D = diag(sigma_0 / sin phi). Long arcs count most though
they are known no better, short ones, which show the local scale, count for nothing, and correlations are left out. sigma_0^2 is the
mean of sin^2 phi (sigma_i^2 + sigma_j^2), which makes the cost chi-square in the mean, as far as a wrong weight can.

The inverse of A = H^T D^-2 H is not the covariance of that estimate. With the arcs' true covariance R = L L^T it is

    P = A^-1 B A^-1,     B = H^T D^-2 R D^-2 H = |L^T D^-2 H|^2,

and no choice of weights beats R's: P >= (H^T R^-1 H)^-1 (Gauss, Markov).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.estimation.arcs import ArcSet

FloatArray = NDArray[np.float64]

#: Frames whose Jacobians are held at once, to bound memory.
CHUNK = 2000


@dataclass(frozen=True)
class Worth:
    """Information (n_free, n_free) of a cosine estimate in typical sigmas: `held`, P^-1, and `claimed`, the naive A."""

    held: FloatArray
    claimed: FloatArray


def unweighted(arcs: ArcSet) -> ArcSet:
    """Put cosine's diagonal factor in the place of R's; takes weighed arcs."""
    sine = np.sin(arcs.phi)
    variance = (arcs.band**2).sum(axis=1)
    band = np.zeros_like(arcs.band)
    band[:, -1] = np.sqrt(np.mean(sine**2 * variance)) / sine
    return replace(arcs, band=band)


def worth(arcs: ArcSet, x: FloatArray, free: NDArray[np.int64], scale: FloatArray) -> Worth:
    """Weigh a cosine estimate at x by the arcs' true covariance.

    Parameters
    ----------
    arcs
        With R's factor; the cosine's is made from it.
    x, free, scale
        As in `batch.normal_equations`.
    """
    flat = unweighted(arcs)
    A, B = np.zeros((2, len(free), len(free)))
    for first in range(0, arcs.n_frames, CHUNK):
        last = min(first + CHUNK, arcs.n_frames)
        part, L = flat.frames(first, last), arcs.frames(first, last).band
        e, H = np.empty(part.n_arcs), np.empty((part.n_arcs, len(free)))
        kernels.whitened_rows(
            part.model, x, part.pitch, part.star_start, part.row_px, part.col_px, part.phi, part.band, free, scale, e, H
        )
        A += H.T @ H
        root = _transposed_product(L, H / part.band[:, -1:])
        B += root.T @ root
    return Worth(A @ np.linalg.pinv(B, rcond=1e-13, hermitian=True) @ A, A)


def _transposed_product(band: FloatArray, G: FloatArray) -> FloatArray:
    """L^T G for the banded factor (n_arcs, 5), whose entries across exposures are zero, and G (n_arcs, n_free)."""
    product = band[:, -1:] * G
    for d in range(1, band.shape[1]):
        product[:-d] += band[d:, -1 - d, None] * G[d:]
    return product
