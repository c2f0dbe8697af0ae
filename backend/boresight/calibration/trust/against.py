"""Residual against radius, magnitude, temperature and time: what the camera model or the noise model leaves out.

The quantity is the residual along the outward radius, r . rho / |rho|: a wrong focal length or distortion moves stars along it,
and no attitude can hide that. A bin's mean has the sigma

    sigma_of_mean = sqrt(sum sigma_i^2 M_rr) / count,

with M_rr the radial share of a star's own error (`residuals`), times the residuals' spread where that exceeds one. The squares
of the means over their sigmas, summed over bins, are compared with chi-square of as many degrees of freedom. The fit has taken
some freedom out of them, so chance alone calls fewer than 1 % of sets uneven. Bins hold equally many stars.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtrc

from boresight.arrays import FloatArray
from boresight.calibration.trust.fitted_set import FittedSet, nested, probability
from boresight.calibration.trust.residuals import LEAST_SHARE, StarResiduals

MOST_BINS = 12
FEWEST_IN_A_BIN = 20
UNLIKELY = 0.01
UNITS = {"radius": "px", "magnitude": "mag", "temperature": "°C", "time": "h"}
ABSENT = {
    "magnitude": "The telemetry gives no magnitude.",
    "temperature": "The telemetry gives no temperature.",
    "time": "The telemetry gives no time.",
}


def residual_against(fitted: FittedSet, found: StarResiduals) -> tuple[dict[str, Any], dict[str, str]]:
    """One entry a quantity, and for those that are null why."""
    known = found.known
    away, radius = _outward(fitted, found)
    residual = np.sum(away * found.r, axis=1)
    share = np.maximum(np.einsum("ni,nij,nj->n", away, found.M, away), LEAST_SHARE)
    sigma = found.arcs.sigma_px * np.sqrt(share) * max(found.spread, 1.0)
    entries: dict[str, Any] = dict.fromkeys(UNITS)
    missing: dict[str, str] = {}
    for name, values in _quantities(fitted, found, radius).items():
        if values is None or not np.isfinite(values).any():
            missing[name] = ABSENT[name]
            continue
        usable = known & np.isfinite(values)
        entries[name] = _binned(name, values[usable], residual[usable], sigma[usable])
        if entries[name] is None:
            missing[name] = f"The set is too small or its {name} too uniform for two bins of {FEWEST_IN_A_BIN} stars."
    return entries, missing


def _outward(fitted: FittedSet, found: StarResiduals) -> tuple[FloatArray, FloatArray]:
    """Unit vectors away from the principal point (n_stars, 2), and the distance from it, pixels."""
    row, col = fitted.problem.camera.principal_point(fitted.x)
    away = np.stack([found.arcs.row_px - row, found.arcs.col_px - col], axis=-1)
    radius = np.hypot(away[:, 0], away[:, 1])
    return away / np.maximum(radius, 1e-9)[:, None], radius


def _quantities(fitted: FittedSet, found: StarResiduals, radius: FloatArray) -> dict[str, FloatArray | None]:
    """What the residual is held against, (n_stars,) each; None where the telemetry lacks it."""
    telemetry, rows = fitted.telemetry, found.arcs.source_row
    hours = None
    if telemetry.time_utc is not None:
        time = telemetry.time_utc[rows]
        hours = (time - np.nanmin(time)) / np.timedelta64(1, "h") if not np.isnat(time).all() else None
    return {
        "radius": radius,
        "magnitude": None if telemetry.magnitude is None else telemetry.magnitude[rows],
        "temperature": None if telemetry.temperature_c is None else telemetry.temperature_c[rows],
        "time": hours,
    }


def _binned(name: str, values: FloatArray, residual: FloatArray, sigma: FloatArray) -> dict[str, Any] | None:
    """Mean with its sigma, and rms, of equally full bins; None where there are not two."""
    bins = min(MOST_BINS, len(values) // FEWEST_IN_A_BIN)
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1))) if bins >= 2 else values[:0]
    if len(edges) < 3:
        return None
    of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    n = len(edges) - 1
    counts = np.bincount(of, minlength=n)
    safe = np.maximum(counts, 1)
    mean = np.bincount(of, residual, minlength=n) / safe
    of_mean = np.sqrt(np.bincount(of, sigma**2, minlength=n)) / safe
    rms = np.sqrt(np.bincount(of, residual**2, minlength=n) / safe)
    filled = counts > 0
    p = float(chdtrc(int(filled.sum()), np.sum((mean[filled] / of_mean[filled]) ** 2)))
    return {
        "edges": nested(edges),
        "mean_px": nested(np.where(filled, mean, np.nan)),
        "sigma_of_mean_px": nested(np.where(filled, of_mean, np.nan)),
        "rms_px": nested(np.where(filled, rms, np.nan)),
        "count": counts.tolist(),
        "unit": UNITS[name],
        "p": p,
        "even": p >= UNLIKELY,
        "sentence": _sentence(name, float(np.abs(mean[filled]).max()), p),
    }


def _sentence(name: str, largest: float, p: float) -> str:
    """The verdict in words."""
    if p >= UNLIKELY:
        return f"The radial residual does not depend on {name}, as far as the noise lets one see ({probability(p)})."
    return (
        f"The radial residual depends on {name}: bins are up to {largest:.2g} px off, more than noise explains "
        f"({probability(p)})."
    )
