"""SciPy, NumPy and filterpy on the same whitened arcs and the same Jacobian, one linearisation a frame where they filter."""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.measurements.peers import Answer
from boresight.measurements.peers.boresight import START_SIGMA, answer_of
from boresight.measurements.views import Views
from boresight.studies import peers
from boresight.studies.star_frames import EXPOSURES_A_FRAME, STARS


def prepared(views: Views) -> tuple[peers.EqualExposures, FloatArray, FloatArray]:
    """Whitened exposures, start and typical sigmas."""
    return peers.EqualExposures.of(views.weighed(), STARS), views.sensor.initial, views.sensor.typical_sigma


def scipy_least_squares(views: Views) -> Answer:
    """`scipy.optimize.least_squares` with the analytic Jacobian, batched in NumPy."""
    data, x_0, scale = prepared(views)
    x, evaluations = peers.scipy_fit(data, x_0, scale)
    A, _ = peers.numpy_evaluation(data, x, scale)
    found = answer_of(views, x, np.asarray(np.linalg.inv(A)), views.weighed())
    found.notes["evaluations"] = evaluations
    return found


def numpy_extended(views: Views) -> Answer:
    """Vector extended filter as the textbook has it."""
    data, x_0, scale = prepared(views)
    z, P = np.zeros(len(x_0)), START_SIGMA**2 * np.eye(len(x_0))
    for first in range(0, len(data.phi), EXPOSURES_A_FRAME):
        e, H = data.part(first, first + EXPOSURES_A_FRAME).rows(x_0 + z * scale, scale)
        K = np.linalg.solve(H @ P @ H.T + np.eye(len(e)), H @ P).T
        z, P = z - K @ e, (np.eye(len(z)) - K @ H) @ P
    return answer_of(views, x_0 + z * scale, P, views.weighed())


def filterpy_extended(views: Views) -> Answer:
    """`filterpy.kalman.ExtendedKalmanFilter`: z is zero and Hx the residual, so that its innovation is minus ours."""
    from filterpy.kalman import ExtendedKalmanFilter  # noqa: PLC0415 - an optional peer

    data, x_0, scale = prepared(views)
    n_arcs = EXPOSURES_A_FRAME * data.phi.shape[1]
    filtered = ExtendedKalmanFilter(dim_x=len(x_0), dim_z=n_arcs)
    filtered.x, filtered.P, filtered.R = np.zeros(len(x_0)), START_SIGMA**2 * np.eye(len(x_0)), np.eye(n_arcs)
    nothing = np.zeros(n_arcs)
    for first in range(0, len(data.phi), EXPOSURES_A_FRAME):
        e, H = data.part(first, first + EXPOSURES_A_FRAME).rows(x_0 + filtered.x * scale, scale)
        filtered.update(nothing, lambda _x, H=H: H, lambda _x, e=e: e)
    return answer_of(views, x_0 + filtered.x * scale, filtered.P, views.weighed())


def filterpy_square_root(views: Views) -> Answer:
    """`filterpy.kalman.SquareRootKalmanFilter`, linear: each frame's measurement is H x - e at the state so far."""
    from filterpy.kalman import SquareRootKalmanFilter  # noqa: PLC0415 - an optional peer

    data, x_0, scale = prepared(views)
    n_arcs = EXPOSURES_A_FRAME * data.phi.shape[1]
    filtered = SquareRootKalmanFilter(dim_x=len(x_0), dim_z=n_arcs)
    filtered.x, filtered.P, filtered.R = np.zeros((len(x_0), 1)), START_SIGMA**2 * np.eye(len(x_0)), np.eye(n_arcs)
    for first in range(0, len(data.phi), EXPOSURES_A_FRAME):
        e, H = data.part(first, first + EXPOSURES_A_FRAME).rows(x_0 + filtered.x[:, 0] * scale, scale)
        filtered.H = H
        filtered.update(H @ filtered.x - e[:, None])
    return answer_of(views, x_0 + filtered.x[:, 0] * scale, filtered.P, views.weighed())
