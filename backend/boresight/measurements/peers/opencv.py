"""OpenCV's calibrators on stars: each view a target at distance one, seen from the middle, with a pose to be found.

`sphere`: the stars' directions are points of a unit sphere, the same in all views, and the true translation is zero. `plane`: each
view's stars are projected onto the plane that touches the sphere at their mean, a flat target of its own. Matches are known, every
view has twelve stars. OpenCV has no switch for views that only rotate: a translation is estimated with each.

Rows and columns stand for OpenCV's x and y, which makes its axes the detector's. It starts from the ground calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boresight.arrays import FloatArray
from boresight.measurements.detector_errors import Directions
from boresight.measurements.peers import Answer
from boresight.measurements.views import Views

ITERATIONS, REST = 200, 1e-10


def sphere(views: Views) -> Answer:
    """`calibrateCamera` with points on the unit sphere."""
    return _calibrated(views, views.stars)


def plane(views: Views) -> Answer:
    """`calibrateCamera` with a flat target a view."""
    return _calibrated(views, flat(views.stars))


def flat(stars: FloatArray) -> FloatArray:
    """Project directions (n_views, n, 3) onto each view's tangent plane at their mean: (n_views, n, 3), third coordinate zero."""
    middle = stars.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    across = np.cross(middle, np.eye(3)[np.argmin(np.abs(middle), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([across, np.cross(middle, across), middle], axis=1)
    turned = np.einsum("vak,vnk->vna", axes, stars)
    return np.concatenate([turned[..., :2] / turned[..., 2:], np.zeros_like(turned[..., :1])], axis=-1)


def _guess(views: Views) -> FloatArray:
    """Camera matrix of the ground calibration."""
    f_px = views.sensor.initial[0] / views.sensor.pixel_pitch_m
    m0, n0 = views.camera.principal_point(views.sensor.initial)
    return np.array([[f_px, 0.0, m0], [0.0, f_px, n0], [0.0, 0.0, 1.0]])


def _calibrated(views: Views, targets: FloatArray) -> Answer:
    """Calibrate a pinhole with two radial and two decentring terms."""
    import cv2  # noqa: PLC0415 - an optional peer

    cv2.setNumThreads(1)
    rest = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, ITERATIONS, REST)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    found = cv2.calibrateCameraExtended(
        list(targets.astype(np.float32)), list(views.pixels.astype(np.float32)), (views.sensor.rows, views.sensor.columns),
        _guess(views), np.zeros(5), flags=flags, criteria=rest,
    )  # fmt: skip
    rms_px, K, lens, _, moved, claimed = found[:6]

    def directions(row: FloatArray, col: FloatArray) -> FloatArray:
        ideal = cv2.undistortPoints(
            np.stack([row, col], axis=-1)[:, None], K, lens, criteria=(cv2.TERM_CRITERIA_COUNT, 100, 0)
        )
        return _unit(ideal[:, 0])

    return _answer(views, directions, K, rms_px, {"translation": _typical_length(moved)}, float(claimed[0, 0]))


def fisheye(views: Views) -> Answer:
    """`fisheye.calibrate` with a flat target a view."""
    import cv2  # noqa: PLC0415 - an optional peer

    cv2.setNumThreads(1)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    rest = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, ITERATIONS, REST)
    rms_px, K, lens, _, moved = cv2.fisheye.calibrate(
        list(flat(views.stars)[:, None]), list(views.pixels[:, None]), (views.sensor.rows, views.sensor.columns), _guess(views),
        np.zeros(4), flags=flags, criteria=rest,
    )  # fmt: skip

    def directions(row: FloatArray, col: FloatArray) -> FloatArray:
        return _unit(cv2.fisheye.undistortPoints(np.stack([row, col], axis=-1)[:, None], K, lens)[:, 0])

    return _answer(views, directions, K, rms_px, {"translation": _typical_length(moved)}, None)


def _answer(
    views: Views,
    directions: Directions,
    K: FloatArray,
    rms_px: float,
    notes: dict[str, float | str],
    claimed_px: float | None,
) -> Answer:
    """Dress a camera matrix; OpenCV's RMS is of both axes together."""
    pitch = views.sensor.pixel_pitch_m
    focal_sigma_m = None if claimed_px is None else claimed_px * pitch
    return Answer(directions, float(K[0, 0] * pitch), float(rms_px) / np.sqrt(2), None, None, focal_sigma_m, notes)


def _unit(ideal: FloatArray) -> FloatArray:
    """Directions (n, 3) of ideal coordinates (n, 2)."""
    r = np.column_stack([ideal, np.ones(len(ideal))])
    return np.asarray(r / np.linalg.norm(r, axis=1, keepdims=True))


def _typical_length(moved: Sequence[FloatArray]) -> float:
    """Root mean square of the translations that were found; of a sphere they should be zero, of a plane one."""
    return float(np.sqrt(np.mean(np.sum(np.array(moved).reshape(-1, 3) ** 2, axis=1))))
