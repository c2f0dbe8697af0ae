"""Results of runs against a reference run: parameters, correlations and the radial curve, in sigmas of the difference.

The covariance of a difference needs to know what data the two runs share; `boresight.estimation.statistics.difference` derives it.
Results are calibration JSONs of one camera model; numbers are SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.statistics.difference import (
    SharedData,
    covariance_of_difference,
    joint_test,
    sigma_of_difference,
)
from boresight.estimation.statistics.uncertainty import radial_difference

Result = Mapping[str, Any]

RADII = 121
ARCSEC = float(np.degrees(1.0) * 3600)
#: A correlation is shown from here on.
STRONG = 0.5


@dataclass(frozen=True)
class Contrast:
    """One run against the reference; arrays (n_parameters,) in the model's order, SI, NaN where nothing is known.

    Parameters
    ----------
    difference
        The run's value minus the reference's.
    covariance
        (n_parameters, n_parameters) of the difference.
    sigma
        Of the difference; NaN where what differs is not noise, see `LEAST_SHARE`.
    joint
        Statistic, degrees of freedom and p of all parameters together; None where no difference is noise.
    """

    difference: FloatArray
    covariance: FloatArray
    sigma: FloatArray
    joint: tuple[float, int, float] | None

    @property
    def separation(self) -> FloatArray:
        """The difference in its own sigmas."""
        return np.asarray(self.difference / self.sigma)


def read_values(result: Result, names: Sequence[str]) -> FloatArray:
    """Read a result's parameters, (n_parameters,), NaN where it has none."""
    values = result.get("parameters") or {}
    return np.array([values.get(name) for name in names], dtype=np.float64)


def read_covariance(result: Result, names: Sequence[str]) -> FloatArray:
    """Read a result's covariance in the model's order, (n_parameters, n_parameters), zero rows for what it held fixed."""
    found = result.get("covariance") or {}
    place = [names.index(name) for name in found.get("names") or ()]
    P = np.zeros((len(names), len(names)))
    if place:
        P[np.ix_(place, place)] = np.array(found["matrix"], dtype=np.float64)
    return P


def contrast(result: Result, reference: Result, names: Sequence[str], shared: SharedData) -> Contrast:
    """Set one result against another."""
    difference = read_values(result, names) - read_values(reference, names)
    P, P_reference = read_covariance(result, names), read_covariance(reference, names)
    D = covariance_of_difference(P, P_reference, shared)
    sigma = np.where(np.isfinite(difference), sigma_of_difference(P, P_reference, D), np.nan)
    return Contrast(difference, D, sigma, joint_test(difference, D, sigma))


def correlation(result: Result, names: Sequence[str]) -> FloatArray:
    """Read a result's correlations, (n_parameters, n_parameters), NaN where a parameter was not estimated."""
    P = read_covariance(result, names)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(P / np.sqrt(np.outer(np.diag(P), np.diag(P))))


def strong_correlations(results: Sequence[Result], names: Sequence[str]) -> list[tuple[str, str, list[float | None]]]:
    """List the pairs of parameters that any run correlates by `STRONG` or more, the strongest first, with a number a run."""
    matrices = np.array([correlation(result, names) for result in results])
    rows, columns = np.triu_indices(len(names), 1)
    pairs = matrices[:, rows, columns]
    strength = np.max(np.abs(np.nan_to_num(pairs)), axis=0)
    chosen = [i for i in np.argsort(-strength, kind="stable") if strength[i] >= STRONG]
    return [
        (names[rows[i]], names[columns[i]], [float(v) if np.isfinite(v) else None for v in pairs[:, i]]) for i in chosen
    ]


def radial_contrast(
    result: Result, reference: Result, against: Contrast, detector: tuple[int, int, float]
) -> dict[str, Any] | None:
    """Displacement along the radius of one result against another, with one-sigma; None where a result has none.

    Parameters
    ----------
    against
        Of the two results.
    detector
        Rows, columns, and pixel pitch in metres.

    Returns
    -------
    dict with `radius_px`, `difference_px`, `sigma_px`, `difference_arcsec`, `sigma_arcsec`, lists of one length with null for
    what is not noise, and `data_radius_px`, the outermost star that both have seen.
    """
    camera = CAMERA_MODELS[str(result.get("camera_model"))]
    x, x_0 = (read_values(one, camera.parameter_names) for one in (result, reference))
    if not (np.isfinite(x).all() and np.isfinite(x_0).all()):
        return None
    row_0, col_0 = camera.principal_point(x_0)
    corner = float(np.hypot(max(row_0, detector[0] - 1 - row_0), max(col_0, detector[1] - 1 - col_0)))
    curve = radial_difference(camera, x, x_0, against.covariance, np.linspace(0, corner, RADII), detector[2])
    known = np.isfinite(against.sigma).any()
    sigma_px, sigma_rad = (values if known else np.full(RADII, np.nan) for values in (curve.sigma_px, curve.sigma_rad))
    radials = [one.get("radial") or {} for one in (result, reference)]
    reached = [radial["data_radius_px"] for radial in radials if radial.get("data_radius_px") is not None]
    return {
        "radius_px": _listed(curve.radius_px),
        "difference_px": _listed(curve.difference_px),
        "sigma_px": _listed(sigma_px),
        "difference_arcsec": _listed(curve.difference_rad * ARCSEC),
        "sigma_arcsec": _listed(sigma_rad * ARCSEC),
        "data_radius_px": min(map(float, reached)) if len(reached) == 2 else None,
    }


def _listed(values: FloatArray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
