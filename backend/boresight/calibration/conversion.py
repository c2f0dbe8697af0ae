"""Parameters of one camera model written down for another, with how well that goes: `boresight convert`.

A misfit is an error that is the same in every frame, so no number of them averages it away. It may be 1 % of the error of one
centroid: the mean of n stars knows a place to centroid_sigma_px / sqrt(n), so that 10,000 stars at one place of the detector would
just begin to see it. The strongly distorted lens of W Table 1 misses this: its 0.1 arcsec would be as large as all that a
calibration of 2,400 frames leaves open. Whoever needs it closer, or can do with less, says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.parameter_file import parse_parameters
from boresight.calibration.result import numbers
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.conversion import REASON, Conversion, convert
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document

SCHEMA = "boresight.parameters/1"
#: Misfit that is allowed, as a share of the sensor's centroid_sigma_px.
ALLOWED_SHARE = 0.01
ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0


def converted(
    document: Mapping[str, Any], sensor: Sensor, name: str, target: str, allowed_px: float | None = None
) -> dict[str, Any]:
    """Write parameters of a sensor in another camera model, schema `boresight.parameters/1`.

    Parameters
    ----------
    document
        Calibration, parameter set, or names and values, as `parameter_file` reads it.
    sensor
        Whose parameters they are.
    name
        What refusals call the document.
    target
        Name of the other model.
    allowed_px
        Largest misfit over the detector; `ALLOWED_SHARE` of the sensor's centroid_sigma_px where None.

    Raises
    ------
    RefusedInputError
        When there is no such model, the parameters are none of this sensor, the other model cannot follow them closely enough,
        or what comes out is no plausible camera; says by how much, and why.
    """
    x, P = _given(document, sensor, name, target)
    allowed = ALLOWED_SHARE * sensor.centroid_sigma_px if allowed_px is None else allowed_px
    found = convert(x, sensor.camera_model, target, (sensor.rows, sensor.columns, sensor.pixel_pitch_m), P=P)
    if not found.misfit_px <= allowed:
        raise RefusedInputError(_refusal(name, sensor.camera_model, target, found, allowed, by_rule=allowed_px is None))
    camera = CAMERA_MODELS[target]
    names = list(camera.parameter_names)
    sigma = [None] * len(names) if found.P is None else numbers(np.sqrt(np.maximum(np.diag(found.P), 0.0)))
    written = {
        "schema": SCHEMA,
        "sensor": sensor.name,
        "camera_model": target,
        "parameters": dict(zip(names, found.x.tolist(), strict=True)),
        "units": dict(zip(names, camera.units, strict=True)),
        "sigma": dict(zip(names, sigma, strict=True)),
        "covariance": None if found.P is None else {"names": names, "matrix": found.P.tolist()},
        "conversion": _how(name, sensor.camera_model, x, found, allowed, _assumed(document, sensor)),
    }
    parse_parameters(written, sensor_under(sensor, written), f"{name} in {target}")
    return written


def _given(document: Mapping[str, Any], sensor: Sensor, name: str, target: str) -> tuple[FloatArray, FloatArray | None]:
    """Read the parameters; refuse a model that there is not, and their own."""
    if target not in CAMERA_MODELS:
        raise RefusedInputError(f"There is no camera model {target!r}: choose {' or '.join(CAMERA_MODELS)}.")
    x, P = parse_parameters(document, sensor, name)
    if target == sensor.camera_model:
        others = " or ".join(model for model in CAMERA_MODELS if model != target)
        raise RefusedInputError(f"{name} is of {target} already: choose {others} to convert it to.")
    return x, P


def _assumed(document: Mapping[str, Any], sensor: Sensor) -> list[str]:
    """Name the parameters that a document with a covariance did not estimate."""
    covariance = document.get("covariance")
    estimated = covariance["names"] if covariance else ()
    return [name for name in CAMERA_MODELS[sensor.camera_model].parameter_names if estimated and name not in estimated]


def _refusal(name: str, source: str, target: str, found: Conversion, allowed_px: float, *, by_rule: bool) -> str:
    """One sentence that says by how much, why, and what to do instead."""
    size = (
        f"differ by up to {found.misfit_px:.2g} px ({found.misfit_rad * ARCSEC_PER_RAD:.2g} arcsec) over the detector"
        if math.isfinite(found.misfit_px)
        else "do not even meet over the whole detector"
    )
    rule = f" ({100 * ALLOWED_SHARE:g} % of the sensor's centroid_sigma_px)" if by_rule else ""
    return (
        f"{name} cannot be written in {target}: at best it and {source} {size}, where {allowed_px:.2g} px is allowed{rule}, "
        f"because {REASON}; calibrate the telemetry under {target} instead, or allow more."
    )


def _how(
    name: str, source: str, x: FloatArray, found: Conversion, allowed_px: float, assumed: list[str]
) -> dict[str, Any]:
    """What was converted, how well, and for which parameters the spread of a ground calibration stands as their sigma."""
    return {
        "source": name,
        "camera_model": source,
        "parameters": dict(zip(CAMERA_MODELS[source].parameter_names, x.tolist(), strict=True)),
        "misfit_px": {"max": found.misfit_px, "rms": found.rms_px},
        "misfit_arcsec": {"max": found.misfit_rad * ARCSEC_PER_RAD, "rms": found.rms_rad * ARCSEC_PER_RAD},
        "allowed_px": allowed_px,
        "lost_sigma_px": found.lost_sigma_px,
        "assumed": assumed,
    }


def sensor_under(sensor: Sensor, written: Mapping[str, Any]) -> Sensor:
    """Describe a sensor by converted parameters, all of them free.

    Their typical sigmas are those of the old model carried over, where these are larger than what is usual in the new one: a
    parameter that the old model has not, or holds more closely, must be free to move.

    Parameters
    ----------
    sensor
        Under the old model.
    written
        What `converted` gave.
    """
    camera = CAMERA_MODELS[written["camera_model"]]
    old = CAMERA_MODELS[sensor.camera_model]
    x = np.array([written["conversion"]["parameters"][name] for name in old.parameter_names])
    detector = (sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    carried = convert(x, sensor.camera_model, camera.name, detector, P=np.diag(sensor.typical_sigma**2)).P
    usual = np.array(camera.default_typical_sigma)
    return replace(
        sensor,
        camera_model=camera.name,
        initial=np.array([written["parameters"][name] for name in camera.parameter_names]),
        typical_sigma=usual if carried is None else np.sqrt(np.maximum(np.diag(carried), usual**2)),
        free=camera.parameter_names,
    )


def sensor_file(sensor: Sensor, written: Mapping[str, Any]) -> dict[str, Any]:
    """Write the sensor file of converted parameters.

    Raises
    ------
    RefusedInputError
        When it is no sensor that could be registered; names the field.
    """
    document = sensor_document(sensor_under(sensor, written))
    parse_sensor(document)
    return document
