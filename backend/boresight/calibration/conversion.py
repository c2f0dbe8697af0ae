"""Parameters of one camera model written down for another, with how well that goes: `boresight convert`.

A misfit is an error that is the same in every frame, so no number of them averages it away. It may be 1 % of the error of one
centroid: the mean of n stars knows a place to centroid_sigma_px / sqrt(n), so that 10,000 stars at one place of the detector would
just begin to see it. The strongly distorted lens of W Table 1 misses this: its 0.1 arcsec would be as large as all that a
calibration of 2,400 frames leaves open. Whoever needs it closer, or can do with less, says so.

`inverted_wang` gives the tangent of a ray as a polynomial of the place on the detector, `pinhole_radial` the place as a polynomial
of the tangent. With R = rho / f (the focal lengths below) the one is the inverse series of the other::

    r = R (1 + b_2 f^2 R^2 + b_4 f^4 R^4)          R = r (1 + k_1 r^2 + k_2 r^4)
    k_1 = -b_2 f^2      k_2 = 3 k_1^2 - b_4 f^4    up to a term in R^7

and neither series ends where the other does. Exact is only the lens without distortion, and without the decentring a_1, a_2, which
`pinhole_radial` has not: both then scale rows by 1 / f and columns by g_y / f, so

    s = 1 / g_y     f_pinhole = f / g_y     u_0 = n_0     v_0 = m_0.

So the start is that of the series, and where it is not exact the target is fitted to the source's directions over a grid of the
detector by Gauss and Newton. What is left is the misfit, which comes with the answer; how much of it may be is said
above. Directions in D are kept as they are: a rotation, which arcs cannot see, would be a change of C_SD.

The covariance follows by the derivative of the fit, with J the derivatives of all directions: dx' = (J'^T J')^-1 J'^T J dx. What
the target cannot express, (J - J' dx'/dx) dx, is lost; its largest size over the detector comes with the answer. A value or a
sigma that moves no star by a millionth of a pixel is rounding, and is given as nought, such as the decentring of a straight lens.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.parameter_file import parse_parameters
from boresight.calibration.result import numbers
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import CameraModel
from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document

#: What counts as rounding, pixels.
EXACT_PX = 1e-6
GRID = 21
ITERATIONS = 12

#: Why the two models do not always say the same.
REASON = (
    "the one model's radial polynomial runs from the detector to the sky, the other's from the sky to the detector, and only "
    "inverted_wang has decentring"
)


@dataclass(frozen=True)
class Conversion:
    """Parameters in the target model.

    `x`: (n_parameters,) SI, in the target's order. `P`: (n_parameters, n_parameters) their covariance, or None where none was
    given. `misfit_px`, `rms_px`: largest, and root mean square, distance over the detector between where the two models see a
    star; infinite where the target sees none. `misfit_rad`, `rms_rad`: the same as angles between the two directions of a
    pixel. `lost_sigma_px`: largest one-sigma over the detector of that part of the given covariance which the target cannot
    express; 0 without one.
    """

    x: FloatArray
    P: FloatArray | None
    misfit_px: float
    rms_px: float
    misfit_rad: float
    rms_rad: float
    lost_sigma_px: float


def convert(
    x: FloatArray, source: str, target: str, detector: tuple[int, int, float], *, P: FloatArray | None = None
) -> Conversion:
    """Write parameters of one camera model in another, as closely as that can say them.

    `x`: (n_parameters,) of the source, SI. `source`, `target`: names in `CAMERA_MODELS`. `detector`: rows, columns, and pixel
    pitch in metres. `P`: (n_parameters, n_parameters) covariance of x.
    """
    if source == target:
        return Conversion(x.copy(), None if P is None else P.copy(), 0.0, 0.0, 0.0, 0.0, 0.0)
    seen, meant = CAMERA_MODELS[source], CAMERA_MODELS[target]
    places, pitch = _grid(detector), detector[2]
    s, J = seen.directions_and_jacobian(x, *places, pitch)
    pixel = np.sqrt(seen.solid_angle(x, *places, pitch))
    y = _SERIES[source, target](x)
    if not np.max(_angles(meant, y, places, pitch, s) / pixel) <= EXACT_PX:
        y = _fit(meant, y, places, pitch, s)
    J_target = meant.directions_and_jacobian(y, *places, pitch)[1]
    reach_px = np.max(np.linalg.norm(J_target, axis=1) / pixel[:, None], axis=0)
    y = np.where(np.abs(y) * reach_px < EXACT_PX, 0.0, y)
    away = _angles(meant, y, places, pitch, s)
    carried, lost = None, 0.0
    if P is not None and np.isfinite(away).all():
        carried, lost = _carried(J_target, J, P, pixel)
        known = np.sqrt(np.maximum(np.diag(carried), 0.0)) * reach_px >= EXACT_PX
        carried = carried * np.outer(known, known)
    return Conversion(y, carried, *_sizes(away / pixel), *_sizes(away), lost)


def _grid(detector: tuple[int, int, float]) -> tuple[FloatArray, FloatArray]:
    """Rows and columns of an even grid over the detector, edges included, (GRID^2,) each."""
    rows, columns, _ = detector
    row, col = np.meshgrid(np.linspace(-0.5, rows - 0.5, GRID), np.linspace(-0.5, columns - 0.5, GRID), indexing="ij")
    return row.ravel(), col.ravel()


def _angles(
    camera: CameraModel, y: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float, s: FloatArray
) -> FloatArray:
    """Angle between the camera's directions and s, (n,) rad; infinite where it has none."""
    away = np.linalg.norm(camera.directions(y, *places, pitch) - s, axis=-1)
    return np.asarray(np.where(np.isfinite(away), away, np.inf))


def _sizes(away: FloatArray) -> tuple[float, float]:
    return float(away.max()), float(np.sqrt(np.mean(away**2)))


def _fit(
    camera: CameraModel, start: FloatArray, places: tuple[FloatArray, FloatArray], pitch: float, s: FloatArray
) -> FloatArray:
    """Least squares of directions over the grid from a start; the best state on the way."""
    y, best, least = start, start, np.inf
    for _ in range(ITERATIONS):
        at, J = camera.directions_and_jacobian(y, *places, pitch)
        cost = float(np.sum((at - s) ** 2))
        if not cost < least:  # NaN, or no better: rounding, or a step too far
            break
        best, least = y, cost
        y = y - _solved(J, (at - s)[..., None])[:, 0]
    return best


def _solved(J: FloatArray, change: FloatArray) -> FloatArray:
    """Least-squares (n_parameters, k) of stacked changes of directions (n, 3, k), columns of J scaled first."""
    flat = J.reshape(-1, J.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    size = np.where(size > 0, size, 1.0)
    answer = np.linalg.lstsq(flat / size, change.reshape(len(flat), -1), rcond=1e-13)[0]
    return np.asarray(answer / size[:, None])


def _carried(J_target: FloatArray, J: FloatArray, P: FloatArray, pixel: FloatArray) -> tuple[FloatArray, float]:
    """Covariance in the target, and the largest sigma in pixels of what it cannot express."""
    D = _solved(J_target, J)
    rest = J - J_target @ D
    variance = np.einsum("nip,pq,niq->n", rest, P, rest)
    return D @ P @ D.T, float(np.sqrt(np.max(np.maximum(variance, 0.0) / pixel**2)))


def _pinhole_of_wang(x: FloatArray) -> FloatArray:
    """Start of `pinhole_radial` from [f m0 n0 b4 b2 a1 a2 g_y]; k2 by the inverse series."""
    f, m0, n0, b4, b2, _, _, g_y = x
    k1 = -b2 * f**2
    return np.array([1 / g_y, f / g_y, n0, m0, k1, 3 * k1**2 - b4 * f**4])


def _wang_of_pinhole(x: FloatArray) -> FloatArray:
    """Start of `inverted_wang` from [s f u0 v0 k1 k2]."""
    s, f_pinhole, u0, v0, k1, k2 = x
    f = f_pinhole / s
    return np.array([f, v0, u0, (3 * k1**2 - k2) / f**4, -k1 / f**2, 0.0, 0.0, 1 / s])


_SERIES: dict[tuple[str, str], Callable[[FloatArray], FloatArray]] = {
    ("inverted_wang", "pinhole_radial"): _pinhole_of_wang,
    ("pinhole_radial", "inverted_wang"): _wang_of_pinhole,
}


SCHEMA = "boresight.parameters/1"
#: Misfit that is allowed, as a share of the sensor's centroid_sigma_px.
ALLOWED_SHARE = 0.01
ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0


def converted(
    document: Mapping[str, Any], sensor: Sensor, name: str, target: str, allowed_px: float | None = None
) -> dict[str, Any]:
    """Write parameters of a sensor in another camera model, schema `boresight.parameters/1`.

    `document`: calibration, parameter set, or names and values, as `parameter_file` reads it. `sensor`: whose parameters they
    are. `name`: what refusals call the document. `target`: name of the other model. `allowed_px`: largest misfit over the
    detector; `ALLOWED_SHARE` of the sensor's centroid_sigma_px where None. Raises RefusedInputError when there is no such
    model, the parameters are none of this sensor, the other model cannot follow them closely enough, or what comes out is no
    plausible camera; says by how much, and why.
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

    `sensor`: under the old model. `written`: what `converted` gave.
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

    Raises RefusedInputError when it is no sensor that could be registered; names the field.
    """
    document = sensor_document(sensor_under(sensor, written))
    parse_sensor(document)
    return document
