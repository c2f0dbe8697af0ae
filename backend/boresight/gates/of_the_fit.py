"""What the run behind a set says of its own fit: did it rest, do the residuals fit, what did the data see.

The arc uncertainty follows from the set's covariance alone (`trust.arc_map`), so it is had for every set, and for the
incumbent beside it: at the worst place of the detector, in pixels of the centre. The coverage counts the regions, 6 rows by 8
columns of the detector, in which there was at least one star; where there was none the model is a guess.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.calibration.trust.arc_map import field_arc_sigma
from boresight.estimation.filters import FILTERS
from boresight.gates.evidence import Document, Evidence
from boresight.gates.measurement import Measurement, absent, answer, ends

ROWS, COLUMNS = 6, 8
NO_RUN = "The set was declared with the sensor; no run measured this."
ENDED = {
    "converged": ("PASS", "The estimate came to rest."),
    "max_iterations": ("MARGINAL", "The estimate was still moving at its last iteration: allow more, or free fewer."),
    "ground calibration": ("PASS", "A ground calibration is declared; there was nothing to come to rest."),
}
ARCSEC = float(np.degrees(1.0) * 3600)


def convergence(evidence: Evidence) -> Measurement:
    """Ask whether the estimate came to rest."""
    status = str(evidence.candidate.get("status"))
    return answer(
        *ENDED.get(status, ("FAIL", f"The run ended {status.replace('_', ' ')}: its numbers are no estimate."))
    )


def chi_square(evidence: Evidence) -> Measurement:
    """Measure the residuals against the stated noise."""
    result = evidence.result or {}
    value, test = result.get("chi2_per_dof"), result.get("chi2")
    if value is None or not test:
        return absent(NO_RUN if evidence.result is None else "The run kept no chi-square: run it again.")
    return _around_one(value, test, "Residuals")


def nis(evidence: Evidence) -> Measurement:
    """Measure a filter's innovations against what it expected; a batch has residuals in their place."""
    result = evidence.result or {}
    test = result.get("nis")
    if not test or test.get("mean") is None:
        return absent(NO_RUN if evidence.result is None else "The run kept no innovations: run it again.")
    what = "Innovations" if result.get("method") in FILTERS else "A batch has no innovations; its residuals"
    return _around_one(test["mean"], test, what)


def _around_one(value: float, test: Document, what: str) -> Measurement:
    """Describe a mean square beside its 95 % bounds."""
    inside = "inside" if test["lower"] <= value <= test["upper"] else "outside"
    return Measurement(
        float(value),
        f"{what} are {np.sqrt(value):.3g} times as large as expected, {inside} the 95 % bounds of sound sets.",
        bounds=ends((test["lower"], test["upper"])),
    )


def arc_uncertainty(evidence: Evidence) -> Measurement:
    """Measure what the covariance does to an arc at the worst place of the detector."""
    worst, degrees = _worst_arc(evidence, evidence.candidate, evidence.x)
    incumbent = None
    if evidence.incumbent is not None and evidence.x_incumbent is not None:
        incumbent = _worst_arc(evidence, evidence.incumbent, evidence.x_incumbent)[0] / evidence.pixel_rad
    return Measurement(
        worst / evidence.pixel_rad,
        f"An arc of {degrees:.2g}° may be {worst * ARCSEC:.2g} arcsec off (1 sigma) at the worst place of the detector.",
        incumbent=incumbent,
    )


def _worst_arc(evidence: Evidence, document: Document, x: Any) -> tuple[float, float]:
    """Largest sigma of an arc over the detector, rad, and the length of the arcs, degrees."""
    sigma, length = field_arc_sigma(evidence.sensor, x, evidence.covariance_of(document))
    return float(np.nanmax(sigma)), float(np.degrees(length))


def condition_number(evidence: Evidence) -> Measurement:
    """Measure how unevenly the data see the parameters."""
    seen = (evidence.result or {}).get("observability")
    if not seen or seen.get("condition_number") is None:
        return absent(NO_RUN if evidence.result is None else "The data leave a direction open: free fewer parameters.")
    free = len(seen["singular_values"])
    return Measurement(float(seen["condition_number"]), f"Largest over smallest of {free} singular values.")


def weak_directions(evidence: Evidence) -> Measurement:
    """Measure how well the weakest direction is known, and name it."""
    seen = (evidence.result or {}).get("observability")
    if not seen or not seen.get("sigma_of_direction"):
        return absent(NO_RUN if evidence.result is None else "The run kept no observability: run it again.")
    spread = seen["sigma_of_direction"]
    if any(sigma is None for sigma in spread):
        return absent("The data leave a direction open: free fewer parameters.")
    return Measurement(float(max(spread)), str(seen["weakest"]["sentence"]))


def coverage(evidence: Evidence) -> Measurement:
    """Measure in how many regions of the detector there were stars."""
    seen = (evidence.result or {}).get("coverage")
    if not seen:
        return absent(NO_RUN if evidence.result is None else "The run kept no coverage: run it again.")
    counts = np.array(seen["counts"])
    regions = counts.reshape(ROWS, counts.shape[0] // ROWS, COLUMNS, counts.shape[1] // COLUMNS).sum(axis=(1, 3))
    held = int((regions > 0).sum())
    return Measurement(
        held / regions.size,
        f"{held} of {regions.size} regions had stars, the fullest {regions.max():,}; elsewhere the model is extrapolated.",
    )
