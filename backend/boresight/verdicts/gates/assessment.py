"""A verdict on a calibration file, with no store behind it: what `boresight assess` does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from boresight.calibration.options import CalibrationSettings
from boresight.calibration.parameter_file import parse_parameters
from boresight.cameras import CAMERA_MODELS
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor
from boresight.verdicts.gates.evidence import Document, GateInputs
from boresight.verdicts.gates.held_out import compute_validation_scores, of_result
from boresight.verdicts.gates.judgement import judge
from boresight.verdicts.gates.measurements import measure
from boresight.verdicts.gates.profile import Profile

NO_FRAMES = "No held-out frames were given: add a telemetry set that the calibration did not use."


def ground_set(sensor: Sensor) -> dict[str, Any]:
    """Return a sensor's start as a set: declared, its sigmas the typical spread from unit to unit."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    sigma = [float(value) for value in sensor.typical_sigma]
    return {
        "sensor": sensor.name,
        "camera_model": sensor.camera_model,
        "parameters": dict(zip(names, map(float, sensor.initial), strict=True)),
        "sigma": dict(zip(names, sigma, strict=True)),
        "covariance": {"names": list(names), "matrix": np.diag(np.square(sigma)).tolist()},
        "status": "ground calibration",
    }


def as_set(document: Document, sensor: Sensor) -> dict[str, Any]:
    """Return parameters from a file as a set; without a covariance they are known as a ground calibration's are."""
    x, _ = parse_parameters(document, sensor, "The incumbent")
    declared = ground_set(sensor)
    covariance = document.get("covariance") or declared["covariance"]
    return {
        **declared,
        "parameters": dict(zip(declared["parameters"], map(float, x), strict=True)),
        "covariance": covariance,
    }


def started_from(result: Document, incumbent: Document) -> bool:
    """Whether a run started from the incumbent, so that its own validation already compares with it."""
    initial, values = result.get("initial") or {}, incumbent["parameters"]
    return set(initial) == set(values) and all(
        math.isclose(initial[name], values[name], rel_tol=1e-12) for name in values
    )


def assess(
    result: Document,
    sensor: Sensor,
    incumbent: Document,
    profile: Profile,
    frames: tuple[Telemetry, Catalogue] | None = None,
) -> dict[str, Any]:
    """Judge a calibration JSON."""
    held_out, why = None, NO_FRAMES
    if frames is not None:
        settings = CalibrationSettings.parse((result.get("inputs") or {}).get("settings") or {})
        held_out = compute_validation_scores(frames[0], sensor, frames[1], incumbent, result, settings)
    elif started_from(result, incumbent):
        held_out = of_result(result)
    evidence = GateInputs(
        sensor=sensor,
        candidate=result,
        incumbent=incumbent,
        result=result,
        held_out=held_out,
        no_held_out="" if held_out else why,
    )
    return judge(profile, measure(evidence))
