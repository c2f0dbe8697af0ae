"""Every gate measured: one function a gate, in a table that tests walk.

A gate whose function is refused what it needs has no data, with the refusal as its sentence; the critical gates answer for
the cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from boresight.errors import RefusedInputError
from boresight.gates import of_the_fit, of_the_set
from boresight.gates.evidence import Evidence
from boresight.gates.measurement import Measurement, absent, ends
from boresight.gates.on_board import quantisation

IS_INCUMBENT = "There is no other set to compare with: this one is the baseline, or the sensor has none."


def measure(evidence: Evidence) -> dict[str, Measurement]:
    """Measure everything that the gates ask, by gate."""
    return {name: _measured(function, evidence) for name, function in MEASURES.items()}


def _measured(function: Callable[[Evidence], Measurement], evidence: Evidence) -> Measurement:
    """Measure for one gate; what cannot be had is absent, with the reason."""
    try:
        return _finite(function(evidence))
    except RefusedInputError as refusal:
        return absent(str(refusal))
    except (AttributeError, LookupError, TypeError, ValueError, np.linalg.LinAlgError):
        return absent("The numbers of this set are not complete enough to tell: calibrate again.")


def _finite(measured: Measurement) -> Measurement:
    """Return a measurement whose value is a number, or none at all."""
    if measured.value is not None and not np.isfinite(measured.value):
        return absent(f"This is no finite number for this set. {measured.sentence}")
    if measured.incumbent is not None and not np.isfinite(measured.incumbent):
        return replace(measured, incumbent=None)
    return measured


def _score(name: str, evidence: Evidence) -> Measurement:
    """Take a score of the held-out frames."""
    if evidence.held_out is None:
        return absent(evidence.no_held_out)
    score, frames = evidence.held_out[name], evidence.held_out["frames"]
    if score["value"] is None:
        return absent(f"None of the {frames:,} held-out frames gives this number: choose frames with more stars.")
    return Measurement(
        float(score["value"]),
        f"On {frames:,} held-out frames.",
        interval=ends(score["interval"]),
        incumbent=score["incumbent"],
    )


def _against(name: str, evidence: Evidence) -> Measurement:
    """Take a score that compares with the incumbent."""
    if evidence.incumbent is None:
        return absent(IS_INCUMBENT)
    return _score(name, evidence)


def _rms_in_noise(evidence: Evidence) -> Measurement:
    """Take the RMS in multiples of what the stated centroid noise alone would cause in an arc, sqrt(2) sigmas of a pixel."""
    measured = _score("validation-rms", evidence)
    if measured.value is None:
        return measured
    noise = float(np.sqrt(2) * evidence.sensor.centroid_sigma_px * evidence.pixel_rad)
    low, high = measured.interval or (None, None)
    return Measurement(
        measured.value / noise,
        f"{measured.value * 1e6:.4g} µrad, where the stated noise of an arc is {noise * 1e6:.4g}. {measured.sentence}",
        interval=ends((None if low is None else low / noise, None if high is None else high / noise)),
        incumbent=None if measured.incumbent is None else measured.incumbent / noise,
    )


MEASURES: dict[str, Callable[[Evidence], Measurement]] = {
    "finite": of_the_set.finite,
    "covariance": of_the_set.covariance,
    "sensor": of_the_set.sensor,
    "convergence": of_the_fit.convergence,
    "validation-rms": _rms_in_noise,
    "validation-rms-incumbent": partial(_against, "validation-rms-incumbent"),
    "availability": partial(_score, "availability"),
    "availability-incumbent": partial(_against, "availability-incumbent"),
    "matched-stars": partial(_score, "matched-stars"),
    "matched-stars-incumbent": partial(_against, "matched-stars-incumbent"),
    "chi-square": of_the_fit.chi_square,
    "nis": of_the_fit.nis,
    "parameter-shift": of_the_set.parameter_shift,
    "arc-uncertainty": of_the_fit.arc_uncertainty,
    "condition-number": of_the_fit.condition_number,
    "weak-directions": of_the_fit.weak_directions,
    "coverage": of_the_fit.coverage,
    "quantisation": quantisation,
}
