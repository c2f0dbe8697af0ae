"""The contract's calibration JSON, `boresight.calibration/1`: every number beside how far it can be trusted.

Numbers are SI in parameter order; null stands where a number was not estimated or cannot be known, never NaN.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np

from boresight import __version__
from boresight.arrays import FloatArray
from boresight.calibration.advice import advice, too_few
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.robust import robust_view
from boresight.calibration.views import coverage_view, history_view, radial_view, trace_view
from boresight.estimation.batch import sigma_in_scale
from boresight.estimation.consistency import ChiSquare, chi_square
from boresight.estimation.metrics import tail_rms
from boresight.estimation.observability import observability
from boresight.estimation.stored_arcs import Arcs

SCHEMA = "boresight.calibration/1"


def numbers(values: FloatArray) -> list[Any]:
    """Turn an array into nested lists with null for what is not finite."""
    if values.ndim > 1:
        return [numbers(row) for row in values]
    return [float(value) if np.isfinite(value) else None for value in values]


def header(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, sha256s: Mapping[str, str]
) -> dict[str, Any]:
    """Everything that is known before estimating."""
    sensor, camera = problem.sensor, problem.camera
    names = camera.parameter_names
    return {
        "schema": SCHEMA,
        "sensor": sensor.name,
        "method": settings.method,
        "variant": settings.variant if settings.sequential else None,
        "camera_model": camera.name,
        "parameter_names": list(names),  # a store may sort the keys of the objects below
        "free": [names[p] for p in parameters.free],
        "initial": dict(zip(names, numbers(sensor.initial), strict=True)),
        "typical_sigma": dict(zip(names, numbers(sensor.typical_sigma), strict=True)),
        "units": dict(zip(names, camera.units, strict=True)),
        "symbols": dict(zip(names, camera.symbols, strict=True)),
        "truth": None,
        "frames": problem.arcs.n_frames,
        "exposures": problem.arcs.n_exposures,
        "stars": problem.arcs.n_stars,
        "pairs": 2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures,
        "frames_in_set": problem.frames_in_set,
        "left_out": [vars(item) for item in problem.left_out],
        "inputs": {
            "sha256s": dict(sha256s),
            "versions": dict(_versions()),
            "settings": settings.document(),
        },
    }


@cache
def _versions() -> dict[str, str]:
    """What computes here; asking the installed packages takes as long as a short fit."""
    return {name: version(name) for name in ("numpy", "numba", "scipy", "pyerfa")} | {
        "boresight": __version__,
        "python": platform.python_version(),
    }


def document(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    sha256s: Mapping[str, str],
) -> dict[str, Any]:
    """Write an estimate, finished or on its way, as the contract's JSON; `validation` and `timing_s` come from the caller."""
    arcs = problem.weighed(estimate.x)
    initial, final = tail_rms(arcs, np.stack([problem.sensor.initial, estimate.x]))
    sigma = _sigma(problem, parameters, estimate)
    return {
        **header(problem, parameters, settings, sha256s),
        **_estimated(problem, parameters, estimate, sigma),
        **_judged(problem, parameters, settings, estimate, arcs),
        "rms_arc_rad": {"initial": float(initial), "final": _finite(float(final))},
        "robust": None
        if estimate.robust is None
        else robust_view(estimate.robust, problem.camera.parameter_names, sigma),
        "validation": None,
        **_not_yet(),
        "history": history_view(problem, parameters, estimate, arcs),
        "trace": trace_view(parameters, estimate, arcs.n_arcs, problem),
        "radial": radial_view(problem, parameters, estimate, sigma),
        "coverage": coverage_view(problem),
        "timing_s": {},
    }


def _not_yet() -> dict[str, Any]:
    """What `judgement` fills in when the estimate has ended."""
    return {
        "judged_on": None,
        "evaluation": None,
        "matching": None,
        "alignment": None,
        "frame_observability": None,
        "trust": None,
        "shadow": {"calibration": None, "validation": None},
    }


def _finite(value: float) -> float | None:
    """Return a number, or null."""
    return value if np.isfinite(value) else None


def _sigma(problem: Problem, parameters: Parameters, estimate: Estimate) -> FloatArray:
    """(n_parameters,) one-sigma in SI, NaN where not estimated or not determined."""
    sigma = np.full(len(problem.camera.parameter_names), np.nan)
    in_scale = np.sqrt(np.diag(estimate.P))
    if np.isfinite(estimate.A).all():
        in_scale = np.where(np.isfinite(sigma_in_scale(estimate.A)), in_scale, np.nan)
    sigma[parameters.free] = np.where(estimate.status == "diverged", np.nan, parameters.scale * in_scale)
    return sigma


def _estimated(problem: Problem, parameters: Parameters, estimate: Estimate, sigma: FloatArray) -> dict[str, Any]:
    """Parameters with sigma, covariance and shift."""
    names = problem.camera.parameter_names
    known = np.isfinite(sigma[parameters.free])
    P = parameters.covariance(estimate.P)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = (estimate.x - problem.sensor.initial) / sigma
    return {
        "parameters": dict(zip(names, numbers(estimate.x), strict=True)),
        "sigma": dict(zip(names, numbers(sigma), strict=True)),
        "delta_over_sigma": dict(zip(names, numbers(shift), strict=True)),
        "covariance": {
            "names": [names[p] for p in parameters.free[known]],
            "matrix": numbers(P[np.ix_(known, known)]),
        },
        "status": estimate.status,
        "iterations": estimate.iterations,
    }


def _judged(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate, arcs: Arcs
) -> dict[str, Any]:
    """Chi-square, innovations, observability and advice; nulls while the estimate is on its way."""
    dof = arcs.n_arcs - len(parameters.free)
    if estimate.status == "running" or not np.isfinite(estimate.A).all() or dof <= 0:
        unknown = {"chi2_per_dof": None, "chi2": None, "nis": _innovations_so_far(estimate), "observability": None}
        return {**unknown, "advice": _unjudged(estimate, dof)}
    fit = chi_square(estimate.chi2, dof)
    nis = _innovations(estimate) or fit
    names = [problem.camera.parameter_names[p] for p in parameters.free]
    symbols = [problem.camera.symbols[p] for p in parameters.free]
    observed = observability(estimate.A, tuple(names), tuple(symbols))
    weakest = len(names) - 1
    return {
        "chi2_per_dof": fit.mean,
        "chi2": {"value": estimate.chi2, **_bounds(fit)},
        "nis": {"mean": nis.mean, **_bounds(nis)},
        "observability": {
            "parameter_names": names,
            "singular_values": numbers(observed.singular_values),
            "condition_number": observed.condition_number,
            "right_singular_vectors": numbers(observed.V.T),
            "sigma_of_direction": numbers(observed.sigma_of_direction),
            "weakest": {"direction": observed.direction(weakest), "sentence": observed.sentence(weakest)},
        },
        "advice": advice(problem, parameters, settings, estimate, fit, nis, observed),
    }


def _unjudged(estimate: Estimate, dof: int) -> list[str]:
    """Advice where statistics cannot be had."""
    if estimate.status == "running":
        return []
    if dof <= 0:
        return ["There are no more arcs than free parameters, so nothing can be checked: add frames or free fewer."]
    diverged = "The fit diverged: do not use these numbers; free fewer parameters, or start closer to the truth."
    return [*estimate.remarks, diverged]


def _bounds(test: ChiSquare) -> dict[str, Any]:
    """A chi-square test as JSON, without its value."""
    return {"dof": test.dof, "lower": test.lower, "upper": test.upper, "consistent": test.consistent}


def _innovations(estimate: Estimate) -> ChiSquare | None:
    """A filter's normalised innovations per degree of freedom; None of the batch, and where every one was left out."""
    if not estimate.history or not estimate.history.dof_sum:
        return None
    return chi_square(estimate.history.nis_sum, estimate.history.dof_sum)


def _innovations_so_far(estimate: Estimate) -> dict[str, Any] | None:
    """The same as JSON while a filter is on its way."""
    test = _innovations(estimate)
    return None if test is None or not np.isfinite(test.mean) else {"mean": test.mean, **_bounds(test)}


def nothing_estimated(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, sha256s: Mapping[str, str]
) -> dict[str, Any]:
    """The document of a set with too few stars everywhere: the start's values, no sigma, and why."""
    names: Sequence[str] = problem.camera.parameter_names
    nothing = dict.fromkeys(names)
    absent = ("chi2_per_dof", "chi2", "nis", "observability", "validation", "history", "trace", "radial", "coverage")
    return {
        **header(problem, parameters, settings, sha256s),
        "parameters": dict(zip(names, numbers(problem.sensor.initial), strict=True)),
        "sigma": nothing,
        "delta_over_sigma": nothing,
        "covariance": {"names": [], "matrix": []},
        "status": "too_few_stars",
        "iterations": 0,
        "rms_arc_rad": {"initial": None, "final": None},
        **dict.fromkeys(absent),
        **_not_yet(),
        "robust": None,
        "advice": too_few(problem, settings.minimum_stars),
        "timing_s": {},
    }
