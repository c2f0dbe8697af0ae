"""Which way loading new parameters turns the reported attitude, and the C_SD that keeps it (end of E section II-C).

Arclengths do not see a bulk rotation, so new parameters may bring one along: the weak directions (m0, a2) and (n0, a1) are
just that. Each exposure k is solved twice with the same stars and weights, under the old parameters x_0 and the new x:

    R_k = C(x) C(x_0)^T = C(θ_k)        R = mean of the R_k (Markley), weighted by 1 / trace(attitude covariance)

R is about the axes of the right-handed detector triad. What the spacecraft uses is C_si = C_sd C_di, and on average it stays
as it was if

    C_sd_new R C_di = C_sd_old C_di        so        C_sd_new = C_sd_old R^T.

Two questions about R have two answers:

- How far does loading these very parameters turn the attitude? The stars differ from frame to frame, so the θ_k scatter and
  their mean is uncertain. Neighbouring frames share stars, so the scatter is taken between the means of `BLOCKS` stretches.
- How far would another calibration of the same sensor have turned it? To this the covariance P of x adds J P J^T. A small
  change ds of the directions turns Wahba's attitude by (Σ (I - s s^T)/σ²)^-1 Σ s × ds/σ², so J is the mean over exposures of

      J_k = [Σ (I - s s^T) / σ²]^-1 Σ s × (ds/dx) / σ².

`sigma` holds both. The rotation is called consistent when the means of both halves of the set agree within the scatter of their
stretches (Hotelling's T² at 99 %): a change that drifts through the set is not nulled by one rotation.

Reference: Markley, Cheng, Crassidis, Oshman, "Averaging Quaternions", J. Guidance, Control and Dynamics 30, 2007 (E [23]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.calibration import Alignment
from boresight.calibration.problem import Problem
from boresight.calibration.result import numbers
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.attitude import (
    attitudes,
    mean_rotation,
    rotation_vector,
    to_matrix,
    to_quaternion,
    triad,
    turns_from,
)
from boresight.estimation.statistics.special import fdtri

#: Stretches of the set between which the scatter of the mean is taken: each holds many frames that share stars.
BLOCKS = 10
#: Confidence of the test that both halves agree.
CONFIDENCE = 0.99
#: Exposures, evenly spread, over which the sensitivity J is averaged; it varies by some percent between them.
EXPOSURES_FOR_SENSITIVITY = 2000
#: A turn within 5 degrees of one axis is named by it.
MOSTLY = float(np.cos(np.radians(5)))
AXES = ("x (the rows axis)", "y (the columns axis)", "z (the boresight)")


@dataclass(frozen=True)
class MeanRotation:
    """The mean rotation from attitudes under old parameters to those under new ones.

    `quaternion`: (4,) R, x y z w. `covariance`: (3, 3) of its rotation vector about the axes of the detector triad, rad²:
    parameters and scatter. `covariance_of_mean`: (3, 3) from the scatter alone. `scatter_rad`: root mean square turn of one
    frame away from the mean. `noise_rad`: the same as centroid noise makes of one attitude, to see the scatter beside.
    `frames`: how many took part. `consistent`: whether both halves of the set agree.
    """

    quaternion: FloatArray
    covariance: FloatArray
    covariance_of_mean: FloatArray
    scatter_rad: float
    noise_rad: float
    frames: int
    consistent: bool

    @property
    def rotation(self) -> FloatArray:
        """(3,) rotation vector of R, rad."""
        return rotation_vector(self.quaternion)

    @property
    def c_sd_update(self) -> FloatArray:
        """(3, 3) R^T: C_sd_new = C_sd_old @ c_sd_update."""
        return to_matrix(self.quaternion).T


def align(problem: Problem, x_0: FloatArray, x: FloatArray, P: FloatArray) -> MeanRotation | None:
    """Compare the attitudes of every exposure under two states.

    `x_0`, `x`: (n_parameters,) old and new state, SI. `P`: (n_parameters, n_parameters) covariance of x, SI; zero rows for
    fixed parameters, NaN where not determined. Returns the alignment; None for fewer than two frames, whose scatter says
    nothing.
    """
    arcs, camera = problem.arcs.whole(), problem.camera
    if arcs.n_frames < 2:
        return None
    sigma = angular_sigma(camera, x_0, arcs)
    old, new = (
        attitudes(
            arcs.star_start,
            camera.directions(state, arcs.row_px, arcs.col_px, arcs.pitch),
            arcs.s_i,
            sigma,
            problem.sensor.parity,
        )
        for state in (x_0, x)
    )
    turns = to_quaternion(new.C @ np.swapaxes(old.C, 1, 2))
    variance = np.trace(new.covariance, axis1=1, axis2=2)
    known = np.isfinite(variance) & old.known
    weights = np.where(known, 1 / np.where(known, variance, 1.0), 0.0)
    mean = mean_rotation(np.where(known[:, None], turns, 0.0), weights)
    theta = np.where(known[:, None], turns_from(mean, turns), 0.0)
    per_frame, frame_weights = _means(theta, weights, arcs.frame_start[:-1])
    of_mean, consistent = _between_blocks(per_frame, frame_weights)
    J = sensitivity(problem, x, sigma)
    return MeanRotation(
        quaternion=mean,
        covariance=of_mean + J @ P @ J.T,
        covariance_of_mean=of_mean,
        scatter_rad=float(np.sqrt(frame_weights @ np.sum(per_frame**2, axis=1) / frame_weights.sum())),
        noise_rad=float(np.sqrt(known.sum() / weights.sum())),
        frames=arcs.n_frames,
        consistent=consistent,
    )


def _means(theta: FloatArray, weights: FloatArray, first: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Weighted means (n_groups, 3) and total weights (n_groups,) of consecutive groups that begin at `first`."""
    total = np.add.reduceat(weights, first)
    sums = np.add.reduceat(weights[:, None] * theta, first, axis=0)
    return sums / np.where(total > 0, total, 1.0)[:, None], total


def _between_blocks(theta: FloatArray, weights: FloatArray) -> tuple[FloatArray, bool]:
    """Covariance (3, 3) of the mean from the scatter of stretches, and whether the halves agree within it."""
    n = min(BLOCKS, len(theta))
    block, total = _means(theta, weights, np.arange(n) * len(theta) // n)
    share = total / total.sum()
    covariance = np.einsum("n,ni,nj->ij", share**2, block, block) * n / (n - 1)
    if n < BLOCKS:
        return covariance, True  # too few stretches to test anything by
    early, late = block[: n // 2], block[n // 2 :]
    dof = n - 2
    pooled = ((early - early.mean(axis=0)).T @ (early - early.mean(axis=0))
              + (late - late.mean(axis=0)).T @ (late - late.mean(axis=0))) / dof  # fmt: skip
    difference = early.mean(axis=0) - late.mean(axis=0)
    t2 = difference @ np.linalg.pinv(pooled, hermitian=True) @ difference / (1 / len(early) + 1 / len(late))
    return covariance, bool(t2 * (dof - 2) / (3 * dof) < fdtri(3, dof - 2, CONFIDENCE))


def sensitivity(problem: Problem, x: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """J (3, n_parameters): how the mean reported attitude turns with each parameter, rad per SI unit.

    `x`: (n_parameters,) state, SI. `sigma_rad`: (n_stars,) direction errors that weigh the stars of an attitude.
    """
    arcs = problem.arcs.whole()
    chosen, starts = _pick_exposures(arcs)
    each, covariance = sensitivity_of_exposures(arcs, chosen, starts, x, sigma_rad[chosen], problem.sensor.parity)
    return np.average(each, axis=0, weights=1 / np.trace(covariance, axis1=1, axis2=2))


def sensitivity_of_exposures(
    arcs: ArcSet, stars: NDArray[np.int64], starts: NDArray[np.int64], x: FloatArray, sigma_rad: FloatArray, parity: int
) -> tuple[FloatArray, FloatArray]:
    """J_k (n_exposures, 3, n_parameters) and covariances (n_exposures, 3, 3) of the attitudes of stars that begin at `starts`."""
    s, ds = arcs.camera.directions_and_jacobian(x, arcs.row_px[stars], arcs.col_px[stars], arcs.pitch)
    s, ds = triad(s, parity), np.swapaxes(triad(np.swapaxes(ds, 1, 2), parity), 1, 2)
    weight = 1 / sigma_rad**2
    across = weight[:, None, None] * (np.eye(3) - s[:, :, None] * s[:, None, :])
    torque = weight[:, None, None] * np.cross(s[:, :, None], ds, axis=1)
    covariance = np.linalg.inv(np.add.reduceat(across, starts, axis=0))
    return covariance @ np.add.reduceat(torque, starts, axis=0), covariance


def _pick_exposures(arcs: ArcSet) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stars of exposures spread evenly over the set, and where each of those exposures begins among them."""
    step = max(1, arcs.n_exposures // EXPOSURES_FOR_SENSITIVITY)
    exposures = np.arange(0, arcs.n_exposures, step)
    stars = [np.arange(arcs.star_start[e], arcs.star_start[e + 1]) for e in exposures]
    return np.concatenate(stars), np.cumsum([0, *(len(run) for run in stars[:-1])])


def alignment_view(problem: Problem, x_0: FloatArray, x: FloatArray, P_si: FloatArray) -> Alignment | None:
    """Return the `alignment` object of the calibration JSON, see `align`; null where that is None.

    Angles are in arcsec about the axes of the right-handed detector triad; `sigma_of_mean_arcsec` belongs to loading these very
    values, `sigma_arcsec` to another calibration as good as this one.
    """
    found = align(problem, x_0, x, P_si)
    if found is None:
        return None
    return Alignment(
        quaternion=numbers(found.quaternion),
        rotation_arcsec=numbers(found.rotation * ARCSEC_PER_RAD),
        sigma_arcsec=numbers(_sigmas(found.covariance)),
        sigma_of_mean_arcsec=numbers(_sigmas(found.covariance_of_mean)),
        frames=found.frames,
        scatter_arcsec=found.scatter_rad * ARCSEC_PER_RAD,
        noise_arcsec=found.noise_rad * ARCSEC_PER_RAD,
        consistent=found.consistent,
        sentence=sentence(found),
        c_sd_update=numbers(found.c_sd_update),
    )


def _sigmas(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(covariance)) * ARCSEC_PER_RAD)


def sentence(found: MeanRotation) -> str:
    """Say how far the attitude turns, about what, how well that is known and what to do about it."""
    angle = float(np.linalg.norm(found.rotation))
    axis = found.rotation / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    by_loading, by_repeating = (
        float(np.sqrt(axis @ P @ axis)) * ARCSEC_PER_RAD for P in (found.covariance_of_mean, found.covariance)
    )
    size = f"{_fixed(angle * ARCSEC_PER_RAD, by_loading)} ± {_fixed(by_loading, by_loading)} arcsec"
    turned = f"Loading these parameters turns the reported attitude by {size}"
    if not found.consistent:
        return (
            f"{turned} {_about(axis)} on average, but the two halves of the set differ: find out why "
            "before you update C_SD."
        )
    if angle * ARCSEC_PER_RAD <= 2 * by_loading:
        return f"{turned}, which is not significant in these data: C_SD can stay unchanged."
    another = ""
    if np.isfinite(by_repeating):
        another = f"; repeated calibrations scatter by {_fixed(by_repeating, by_repeating)} arcsec (one sigma)"
    return (
        f"{turned} {_about(axis)}{another}: right-multiply C_SD by the update to keep the reported attitude unchanged."
    )


def _fixed(value: float, sigma: float) -> str:
    """Write a value to the digits that its sigma supports."""
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6)) if sigma > 0 else 1
    return f"{value:,.{digits}f}"


def _about(axis: FloatArray) -> str:
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) < MOSTLY:
        x, y, z = np.round(axis, 2) + 0.0  # no negative zero
        return f"about ({x:.2f}, {y:.2f}, {z:.2f}) in x, y, z of the detector"
    return f"about {'−' if axis[largest] < 0 else ''}{AXES[largest]}"
