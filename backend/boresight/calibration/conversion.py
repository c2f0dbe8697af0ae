"""Parameters of one camera model written down for another, with how well that goes: `boresight convert`.

A misfit is an error that is the same in every frame, so no number of them averages it away. It may be 1 % of the error of one
centroid: the mean of n stars knows a place to centroid_sigma_px / sqrt(n), so that 10,000 stars at one place of the detector would
just begin to see it. The strongly distorted lens of W Table 1 misses this: its 0.1 arcsec would be as large as all that a
calibration of 2,400 frames leaves open. Whoever needs it closer, or can do with less, says so.

The target is fitted to the source's directions over a grid of the detector by Gauss and Newton, from the target without distortion
that has the source's focal length and principal point. What is left is the misfit, which comes with the answer; how much of it may
be is said above. Some models contain others: `brown_conrady` every `pinhole_radial`, `inverted_wang_decentred` every
`inverted_wang`; and every model has the lens without distortion. Between the two families there is none but that: the one's
polynomial runs from the detector to the sky, the other's from the sky to the detector, and the inverse of neither ends where the
other does. Directions in D are kept as they are: a rotation, which arcs cannot see, would be a change of C_SD.

Where a calibration found that its camera leaves a displacement d over the detector (`residual_spline`), the target can follow the
camera with it: a star seen at p has the direction that the source gives p - d(p). d is known up to a rotation of the sky, so the
target may turn there, and the turn is told: C_SD has to turn back.

The covariance follows by the derivative of the fit, with J the derivatives of all directions: dx' = (J'^T J')^-1 J'^T J dx. What
the target cannot express, (J - J' dx'/dx) dx, is lost; its largest size over the detector comes with the answer. A value or a
sigma that moves no star by a millionth of a pixel is rounding, and is given as zero, such as the decentring of a straight lens.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.parameter_file import parse_parameters
from boresight.calibration.residual_spline import ResidualSplineFit, require_in
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import NEUTRAL, CameraModel
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import rotation_vector, to_matrix, to_quaternion, vector_to_quaternion
from boresight.estimation.residual_spline import Surface
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document

#: What counts as rounding, pixels.
EXACT_PX = 1e-6
GRID = 21
ITERATIONS = 12


@dataclass(frozen=True)
class Conversion:
    """Parameters in the target model.

    `x`: (n_parameters,) SI, in the target's order. `P`: (n_parameters, n_parameters) their covariance, or None where none was
    given. `misfit_px`, `rms_px`: largest, and root mean square, distance over the detector between where the two models see a
    star; infinite where the target sees none. `misfit_rad`, `rms_rad`: the same as angles between the two directions of a
    pixel. `lost_sigma_px`: largest one-sigma over the detector of that part of the given covariance which the target cannot
    express; 0 without one. `turn`: (3, 3) rotation of the source's directions that the target was fitted to, one but for a
    residual, which is known up to a rotation.
    """

    x: FloatArray
    P: FloatArray | None
    misfit_px: float
    rms_px: float
    misfit_rad: float
    rms_rad: float
    lost_sigma_px: float
    turn: FloatArray


@dataclass(frozen=True)
class TriedConversion:
    """A conversion of a document: how far the models differ, how far they may, and the document or why there is none."""

    misfit_px: float
    allowed_px: float
    outcome: dict[str, Any] | RefusedInputError


def convert(
    x: FloatArray,
    source: str,
    target: str,
    detector: tuple[int, int, float],
    *,
    P: FloatArray | None = None,
    residual: Surface | None = None,
) -> Conversion:
    """Write parameters of one camera model in another, as closely as that can say them.

    `x`: (n_parameters,) of the source, SI. `source`, `target`: names in `CAMERA_MODELS`. `detector`: rows, columns, and pixel
    pitch in metres. `P`: (n_parameters, n_parameters) covariance of x. `residual`: what the source leaves over, to be said too.
    """
    if source == target:
        return Conversion(x.copy(), None if P is None else P.copy(), 0.0, 0.0, 0.0, 0.0, 0.0, np.eye(3))
    seen, meant = CAMERA_MODELS[source], CAMERA_MODELS[target]
    places, pitch = _grid(detector), detector[2]
    s, J = seen.directions_and_jacobian(x, *(places if residual is None else undone(places, residual)), pitch)
    pixel = np.sqrt(seen.solid_angle(x, *places, pitch))
    plain = meant.plain(seen.focal_px(x, pitch), *seen.principal_point(x), pitch)
    y, turn = _fit(meant, plain, places, pitch, s, turning=residual is not None)
    s = s @ turn.T
    at, J_target = meant.directions_and_jacobian(y, *places, pitch)
    reach_px = np.max(np.linalg.norm(J_target, axis=1) / pixel[:, None], axis=0)
    y = np.where(np.abs(y) * reach_px < EXACT_PX, 0.0, y)
    away = _angles(meant, y, places, pitch, s)
    carried, lost = None, 0.0
    if P is not None and np.isfinite(away).all():
        carried, lost = _carried(
            J_target, turn @ J, P, pixel, np.zeros((len(s), 3, 0)) if residual is None else _turns(at)
        )
        known = np.sqrt(np.maximum(np.diag(carried), 0.0)) * reach_px >= EXACT_PX
        carried = carried * np.outer(known, known)
    return Conversion(y, carried, *_sizes(away / pixel), *_sizes(away), lost, turn)


def undone(places: tuple[FloatArray, FloatArray], residual: Surface) -> tuple[FloatArray, FloatArray]:
    """Places (n,) at which the source alone would show the stars that are seen at these."""
    d = residual(*places)
    return places[0] - d[:, 0], places[1] - d[:, 1]


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
    camera: CameraModel,
    start: FloatArray,
    places: tuple[FloatArray, FloatArray],
    pitch: float,
    s: FloatArray,
    *,
    turning: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Least squares of directions over the grid from a start: the best state on the way, and the turn of s where that is free."""
    y, turn = start, np.eye(3)
    best, least = (y, turn), np.inf
    for _ in range(ITERATIONS):
        at, J = camera.directions_and_jacobian(y, *places, pitch)
        cost = float(np.sum((at - s @ turn.T) ** 2))
        if not cost < least:  # NaN, or no better: rounding, or a step too far
            break
        best, least = (y, turn), cost
        columns = np.concatenate([J, _turns(at)], axis=-1) if turning else J
        step = _solved(columns, (at - s @ turn.T)[..., None])[:, 0]
        y = y - step[: len(y)]
        if turning:
            turn = to_matrix(vector_to_quaternion(step[len(y) :])) @ turn
    return best


def _turns(s: FloatArray) -> FloatArray:
    """Derivatives (n, 3, 3) of directions by a small rotation about the axes of D."""
    return np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1)


def _solved(J: FloatArray, change: FloatArray) -> FloatArray:
    """Least-squares (n_parameters, k) of stacked changes of directions (n, 3, k), columns of J scaled first."""
    flat = J.reshape(-1, J.shape[-1])
    size = np.linalg.norm(flat, axis=0)
    size = np.where(size > 0, size, 1.0)
    answer = np.linalg.lstsq(flat / size, change.reshape(len(flat), -1), rcond=1e-13)[0]
    return np.asarray(answer / size[:, None])


def _carried(
    J_target: FloatArray, J: FloatArray, P: FloatArray, pixel: FloatArray, turns: FloatArray
) -> tuple[FloatArray, float]:
    """Covariance in the target, and the largest sigma in pixels of what neither it nor the turns (n, 3, k) can express."""
    columns = np.concatenate([J_target, turns], axis=-1)
    D = _solved(columns, J)
    rest = J - columns @ D
    variance = np.einsum("nip,pq,niq->n", rest, P, rest)
    D = D[: J_target.shape[-1]]
    return D @ P @ D.T, float(np.sqrt(np.max(np.maximum(variance, 0.0) / pixel**2)))


SCHEMA = "boresight.parameters/1"
#: Misfit that is allowed, as a share of the sensor's centroid_sigma_px.
ALLOWED_SHARE = 0.01


def converted(
    document: Mapping[str, Any],
    sensor: Sensor,
    name: str,
    target: str,
    allowed_px: float | None = None,
    *,
    with_residual: bool = False,
) -> dict[str, Any]:
    """Write parameters of a sensor in another camera model, schema `boresight.parameters/1`.

    `document`: calibration, parameter set, or names and values, as `parameter_file` reads it. `sensor`: whose parameters they
    are. `name`: what refusals call the document. `target`: name of the other model. `allowed_px`: largest misfit over the
    detector; `ALLOWED_SHARE` of the sensor's centroid_sigma_px where None. `with_residual`: the target follows the source with
    the residual spline of its calibration; sigmas stay those of the parameters, and the spline's own is told beside. Raises
    RefusedInputError when there is no such model, the parameters are none of this sensor, the other model cannot follow them
    closely enough, or what comes out is no plausible camera; says by how much, and why.
    """
    tried = try_conversion(document, sensor, name, target, allowed_px, with_residual=with_residual)
    if isinstance(tried.outcome, RefusedInputError):
        raise tried.outcome
    return tried.outcome


def try_conversion(
    document: Mapping[str, Any],
    sensor: Sensor,
    name: str,
    target: str,
    allowed_px: float | None = None,
    *,
    with_residual: bool = False,
) -> TriedConversion:
    """Write parameters in another camera model as `converted` does; that the model cannot follow them is an answer too."""
    x, P = _given(document, sensor, name, target)
    allowed = ALLOWED_SHARE * sensor.centroid_sigma_px if allowed_px is None else allowed_px
    spline = require_in(document, name) if with_residual else None
    residual = None if spline is None else spline.surface
    detector = (sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    found = convert(x, sensor.camera_model, target, detector, P=P, residual=residual)
    if not found.misfit_px <= allowed:
        why = _refusal(name, sensor.camera_model, target, found, allowed, by_rule=allowed_px is None)
        return TriedConversion(found.misfit_px, allowed, RefusedInputError(why, code="not-expressible"))
    camera = CAMERA_MODELS[target]
    names = list(camera.parameter_names)
    sigma = [None] * len(names) if found.P is None else np.sqrt(np.maximum(np.diag(found.P), 0.0)).tolist()
    written = {
        "schema": SCHEMA,
        "sensor": sensor.name,
        "camera_model": target,
        "parameters": dict(zip(names, found.x.tolist(), strict=True)),
        "units": dict(zip(names, camera.units, strict=True)),
        "sigma": dict(zip(names, sigma, strict=True)),
        "covariance": None if found.P is None else {"names": names, "matrix": found.P.tolist()},
        "conversion": _how(name, sensor.camera_model, x, found, allowed, _assumed(document, sensor))
        | _describe_residual(spline, found),
    }
    parse_parameters(written, sensor_under(sensor, written), f"{name} converted to {target}")
    return TriedConversion(found.misfit_px, allowed, written)


def _describe_residual(spline: ResidualSplineFit | None, found: Conversion) -> dict[str, Any]:
    """Say what residual the target follows too, and how far its directions are turned about the axes of D: C_SD turns back."""
    if spline is None:
        return {}
    largest = np.hypot(*spline.displacement_px)
    return {
        "residual": {
            "max_px": float(largest.max()),
            "rms_px": float(np.sqrt(np.mean(largest**2))),
            "max_sigma_px": float(spline.sigma_px.max()),
            "p": spline.p,
        },
        "turn_rad": rotation_vector(to_quaternion(found.turn)).tolist(),
    }


def _given(document: Mapping[str, Any], sensor: Sensor, name: str, target: str) -> tuple[FloatArray, FloatArray | None]:
    """Read the parameters; refuse a model that there is not, and their own."""
    if target not in CAMERA_MODELS:
        raise RefusedInputError(f"There is no camera model {target!r}: choose {' or '.join(CAMERA_MODELS)}.")
    x, P = parse_parameters(document, sensor, name)
    if target == sensor.camera_model:
        others = " or ".join(model for model in CAMERA_MODELS if model != target)
        raise RefusedInputError(f"{name} is in {target} already: choose {others} to convert it to.")
    return x, P


def _assumed(document: Mapping[str, Any], sensor: Sensor) -> list[str]:
    """Name the parameters that a document with a covariance did not estimate."""
    covariance = document.get("covariance")
    estimated = covariance["names"] if covariance else ()
    return [name for name in CAMERA_MODELS[sensor.camera_model].parameter_names if estimated and name not in estimated]


def _plain(value: float) -> str:
    """Write a number with two digits, and without a power of ten below a million."""
    return f"{float(f'{value:.2g}'):g}"


def _refusal(name: str, source: str, target: str, found: Conversion, allowed_px: float, *, by_rule: bool) -> str:
    """One sentence that says by how much, why, and what to do instead."""
    size = (
        f"differs from {source} by up to {_plain(found.misfit_px)} px ({_plain(found.misfit_rad * ARCSEC_PER_RAD)} arcsec) over "
        "the detector"
        if math.isfinite(found.misfit_px)
        else f"cannot be compared with {source} over the whole detector"
    )
    rule = f" ({100 * ALLOWED_SHARE:g} % of the sensor's centroid_sigma_px)" if by_rule else ""
    return (
        f"{name} cannot be converted to {target}: even the best fit {size}, where {allowed_px:.2g} px is allowed{rule}, "
        f"because {_reason(source, target)}; calibrate the telemetry under {target} instead, or allow more."
    )


def _reason(source: str, target: str) -> str:
    """Why the one model cannot say what the other does."""
    seen, meant = CAMERA_MODELS[source], CAMERA_MODELS[target]
    lacking = {one.role for one in seen.parameters} & set(NEUTRAL) - {one.role for one in meant.parameters}
    if lacking:
        return f"{target} has no {' or '.join(sorted(role.value for role in lacking))}"
    if seen.equations.runs != meant.equations.runs:
        return f"the radial polynomial of {source} runs {seen.equations.runs}, that of {target} {meant.equations.runs}"
    return f"{target} has fewer radial terms or defines the radius differently"


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
