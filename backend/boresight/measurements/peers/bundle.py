"""Bundle adjustment by Ceres: eight parameters of the camera and three angles a view, residuals in the tangent plane of each star.

With s(x) the direction that the camera gives a centroid, C(theta) the view's attitude about its start C_0, and T (2, 3) a basis
across the measured direction, the residual of a star is

    e = T (s(x) - exp([theta x]) C_0 s_i) / sigma,     de/dx = T ds/dx / sigma,     de/dtheta = T [p x] / sigma,  p = C s_i

(the derivative by theta at theta = 0, where the angles stay: they are some milliradians). Ceres eliminates the attitudes by
Schur's complement.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from boresight.arrays import FloatArray
from boresight.estimation import arcs as arcsets
from boresight.estimation.attitude import attitudes
from boresight.measurements.peers import Answer
from boresight.measurements.peers.boresight import answer_of
from boresight.measurements.views import Views
from boresight.studies.star_frames import STARS


def ceres(views: Views) -> Answer:
    """Solve by pyceres on one thread with a dense Schur complement."""
    import pyceres  # noqa: PLC0415 - an optional peer

    x_0, scale = views.sensor.initial, views.sensor.typical_sigma
    sigma = arcsets.angular_sigma(views.camera, x_0, views.arcs)
    s_d = views.camera.directions(x_0, views.arcs.row_px, views.arcs.col_px, views.arcs.pitch)
    C_0 = attitudes(views.arcs.star_start, s_d, views.arcs.s_i, sigma, views.sensor.parity).C
    camera, turns = np.zeros(len(x_0)), np.zeros((len(C_0), 3))
    problem, costs = pyceres.Problem(), []
    for view, C in enumerate(C_0):
        stars = slice(view * STARS, (view + 1) * STARS)
        costs.append(_cost(pyceres, views, stars, s_d[stars], views.arcs.s_i[stars] @ C.T, sigma[stars]))
        problem.add_residual_block(costs[-1], None, [camera, turns[view]])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.num_threads, options.max_num_iterations = 1, 50
    options.function_tolerance = options.parameter_tolerance = 1e-12
    options.logging_type = pyceres.LoggingType.SILENT
    summary = pyceres.SolverSummary()
    pyceres.solve(options, problem, summary)
    x = x_0 + camera * scale
    found = answer_of(views, x, _covariance(costs, camera, turns), views.weighed())
    found.notes["status"] = str(summary.termination_type).rpartition(".")[2].lower()
    return found


def _cost(pyceres: Any, views: Views, stars: slice, s_d: FloatArray, s_0: FloatArray, sigma: FloatArray) -> Any:
    """Cost function of one view."""
    across = np.cross(s_d, np.eye(3)[np.argmin(np.abs(s_d), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    T = np.stack([across, np.cross(s_d, across)], axis=1) / sigma[:, None, None]
    row, col, pitch = views.arcs.row_px[stars], views.arcs.col_px[stars], views.arcs.pitch
    x_0, scale = views.sensor.initial, views.sensor.typical_sigma

    class View(pyceres.CostFunction):  # type: ignore[misc] # a class of an untyped library
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(2 * len(row))
            self.set_parameter_block_sizes([len(x_0), 3])

        def rows(self, z: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            """Residuals (2n,) and derivatives (2n, 8), (2n, 3)."""
            s, ds = views.camera.directions_and_jacobian(x_0 + z * scale, row, col, pitch)
            p = s_0 @ Rotation.from_rotvec(theta).as_matrix().T
            turned = np.cross(p[:, None, :], np.eye(3)[None])
            e = np.einsum("nak,nk->na", T, s - p).ravel()
            return e, (T @ (ds * scale)).reshape(len(e), -1), np.einsum("nak,njk->naj", T, turned).reshape(len(e), 3)

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            e, by_camera, by_attitude = self.rows(np.asarray(parameters[0]), np.asarray(parameters[1]))
            residuals[:] = e
            if jacobians is not None:
                for place, found in enumerate((by_camera, by_attitude)):
                    if jacobians[place] is not None:
                        jacobians[place][:] = found.ravel()
            return True

    return View()


def _covariance(costs: list[Any], camera: FloatArray, turns: FloatArray) -> FloatArray:
    """Covariance of the camera in typical sigmas, attitudes eliminated."""
    A = np.zeros((len(camera), len(camera)))
    for cost, theta in zip(costs, turns, strict=True):
        _, J, K = cost.rows(camera, theta)
        A += J.T @ J - J.T @ K @ np.linalg.solve(K.T @ K, K.T @ J)
    return np.asarray(np.linalg.inv(A))
