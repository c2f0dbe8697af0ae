"""What a trend over the mission keeps of a calibration: its parameters with the full covariance, made honest.

A test of drift is as good as the covariances it is given, and a covariance that is too small cries wolf. So variances are
multiplied by the largest of

- chi-square per degree of freedom, where it is above its 95 % bound: the residuals are larger than the stated noise;
- a filter's normalised innovations per degree of freedom, where they are above theirs;
- the Cramer-Rao bound over the claim, squared, over all directions, where a claim is below what the centroids allow,

and what no factor makes comparable takes no part, with the reason: filters whose estimate is of their last frames only, or
whose matches were held to another set's parameters, or that linearise once a frame (see `estimation.filters.square_root`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from boresight.calibration.trust.advice import TOO_SMALL

USABLE = "converged"
LEFT_OUT_VARIANTS = {
    "q": "process noise lets it forget: it is an estimate of its last frames",
    "no-refit": "its matches were held to the parameters that it started from",
}


def trend_entry(result: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return what a trend keeps; None where nothing was estimated.

    Returns
    -------
    dict
        `camera_model`, `names` (k,) of the estimated parameters, `parameters {}` of all, `covariance` (k, k) with
        `variance_factor` in it, `said` sentences on that factor, `left_out` why it takes no part in tests, or null.
    """
    covariance = result.get("covariance") or {}
    names = list(covariance.get("names") or ())
    if not names:
        return None
    factors = dict(_factors(result))
    said = max(factors, key=lambda sentence: factors[sentence], default=None)
    factor = 1.0 if said is None else factors[said]
    return {
        "camera_model": result["camera_model"],
        "names": names,
        "parameters": dict(result["parameters"]),
        "covariance": [[None if one is None else one * factor for one in row] for row in covariance["matrix"]],
        "variance_factor": factor,
        "said": said,
        "left_out": _left_out(result),
    }


def _factors(result: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield why variances must be larger, and by how much."""
    chi2, nis = result.get("chi2") or {}, result.get("nis") or {}
    per_dof = result.get("chi2_per_dof")
    if per_dof is not None and chi2.get("upper") is not None and per_dof > chi2["upper"]:
        yield f"sigmas widened {per_dof**0.5:.2f} times: chi-square is {per_dof:.3g} per degree of freedom", per_dof
    mean = nis.get("mean")
    if mean is not None and nis.get("upper") is not None and mean > nis["upper"]:
        yield f"sigmas widened {mean**0.5:.2f} times: the normalised innovations are {mean:.3g}", mean
    ratio = ((result.get("trust") or {}).get("efficiency") or {}).get("overall_ratio")
    if ratio is not None and 0 < ratio < TOO_SMALL:
        yield f"sigmas widened {1 / ratio:.2f} times: they were claimed below the Cramér-Rao bound", ratio**-2


def _left_out(result: Mapping[str, Any]) -> str | None:
    """Say why an estimate takes no part in tests; None where it does."""
    settings = (result.get("inputs") or {}).get("settings") or {}
    if result.get("status") != USABLE:
        return f"it ended {str(result.get('status')).replace('_', ' ')}"
    if result.get("variant") in LEFT_OUT_VARIANTS:
        return LEFT_OUT_VARIANTS[str(result["variant"])]
    if result.get("variant") is not None and settings.get("linearisations") == 1:
        return "one linearisation a frame makes it over-confident"
    if (settings.get("forgetting_factor") or 1.0) < 1.0:
        return "it forgets: it is an estimate of its last frames"
    return None
