"""Efficiency of the batch and of the square-root filter beside an independent maximum-likelihood fit (part `efficiency`).

For each camera of `CASES` many sets are simulated with its own model: a lens with 0.3 px of decentring, one with a sixth order of
the radius, a wide field. Each set is fitted by the batch, by the square-root filter, and by the maximum-likelihood fit that is
written below in plain NumPy from the cameras' equations, sharing no line with the product: centroids p = P(x, C_e s_i) + noise,
with the attitude C_e of every exposure as a nuisance. Gauss and Newton's steps for parameters and attitudes are

    r = p - P(x, C s)      J = dP/dx      K = dP/dw, w a small rotation of C s          all by complex step

    (J^T J - sum_e E_e N_e E_e^T) dx = J^T r - sum_e E_e N_e K_e^T r      E_e = J_e^T K_e,  N_e = (K_e^T K_e)^-1

summed over exposures e, and w_e = N_e (K_e^T r - E_e^T dx): the attitudes are eliminated one by one (Schur complement). The matrix
on the left at the truth is the Fisher information I of the parameters, and its inverse the Cramer-Rao bound. Told are, per
estimator over all sets with n parameters,

- `rmse_over_bound` = sqrt(mean of e^T I e / n): the root mean square error over the bound, all directions of the parameters
  together, with a 95 % interval by bootstrap over the sets; `worst_parameter` is the same of the worst single one;
- `over_likelihood`: that over the maximum-likelihood fit's on the same sets, with the interval of the pairs. Chance moves both
  alike, so this tells a per cent where the first figure scatters by several;
- `nees`: mean of e^T P^-1 e with the estimator's own P, and the 95 % bounds it keeps if P is honest.

What it does not tell: how either fares from a start so far away that another optimum is nearer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from benchmarks import Report, held
from benchmarks.stars import uniform_field
from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import covariance
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.statistics.consistency import chi_square, nees

Forward = Callable[[Any, Any], tuple[Any, Any]]

#: Most that an estimator may err over the maximum-likelihood fit.
OVER_LIKELIHOOD = 1.05
ITERATIONS, SETTLED = 12, 1e-7
STEP = 1e-30  # of a complex step, which has no rounding
BOOTSTRAP = 2000
START_SIGMA = 10.0
PITCH_M = 2.2e-6


class Centroids(Protocol):
    """What the maximum-likelihood fit needs of a set: centroids and directions (n, 3) by star, exposure after exposure."""

    @property
    def n_exposures(self) -> int:
        """How many exposures."""

    @property
    def star_start(self) -> Any:
        """(n_exposures + 1,) where the stars of each begin."""

    @property
    def s_i(self) -> FloatArray:
        """(n, 3) directions of the stars, turned by attitudes that are nearly right."""

    @property
    def sigma_px(self) -> FloatArray:
        """(n,) of one axis."""

    @property
    def row_px(self) -> FloatArray:
        """(n,) measured."""

    @property
    def col_px(self) -> FloatArray:
        """(n,) measured."""


@dataclass(frozen=True)
class Case:
    """A camera with a truth, and a lens that needs its terms.

    `forward`: directions (n, 3) in D to rows and columns, complex numbers too. `truth`, `typical_sigma`: (n_parameters,) of the
    file. `size`: rows and columns. `stars`: an exposure. `noise_px`: one axis of a centroid.
    """

    camera: str
    shows: str
    forward: Forward
    truth: tuple[float, ...]
    typical_sigma: tuple[float, ...]
    size: tuple[int, int]
    stars: int
    noise_px: float


def brown_conrady(x: Any, s: Any) -> tuple[Any, Any]:
    """OpenCV's camera: X along columns, Y along rows."""
    aspect, f, u0, v0, k1, k2, p1, p2, k3 = x
    X, Y = s[:, 1] / s[:, 2], s[:, 0] / s[:, 2]
    r2 = X**2 + Y**2
    B = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    column = X * B + 2 * p1 * X * Y + p2 * (r2 + 2 * X**2)
    row = Y * B + p1 * (r2 + 2 * Y**2) + 2 * p2 * X * Y
    return v0 + f * row / (aspect * PITCH_M), u0 + f * column / PITCH_M


def kannala_brandt(x: Any, s: Any) -> tuple[Any, Any]:
    """OpenCV's fisheye, by the arc tangent of a ratio that a complex step passes through."""
    aspect, f, u0, v0, k1, k2, k3, k4 = x
    X, Y = s[:, 1] / s[:, 2], s[:, 0] / s[:, 2]
    r = np.sqrt(X**2 + Y**2)
    theta = np.arctan(r)
    rho = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    return v0 + f * rho * (Y / r) / (aspect * PITCH_M), u0 + f * rho * (X / r) / PITCH_M


def inverted_wang_decentred(x: Any, s: Any) -> tuple[Any, Any]:
    """The inverted model solved for the pixel with the slope of the lens without distortion: each turn leaves some per cent."""
    f, m0, n0, b4, b2, a1, a2, g_y, b6, p1, p2 = x
    goal = np.array([s[:, 0] / s[:, 2], s[:, 1] / s[:, 2]])
    u, v = goal * f
    for _ in range(40):
        over = a1 * v + a2 * u + f
        U, V = u * f / over, v * f / over
        rho2 = U**2 + V**2
        B = 1 + b2 * rho2 + b4 * rho2**2 + b6 * rho2**3
        tangents = (
            np.array([B * U + p1 * (rho2 + 2 * U**2) + 2 * p2 * U * V, B * V + p2 * (rho2 + 2 * V**2) + 2 * p1 * U * V])
            / f
        )
        u, v = np.array([u, v]) + f * (goal - tangents)
    return m0 + u / PITCH_M, n0 + v / (g_y * PITCH_M)


CASES: tuple[Case, ...] = (
    Case(
        "brown_conrady", "0.3 px of tangential distortion, a sixth order", brown_conrady,
        (1.0002, 0.01603, 1290.0, 975.0, -0.1, 0.12, 3e-4, -2e-4, 1.0), (2e-4, 8e-6, 10.0, 10.0, 1e-2, 0.3, 1e-3, 1e-3, 4.0),
        (1944, 2592), 20, 0.1,
    ),
    Case(
        "inverted_wang_decentred", "decentring and a sixth order", inverted_wang_decentred,
        (0.01603, 1012.0, 1250.0, 1.4e8, -2.1e3, 2e-3, -1e-3, 1.0004, 3e12, 0.02, -0.015),
        (8e-6, 30.0, 30.0, 1e8, 1e3, 0.01, 0.01, 2e-4, 1e13, 0.1, 0.1), (1944, 2592), 20, 0.1,
    ),
    Case(
        "kannala_brandt", "92 degrees across the diagonal", kannala_brandt,
        (1.0003, 0.00198, 515.0, 508.0, -0.02, 0.008, -0.003, 0.001), (2e-4, 8e-6, 10.0, 10.0, 1e-2, 1e-2, 1e-2, 1e-2),
        (1024, 1024), 20, 0.1,
    ),
)  # fmt: skip
NAMES = tuple(case.camera for case in CASES)


def measure(report: Report, *, sets: int = 200, frames: int = 60, cameras: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """Fit every set of every camera by batch, filter and maximum likelihood."""
    chosen = [case for case in CASES if case.camera in cameras]
    found: dict[str, Any] = {}
    for place, case in enumerate(chosen):
        trials = []
        for seed in range(sets):
            report((place + seed / sets) / len(chosen), f"{case.camera}, set {seed + 1} of {sets}")
            trials.append(trial(case, frames, np.random.default_rng([2018, seed])))
        found[case.camera] = {
            "shows": case.shows,
            "parameters": list(CAMERA_MODELS[case.camera].parameter_names),
            "estimators": summarise(trials),
        }
    limits = {
        f"{camera}, {name}: error over the maximum-likelihood fit's": held(OVER_LIKELIHOOD, one["over_likelihood"])
        for camera, of in found.items()
        for name, one in of["estimators"].items()
        if "over_likelihood" in one
    }
    return {"sets": sets, "frames": frames, "cameras": found, "limits": limits}


@dataclass(frozen=True)
class Trial:
    """One set: information at the truth, and (error, covariance) of each estimator, all in typical sigmas."""

    information: FloatArray
    answers: dict[str, tuple[FloatArray, FloatArray]]


def trial(case: Case, frames: int, rng: np.random.Generator) -> Trial:
    """Simulate one set of one exposure a frame, and fit it."""
    camera, truth, scale = CAMERA_MODELS[case.camera], np.array(case.truth), np.array(case.typical_sigma)
    counts = np.maximum(4, rng.poisson(case.stars, frames))
    field = uniform_field(camera, truth, case.size, PITCH_M, counts, case.noise_px, rng)
    x0, free = truth + 0.3 * scale * rng.normal(size=len(truth)), np.arange(len(truth))
    fitted = batch.fit(_whitened(field, x0), x0, free, scale)
    fitted = batch.fit(_whitened(field, fitted.x), fitted.x, free, scale)
    history = FILTERS["sqrf"](
        _whitened(field, x0), start(x0, len(free), START_SIGMA), free, scale, Tuning(process_noise=0.0)
    )
    x, information, _ = likelihood_fit(case.forward, field, x0)
    at_truth = normal_matrix(case.forward, field, truth, np.broadcast_to(np.eye(3), (frames, 3, 3)))[0]
    return Trial(
        at_truth * np.outer(scale, scale),
        {
            "maximum_likelihood": ((x - truth) / scale, covariance(information * np.outer(scale, scale))),
            "batch": ((fitted.x - truth) / scale, covariance(fitted.A)),
            "sqrf": ((history.last.x - truth) / scale, history.last.P),
        },
    )


def _whitened(field: ArcSet, x: FloatArray) -> ArcSet:
    return arcsets.whiten(field, arcsets.angular_sigma(field.camera, x, field))[0]


def likelihood_fit(forward: Forward, field: Centroids, x0: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Maximum-likelihood parameters (n,) of the file, every attitude a nuisance, their information (n, n), and chi-square."""
    x, C = x0.copy(), np.broadcast_to(np.eye(3), (field.n_exposures, 3, 3)).copy()
    for _ in range(ITERATIONS):
        A, b, N, E, k = normal_matrix(forward, field, x, C)
        dx = np.linalg.solve(A, b)
        x += dx
        w = np.einsum("eij,ej->ei", N, k - np.einsum("eni,n->ei", E, dx))
        C = rotations(w) @ C
        if dx @ A @ dx < SETTLED**2:
            break
    s = np.einsum("nij,nj->ni", np.repeat(C, np.diff(field.star_start), axis=0), field.s_i)
    r = (np.stack([field.row_px, field.col_px]) - np.stack(forward(x, s))) / field.sigma_px
    return x, normal_matrix(forward, field, x, C)[0], float(np.sum(r**2))


def normal_matrix(
    forward: Forward, field: Centroids, x: FloatArray, C: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Reduced normal equations A, b of the parameters, and N, E, K^T r of every exposure; whitened by the centroids' sigma."""
    runs = field.star_start[:-1]
    of = np.repeat(np.arange(field.n_exposures), np.diff(field.star_start))
    s = np.einsum("nij,nj->ni", C[of], field.s_i)
    weight = 1 / field.sigma_px
    r = np.stack([field.row_px, field.col_px], axis=1) - np.stack(forward(x, s), axis=1)
    r *= weight[:, None]
    J, K = np.empty((len(s), 2, len(x))), np.empty((len(s), 2, 3))
    for p in range(len(x)):
        moved = x.astype(complex)
        moved[p] += 1j * STEP
        J[:, :, p] = np.stack(forward(moved, s), axis=1).imag / STEP
    for axis, unit in enumerate(np.eye(3)):
        K[:, :, axis] = np.stack(forward(x, s + 1j * STEP * np.cross(unit, s)), axis=1).imag / STEP
    J, K = J * weight[:, None, None], K * weight[:, None, None]
    N = np.linalg.inv(np.add.reduceat(np.einsum("nai,naj->nij", K, K), runs))
    E = np.add.reduceat(np.einsum("nap,nai->npi", J, K), runs)
    k = np.add.reduceat(np.einsum("nai,na->ni", K, r), runs)
    A = np.einsum("nap,naq->pq", J, J) - np.einsum("epi,eij,eqj->pq", E, N, E)
    b = np.einsum("nap,na->p", J, r) - np.einsum("epi,eij,ej->p", E, N, k)
    return A, b, N, E, k


def rotations(w: FloatArray) -> FloatArray:
    """Rotation matrices (n, 3, 3) of small rotation vectors (n, 3), by Cayley's formula: proper, and right to the second order."""
    a, b, c = w.T / 2
    zero = np.zeros_like(a)
    X = np.array([[zero, -c, b], [c, zero, -a], [-b, a, zero]]).transpose(2, 0, 1)
    return np.asarray(np.linalg.solve(np.eye(3) - X, np.eye(3) + X))


def summarise(trials: list[Trial]) -> dict[str, dict[str, Any]]:
    """What is told of each estimator, see above."""
    n, sets = len(trials[0].information), len(trials)
    bounds = np.array([np.sqrt(np.diag(np.linalg.inv(one.information))) for one in trials])
    drawn = np.random.default_rng(1).integers(0, sets, (BOOTSTRAP, sets))
    squares = {
        name: np.array([nees(one.answers[name][0], covariance(one.information)) for one in trials]) / n
        for name in trials[0].answers
    }
    best = squares["maximum_likelihood"]
    expected = chi_square(float(n * sets), n * sets)
    told: dict[str, dict[str, Any]] = {}
    for name, square in squares.items():
        error = np.array([one.answers[name][0] for one in trials])
        own = float(np.mean([nees(*one.answers[name]) for one in trials]))
        told[name] = {
            "rmse_over_bound": float(np.sqrt(square.mean())),
            "interval": np.quantile(np.sqrt(square[drawn].mean(axis=1)), (0.025, 0.975)).tolist(),
            "worst_parameter": float(np.sqrt(np.mean((error / bounds) ** 2, axis=0)).max()),
            "nees": own,
            "nees_bounds": [n * expected.lower, n * expected.upper],
            "nees_inside": bool(n * expected.lower <= own <= n * expected.upper),
        }
        if name != "maximum_likelihood":
            pairs = np.sqrt(square[drawn].mean(axis=1) / best[drawn].mean(axis=1))
            told[name]["over_likelihood"] = float(np.sqrt(square.mean() / best.mean()))
            told[name]["over_likelihood_interval"] = np.quantile(pairs, (0.025, 0.975)).tolist()
    return told
