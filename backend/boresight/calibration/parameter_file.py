"""Parameters from a file: a calibration JSON, or an object of names and values such as a simulation's truth.

==============================================  ==========================================================
document                                        covariance
==============================================  ==========================================================
calibration JSON, `boresight.calibration/1`     its own; a ground calibration's for parameters it held fixed
`{"parameters": {"f_m": 0.016, ...}}`           none, unless it has `covariance` as above
`{"f_m": 0.016, ...}`                           none; `f_px`, in pixels, may stand for `f_m`
==============================================  ==========================================================
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Calibration, Covariance
from boresight.calibration.matching.rematch import ground_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import read_json
from boresight.telemetry.sensors import Sensor, check_geometry, in_metres

#: Statuses under which a calibration's numbers are no calibration.
FAILED = ("diverged", "too_few_stars", "running")


def read_parameters(path: Path, sensor: Sensor) -> tuple[FloatArray, FloatArray | None]:
    """Read a sensor's parameters from a file.

    Returns x: (n_parameters,) in the camera model's order, SI. Returns P: (n_parameters, n_parameters) covariance, SI;
    None where the file gives none.
    """
    return parse_parameters(read_document(path), sensor, path.name)


def read_document(path: Path, wanted: str = "a calibration JSON or an object of parameters") -> dict[str, Any]:
    """Read a JSON object of a file; `wanted` is what a refusal asks for."""
    try:
        document = read_json(path, path.name)
    except json.JSONDecodeError as error:
        raise RefusedInputError(f"{path.name} is not JSON: give {wanted}.") from error
    if not isinstance(document, dict):
        raise RefusedInputError(f"{path.name} is not a JSON object: give {wanted}.")
    return document


def parse_parameters(document: Mapping[str, Any], sensor: Sensor, name: str) -> tuple[FloatArray, FloatArray | None]:
    """Read a sensor's parameters from a document; `name` is what refusals call it. As `read_parameters`."""
    values = document.get("parameters", document)
    if not isinstance(values, Mapping):
        raise RefusedInputError(f"{name} has `parameters` that are not an object: write names and numbers.")
    subject = "the set under 'parameters'" if "parameters" in document else "the set of parameters"
    model, status = document.get("camera_model", sensor.camera_model), document.get("status")
    x = _check_parameters(model, status, values, sensor, name, subject)
    covariance = document.get("covariance")
    if covariance is None:
        return x, None
    try:
        names, matrix = list(covariance["names"]), covariance["matrix"]
    except (TypeError, LookupError, ValueError) as error:
        raise _no_covariance(name) from error
    return x, _spread_covariance(names, matrix, sensor, name)


def take_parameters(
    result: Calibration, covariance: Covariance, sensor: Sensor, name: str
) -> tuple[FloatArray, FloatArray | None]:
    """Take the parameters of a calibration with one of its covariances. As `read_parameters`."""
    subject = "the set under 'parameters'"
    x = _check_parameters(result.camera_model, result.status, result.parameters, sensor, name, subject)
    return x, _spread_covariance(covariance.names, covariance.matrix, sensor, name)


def read_reliable_parameters(result: Calibration, sensor: Sensor, name: str) -> tuple[FloatArray, FloatArray | None]:
    """Take the parameters of a calibration with the covariance to decide by: with misfit where it has one. As `read_parameters`."""
    return take_parameters(result, result.reliable_covariance, sensor, name)


def _check_parameters(
    model: Any, status: Any, values: Mapping[str, Any], sensor: Sensor, name: str, subject: str
) -> FloatArray:
    """Return (n_parameters,) in the camera model's order; refuse what is no set of this sensor's."""
    if model != sensor.camera_model:
        raise RefusedInputError(
            f"{name} uses the camera model {model}, the sensor {sensor.camera_model}: choose parameters of this sensor.",
            code="other-camera-model",
        )
    if status in FAILED:
        raise RefusedInputError(f"{name} is a calibration that {_ended(status)}: choose one that converged.")
    values = in_metres(values, CAMERA_MODELS[sensor.camera_model].parameter_names, sensor.pixel_pitch_m)
    _check_names(values, sensor, name)
    x = np.array([values[parameter] for parameter in CAMERA_MODELS[sensor.camera_model].parameter_names], np.float64)
    faults = Faults(name)
    check_geometry(replace(sensor, initial=x), CAMERA_MODELS[sensor.camera_model], faults, subject)
    faults.refuse()
    return x


def _ended(status: str) -> str:
    return {"diverged": "diverged", "too_few_stars": "had too few stars", "running": "is still running"}[status]


def _check_names(values: Mapping[str, Any], sensor: Sensor, name: str) -> None:
    """Refuse parameters that are missing, unknown, or no plausible number."""
    camera = CAMERA_MODELS[sensor.camera_model]
    missing = [parameter for parameter in camera.parameter_names if parameter not in values]
    if missing:
        raise RefusedInputError(f"{name} lacks {', '.join(missing)}: give every parameter of {camera.name}.")
    unknown = [parameter for parameter in values if parameter not in camera.parameter_names]
    if unknown:
        raise RefusedInputError(f"{name} gives {unknown[0]!r}, which is not a parameter of {camera.name}: omit it.")
    for parameter, fault in camera.find_implausible(values):
        raise RefusedInputError(f"{name} gives {parameter} as {fault}: check its unit.")


def _no_covariance(name: str) -> RefusedInputError:
    return RefusedInputError(
        f"{name} has a covariance that is not names and a square matrix: write the file again.",
        code="damaged-covariance",
    )


def _spread_covariance(names: Sequence[str], rows: Any, sensor: Sensor, name: str) -> FloatArray | None:
    """Spread a covariance over all parameters; those not named in it are known as a ground calibration knows them."""
    parameters = CAMERA_MODELS[sensor.camera_model].parameter_names
    try:
        matrix = np.array(rows, np.float64)
        places = [parameters.index(parameter) for parameter in names]
    except (TypeError, ValueError) as error:
        raise _no_covariance(name) from error
    if not names:
        return None
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all() or (np.diag(matrix) < 0).any():
        raise _no_covariance(name)
    P = ground_covariance(sensor, CalibrationSettings().initial_sigma_scale)
    P[np.ix_(places, places)] = matrix
    return P
