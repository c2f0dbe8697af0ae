"""Robust losses: what a false star may say, and what the estimate is worth when it may not say more.

Stars
-----
A false star is one star, not one arc: whitening spreads it over a quarter of the arcs of its exposure. So it is judged where it is
one, by its two residuals r_i across its direction under the attitude of the others. The estimate x and the attitudes solve

    sum_i w(t_i) (dr_i)^T r_i / sigma_i^2 = 0,     t_i^2 = d_i^T V_i^-1 d_i,     V_i = sigma_i^2 I + K_i N_-i K_i^T,

d_i the residual under the weighted attitude of the exposure without star i, N_-i that attitude's covariance, K_i = dr_i / d theta,
with the weight of Tukey's biweight, which falls to nothing at t = c s:

    w(t) = (1 - t^2 / (c s)^2)^2   inside,   0 beyond,        s^2 = median of all t^2 over 2 ln 2.

t is of the deleted star: its own weight is not in it, nor does leverage shrink it, so that t^2 of a good star is chi-square with
2 degrees of freedom whatever the exposure. For given x the weights of an exposure follow from its stars alone: the largest set of
which every two have the catalogue's arc (the vote, which half of the stars cannot break) begins with w = 1, attitude and weights
are taken in turn until they reproduce themselves (`kernels.verification.weigh_stars`). Neither vote nor sums know an order of the
stars.

Minimising sum w_i |r_i|^2 / sigma_i^2 over the attitude is what whitened arcs do with the variances sigma_i^2 / w_i. So a round
is to weigh at x, leave out stars without weight, whiten again, and fit; the fixed point is where x moves by less than
`REST_OF_ROUNDS` of its sigmas and s rests.

The score of a star is psi = w r. With q_i^2 = r_i^T M_i^-1 r_i / sigma_i^2, residual and covariance sigma_i^2 M_i by least squares,

    a = 1/2 E[w^2 q^2],     b = E[w + 1/2 w' t],       P = (a / b^2) (n / (n - p)) (J^T J)^-1,

n the arcs, p the free parameters, J^T J the information of the stars with weight by least squares: E[psi psi^T] = a I and E[d psi
/ d r] = b I for a residual whose two axes are alike (Huber 1981, chapter 6, in two dimensions). a and b are means over these
stars, so P needs neither a Gaussian nor the stated noise. a takes q and not t: the others' weights, which t takes as given, lean
towards the star that is left out, so that t is 3 % small at 12 stars an exposure and 6 % at 5, and so were the sigmas. At c =
5.123 Gaussian noise is served with 95 % of the information.

The price: a redescending loss has several minima, so the start counts. Least squares on stars that were verified or matched is near
enough; it is not from a set with every tenth identity wrong that nobody looked at.

Arcs: Huber
-----------
For comparison: a whitened residual e counts rho(e) = e^2 up to the threshold k and 2 k |e| - k^2 beyond,
so that the pull of one arc on the estimate, psi(e) = max(-k, min(k, e)), is bounded. `batch` minimises the sum by
Levenberg-Marquardt with weights w = psi(e) / e taken at each iterate, for which A = H'^T W H' and b = H'^T psi(e).

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
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet, angular_sigma, whiten
from boresight.estimation.attitude import triad
from boresight.estimation.stored_arcs import Arcs
from boresight.kernels.verification import verify_stars, weigh_stars

#: c of Tukey's biweight: 95 % of the information of Gaussian noise in two dimensions.
TUNING = 5.123
#: Gate of an arc in the vote that the weights of an exposure begin with, in its sigmas.
VOTE_GATE = 4.5
#: Weight below which a star takes no part.
LEAST_WEIGHT = 1e-6
#: Most rounds, and the move in sigmas of the estimate and the change of the scale at which they rest.
MOST_ROUNDS, REST_OF_ROUNDS, SCALE_RESTS = 60, 1e-8, 1e-10


@dataclass(frozen=True)
class StarWeights:
    """How the stars of any part of a set are weighed: parity of the sensor, state x (n_parameters,) SI, scale s, least stars."""

    parity: int
    x: FloatArray
    scale: float
    minimum_stars: int

    def compute_weights(self, block: ArcSet) -> tuple[FloatArray, FloatArray]:
        """Return weights w and t^2 in units of the scale, (n_stars,) each; zero and infinite where there is no attitude."""
        s = triad(block.camera.directions(self.x, block.row_px, block.col_px, block.pitch), self.parity)
        w, t2 = np.empty(block.n_stars), np.empty(block.n_stars)
        sigma = self.scale * angular_sigma(block.camera, self.x, block)
        weigh_stars(block.star_start, s, sigma, block.s_i, VOTE_GATE, TUNING, w, t2)
        return w, t2


def whiten_weighted(arcs: ArcSet, how: StarWeights, *, even: bool = False) -> ArcSet:
    """Leave out stars without weight and whiten the others with sigma^2 / w, or sigma^2 (`even`): for `Arcs.each`."""
    w, _ = how.compute_weights(arcs)
    out = w < LEAST_WEIGHT
    weighted = arcs if even else ArcSet(**{**vars(arcs), "sigma_px": arcs.sigma_px / np.sqrt(np.where(out, 1.0, w))})
    kept, _, _ = weighted.without(arcs.source_row[out], how.minimum_stars)
    return whiten(kept, angular_sigma(kept.camera, how.x, kept))[0]


def whiten_even(arcs: ArcSet, how: StarWeights) -> ArcSet:
    """Leave out stars without weight and whiten the others with their own variances: for `Arcs.each`."""
    return whiten_weighted(arcs, how, even=True)


@dataclass(frozen=True)
class StarEffect:
    """What the weights did: stars, those without weight, and what J^T J is to be multiplied by to be the information."""

    stars: int
    left_out: int
    information_share: float


def measure_scale(arcs: Arcs, how: StarWeights) -> float:
    """Return s at a state, from that of `how`."""
    t2 = np.concatenate(arcs.over_blocks(_statistics_in_block, how))
    t2 = t2[np.isfinite(t2)]
    return how.scale * float(np.sqrt(np.median(t2) / (2 * np.log(2)))) if len(t2) else how.scale


def _statistics_in_block(block: ArcSet, how: StarWeights) -> FloatArray:
    """t^2 of the stars of one block."""
    return how.compute_weights(block)[1]


def measure_star_effect(arcs: Arcs, how: StarWeights, n_free: int) -> StarEffect:
    """Judge the weights at one state; a share of zero where nothing is left over."""
    stars, held, n_arcs, psi, slope = np.sum(arcs.over_blocks(_consistency_in_block, how), axis=0).tolist()
    left_out = int(stars - held)
    if held == 0 or n_arcs <= n_free or slope <= 0:
        return StarEffect(int(stars), left_out, 0.0)
    a, b = psi / held, slope / held
    return StarEffect(int(stars), left_out, b**2 / a * (n_arcs - n_free) / n_arcs)


def _consistency_in_block(block: ArcSet, how: StarWeights) -> FloatArray:
    """Stars, those with weight, their arcs, and the sums of 1/2 w^2 q^2 and w + 1/2 w' t over one block, (5,)."""
    kept = whiten_even(block, how)
    if not kept.n_stars:
        return np.array([block.n_stars, 0.0, 0.0, 0.0, 0.0])
    w, t2 = how.compute_weights(kept)
    psi = 0.5 * np.sum(w**2 * _plain_statistics(kept, how))
    slope = np.sum(w - 2 * t2 / TUNING**2 * np.sqrt(w))
    return np.array([block.n_stars, kept.n_stars, 2 * kept.n_stars - 3 * kept.n_exposures, psi, slope])


def _plain_statistics(arcs: ArcSet, how: StarWeights) -> FloatArray:
    """Return q^2 of each star, (n_stars,): attitudes by least squares, leverage taken out."""
    n = arcs.n_stars
    s = triad(arcs.camera.directions(how.x, arcs.row_px, arcs.col_px, arcs.pitch), how.parity)
    q2, use, voted = np.empty(n), np.empty(n, np.bool_), np.empty(n, np.bool_)
    sigma = angular_sigma(arcs.camera, how.x, arcs)
    verify_stars(arcs.star_start, s, np.empty((n, 3, 0)), sigma, arcs.s_i, np.inf, np.inf, 0.0, use, voted, q2)
    return q2


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
    beyond, squares = kernels.count_beyond(*block.begin_whitened_loop(x), threshold)
    return int(beyond), float(squares)
