"""Estimators of others on the same stars, by name: what problem each solves, what it needs, and how many frames it can bear.

Three problems are told apart, since times and errors compare only within one:

- `arcs`: eight parameters from the arclengths between stars with their covariance, Boresight's own problem and camera model;
- `attitudes`: the same eight and three angles of attitude a view as nuisance, bundle adjustment without translations. Its optimum
  is that of the arcs to a part in a thousand of sigma, its work is larger;
- `poses`: a general calibrator, with a translation a view besides and a camera model of its own. Stars have no parallax, so that a
  translation trades with the focal length: another problem, given here because it is the tool at hand.

A peer is a function of the views that returns an `Answer`; libraries of others are imported inside it. Boresight's own two have
everything counted from centroids and directions on.

**Ceres.** With s(x) the direction that the camera gives a centroid, C(theta) the view's attitude about its start C_0, and T (2, 3)
a basis across the measured direction, the residual of a star is

    e = T (s(x) - exp([theta x]) C_0 s_i) / sigma,     de/dx = T ds/dx / sigma,     de/dtheta = T [p x] / sigma,  p = C s_i

(the derivative by theta at theta = 0, where the angles stay: they are some milliradians). Ceres eliminates the attitudes by Schur's
complement.

**OpenCV.** Each view is a target at distance one, seen from the middle, with a pose to be found. `sphere`: the stars' directions
are points of a unit sphere, the same in all views, and the true translation is zero. `plane`: each view's stars are projected onto
the plane that touches the sphere at their mean, a flat target of its own. OpenCV has no switch for views that only rotate: a
translation is estimated with each. Rows and columns stand for its x and y, which makes its axes the detector's.

**tetra3rs.** Each view is solved from nothing but its centroids and brightness, then `calibrate_camera` runs over all the
solutions. Rows and columns stand for its x and y, from the middle of the detector. Its catalogue is Gaia's with Hipparcos for the
brightest; aberration is corrected by its own velocity of the Earth.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import peers
from benchmarks.kernels import START_SIGMA
from benchmarks.stars import EXPOSURES_A_FRAME, STARS, TIME, Views
from boresight.arrays import FloatArray
from boresight.calibration.problem import whiten_at
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.attitude import attitudes
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start

#: Unit directions (n, 3) of pixels (n,), (n,).
Directions = Callable[[FloatArray, FloatArray], FloatArray]

ITERATIONS, REST = 200, 1e-10  # of OpenCV
FIELD_DEG, TIMEOUT_MS = 21.0, 1000  # of tetra3rs


@dataclass(frozen=True)
class Answer:
    """What an estimator says of a set, its camera by what it makes of pixels.

    `rms_px` is the residual of one axis that it is left with or reports. `x` (8,) and `P` (8, 8), in typical sigmas, are in our
    parameters, SI, and None for a camera model of its own; `focal_sigma_m` is what it claims; `notes` are what it says about
    itself.
    """

    directions: Directions
    focal_length_m: float
    rms_px: float | None = None
    x: FloatArray | None = None
    P: FloatArray | None = None
    focal_sigma_m: float | None = None
    notes: dict[str, float | str] = field(default_factory=dict)


def make_answer(views: Views, x: FloatArray, P: FloatArray | None, arcs: ArcSet) -> Answer:
    """Dress an estimate of the eight parameters; the residual is that of the arcs, each of two ends, in pixels."""
    squares = batch.normal_equations(arcs, x, np.arange(len(x)), views.sensor.typical_sigma).sum_of_squares
    n_arcs = 2 * len(arcs.row_px) - 3 * (len(arcs.star_start) - 1)
    per_pixel_rad = np.median(arcsets.angular_sigma(views.camera, x, arcs) / arcs.sigma_px)
    return Answer(
        lambda row, col: views.camera.directions(x, row, col, views.sensor.pixel_pitch_m),
        float(x[0]),
        float(np.sqrt(squares / n_arcs / 2) / per_pixel_rad),
        x,
        P,
        None if P is None else float(np.sqrt(P[0, 0]) * views.sensor.typical_sigma[0]),
    )


def batch_fit(views: Views) -> Answer:
    """Fit by Levenberg-Marquardt, and once more with R at the solution, as a batch calibration does."""
    x, scale = views.sensor.initial, views.sensor.typical_sigma
    arcs = _ordered(views)
    for _ in range(2):
        arcs = whiten_at(arcs, views.camera, x)
        fitted = batch.fit(arcs, x, np.arange(len(x)), scale)
        x = fitted.x
    P = np.asarray(np.linalg.inv(batch.normal_equations(arcs, x, np.arange(len(x)), scale).A))
    return make_answer(views, x, P, arcs)


def square_root(views: Views) -> Answer:
    """Run the iterated square-root filter without process noise, as a sequential calibration does."""
    x, scale = views.sensor.initial, views.sensor.typical_sigma
    arcs = whiten_at(_ordered(views), views.camera, x)
    pooled = pool_start(arcs, START_ARCS_PER_PARAMETER * len(x))
    last = FILTERS["sqrf"](pooled, start(x, len(x), START_SIGMA), np.arange(len(x)), scale, Tuning()).last
    return make_answer(views, last.x, last.P, arcs)


def _ordered(views: Views) -> ArcSet:
    arcsets.order(views.arcs.star_start, views.arcs.s_i)
    return views.arcs


def prepared(views: Views) -> tuple[peers.EqualExposures, FloatArray, FloatArray]:
    """Whitened exposures, start and typical sigmas."""
    return peers.EqualExposures.of(views.whitened(), STARS), views.sensor.initial, views.sensor.typical_sigma


def scipy_least_squares(views: Views) -> Answer:
    """`scipy.optimize.least_squares` with the analytic Jacobian, batched in NumPy."""
    data, x_0, scale = prepared(views)
    x, evaluations = peers.scipy_fit(data, x_0, scale)
    A, _ = peers.numpy_evaluation(data, x, scale)
    found = make_answer(views, x, np.asarray(np.linalg.inv(A)), views.whitened())
    found.notes["evaluations"] = evaluations
    return found


def numpy_extended(views: Views) -> Answer:
    """Vector extended filter as the textbook has it."""
    x, P = peers.numpy_extended_filter(*prepared(views), START_SIGMA)
    return make_answer(views, x, P, views.whitened())


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
    return make_answer(views, x_0 + filtered.x * scale, filtered.P, views.whitened())


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
    return make_answer(views, x_0 + filtered.x[:, 0] * scale, filtered.P, views.whitened())


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
    found = make_answer(views, x, _covariance(costs, camera, turns), views.whitened())
    found.notes["status"] = str(summary.termination_type).rpartition(".")[2].lower()
    return found


def _cost(pyceres: Any, views: Views, stars: slice, s_d: FloatArray, s_0: FloatArray, sigma: FloatArray) -> Any:
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
    f_px = views.sensor.initial[0] / views.sensor.pixel_pitch_m
    m0, n0 = views.camera.principal_point(views.sensor.initial)
    return np.array([[f_px, 0.0, m0], [0.0, f_px, n0], [0.0, 0.0, 1.0]])


def opencv_pinhole(views: Views, targets: FloatArray) -> Answer:
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

    return _opencv_answer(views, directions, K, rms_px, moved, float(claimed[0, 0]))


def opencv_fisheye(views: Views) -> Answer:
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

    return _opencv_answer(views, directions, K, rms_px, moved, None)


def _opencv_answer(
    views: Views,
    directions: Directions,
    K: FloatArray,
    rms_px: float,
    moved: Sequence[FloatArray],
    claimed_px: float | None,
) -> Answer:
    """Dress a camera matrix; OpenCV's RMS is of both axes together, translations of a sphere should be zero, of a plane one."""
    pitch = views.sensor.pixel_pitch_m
    translation = float(np.sqrt(np.mean(np.sum(np.array(moved).reshape(-1, 3) ** 2, axis=1))))
    focal_sigma_m = None if claimed_px is None else claimed_px * pitch
    notes: dict[str, float | str] = {"translation": translation}
    return Answer(directions, float(K[0, 0] * pitch), float(rms_px) / np.sqrt(2), None, None, focal_sigma_m, notes)


def _unit(ideal: FloatArray) -> FloatArray:
    r = np.column_stack([ideal, np.ones(len(ideal))])
    return np.asarray(r / np.linalg.norm(r, axis=1, keepdims=True))


@cache
def _patterns() -> Any:
    """Make the table of patterns: no part of a calibration."""
    import tetra3rs  # noqa: PLC0415 - an optional peer

    return tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=FIELD_DEG)


def tetra3rs_by(views: Views, model: str) -> Answer:
    """Solve every view and calibrate."""
    import tetra3rs  # noqa: PLC0415 - an optional peer

    table, sensor = _patterns(), views.sensor
    middle = np.array([(sensor.rows - 1) / 2, (sensor.columns - 1) / 2])
    velocity = tetra3rs.earth_barycentric_velocity(TIME.astype("datetime64[s]").astype(datetime).replace(tzinfo=UTC))
    ground = tetra3rs.CameraModel(sensor.initial[0] / sensor.pixel_pitch_m, sensor.rows, sensor.columns)
    centroids = [
        [
            tetra3rs.Centroid(place[0], place[1], 10 ** (-0.4 * faint))
            for place, faint in zip(view - middle, magnitude, strict=True)
        ]
        for view, magnitude in zip(views.pixels, views.magnitude, strict=True)
    ]
    given = {"camera_model": ground, "observer_velocity_km_s": velocity, "solve_timeout_ms": TIMEOUT_MS}
    solved = [table.solve_from_centroids(view, **given) for view in centroids]
    found = table.calibrate_camera(
        solved, centroids, image_width=sensor.rows, image_height=sensor.columns, model=model, max_iterations=50
    )
    camera = found.camera_model

    def directions(row: FloatArray, col: FloatArray) -> FloatArray:
        return _unit(np.array([camera.pixel_to_tanplane(*place) for place in np.stack([row, col], axis=-1) - middle]))

    notes: dict[str, float | str] = {
        "views_solved": float(sum(map(bool, solved))),
        "crpix_row_px": float(camera.crpix[0] + middle[0]),
        "crpix_col_px": float(camera.crpix[1] + middle[1]),
    }
    focal_length_m, rms_px = (
        float(camera.focal_length_px * sensor.pixel_pitch_m),
        float(found.rmse_after_px) / np.sqrt(2),
    )
    return Answer(directions, focal_length_m, rms_px, notes=notes)


@dataclass(frozen=True)
class Peer:
    """One estimator: what problem it solves, what is not the same in a sentence, and the most frames it is given.

    `module` and `package` must be installed, as it is imported and as it is named to be installed; empty where nothing is needed.
    """

    estimate: Callable[[Views], Answer]
    title: str
    problem: str
    unfair: str
    module: str = ""
    package: str = ""
    frames: int = 1_000_000

    @property
    def installed(self) -> bool:
        """Whether what it needs is there."""
        return not self.module or importlib.util.find_spec(self.module) is not None


PREPARED = (
    "The order of the stars is Boresight's and not counted; R is Boresight's, inverted as full matrices, and counted."
)
SOLVES_ITSELF = "It finds attitude and matches itself, from its own catalogue, which is counted; no translation."
OPENCV, FILTERPY, TETRA3RS = ("cv2", "opencv-python-headless", 50), ("filterpy", "filterpy"), ("tetra3rs", "tetra3rs")

PEERS: dict[str, Peer] = {
    "boresight_batch": Peer(batch_fit, "Boresight, batch", "arcs", "Ordering the stars and R are counted."),
    "boresight_sqrf": Peer(square_root, "Boresight, square-root filter", "arcs", "Ordering and R are counted."),
    "scipy_least_squares": Peer(scipy_least_squares, "SciPy least_squares", "arcs", PREPARED),
    "numpy_ekf": Peer(numpy_extended, "NumPy, extended filter", "arcs", PREPARED),
    "filterpy_ekf": Peer(filterpy_extended, "filterpy, ExtendedKalmanFilter", "arcs", PREPARED, *FILTERPY),
    "filterpy_sqrf": Peer(filterpy_square_root, "filterpy, SquareRootKalmanFilter", "arcs", PREPARED, *FILTERPY),
    "pyceres": Peer(
        ceres, "Ceres (pyceres)", "attitudes",
        "Three attitude angles a view are estimated besides; the cost is written in Python, analytic, one call a view.",
        "pyceres", "pyceres", 50,
    ),
    "opencv_sphere": Peer(
        lambda views: opencv_pinhole(views, views.stars), "OpenCV calibrateCamera, stars on a unit sphere", "poses",
        "Stars are points at distance one, and a translation a view is estimated besides; its time grows with the square of views.",
        *OPENCV,
    ),
    "opencv_plane": Peer(
        lambda views: opencv_pinhole(views, flat(views.stars)), "OpenCV calibrateCamera, stars on a plane a view", "poses",
        "Each view's stars are a flat target at distance one, and a translation a view is estimated besides.", *OPENCV,
    ),
    "opencv_fisheye": Peer(
        opencv_fisheye, "OpenCV fisheye.calibrate, stars on a plane a view", "poses",
        "As the plane, with an equidistant lens and no decentring.", *OPENCV,
    ),
    "tetra3rs_radial": Peer(
        lambda views: tetra3rs_by(views, "radial"), "tetra3rs calibrate_camera, radial", "poses", SOLVES_ITSELF, *TETRA3RS,
    ),
    "tetra3rs_polynomial": Peer(
        lambda views: tetra3rs_by(views, "polynomial"), "tetra3rs calibrate_camera, polynomial", "poses", SOLVES_ITSELF, *TETRA3RS,
    ),
}  # fmt: skip
