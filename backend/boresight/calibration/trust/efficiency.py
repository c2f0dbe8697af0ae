"""Whether the claimed sigmas are the smallest that these centroids allow.

The bound is `estimation.cramer_rao`'s: centroids with attitude as nuisance, no arcs. A filter knows its start besides, with
covariance s^2 I, so its bound is (information + I / s^2)^-1. Beyond `MOST_FRAMES` the bound is taken on frames spaced evenly:
with the arcs' information of those frames A_t = L_t L_t^T and of all A = L L^T, the information of all is L (L_t^-1 I_t L_t^-T)
L^T.

A ratio over one is information left behind: process noise, forgetting, a robust loss. A ratio under one cannot be had by an
honest estimator: such sigmas are too small. Over all directions together the ratio is (det P / det bound)^(1 / 2n).

A robust fit takes the size of the noise from the residuals, and so does its bound here: their median square over that of a unit
normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.trust.ground import Ground, Unavailable, nested
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cramer_rao import centroid_rows

MOST_FRAMES = 400
#: Ratios within this share of one are one: the isotropic error of an arc's ends is that near to a round pixel error.
NEAR = 0.03
#: Median of the square of a unit normal number.
MEDIAN_OF_A_SQUARE = 0.454936


def efficiency(ground: Ground) -> dict[str, Any]:
    """Claimed sigma over bound, a parameter at a time and over all directions."""
    if not ground.determined:
        raise Unavailable("The data leave a direction of the parameters open, so there is no bound: hold it fixed.")
    arcs = ground.thinned(MOST_FRAMES)
    held = _centroid_information(ground, arcs)
    if ground.settings.sequential:
        held = held + np.eye(len(held)) / ground.settings.initial_sigma_scale**2
    bound, P = np.linalg.inv(held) * _noise(ground), ground.estimate.P
    if not (np.diag(P) > 0).all() or not (np.diag(bound) > 0).all():
        raise np.linalg.LinAlgError("Expected positive variances, received rounding errors")
    ratio = np.sqrt(np.diag(P) / np.diag(bound))
    overall = float(np.exp((np.linalg.slogdet(P)[1] - np.linalg.slogdet(bound)[1]) / (2 * len(P))))
    sigma = np.sqrt(np.diag(bound)) * ground.parameters.scale
    return {
        "names": ground.names,
        "cramer_rao_sigma": dict(zip(ground.names, nested(sigma), strict=True)),
        "ratio": dict(zip(ground.names, nested(ratio), strict=True)),
        "overall_ratio": overall,
        "frames_used": arcs.n_frames,
        "sentence": _sentence(overall, ratio, ground, arcs.n_frames),
    }


def _noise(ground: Ground) -> float:
    """Variance of the residuals over the stated one where the claim follows it, as a robust fit's does; else one."""
    return 1.0 if np.isinf(ground.threshold) else float(np.median(ground.e**2)) / MEDIAN_OF_A_SQUARE


def _centroid_information(ground: Ground, arcs: ArcSet) -> FloatArray:
    """Information of the centroids of all frames, from those of some (see above)."""
    free, scale, x = ground.parameters.free, ground.parameters.scale, ground.x
    held = centroid_rows(ground.problem.camera, x, arcs, free, scale).information
    if arcs.n_frames == ground.arcs.n_frames:
        return held
    L = np.linalg.cholesky(ground.A)
    L_t = np.linalg.cholesky(batch.normal_equations(arcs, x, free, scale).A)
    to_all = L @ np.linalg.inv(L_t)
    return np.asarray(to_all @ held @ to_all.T)


def _sentence(overall: float, ratio: FloatArray, ground: Ground, frames_used: int) -> str:
    """The verdict in words."""
    of = "" if frames_used == ground.arcs.n_frames else f", from {frames_used} frames spaced evenly over the set"
    worst = int(np.argmax(ratio))
    numbers = (
        f"{overall:.3f} times the Cramér-Rao bound over all directions, {ratio[worst]:.3f} for {ground.symbols[worst]}"
    )
    remedy = "; run the batch" if ground.settings.sequential else ""
    if overall < 1 - NEAR:
        return f"The claimed sigmas are {numbers}{of}: less than the centroids allow, so they are too small{remedy}."
    if overall > 1 + NEAR:
        return f"The claimed sigmas are {numbers}{of}: these centroids hold more than the method took from them."
    return f"The claimed sigmas are {numbers}{of}: these centroids hold no more."
