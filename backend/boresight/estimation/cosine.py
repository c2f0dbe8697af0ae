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
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.stored_arcs import Arcs


@dataclass(frozen=True)
class CosineInformation:
    """Information (n_free, n_free) of a cosine estimate in typical sigmas: `held`, P^-1, and `claimed`, the naive A."""

    held: FloatArray
    claimed: FloatArray


def unweighted(arcs: Arcs) -> Arcs:
    """Put cosine's diagonal factor in the place of R's; takes whitened arcs."""
    return arcs.each(_flat, _sigma_0(arcs))


def _sigma_0(arcs: Arcs) -> float:
    """Factor that makes the cost chi-square in the mean."""
    total = 0.0
    for of_block in arcs.over_blocks(_variance_in_block):
        total += of_block
    return float(np.sqrt(total / arcs.n_arcs))


def _variance_in_block(block: ArcSet) -> float:
    """Sum sin^2 phi (sigma_i^2 + sigma_j^2) over the arcs of one block."""
    return float(np.sum(np.sin(block.phi) ** 2 * (block.band**2).sum(axis=1)))


def _flat(arcs: ArcSet, sigma_0: float) -> ArcSet:
    """Put sigma_0 / sin phi in the place of R's factor."""
    band = np.zeros_like(arcs.band)
    band[:, -1] = sigma_0 / np.sin(arcs.phi)
    return replace(arcs, band=band)


def compute_information(arcs: Arcs, x: FloatArray, free: NDArray[np.int64], scale: FloatArray) -> CosineInformation:
    """Weigh a cosine estimate at x by the arcs' true covariance.

    Parameters
    ----------
    arcs
        With R's factor; the cosine's is made from it.
    x, free, scale
        As in `batch.normal_equations`.
    """
    sigma_0 = _sigma_0(arcs)
    A, B = np.zeros((2, len(free), len(free)))
    for claimed, spread in arcs.over_blocks(_worth_of_block, x, free, scale, sigma_0):
        A += claimed
        B += spread
    return CosineInformation(A @ np.linalg.pinv(B, rcond=1e-13, hermitian=True) @ A, A)


def _worth_of_block(
    block: ArcSet, x: FloatArray, free: NDArray[np.int64], scale: FloatArray, sigma_0: float
) -> tuple[FloatArray, FloatArray]:
    """A and B of one block."""
    part = _flat(block, sigma_0)
    e, H = np.empty(part.n_arcs), np.empty((part.n_arcs, len(free)))
    kernels.whitened_rows(
        part.camera.kind,
        x,
        part.pitch,
        part.star_start,
        part.row_px,
        part.col_px,
        part.phi,
        part.band,
        free,
        scale,
        e,
        H,
    )
    root = _transposed_product(block.band, H / part.band[:, -1:])
    return H.T @ H, root.T @ root


def _transposed_product(band: FloatArray, G: FloatArray) -> FloatArray:
    """L^T G for the banded factor (n_arcs, 5), whose entries across exposures are zero, and G (n_arcs, n_free)."""
    product = band[:, -1:] * G
    for d in range(1, band.shape[1]):
        product[:-d] += band[d:, -1 - d, None] * G[d:]
    return product
