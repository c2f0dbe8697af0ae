"""What a set says by itself, and beside the incumbent: values, covariance, whose it is, how far it moved.

The shift is the largest, over the parameters, of |x_i - x0_i| / sigma_i with

    sigma_i^2 = P_ii + P0_ii + (typical_i / 10)^2,

the variance of the difference of two independent estimates and a floor. Without the floor a set of a million stars, whose
sigmas are a thousandth of the typical ones, would be thousands of sigmas from any other for what no camera model holds.
Two estimates that share data differ by less than this says; the gate is then only slower to speak.
"""

from __future__ import annotations

import numpy as np

from boresight.errors import RefusedInputError
from boresight.gates.evidence import Evidence
from boresight.gates.measurement import Measurement, absent, answer

#: Share of the typical spread from unit to unit below which no difference of parameters counts in sigmas.
FLOOR = 0.1
#: Relative difference of a sigma from the root of its variance that rounding explains.
ROUNDING = 1e-6


def finite(evidence: Evidence) -> Measurement:
    """Ask for a plausible number for every parameter, and for a finite one or none for every sigma."""
    try:
        evidence.x  # noqa: B018 - reading it is the check
    except RefusedInputError as refusal:
        return answer("FAIL", str(refusal))
    sigma = evidence.candidate.get("sigma") or {}
    bad = [name for name in evidence.names if sigma.get(name) is not None and not _is_sigma(sigma[name])]
    if bad:
        return answer("FAIL", f"The sigma of {', '.join(bad)} is no positive number: calibrate again.")
    return answer("PASS", "Every parameter is a finite number in its model's range.")


def _is_sigma(value: object) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value)) and value >= 0


def covariance(evidence: Evidence) -> Measurement:
    """Ask for a symmetric, positive definite covariance whose roots are the sigmas."""
    try:
        P = evidence.covariance_of(evidence.candidate)
    except (KeyError, TypeError, ValueError):
        return answer("FAIL", "The covariance is not names and a square matrix of numbers: calibrate again.")
    places = [evidence.names.index(name) for name in evidence.candidate["covariance"]["names"]]
    if not places:
        return answer("FAIL", "There is no covariance, so no sigma can be trusted: calibrate again with more frames.")
    return _of_matrix(evidence, P[np.ix_(places, places)], [evidence.names[place] for place in places])


def _of_matrix(evidence: Evidence, P: np.ndarray, names: list[str]) -> Measurement:
    """Judge the covariance of the free parameters (n_free, n_free)."""
    variance = np.diag(P)
    if not np.isfinite(P).all() or (variance <= 0).any():
        return answer("FAIL", "The covariance has a variance that is no positive number: calibrate again.")
    correlation = P / np.sqrt(np.outer(variance, variance))
    if not np.allclose(correlation, correlation.T, rtol=0, atol=ROUNDING):
        return answer("FAIL", "The covariance is not symmetric: calibrate again.")
    least = float(np.linalg.eigvalsh((correlation + correlation.T) / 2)[0])
    if least <= 0:
        return answer("FAIL", f"The covariance is not positive definite (least eigenvalue {least:.2g}): free fewer.")
    sigma = evidence.candidate.get("sigma") or {}
    stated = [(name, sigma[name], root) for name, root in zip(names, np.sqrt(variance), strict=True) if sigma.get(name)]
    off = [name for name, given, root in stated if abs(given - root) > 1e-3 * root]
    if off:
        return answer("FAIL", f"The sigma of {', '.join(off)} is not the root of its variance: calibrate again.")
    return answer("PASS", f"Symmetric and positive definite; least eigenvalue of the correlations {least:.2g}.")


def sensor(evidence: Evidence) -> Measurement:
    """Ask whether set, run and sensor speak of one camera."""
    candidate, here = evidence.candidate, evidence.sensor
    if candidate.get("sensor") not in (None, here.name):
        return answer(
            "FAIL", f"The set is of the sensor {candidate['sensor']}, not of {here.name}: choose the right one."
        )
    if candidate.get("camera_model") != here.camera_model:
        return answer(
            "FAIL",
            f"The set is of the camera model {candidate.get('camera_model')}, the sensor of {here.camera_model}.",
        )
    made = evidence.made_with
    if made is None:
        return answer("PASS", f"Set and sensor are {here.name}, {here.camera_model}.")
    detector = {"rows": here.rows, "columns": here.columns, "pixel_pitch_m": here.pixel_pitch_m}
    if made.get("detector") != detector or made.get("parity") != here.parity:
        return answer(
            "FAIL", f"Detector or parity of {here.name} differ from those the run was made with: run it again."
        )
    return answer(
        "PASS", f"Set, run and sensor are {here.name}, {here.camera_model}, {here.rows} x {here.columns} pixels."
    )


def parameter_shift(evidence: Evidence) -> Measurement:
    """Measure the largest shift from the incumbent, in sigmas of the difference."""
    x_0 = evidence.x_incumbent
    if evidence.incumbent is None or x_0 is None:
        return absent("There is no incumbent that it could have moved from.")
    P, P_0 = (evidence.covariance_of(document) for document in (evidence.candidate, evidence.incumbent))
    sigma = np.sqrt(np.diag(P) + np.diag(P_0) + (FLOOR * evidence.sensor.typical_sigma) ** 2)
    shift = (evidence.x - x_0) / sigma
    i = int(np.argmax(np.abs(shift)))
    moved = sum(np.abs(shift) > 3)
    return Measurement(
        float(abs(shift[i])),
        f"{evidence.names[i]} moved farthest, by {shift[i]:+.1f} sigmas of the difference; "
        f"{moved} of {len(shift)} parameters moved by more than 3.",
    )
