r"""The rotation between two frames that turn together, from their attitudes at the same times.

Let A and B be two frames on one body: two trackers, or a tracker and a reference (gyro, payload, body). A vector of A is turned
into one of B by M = C_ba, so that C_bi = M C_ai at every time. Where B is the sensor frame S, M is C_SD itself.

One pair
--------
At time t_k both attitudes were measured, each with an error on its left (`estimation.attitude`), C = C(θ) C_true. Then

    M_k = C_b,k C_a,k^T = C(θ_b) M C(-θ_a) = C(δ_k) M          δ_k = θ_b,k - M θ_a,k                  to first order.

An attitude's error has two parts. That of its own stars, ε_k with the covariance of Wahba's problem, is new in every exposure. That
of the camera's parameters, J_k δx with J_k = dθ_k/dx, has one δx in all of them: it does not average down. With P = root root^T the
covariance of x, δx = root u with u ~ N(0, I), and with both cameras in one u

    δ_k = Σ_j W_kj ε_j + G_k u          G_k = [-M J_a,k root_a, J_b,k root_b].

Stars tell an attitude only up to what the parameters were fitted to, so ε_k and δx are uncorrelated even where the camera was
calibrated from these very exposures: x comes from what is left of the stars when each attitude is free (its Schur complement).

Times that are not equal
------------------------
The attitudes of one series are carried to the times of the other at a constant rate between two neighbours 1 and 2, at the share s
of their distance (outside of [0, 1] as far as `tolerance_s`). With ψ = log(C_2 C_1^T) and J_l the left Jacobian of SO(3),

    C(t) = C(s ψ) C_1,      θ(t) = W_1 θ_1 + W_2 θ_2,      W_2 = s J_l(s ψ) J_l(ψ)^-1,     W_1 = C(s ψ) - W_2 C(ψ),

where the last holds because J_r(ψ)^-1 = J_l(ψ)^-1 C(ψ). Neighbouring pairs then share an attitude, so that R = cov(Σ W ε) is
banded, not block-diagonal; taking it for block-diagonal claims up to half of the variance. Where an attitude has no neighbour, the
rate is unknown: one within the tolerance is taken as it is with the error (`rate_sigma` Δt)^2 I besides.

Temperature and time
--------------------
M need not be constant: with τ = T - T_0 and t in days about the middle, for the three angles about the axes of B,

    M(T, t) = C(φ) M_0          φ = β_0 + β_1 τ + β_2 τ^2 + ... + γ t.

Which terms the data ask for is told by the fall of chi-square, three degrees of freedom a term, each tested beside what is chosen
already, at `SIGNIFICANCE` shared between the tests (Bonferroni). Where the pairs scatter more than they say the fall is divided by
the scatter and held against F.

Estimate
--------
With D_k = C(φ_k) M_0 the residual is r_k = log(M_k D_k^T), and for a change dφ of the angles

    dr_k = -J_r(r_k)^-1 J_l(φ_k) dφ          J_r(v) = J_l(-v).

Gauss-Newton on β and u with the prior u ~ N(0, I): with X = [E, G], E_k = J_r(r_k)^-1 J_l(φ_k) dφ_k/dβ,

    [X^T R^-1 X + diag(0, I)] (dβ, u) = X^T R^-1 r          covariance of β: its block of the inverse.

This is the least squares over all attitudes, M and both cameras with the attitudes eliminated, to the last digit of the linearised
problem. Its chi-square is r^T R^-1 r + u^T u with 3 K less the number of β degrees of freedom.

To be loaded
------------
Whoever loads these very parameters together with M has the cameras' common error on board as well, and wants the rotation between
the attitudes that are reported, not between the frames: u held at 0. With N = E^T R^-1 E

    β_load = β + N^-1 E^T R^-1 G u          cov = N^-1 + (1/K) mean_k (G_k - G_mean) (C_uu + u u^T) (G_k - G_mean)^T,

the second part because other exposures, with other stars, turn a little otherwise under the same parameters. The two rotations
differ by what the pairs tell of the cameras' error, and their sigmas by far more: (m0, a2) and (n0, a1) turn a frame and leave the
arcs alone.

Clocks
------
Where B's time stamps are late by d, its attitude at a stamp is that of d before, C(-w_k d) C_b with the rate w_k about its axes,
and every residual has -w_k d in it. Beside what was fitted, with N = R^-1 - R^-1 X (X^T R^-1 X + diag(0, I))^-1 X^T R^-1,

    d = -w^T N r / w^T N w          sigma_d^2 = 1 / w^T N w

tells it as far as the rate changes: a body that turns steadily about one axis has w d as a constant, which is the rotation itself.

Outliers
--------
After a fit, r_k has the covariance S_k = R_kk - X_k C X_k^T where the pair took part and R_kk + X_k C X_k^T where it did not (C the
joint covariance), and r_k^T S_k^-1 r_k is chi-square with three degrees of freedom. A pair whose chance, divided by the scatter of
the bulk (the median over that of chi-square, at least 1), is below `FALSE_REMOVAL` / K is left out, until the same pairs stand. It
begins at that pair that lies nearest to half of the others.

References: Markley & Crassidis, "Fundamentals of Spacecraft Attitude Determination and Control", 2014, chapter 6; Barfoot, "State
Estimation for Robotics", 2017, section 7.1 (Jacobians of SO(3)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.estimation.attitude import rotation_vector, to_matrix, to_quaternion, vector_to_quaternion
from boresight.estimation.statistics.special import chdtrc, chdtri, fdtrc

#: Chance of a term that is not there to be taken in, shared between the tests.
SIGNIFICANCE = 0.01
#: Chance that a sound set loses any pair.
FALSE_REMOVAL = 0.01
#: Highest power of the temperature that is chosen by evidence.
HIGHEST_POWER = 2
#: Temperatures and times that lie nearer together tell nothing of their effect.
LEAST_SPREAD_C, LEAST_SPREAD_D = 1.0, 0.5 / 24
#: Fewest pairs with a rate that tell of the clocks, and the share of the rates below which they are as good as steady.
FEWEST_RATES, TOLD_APART = 6, 1e-9
#: Pairs among which the start is looked for.
FOR_START = 200
_ROUNDS, _ITERATIONS, _AT_REST = 12, 20, 1e-9
_COLLINEAR = 1e6
_MEDIAN_3 = float(chdtri(3, 0.5))
SECONDS_PER_DAY = 86_400.0


@dataclass(frozen=True)
class AttitudeSeries:
    """Attitudes of one frame, ICRS to it, at ascending times that differ.

    Parameters
    ----------
    time_s
        (n,) seconds from an epoch that both series have in common.
    C
        (n, 3, 3).
    covariance
        (n, 3, 3) of the errors that are new in every attitude, rad².
    shared
        (n, 3, p) effect of errors that all of them share, for p numbers of N(0, I), rad.
    temperature_c
        (n,), NaN where unknown.
    """

    time_s: FloatArray
    C: FloatArray
    covariance: FloatArray
    shared: FloatArray
    temperature_c: FloatArray

    def __len__(self) -> int:
        """Count the attitudes."""
        return len(self.time_s)


@dataclass(frozen=True)
class PairingRule:
    """How attitudes are paired; seconds, and rad/s for the rate of an attitude without a neighbour."""

    tolerance_s: float = 0.5
    longest_gap_s: float = 10.0
    rate_sigma: float = float(np.radians(0.1))


@dataclass(frozen=True)
class Carried:
    """A series at other times.

    `known`: (m,). `C`: (m, 3, 3). `place`: (m, 2) of the attitudes that each is made of, `W`: (m, 2, 3, 3) their weights.
    `unknown_rad2`: (m,) variance of what an unknown rate leaves. `shared`: (m, 3, p).
    """

    known: BoolArray
    C: FloatArray
    place: IntArray
    W: FloatArray
    unknown_rad2: FloatArray
    temperature_c: FloatArray
    shared: FloatArray


@dataclass(frozen=True)
class Pairs:
    """Rotations from A to B at K times.

    Parameters
    ----------
    time_s
        (K,).
    M
        (K, 3, 3) C_b C_a^T.
    R
        (K, 3, 3) covariance of a pair's own error, rad².
    links
        Covariance (3, 3) between pairs k < l that have an attitude in common, by (k, l).
    G
        (K, 3, p) effect of the shared errors.
    temperature_c
        (K, 2) of A and of B, NaN where unknown.
    offset_s
        (K,) how far the nearest measured attitude of the other series is away.
    place
        (K, 2) of the attitude of A and of B that each pair is made of, the nearer one where it is made of two.
    rate
        (K, 3) of B about its axes, rad/s, by its neighbours or A's; NaN where none is near.
    """

    time_s: FloatArray
    M: FloatArray
    R: FloatArray
    links: dict[tuple[int, int], FloatArray]
    G: FloatArray
    temperature_c: FloatArray
    offset_s: FloatArray
    place: IntArray
    rate: FloatArray

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.time_s)

    def chosen(self, keep: BoolArray) -> Pairs:
        """Return some of the pairs."""
        number = np.cumsum(keep) - 1
        links = {(int(number[k]), int(number[j])): R for (k, j), R in self.links.items() if keep[k] and keep[j]}
        arrays = {
            name: getattr(self, name)[keep]
            for name in ("time_s", "M", "R", "G", "temperature_c", "offset_s", "place", "rate")
        }
        return replace(self, links=links, **arrays)

    @cached_property
    def factor(self) -> tuple[FloatArray, bool]:
        """The banded Cholesky factor of R, for `cho_solve_banded`."""
        from scipy.linalg import cholesky_banded  # noqa: PLC0415 - loaded where pairs are

        width = 3 * max((j - k for k, j in self.links), default=0) + 3
        band = np.zeros((width, 3 * len(self)))
        first = np.array([*range(len(self)), *(k for k, _ in self.links)])
        second = np.array([*range(len(self)), *(j for _, j in self.links)])
        R = np.array([*self.R, *self.links.values()])
        for row in range(3):
            for column in range(3):
                below = 3 * (second - first) + row - column
                band[below[below >= 0], (3 * first + column)[below >= 0]] = R[below >= 0, column, row]
        return cholesky_banded(band, lower=True), True

    def whitened(self, rows: FloatArray) -> FloatArray:
        """R^-1 times rows (K, 3, n)."""
        from scipy.linalg import cho_solve_banded  # noqa: PLC0415 - as above

        return np.asarray(cho_solve_banded(self.factor, rows.reshape(3 * len(self), -1))).reshape(rows.shape)


def skew(v: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of the cross product with v (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)


def left_jacobian(v: FloatArray) -> FloatArray:
    """J_l (..., 3, 3) of rotation vectors (..., 3): C(v + dv) = C(J_l dv) C(v)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    near = angle < 1e-4
    safe = np.where(near, 1.0, angle)
    first = np.where(near, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(near, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    K = skew(v)
    return np.asarray(np.eye(3) + first * K + second * K @ K)


def inverse_left_jacobian(v: FloatArray) -> FloatArray:
    """J_l^-1 (..., 3, 3) of rotation vectors (..., 3) shorter than a full turn."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    near = angle < 1e-3
    half = np.where(near, 1.0, angle) / 2
    second = np.where(near, 1 / 12 + angle**2 / 720, (1 - half / np.tan(half)) / (4 * half**2))
    K = skew(v)
    return np.asarray(np.eye(3) - K / 2 + second * K @ K)


def log_rotation(C: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) of matrices (..., 3, 3)."""
    return rotation_vector(to_quaternion(C))


def exp_rotation(v: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of rotation vectors (..., 3)."""
    return to_matrix(vector_to_quaternion(v))


def carry(series: AttitudeSeries, time_s: FloatArray, rule: PairingRule) -> Carried:
    """Carry a series to other times (m,): interpolated at a constant rate, beyond its neighbours as far as the tolerance."""
    first, second, share, single = _stencils(series.time_s, time_s, rule)
    known = first >= 0
    a, b = np.maximum(first, 0), np.maximum(second, 0)
    C_1, C_2 = series.C[a], series.C[b]
    psi = log_rotation(C_2 @ np.swapaxes(C_1, 1, 2))
    part = share[:, None] * psi
    W_2 = share[:, None, None] * left_jacobian(part) @ inverse_left_jacobian(psi)
    turned = exp_rotation(part)
    W = np.stack([turned - W_2 @ exp_rotation(psi), W_2], axis=1)
    W[single] = np.array([np.eye(3), np.zeros((3, 3))])
    G = np.einsum("mhij,mhjp->mip", W, np.stack([series.shared[a], series.shared[b]], axis=1))
    lone = np.where(single, time_s - series.time_s[a], 0.0)
    T_1, T_2 = series.temperature_c[a], series.temperature_c[b]
    return Carried(
        known=known,
        C=np.where(single[:, None, None], C_1, turned @ C_1),
        place=np.column_stack([a, b]),
        W=W,
        unknown_rad2=(rule.rate_sigma * lone) ** 2,
        temperature_c=np.where(single, T_1, T_1 + share * (T_2 - T_1)),
        shared=G,
    )


def _stencils(
    own: FloatArray, time_s: FloatArray, rule: PairingRule
) -> tuple[IntArray, IntArray, FloatArray, BoolArray]:
    """Which attitudes each time (m,) is made of, at which share of their distance, and where it is one alone; -1: of none."""
    n, m = len(own), len(time_s)
    first, second = np.full(m, -1), np.full(m, -1)
    share, single = np.zeros(m), np.ones(m, np.bool_)
    after = np.clip(np.searchsorted(own, time_s), 0, n - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(own[after] - time_s) <= np.abs(own[before] - time_s), after, before)
    distance = np.abs(own[nearest] - time_s)
    alone = distance <= rule.tolerance_s
    first[alone] = second[alone] = nearest[alone]
    # from the least wanted stencil to the most wanted: a later one replaces an earlier one
    for low, high, inside in ((nearest, nearest + 1, False), (nearest - 1, nearest, False), (before, after, True)):
        here = (low >= 0) & (high < n) & (distance > 0)
        from_, to = np.clip(low, 0, n - 1), np.clip(high, 0, n - 1)
        gap = own[to] - own[from_]
        between = (own[from_] <= time_s) & (time_s <= own[to])
        here &= (gap > 0) & (gap <= rule.longest_gap_s) & (between if inside else alone)
        first[here], second[here], single[here] = from_[here], to[here], False
        share[here] = ((time_s - own[from_]) / np.where(gap > 0, gap, 1.0))[here]
    return first, second, share, single


def make_pairs(a: AttitudeSeries, b: AttitudeSeries, rule: PairingRule = PairingRule()) -> Pairs:
    """Pair the attitudes of two frames, at the times of that which has fewer."""
    times = a.time_s if len(a) <= len(b) else b.time_s
    of_a, of_b = (carry(one, times, rule) for one in (a, b)) if len(a) and len(b) else (None, None)
    p = a.shared.shape[2] + b.shared.shape[2]
    if of_a is None or of_b is None:
        return Pairs(np.empty(0), np.empty((0, 3, 3)), np.empty((0, 3, 3)), {}, np.empty((0, 3, p)), np.empty((0, 2)),
                     np.empty(0), np.empty((0, 2), np.int64), np.empty((0, 3)))  # fmt: skip
    kept = np.flatnonzero(of_a.known & of_b.known)
    M = of_b.C[kept] @ np.swapaxes(of_a.C[kept], 1, 2)
    G = np.concatenate([-M @ of_a.shared[kept], of_b.shared[kept]], axis=2)
    lone = of_a.unknown_rad2[kept] + of_b.unknown_rad2[kept]
    of_b_itself = rates_at(b, times[kept], rule)
    by_a = np.einsum("kij,kj->ki", M, rates_at(a, times[kept], rule))
    R, links = _noise(((of_a, a.covariance, -M), (of_b, b.covariance, np.eye(3))), kept)
    return Pairs(
        time_s=times[kept],
        M=M,
        R=R + lone[:, None, None] * np.eye(3),
        links=links,
        G=G,
        temperature_c=np.column_stack([of_a.temperature_c[kept], of_b.temperature_c[kept]]),
        offset_s=np.maximum(*(np.abs(one.time_s[_nearest(one.time_s, times[kept])] - times[kept]) for one in (a, b))),
        place=np.column_stack([_nearest(one.time_s, times[kept]) for one in (a, b)]),
        rate=np.where(np.isfinite(of_b_itself), of_b_itself, by_a),
    )


def rates_at(series: AttitudeSeries, time_s: FloatArray, rule: PairingRule) -> FloatArray:
    """Rate (m, 3) of a series about its axes at times (m,), rad/s, over both gaps about the nearest attitude; NaN where long."""
    at = _nearest(series.time_s, time_s)
    first, last = np.maximum(at - 1, 0), np.minimum(at + 1, len(series) - 1)
    gap = series.time_s[last] - series.time_s[first]
    known = (gap > 0) & (gap <= 2.0 * rule.longest_gap_s)
    turn = log_rotation(series.C[last] @ np.swapaxes(series.C[first], 1, 2))
    return np.asarray(np.where(known[:, None], turn / np.where(known, gap, 1.0)[:, None], np.nan))


def _nearest(own: FloatArray, time_s: FloatArray) -> IntArray:
    after = np.clip(np.searchsorted(own, time_s), 0, len(own) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(own[after] - time_s) <= np.abs(own[before] - time_s), after, before)


def _noise(
    sides: Sequence[tuple[Carried, FloatArray, FloatArray]], kept: IntArray
) -> tuple[FloatArray, dict[tuple[int, int], FloatArray]]:
    """Covariances of the pairs and between them, from attitudes that each contribute with a weight."""
    R, links = np.zeros((len(kept), 3, 3)), dict[tuple[int, int], FloatArray]()
    for carried, covariance, turn in sides:
        W = np.broadcast_to(turn, (len(kept), 3, 3))[:, None] @ carried.W[kept]
        users: dict[int, list[tuple[int, FloatArray]]] = {}
        for k, (places, weights) in enumerate(zip(carried.place[kept].tolist(), W, strict=True)):
            for place, weight in zip(places, weights, strict=True):
                if weight.any():
                    users.setdefault(place, []).append((k, weight))
        for place, of in users.items():
            for i, (k, left) in enumerate(of):
                R[k] += left @ covariance[place] @ left.T
                for j, right in of[i + 1 :]:
                    links[k, j] = links.get((k, j), 0.0) + left @ covariance[place] @ right.T
    return R, links


Kind = Literal["temperature", "time"]


@dataclass(frozen=True)
class Term:
    """A term of the rotation's angles beside the constant: the `power` of the temperature or of the time."""

    kind: Kind
    power: int

    @property
    def name(self) -> str:
        """Its name in files."""
        return f"{self.kind}-{self.power}" if self.power > 1 else self.kind


#: Every term there may be, by its name in files.
TERMS = {
    one.name: one for one in (*(Term("temperature", power + 1) for power in range(HIGHEST_POWER)), Term("time", 1))
}


@dataclass(frozen=True)
class Variation:
    """What the rotation may depend on: `temperature_c` (K,), NaN where unknown, `t_d` (K,), about `reference_c`, `middle_s`."""

    temperature_c: FloatArray
    t_d: FloatArray
    reference_c: float
    middle_s: float

    def basis(self, terms: Sequence[Term]) -> FloatArray:
        """Return (K, 1 + n_terms): the constant's one, and each term's value."""
        return np.column_stack([np.ones(len(self.t_d)), *(self.evaluate(term) for term in terms)])

    def evaluate(self, term: Term) -> FloatArray:
        """Return a term's value at each pair (K,)."""
        variable = self.temperature_c - self.reference_c if term.kind == "temperature" else self.t_d
        return np.asarray(variable**term.power)

    def can_tell(self, term: Term, beside: Sequence[Term]) -> bool:
        """Whether the pairs tell a term from the constant and from other terms."""
        spread = np.ptp(self.temperature_c) if term.kind == "temperature" else np.ptp(self.t_d)
        least = LEAST_SPREAD_C if term.kind == "temperature" else LEAST_SPREAD_D
        if not spread >= least:  # also where a temperature is unknown
            return False
        columns = self.basis([*beside, term])
        columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)
        return len(columns) > columns.shape[1] and bool(np.linalg.cond(columns) < _COLLINEAR)


def make_variation(pairs: Pairs, temperature_c: FloatArray, reference_c: float | None = None) -> Variation:
    """Return what a rotation may depend on; `temperature_c` (K,) the one that is asked."""
    middle = float(pairs.time_s.min() + pairs.time_s.max()) / 2
    known = temperature_c[np.isfinite(temperature_c)]
    about = (float(known.mean()) if len(known) else 0.0) if reference_c is None else reference_c
    return Variation(temperature_c, (pairs.time_s - middle) / SECONDS_PER_DAY, about, middle)


@dataclass(frozen=True)
class Fit:
    """A rotation fitted to pairs.

    Parameters
    ----------
    M
        (3, 3) at the reference temperature and the middle of the time.
    terms
        What the angles depend on, beside the constant.
    beta
        (1 + n_terms, 3) angles of the constant, which are in M and so 0, and of the terms a unit, rad, about the axes of B.
    covariance
        (3 + 3 n_terms, 3 + 3 n_terms) of beta in that order: noise and shared errors.
    covariance_of_noise
        The same with the shared errors held.
    load, covariance_to_load
        (1 + n_terms, 3) what to add to beta, and (3 + 3 n_terms, 3 + 3 n_terms) the covariance, for whoever loads these parameters.
    residual
        (K, 3) log(M_k D_k^T) of every pair, taking part or not, rad.
    pair_chi2
        (K,) chi-square of each, three degrees of freedom.
    shared
        (p,) estimate of the shared errors.
    chi2, dof
        Of those that take part.
    """

    M: FloatArray
    terms: tuple[Term, ...]
    beta: FloatArray
    covariance: FloatArray
    covariance_of_noise: FloatArray
    load: FloatArray
    covariance_to_load: FloatArray
    residual: FloatArray
    pair_chi2: FloatArray
    shared: FloatArray
    chi2: float
    dof: int

    @property
    def ratio(self) -> float:
        """Chi-square per degree of freedom; 1 where there is none left."""
        return self.chi2 / self.dof if self.dof > 0 else 1.0

    @property
    def covariance_with_misfit(self) -> FloatArray:
        """The covariance with the pairs' own part multiplied by their scatter, where that is over 1 (Birge)."""
        return self.covariance + max(self.ratio - 1.0, 0.0) * self.covariance_of_noise


def residuals(pairs: Pairs, basis: FloatArray, M_0: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals r_k (K, 3) of angles beta (1 + n_terms, 3), and E (K, 3, 3 + 3 n_terms), minus their derivative."""
    phi = basis @ beta
    r = log_rotation(pairs.M @ np.swapaxes(exp_rotation(phi) @ M_0, 1, 2))
    slope = inverse_left_jacobian(-r) @ left_jacobian(phi)
    return r, np.einsum("kij,kt->kitj", slope, basis).reshape(len(r), 3, -1)


def fit(pairs: Pairs, keep: BoolArray, variation: Variation, terms: tuple[Term, ...], start: FloatArray) -> Fit:
    """Fit a rotation with some terms to the pairs that are kept, from a start (3, 3)."""
    taking, basis = pairs.chosen(keep), variation.basis(terms)
    scale = np.maximum(np.abs(basis).max(axis=0), 1e-300)
    scaled, M_0 = basis / scale, start
    beta = np.zeros((basis.shape[1], 3))
    n, p = beta.size, pairs.G.shape[2]
    prior = np.diag(np.r_[np.zeros(n), np.ones(p)])
    for _ in range(_ITERATIONS):
        r, E = residuals(taking, scaled[keep], M_0, beta)
        X = np.concatenate([E, taking.G], axis=2)
        weighted = taking.whitened(np.concatenate([X, r[:, :, None]], axis=2))
        A = np.einsum("kia,kib->ab", X, weighted[:, :, :-1]) + prior
        step, u = np.split(np.linalg.solve(A, np.einsum("kia,ki->a", X, weighted[:, :, -1])), [n])
        C = np.linalg.inv(A)
        beta = beta + step.reshape(beta.shape)
        M_0, beta[0] = exp_rotation(beta[0]) @ M_0, 0.0
        if np.abs(step).max() <= _AT_REST * np.sqrt(np.diag(C)[:n].min()):
            break
    r, E = residuals(pairs, scaled, M_0, beta)
    X = np.concatenate([E, pairs.G], axis=2)
    left = r - pairs.G @ u
    of_fit = left[keep]
    chi2 = float(np.einsum("ki,ki->", of_fit, taking.whitened(of_fit[:, :, None])[:, :, 0]) + u @ u)
    back = np.kron(1 / scale, np.ones(3))
    noise = np.linalg.inv(A[:n, :n])
    G_away = taking.G - taking.G.mean(axis=0)
    others = np.zeros((n, n))
    others[:3, :3] = np.einsum("kip,pq,kjq->ij", G_away, C[n:, n:] + np.outer(u, u), G_away) / len(taking) ** 2
    return Fit(
        M=M_0,
        terms=terms,
        beta=beta / scale[:, None],
        covariance=C[:n, :n] * np.outer(back, back),
        covariance_of_noise=noise * np.outer(back, back),
        load=(noise @ A[:n, n:] @ u).reshape(beta.shape) / scale[:, None],
        covariance_to_load=(noise + others) * np.outer(back, back),
        residual=r,
        pair_chi2=_chi2_of_pairs(pairs.R, X, C, left, keep),
        shared=u,
        chi2=chi2,
        dof=3 * int(keep.sum()) - n,
    )


def _chi2_of_pairs(R: FloatArray, X: FloatArray, C: FloatArray, left: FloatArray, keep: BoolArray) -> FloatArray:
    """Chi-square (K,) of what is left of each pair, by its own covariance."""
    predicted = np.einsum("kia,ab,kjb->kij", X, C, X)
    S = R + np.where(keep, -1.0, 1.0)[:, None, None] * predicted
    # three angles of which the fit took some entirely (a single pair) leave nothing to test
    values, vectors = np.linalg.eigh(S)
    floor = 1e-9 * np.trace(R, axis1=1, axis2=2)[:, None]
    along = np.einsum("kij,ki->kj", vectors, left)
    return np.asarray(np.sum(np.where(values > floor, along**2 / np.where(values > floor, values, 1.0), 0.0), axis=1))


@dataclass(frozen=True)
class TermTest:
    """Whether the pairs ask for a term: fall of chi-square over three degrees of freedom, and its chance without the term."""

    term: Term
    fall: float
    p: float
    needed: bool


@dataclass(frozen=True)
class ClockTest:
    """By how much B's time stamps are later than A's, as far as the rate tells: s, its sigma, and its chance if they are equal.

    `steady_rad_s`: length of the mean rate, at which each second turns the rotation unseen.
    """

    offset_s: float
    sigma_s: float
    p: float
    needed: bool
    steady_rad_s: float


def compare_clocks(pairs: Pairs, keep: BoolArray, variation: Variation, found: Fit) -> ClockTest | None:
    """Test whether the pairs' time stamps are of one clock; None where hardly any rate is known."""
    some = keep & np.isfinite(pairs.rate).all(axis=1)
    if some.sum() < FEWEST_RATES:
        return None
    taking, basis = pairs.chosen(some), variation.basis(found.terms)
    scale = np.maximum(np.abs(basis).max(axis=0), 1e-300)
    r, E = residuals(taking, (basis / scale)[some], found.M, found.beta * scale[:, None])
    X = np.concatenate([E, taking.G], axis=2)
    columns = np.concatenate([X, r[:, :, None], -taking.rate[:, :, None]], axis=2)
    inner = np.einsum("kia,kib->ab", columns, taking.whitened(columns))
    n, p = E.shape[2], taking.G.shape[2]
    inner[n : n + p, n : n + p] += np.eye(p)
    beside = np.linalg.solve(inner[: n + p, : n + p], inner[: n + p, n + p :])
    left = inner[n + p :, n + p :] - inner[n + p :, : n + p] @ beside
    steady = float(np.linalg.norm(taking.rate.mean(axis=0)))
    if left[1, 1] <= TOLD_APART * inner[-1, -1]:
        return ClockTest(0.0, np.inf, 1.0, needed=False, steady_rad_s=steady)
    fall = left[0, 1] ** 2 / left[1, 1]
    scatter = max((found.chi2 - fall) / (found.dof - 1), 1.0) if found.dof > 1 else 1.0
    chance = float(chdtrc(1, fall / scatter))
    sigma = float(np.sqrt(scatter / left[1, 1]))
    return ClockTest(float(left[0, 1] / left[1, 1]), sigma, chance, chance < SIGNIFICANCE / 3, steady)


@dataclass(frozen=True)
class Estimate:
    """A rotation with its terms chosen and its outliers left out.

    `tests`: of every term that could be told, those taken in first; a term that is not in the fit was tested beside it. `keep`,
    `probability`: (K,) which pairs take part, and the chance of so large a chi-square of each. `scatter`: of the bulk, at least 1.
    `clock`: whether the time stamps are of one clock.
    """

    fit: Fit
    keep: BoolArray
    probability: FloatArray
    tests: tuple[TermTest, ...]
    scatter: float
    clock: ClockTest | None = None


def find_start(pairs: Pairs) -> FloatArray:
    """The rotation (3, 3) of that pair that lies nearest to half of the others."""
    some = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), FOR_START)).astype(np.int64))
    M, R = pairs.M[some], pairs.R[some]
    weight = np.linalg.inv(R + R.mean(axis=0))
    medians = []
    for one in M:
        away = log_rotation(M @ one.T)
        medians.append(np.median(np.einsum("ki,kij,kj->k", away, weight, away)))
    return np.asarray(M[int(np.argmin(medians))])


def estimate(
    pairs: Pairs,
    variation: Variation,
    *,
    wanted: tuple[Term, ...] | None = None,
    robust: bool = True,
) -> Estimate:
    """Estimate the rotation; `wanted`: its terms, where evidence does not choose them. At least one pair."""
    if not len(pairs):
        raise ValueError("Expected at least one pair, received 0")
    keep, start, terms = np.ones(len(pairs), np.bool_), find_start(pairs), wanted or ()
    for _ in range(3):
        found, keep, scatter = _settle(pairs, keep, variation, terms, start, robust=robust)
        chosen, tests = (terms, ()) if wanted is not None else choose_terms(pairs, keep, variation, start)
        if chosen == terms:
            break
        terms, start = chosen, found.M
        keep = np.ones(len(pairs), np.bool_)
    else:
        found, keep, scatter = _settle(pairs, keep, variation, terms, start, robust=robust)
    if wanted is not None:
        tests = _tests_beside(pairs, keep, variation, found)
    clock = compare_clocks(pairs, keep, variation, found)
    return Estimate(found, keep, _chances(found.pair_chi2, scatter), tests, scatter, clock)


def _chances(pair_chi2: FloatArray, scatter: float) -> FloatArray:
    return np.array([float(chdtrc(3, one / scatter)) for one in pair_chi2])


def _settle(
    pairs: Pairs, keep: BoolArray, variation: Variation, terms: tuple[Term, ...], start: FloatArray, *, robust: bool
) -> tuple[Fit, BoolArray, float]:
    """Fit and leave out what is too far off, until the same pairs stand."""
    scatter, first = 1.0, True
    for _ in range(_ROUNDS if robust else 1):
        if robust and first:
            keep = _near(pairs, variation, terms, start)
        found = fit(pairs, keep, variation, terms, start)
        first = False
        scatter = max(1.0, float(np.median(found.pair_chi2)) / _MEDIAN_3) if len(pairs) > 2 else 1.0
        again = _chances(found.pair_chi2, scatter) >= FALSE_REMOVAL / len(pairs)
        if not robust or np.array_equal(again, keep) or again.sum() * 3 <= 3 * (1 + len(terms)):
            break
        keep = again
    return found, keep, scatter


def _near(pairs: Pairs, variation: Variation, terms: tuple[Term, ...], start: FloatArray) -> BoolArray:
    """The pairs to begin with: the half that lies nearest to the start; all of few, and all where terms move them apart."""
    if len(pairs) < 8 or terms:
        return _near_terms(pairs, variation, terms, start)
    away = log_rotation(pairs.M @ start.T)
    squares = np.einsum("ki,kij,kj->k", away, np.linalg.inv(pairs.R + pairs.R.mean(axis=0)), away)
    return np.asarray(squares <= np.median(squares))


def _near_terms(pairs: Pairs, variation: Variation, terms: tuple[Term, ...], start: FloatArray) -> BoolArray:
    """The same about angles that depend on something: by least absolute deviations, reweighted."""
    if len(pairs) < 8:
        return np.ones(len(pairs), np.bool_)
    basis = variation.basis(terms)
    basis = basis / np.maximum(np.abs(basis).max(axis=0), 1e-300)
    away = log_rotation(pairs.M @ start.T)
    precision = np.linalg.inv(pairs.R)
    weight = np.ones(len(pairs))
    for _ in range(_ITERATIONS):
        A = np.einsum("k,ka,kij,kb->aibj", weight, basis, precision, basis).reshape(3 * basis.shape[1], -1)
        b = np.einsum("k,ka,kij,kj->ai", weight, basis, precision, away).ravel()
        left = away - basis @ np.linalg.solve(A, b).reshape(basis.shape[1], 3)
        squares = np.einsum("ki,kij,kj->k", left, precision, left)
        weight = 1 / np.sqrt(np.maximum(squares, 0.1))
    return np.asarray(squares <= np.median(squares))


def choose_terms(
    pairs: Pairs, keep: BoolArray, variation: Variation, start: FloatArray
) -> tuple[tuple[Term, ...], tuple[TermTest, ...]]:
    """Take in terms that the pairs ask for, the most telling first; test the rest beside them."""
    terms, taken = tuple[Term, ...](), list[TermTest]()
    current = fit(pairs, keep, variation, terms, start)
    while True:
        tested = [
            (test, after) for test, after in _tested(pairs, keep, variation, current) if test.term.power <= _most(test)
        ]
        best = max(tested, key=lambda one: one[0].fall, default=None)
        if best is None or not best[0].needed:
            return terms, (*taken, *(test for test, _ in _tested(pairs, keep, variation, current)))
        terms, current = best[1].terms, best[1]
        taken.append(best[0])


def _most(test: TermTest) -> int:
    return HIGHEST_POWER if test.term.kind == "temperature" else 1


def _tests_beside(pairs: Pairs, keep: BoolArray, variation: Variation, found: Fit) -> tuple[TermTest, ...]:
    return tuple(test for test, _ in _tested(pairs, keep, variation, found))


def _tested(pairs: Pairs, keep: BoolArray, variation: Variation, before: Fit) -> list[tuple[TermTest, Fit]]:
    """Test the next power of temperature and of time beside a fit."""
    tested = list[tuple[TermTest, Fit]]()
    taking = replace(variation, temperature_c=variation.temperature_c[keep], t_d=variation.t_d[keep])
    kinds: tuple[Kind, ...] = ("temperature", "time")
    for kind in kinds:
        term = Term(kind, 1 + sum(one.kind == kind for one in before.terms))
        if not taking.can_tell(term, before.terms):
            continue
        after = fit(pairs, keep, variation, (*before.terms, term), before.M)
        fall = max(before.chi2 - after.chi2, 0.0)
        ratio = after.ratio
        p = float(fdtrc(3, after.dof, fall / 3 / ratio)) if ratio > 1 and after.dof > 0 else float(chdtrc(3, fall))
        tested.append((TermTest(term, fall, p, p < SIGNIFICANCE / 3), after))
    return tested
