"""Attitude from star directions: Wahba's problem, and the mean of many rotations.

Attitude of one exposure
------------------------
The rotation C that takes catalogue directions s_i nearest to the measured ones s_d, with weights 1/σ² (Wahba 1965):

    J(C) = 1/2 Σ |s_d - C s_i|² / σ²        B = Σ s_d s_i^T / σ² = U diag(s_1, s_2, s_3) V^T
    C = U diag(1, 1, d) V^T                 d = det U det V = ±1                                  (Markley 1988)

J grows about the weakest axis as (s_2 + d s_3) |θ|²/2: where that vanishes, all stars lie in one direction, or the measured
field is the mirror image of the catalogue's, and there is no attitude. With the isotropic direction error of E
section II-B the error θ of C(θ) = C_estimated C_true^T has the covariance

    P = [Σ (I - s_d s_d^T) / σ²]^-1         (Shuster & Oh 1981)            and 2 J is chi-square with 2 n - 3 degrees of freedom.

Parity
------
With parity -1 the detector's axes are left-handed and no rotation leads to them. The measured (x, y, z) is then taken as the
right-handed (x, -y, z), as the notation page says, and C, P and θ are about the axes of that triad.

Mean rotation
-------------
The mean of rotations q_k with weights w_k minimises Σ w_k |C(q) - C(q_k)|² (Frobenius), so it maximises q^T M q with
M = Σ w_k q_k q_k^T: it is the eigenvector of the largest eigenvalue, blind to the sign of each q_k.
With θ_k the turn from the mean to q_k, the first-order covariance of the mean is Σ w_k² θ_k θ_k^T / (Σ w_k)² times n / (n - 1):
the scatter says how good the mean is, whatever the weights claim.

References
----------
Markley, "Attitude Determination using Vector Observations and the Singular Value Decomposition", J. Astronaut. Sci. 36, 1988.
Shuster & Oh, "Three-axis Attitude Determination from Vector Observations", J. Guidance and Control 4, 1981.
Markley, Cheng, Crassidis, Oshman, "Averaging Quaternions", J. Guidance, Control and Dynamics 30, 2007.

Rotations written three ways: matrix, quaternion, rotation vector; one sense for all of them.

A quaternion q = (x, y, z, w) is Hamilton's, scalar last, and C(q) turns vectors: with v = (x, y, z),

    C(q) s = s + 2 w v × s + 2 v × (v × s)            s_d = C(q) s_i            C(p ⊗ q) = C(p) C(q)

q and -q are one rotation; those made here have w >= 0. A rotation vector θ turns by |θ| about θ, so for a small one

    C(θ) s = s + θ × s.

An attitude error is the θ of C(θ) = C_estimated C_true^T: it stands on the left, and its axes are the detector's.

A library that turns the axes and not the vectors (JPL quaternions) means the conjugate. SciPy's `Rotation.from_quat(q)` has the
sense used here and is what the tests hold these lines against; it is not called, because it refuses a table in which
some attitudes are NaN, and costs 0.4 s to import.

Reference: Markley & Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, 2014, sections 2.7 and 2.9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.blocks import in_blocks
from boresight.kernels import attitude as loops


def to_matrix(q: FloatArray) -> FloatArray:
    """Matrices C(q), (..., 3, 3), of quaternions (..., 4) of any length but zero; NaN stays NaN."""
    q = np.asarray(q, dtype=np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_quaternion(C: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4), w >= 0, of proper rotation matrices (..., 3, 3); NaN stays NaN.

    4 q q^T is linear in C. Its longest column is 4 q times the largest component of q, which is never small (Shepperd).
    """
    C = np.asarray(C, dtype=np.float64)
    outer = np.empty((*C.shape[:-2], 4, 4))
    diagonal = np.diagonal(C, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    outer[..., :3, :3] = C + np.swapaxes(C, -1, -2)
    for k in range(3):
        outer[..., k, k] = 1 + 2 * diagonal[..., k] - trace
        outer[..., k, 3] = outer[..., 3, k] = C[..., k - 1, k - 2] - C[..., k - 2, k - 1]
    outer[..., 3, 3] = 1 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton's product p ⊗ q, (..., 4): q turns first."""
    v, w = p[..., :3], p[..., 3:]
    u, t = q[..., :3], q[..., 3:]
    vector = w * u + t * v + np.cross(v, u)
    return np.concatenate([vector, w * t - np.sum(v * u, axis=-1, keepdims=True)], axis=-1)


def conjugate(q: FloatArray) -> FloatArray:
    """The inverse rotation of unit quaternions (..., 4)."""
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), rad, |θ| <= π, of unit quaternions (..., 4)."""
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., 3:])
    return np.asarray(q[..., :3] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine != 0))


def vector_to_quaternion(theta: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad."""
    half = 0.5 * np.linalg.norm(theta, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * theta, np.cos(half)], axis=-1)


#: Mean square angle off one direction below which stars count as parallel, rad²: 0.2 arcsec, far below any centroid error.
PARALLEL = 1e-12


@dataclass(frozen=True)
class Attitude:
    """Attitude of one exposure.

    Parameters
    ----------
    C
        (3, 3) C_di, ICRS to the right-handed detector triad.
    quaternion
        (4,) the same, x y z w.
    covariance
        (3, 3) of the error θ about the axes of that triad, rad².
    cost
        J: half the weighted sum of squares that is left.
    """

    C: FloatArray
    quaternion: FloatArray
    covariance: FloatArray
    cost: float


@dataclass(frozen=True)
class Attitudes:
    """Attitudes of many exposures; NaN where an exposure gives none.

    Parameters
    ----------
    C
        (n_exposures, 3, 3) C_di.
    covariance
        (n_exposures, 3, 3), rad².
    cost
        (n_exposures,) J.
    """

    C: FloatArray
    covariance: FloatArray
    cost: FloatArray

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which exposures have an attitude, (n_exposures,)."""
        return np.isfinite(self.cost)

    @property
    def quaternion(self) -> FloatArray:
        """(n_exposures, 4) x y z w."""
        return to_quaternion(self.C)


def triad(s_d: FloatArray, parity: int) -> FloatArray:
    """Directions (n, 3) in D as seen from the right-handed detector triad; its own inverse."""
    return np.asarray(s_d * np.array([1.0, float(parity), 1.0]))


def wahba(s_d: FloatArray, s_i: FloatArray, sigma_rad: FloatArray, parity: int = 1) -> Attitude | None:
    """Attitude of one exposure.

    Parameters
    ----------
    s_d
        (n, 3) measured unit directions in D.
    s_i
        (n, 3) unit directions of the same stars, ICRS.
    sigma_rad
        (n,) one-axis direction errors.
    parity
        Of the detector axes, see above.

    Returns
    -------
    The attitude, or None when fewer than two stars point in different directions.
    """
    if len(s_d) < 2:
        return None
    solved = attitudes(np.array([0, len(s_d)]), s_d, s_i, sigma_rad, parity)
    if not solved.known[0]:
        return None
    return Attitude(solved.C[0], solved.quaternion[0], solved.covariance[0], float(solved.cost[0]))


def attitudes(
    star_start: IntArray, s_d: FloatArray, s_i: FloatArray, sigma_rad: FloatArray, parity: int = 1
) -> Attitudes:
    """Attitudes of many exposures at once.

    Parameters
    ----------
    star_start
        (n_exposures + 1,) first star of each exposure, and the end; an exposure may be empty.
    s_d, s_i, sigma_rad
        (n_stars, 3), (n_stars, 3), (n_stars,) as in `wahba`.
    """
    s_d, s_i = np.ascontiguousarray(triad(s_d, parity)), np.ascontiguousarray(s_i)
    weight, n = 1 / sigma_rad**2, len(star_start) - 1
    C, covariance, cost = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty(n)

    def solve(first: int, last: int) -> None:
        stars = slice(int(star_start[first]), int(star_start[last]))
        loops.attitudes(
            star_start[first : last + 1] - stars.start, s_d[stars], s_i[stars], weight[stars], PARALLEL, C[first:last],
            covariance[first:last], cost[first:last],
        )  # fmt: skip

    in_blocks(solve, n)
    return Attitudes(C, covariance, cost)


def mean_rotation(quaternions: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted mean of rotations, a unit quaternion (4,) with w >= 0.

    Parameters
    ----------
    quaternions
        (n, 4) unit quaternions, each of either sign.
    weights
        (n,) not negative, not all zero.
    """
    M = np.einsum("n,ni,nj->ij", weights, quaternions, quaternions)
    q = np.linalg.eigh(M)[1][:, -1]
    return np.asarray(-q if q[3] < 0 else q)


def turns_from(mean: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Rotation vectors θ_k (n, 3), rad, of C(θ_k) = C(q_k) C(mean)^T."""
    return rotation_vector(product(quaternions, conjugate(mean)))
