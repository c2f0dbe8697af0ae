"""Camera files for OpenCV and ROS, of a camera that is one of theirs to the last digit; of every other, the reason why not.

OpenCV's frame has X along columns, Y along rows and Z along the boresight, pixel centres at whole numbers from 0, and distorts
the tangents on the way from the sky to the detector::

    x' = X / Z, y' = Y / Z, r^2 = x'^2 + y'^2
    x'' = x' (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x' y' + p2 (r^2 + 2 x'^2)        u = f_x x'' + c_x
    y'' = y' (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y'^2) + 2 p2 x' y'        v = f_y y'' + c_y

or, for wide fields, the angle off the boresight in place of the tangent. Each camera's own file says whether it is one of these
(`CameraModel.opencv`). It needs parity -1: with +1, OpenCV's axes are a left-handed triad of the sky, which no rotation is. A
camera that runs from the detector to the sky has no polynomial for its inverse: no coefficients of OpenCV's are its own, and a fit
would be another camera.

A set of numbers is no camera: the same eight values mean another direction under another order of operations, pixel origin or
sense of the distortion. (Approximations, with their misfit, are `calibration.exports`'; a package holds none.) So every
`parameters.json` says how a pixel becomes a direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from boresight.calibration.exports.opencv import opencv_yaml, ros_yaml
from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import Sensor

NAMES = ("camera_opencv.yaml", "camera_info.yaml")


def why_not(sensor: Sensor) -> str | None:
    """Say why the sensor's camera is none of OpenCV's; None when it is one exactly."""
    if CAMERA_MODELS[sensor.camera_model].opencv is None:
        return (
            f"{sensor.camera_model} distorts from the detector to the sky; OpenCV and ROS distort from the sky to the detector. "
            "None of their coefficients describes this camera exactly, and an approximation would be a different camera."
        )
    if sensor.parity != -1:
        return (
            "The sensor has parity +1: with X along columns, Y along rows and Z along the boresight, the OpenCV and ROS "
            "frame would be left-handed, and no rotation can produce it."
        )
    return None


def camera_files(sensor: Sensor, parameters: Mapping[str, float], title: str) -> dict[str, bytes]:
    """Return the camera files by name, and `camera_files.txt`, which says what they are or why they are not there.

    `parameters`: Number of each parameter of the camera model, SI.
    """
    reason, camera = why_not(sensor), CAMERA_MODELS[sensor.camera_model]
    if reason is not None or camera.opencv is None:
        return {"camera_files.txt": f"Refused: no camera file for OpenCV or ROS.\n{reason}\n".encode()}
    seen = camera.opencv(parameters, sensor.pixel_pitch_m)
    row, column = camera.principal_point(np.array([parameters[name] for name in camera.parameter_names]))
    K = (seen.f_x, 0.0, column, 0.0, seen.f_y, row, 0.0, 0.0, 1.0)
    said = (
        f"{NAMES[0]} and {NAMES[1]} are the camera of {title} exactly, pixel centres at whole numbers from 0.\n"
        "X of their frame is y of the detector frame D (columns), Y is x (rows), Z is z (boresight).\n"
        "They are for analysis; parameters.json is normative.\n"
    )
    size = sensor.columns, sensor.rows
    files = (
        opencv_yaml(*size, K, seen.coefficients),
        ros_yaml(*size, K, (seen.distortion_model, seen.coefficients), title),
    )
    return dict(zip(NAMES, files, strict=True)) | {"camera_files.txt": said.encode()}


def conventions(sensor: Sensor) -> dict[str, Any]:
    """Say what axes, pixels and units are."""
    hand = "right" if sensor.parity == 1 else "left"
    return {
        "axes": "s is a unit vector in the detector frame D: x along increasing rows, y along increasing columns, "
        "z out along the boresight",
        "parity": sensor.parity,
        "handedness": f"(rows, columns, boresight) is a {hand}-handed triad"
        + ("" if sensor.parity == 1 else "; (x, y, z) in D represents the right-handed vector (x, -y, z)"),
        "pixel_origin": "the centre of the top-left pixel is row 0, column 0; rows count down, columns to the right",
        "angles": "radians",
        "quaternions": "x, y, z, w; scalar last",
        "sigma": "one standard deviation from noise alone; null where it was not estimated",
        "sigma_with_misfit": "the same, including effects that the camera model does not describe; use this one for decisions",
        "numbers": "IEEE 754 double precision, written in the fewest digits that read back as the same number",
    }
