"""Results of runs against a reference run: parameters, correlations and the radial curve, in sigmas of the difference.

Results are calibration JSONs of one camera model; numbers are SI. How surely two estimates differ depends on what data they
share. For estimates x_a and x_b of one state from the data A and B, with covariances P_a and P_b and cross-covariance C,

    D = cov(x_a - x_b) = P_a + P_b - C - C^T.

Let both be efficient, so that near the truth x_a = x + P_a s_A with s_A the score of its data, a sum over its independent
exposures with covariance P_a^-1. Scores of different exposures are independent, and the shared ones have the information I_S:

    C = P_a cov(s_A, s_B) P_b = P_a I_S P_b.

- Disjoint data: I_S = 0, so D = P_a + P_b.
- A within B: I_S = P_a^-1, so C = P_b and D = P_a - P_b. It holds also where x_a is unbiased but not efficient, for no
  combination of x_a and x_b may beat x_b (Hausman 1978, Econometrica 46, 1251): the same data by a worse estimator, or by one
  with more free parameters, differ from the better by P_a - P_b.
- The same data by two estimators that are as good: D = 0. What is left between them is not noise but how they got there
  (linearisation, stopping), and no sigma measures it.
- Partly shared: only the shares s_a, s_b of exposures that A and B have in common are known. With every exposure as good as
  any, I_S = s_a P_a^-1 = s_b P_b^-1; between the two, C = (s_a P_b + s_b P_a) / 2, so

      D = (1 - s_b) P_a + (1 - s_a) P_b,

  which is the sum for disjoint data, nothing for equal data, and for nested data of n_a among n_b exposures
  (1 - n_a / n_b) P_a = P_a - P_b again. It is never negative.

D of nested data is a difference of two estimated matrices: its eigenvalues below zero, in units of P_a's sigmas, are put to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray, list_known
from boresight.calibration.calibration import Calibration, Covariance, Numbers
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.statistics.special import chdtrc
from boresight.estimation.statistics.uncertainty import radial_difference

#: Below this share of the larger variance a difference of variances is rounding and linearisation, not noise.
LEAST_SHARE = 0.01
#: Directions whose variance is below this share of the largest, each in its own sigmas, say nothing together.
LEAST_EIGENVALUE = 1e-6


@dataclass(frozen=True)
class SharedData:
    """What two runs' data have in common: the share of each one's exposures that the other has too."""

    share_a: float
    share_b: float

    @property
    def kind(self) -> str:
        """`same`, `inside` (A within B), `around` (B within A), `partly` or `disjoint`."""
        if self.share_a == 0 or self.share_b == 0:
            return "disjoint"
        whole = (self.share_a == 1, self.share_b == 1)
        return {(True, True): "same", (True, False): "inside", (False, True): "around"}.get(whole, "partly")


def covariance_of_difference(P_a: FloatArray, P_b: FloatArray, shared: SharedData) -> FloatArray:
    """Covariance of x_a - x_b.

    `P_a`, `P_b`: (n_parameters, n_parameters) covariances, SI; zero rows for what was not estimated. `shared`: what their data
    have in common. Returns (n_parameters, n_parameters), without negative eigenvalues.
    """
    kind = shared.kind
    if kind == "disjoint":
        return P_a + P_b
    if kind == "partly":
        return np.asarray((1 - shared.share_b) * P_a + (1 - shared.share_a) * P_b)
    scale = np.sqrt(np.maximum(np.diag(P_a), np.diag(P_b)))
    scale = np.where(scale > 0, scale, 1.0)
    Q_a, Q_b = (P / np.outer(scale, scale) for P in (P_a, P_b))
    smaller_is_b = kind == "inside" or (kind == "same" and np.trace(Q_a) >= np.trace(Q_b))
    values, vectors = np.linalg.eigh(Q_a - Q_b if smaller_is_b else Q_b - Q_a)
    D = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(D * np.outer(scale, scale))


def sigma_of_difference(P_a: FloatArray, P_b: FloatArray, D: FloatArray) -> FloatArray:
    """One-sigma of each parameter's difference, (n_parameters,) SI; NaN where what differs is not noise."""
    variance = np.diag(D)
    told = variance > LEAST_SHARE * np.maximum(np.diag(P_a), np.diag(P_b))
    return np.sqrt(np.where(told & (variance > 0), variance, np.nan))


def joint_test(difference: FloatArray, D: FloatArray, sigma: FloatArray) -> tuple[float, int, float] | None:
    """Test all parameters together: d^T D^+ d, chi-square of as many degrees of freedom as D has directions.

    `difference`, `D`: (n_parameters,) x_a - x_b and its covariance, SI. `sigma`: (n_parameters,) of `sigma_of_difference`;
    parameters without one are left out. Returns the statistic, its degrees of freedom and the chance of a larger one if the
    runs had one truth; None where nothing is left.
    """
    told = np.isfinite(sigma)
    if not told.any():
        return None
    z, spread = difference[told] / sigma[told], np.outer(sigma[told], sigma[told])
    values, vectors = np.linalg.eigh(D[np.ix_(told, told)] / spread)
    kept = values > LEAST_EIGENVALUE * values[-1]
    statistic = float(np.sum((vectors.T @ z)[kept] ** 2 / values[kept]))
    dof = int(kept.sum())
    return statistic, dof, float(chdtrc(dof, statistic))


RADII = 121
#: A correlation is shown from here on.
STRONG = 0.5


@dataclass(frozen=True)
class Contrast:
    """One run against the reference; arrays (n_parameters,) in the model's order, SI, NaN where nothing is known.

    `difference`: the run's value minus the reference's. `covariance`: (n_parameters, n_parameters) of the difference. `sigma`:
    of the difference; NaN where what differs is not noise, see `LEAST_SHARE`. `joint`: statistic, degrees of freedom and p of
    all parameters together; None where no difference is noise.
    """

    difference: FloatArray
    covariance: FloatArray
    sigma: FloatArray
    joint: tuple[float, int, float] | None

    @property
    def separation(self) -> FloatArray:
        """The difference in its own sigmas."""
        return np.asarray(self.difference / self.sigma)


def read_values(result: Calibration, names: Sequence[str]) -> FloatArray:
    """Read a result's parameters, (n_parameters,), NaN where it has none."""
    return np.array([result.parameters.get(name) for name in names], dtype=np.float64)


def read_covariance(result: Calibration, names: Sequence[str]) -> FloatArray:
    """Read the covariance to decide by in the model's order, (n_parameters, n_parameters), zero rows for what was held fixed."""
    return _fill_in(result.reliable_covariance, names)


def _fill_in(covariance: Covariance, names: Sequence[str]) -> FloatArray:
    place = [names.index(name) for name in covariance.names]
    P = np.zeros((len(names), len(names)))
    if place:
        P[np.ix_(place, place)] = np.asarray(covariance)
    return P


def contrast(result: Calibration, reference: Calibration, names: Sequence[str], shared: SharedData) -> Contrast:
    """Set one result against another."""
    difference = read_values(result, names) - read_values(reference, names)
    P, P_reference = read_covariance(result, names), read_covariance(reference, names)
    D = covariance_of_difference(P, P_reference, shared)
    sigma = np.where(np.isfinite(difference), sigma_of_difference(P, P_reference, D), np.nan)
    return Contrast(difference, D, sigma, joint_test(difference, D, sigma))


def correlation(result: Calibration, names: Sequence[str]) -> FloatArray:
    """Read a result's correlations, (n_parameters, n_parameters), NaN where a parameter was not estimated."""
    P = _fill_in(result.covariance, names)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(P / np.sqrt(np.outer(np.diag(P), np.diag(P))))


def strong_correlations(
    results: Sequence[Calibration], names: Sequence[str]
) -> list[tuple[str, str, list[float | None]]]:
    """List the pairs of parameters that any run correlates by `STRONG` or more, the strongest first, with a number a run."""
    matrices = np.array([correlation(result, names) for result in results])
    rows, columns = np.triu_indices(len(names), 1)
    pairs = matrices[:, rows, columns]
    strength = np.max(np.abs(np.nan_to_num(pairs)), axis=0)
    chosen = [i for i in np.argsort(-strength, kind="stable") if strength[i] >= STRONG]
    return [(names[rows[i]], names[columns[i]], list_known(pairs[:, i])) for i in chosen]


@dataclass(frozen=True, kw_only=True)
class RadialContrast:
    """Displacement along the radius of one result against another, one-sigma, None for what is not noise.

    `data_radius_px`: of the outermost star that both have seen.
    """

    radius_px: list[float]
    difference_px: Numbers
    sigma_px: Numbers
    difference_arcsec: Numbers
    sigma_arcsec: Numbers
    data_radius_px: float | None


def radial_contrast(
    result: Calibration, reference: Calibration, against: Contrast, detector: tuple[int, int, float]
) -> RadialContrast | None:
    """Displacement along the radius of one result against another; None where a result has none.

    `against`: of the two results. `detector`: rows, columns, and pixel pitch in metres.
    """
    camera = CAMERA_MODELS[result.camera_model]
    x, x_0 = (read_values(one, camera.parameter_names) for one in (result, reference))
    if not (np.isfinite(x).all() and np.isfinite(x_0).all()):
        return None
    row_0, col_0 = camera.principal_point(x_0)
    corner = float(np.hypot(max(row_0, detector[0] - 1 - row_0), max(col_0, detector[1] - 1 - col_0)))
    curve = radial_difference(camera, x, x_0, against.covariance, np.linspace(0, corner, RADII), detector[2])
    known = np.isfinite(against.sigma).any()
    sigma_px, sigma_rad = (values if known else np.full(RADII, np.nan) for values in (curve.sigma_px, curve.sigma_rad))
    reached = [one.radial.data_radius_px if one.radial else None for one in (result, reference)]
    known_px = [radius for radius in reached if radius is not None]
    return RadialContrast(
        radius_px=curve.radius_px.tolist(),
        difference_px=list_known(curve.difference_px),
        sigma_px=list_known(sigma_px),
        difference_arcsec=list_known(curve.difference_rad * ARCSEC_PER_RAD),
        sigma_arcsec=list_known(sigma_rad * ARCSEC_PER_RAD),
        data_radius_px=min(known_px) if len(known_px) == 2 else None,
    )
