"""Huber's loss: what a false star may say, and what the estimate is worth when it may not say more.

A whitened residual e counts rho(e) = e^2 up to the threshold k and 2 k |e| - k^2 beyond, so that the pull of one arc on the
estimate, psi(e) = max(-k, min(k, e)), is bounded. `batch` minimises the sum by Levenberg-Marquardt with weights w = psi(e) / e
taken at each iterate, for which A = H'^T W H' and b = H'^T psi(e).

Neither A nor H'^T H' is the information of such an estimate. With n arcs, p free parameters, m the share of arcs inside k, and the
arcs' distribution free of assumptions but symmetry (Huber 1981, Eqs 7.6.5 and 7.6.6)::

    P = K^2  (sum psi^2 / (n - p)) / m^2  (H'^T H')^-1,        K = 1 + (p / n) (1 - m) / m

At k = 1.345 and Gaussian noise of the stated size this widens every sigma by 2.6 %, the price of the insurance: m = 0.82 there, for
a residual beyond k is no false star yet.

References
----------
Huber, "Robust Statistics", Wiley 1981, chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.estimation.arcs import ArcSet
from boresight.estimation.stored_arcs import Arcs


@dataclass(frozen=True)
class HuberEffect:
    """What the loss did at one state.

    Parameters
    ----------
    beyond
        Arcs whose residual is beyond the threshold.
    information_share
        What H'^T H' is to be multiplied by to be the information of the estimate.
    """

    beyond: int
    information_share: float


def measure_huber_effect(arcs: Arcs, x: NDArray[np.float64], n_free: int, threshold: float) -> HuberEffect:
    """Judge the loss at state x; a share of zero where every arc is beyond the threshold or none is left over."""
    parts = arcs.over_blocks(_beyond_in_block, x, threshold)
    beyond, squares = sum(count for count, _ in parts), sum(total for _, total in parts)
    n = arcs.n_arcs
    inside = 1 - beyond / n
    if inside == 0 or n <= n_free:
        return HuberEffect(beyond, 0.0)
    K = 1 + n_free / n * (1 - inside) / inside
    return HuberEffect(beyond, float(inside**2 * (n - n_free) / (squares * K**2)))


def _beyond_in_block(block: ArcSet, x: NDArray[np.float64], threshold: float) -> tuple[int, float]:
    """Count the arcs of one block beyond the threshold, and sum psi^2."""
    beyond, squares = kernels.count_beyond(
        block.camera.kind,
        x,
        block.pitch,
        block.star_start,
        block.row_px,
        block.col_px,
        block.phi,
        block.band,
        threshold,
    )
    return int(beyond), float(squares)
