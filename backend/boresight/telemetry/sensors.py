"""The sensor description: detector, camera model, starting parameters and their typical spread."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS, CameraModel
from boresight.errors import RefusedInputError
from boresight.site import Site
from boresight.telemetry.declarations import (
    NO_FORMAT,
    NOTHING_DECLARED,
    Declared,
    ImageFormat,
    Readout,
    parse_declared,
    parse_image_format,
    parse_readout,
    parse_site,
)
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.read.formats import read_json
from boresight.wording import quote

_REQUIRED = ("name", "detector", "camera_model", "parity", "centroid_sigma_px", "initial", "typical_sigma")
#: Focal length as it is kept, and as a file may give it instead.
FOCAL_M, FOCAL_PX = "f_m", "f_px"
_OPTIONAL = ("free", "magnitude_limit", "readout", "declared", "site", "image")
_LONGEST_NAME = 64
_MOST_FIELDS = 100
_MOST_PIXELS = 65536
_PITCH_M = (1e-7, 1e-3)
_SIGMA_PX = (1e-4, 100.0)
#: Longest that a detector takes to be read, s.
_READOUT_S = 10.0
_MAGNITUDE = (-2.0, 20.0)
_FIELD_DEG = (0.1, 175.0)


@dataclass(frozen=True)
class Sensor:
    """One star tracker as its sensor file describes it.

    Parameters
    ----------
    name
        Unique in a fleet.
    rows, columns
        Detector size, pixels.
    pixel_pitch_m
        Pixel size Delta, metres.
    camera_model
        A name in `boresight.cameras.CAMERA_MODELS`.
    parity
        +1 or -1, see the notation page.
    centroid_sigma_px
        One-axis standard deviation of a centroid, where telemetry gives none of its own.
    initial, typical_sigma
        (n_parameters,) starting values and unit-to-unit spread (E Table II), in the camera model's parameter order, SI.
    free
        Names of the parameters to estimate, in parameter order.
    magnitude_limit
        Faintest catalogue magnitude the sensor sees, or None.
    readout
        How the detector is read, or None where nobody declared it.
    declared
        What else the data cannot show, as far as it is declared.
    site
        Where on the ground it stands, and the air above; None in space, or where nobody said so.
    image
        How its images are to be read where their files do not say it.
    """

    name: str
    rows: int
    columns: int
    pixel_pitch_m: float
    camera_model: str
    parity: int
    centroid_sigma_px: float
    initial: FloatArray
    typical_sigma: FloatArray
    free: tuple[str, ...]
    magnitude_limit: float | None = None
    readout: Readout | None = None
    declared: Declared = NOTHING_DECLARED
    site: Site | None = None
    image: ImageFormat = NO_FORMAT


def read_sensor(path: Path) -> Sensor:
    """Read a sensor file.

    Raises
    ------
    RefusedInputError
        When there is no such file, it is not JSON, or a field is wrong; names the field.
    """
    path = Path(path)
    try:
        document = read_json(path, path.name)
    except json.JSONDecodeError as error:
        raise RefusedInputError(
            f"{path.name}: row {error.lineno}: this is not JSON: write the sensor file as one JSON object."
        ) from error
    if not isinstance(document, dict):
        raise RefusedInputError(f"{path.name} is not a sensor file: write one JSON object with a name and a detector.")
    return _parse(document, Faults(path.name))


def parse_sensor(document: Mapping[str, Any]) -> Sensor:
    """Turn a sensor document into a sensor."""
    return _parse(document, Faults("The sensor description"))


@dataclass(frozen=True)
class DescribedCamera:
    """What the stored document of a sensor says of its camera: its model, the names that are free, and its detector in metres.

    `initial`: starting values by name, SI, as the document has them.
    """

    name: str
    camera_model: str
    free: tuple[str, ...]
    initial: Mapping[str, float]
    rows: int
    columns: int
    pixel_pitch_m: float


def read_described_camera(document: Mapping[str, Any]) -> DescribedCamera:
    """Read the camera of a document that `parse_sensor` has accepted before, without its checks, which take nearly all its time."""
    detector, model = document["detector"], str(document["camera_model"])
    return DescribedCamera(
        name=str(document["name"]),
        camera_model=model,
        free=tuple(document.get("free") or CAMERA_MODELS[model].parameter_names),
        initial=document["initial"],
        rows=int(detector["rows"]),
        columns=int(detector["columns"]),
        pixel_pitch_m=float(detector["pixel_pitch_m"]),
    )


def sensor_document(sensor: Sensor) -> dict[str, Any]:
    """Return the document of a sensor, as `parse_sensor` reads it."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    document: dict[str, Any] = {
        "name": sensor.name,
        "detector": {"rows": sensor.rows, "columns": sensor.columns, "pixel_pitch_m": sensor.pixel_pitch_m},
        "camera_model": sensor.camera_model,
        "parity": sensor.parity,
        "centroid_sigma_px": sensor.centroid_sigma_px,
        "initial": dict(zip(names, sensor.initial.tolist(), strict=True)),
        "typical_sigma": dict(zip(names, sensor.typical_sigma.tolist(), strict=True)),
        "free": list(sensor.free),
    }
    if sensor.magnitude_limit is not None:
        document["magnitude_limit"] = sensor.magnitude_limit
    if sensor.readout is not None:
        document["readout"] = sensor.readout.document()
    if declared := sensor.declared.document():
        document["declared"] = declared
    if sensor.site is not None:
        document["site"] = sensor.site.document()
    if image := sensor.image.document():
        document["image"] = image
    return document


def _parse(document: Mapping[str, Any], faults: Faults) -> Sensor:
    """Check every field, collecting faults; refuse when there are any."""
    _check_keys(document, faults)
    faults.refuse()
    detector = _mapping(document, "detector", faults)
    model = _camera_model(document["camera_model"], faults)
    faults.refuse()
    names = model.parameter_names
    pitch = _number(detector.get("pixel_pitch_m"), "detector.pixel_pitch_m", _PITCH_M, faults)
    sensor = Sensor(
        name=_name(document["name"], faults),
        rows=_pixels(detector, "rows", faults),
        columns=_pixels(detector, "columns", faults),
        pixel_pitch_m=pitch,
        camera_model=model.name,
        parity=_parity(document["parity"], faults),
        centroid_sigma_px=_number(document["centroid_sigma_px"], "centroid_sigma_px", _SIGMA_PX, faults),
        initial=_parameters(document, "initial", model, model.plausible, pitch, faults),
        typical_sigma=_parameters(document, "typical_sigma", model, _spreads(model), pitch, faults),
        free=_free(document.get("free"), names, faults),
        magnitude_limit=_magnitude_limit(document.get("magnitude_limit"), faults),
        readout=parse_readout(document.get("readout"), faults),
        declared=parse_declared(document.get("declared"), faults),
        site=parse_site(document.get("site"), faults),
        image=parse_image_format(document.get("image"), faults),
    )
    if sensor.site is not None and sensor.declared.refraction == "none":
        faults.add(
            "declared.refraction is none, images from space, and there is a site on the ground: omit one of the two"
        )
    _check_readout(sensor, faults)
    faults.refuse()
    check_geometry(sensor, model, faults)
    faults.refuse()
    return sensor


def _check_readout(sensor: Sensor, faults: Faults) -> None:
    """Refuse a line time with which the whole detector would take longer to read than any does."""
    readout = sensor.readout
    if readout is None or readout.line_time_s is None:
        return
    lines = sensor.rows if readout.axis == "rows" else sensor.columns
    seconds = abs(readout.line_time_s) * lines
    if seconds > _READOUT_S:
        faults.add(
            f"readout.line_time_s is {readout.line_time_s:g}: {lines:,} lines would take {seconds:.3g} s, but at most "
            f"{_READOUT_S:g} s are possible: give seconds from one line to the next, not of a frame"
        )


def _check_keys(document: Mapping[str, Any], faults: Faults) -> None:
    """Find missing keys, and unknown ones that look like a known key misspelt."""
    for key in _REQUIRED:
        if key not in document:
            faults.add(f"{key} is missing: add it")
    if len(document) > _MOST_FIELDS:
        faults.add(
            f"there are {len(document):,} fields, at most {_MOST_FIELDS} are read: keep those that the documentation lists"
        )
        return
    known = (*_REQUIRED, *_OPTIONAL)
    for key in document:
        meant = difflib.get_close_matches(key, known, 1, 0.8) if key not in known else []
        if meant:
            faults.add(f"{key} is not a field: write {meant[0]}")


def _mapping(document: Mapping[str, Any], key: str, faults: Faults) -> Mapping[str, Any]:
    """Return a field that must be an object; an empty one when it is not."""
    value = document[key]
    if isinstance(value, Mapping):
        return value
    faults.add(f"{key} is {quote(value)}: write an object of names and numbers")
    return {}


def _name(value: Any, faults: Faults) -> str:
    if isinstance(value, str) and value.strip() == value and 0 < len(value) <= _LONGEST_NAME and value.isprintable():
        return value
    faults.add(f"name is {quote(value)}: write a text of 1 to {_LONGEST_NAME} printable characters")
    return ""


def _number(value: Any, field: str, limits: tuple[float, float], faults: Faults) -> float:
    """Return a finite number between two limits; NaN with a fault otherwise."""
    if value is None:
        faults.add(f"{field} is missing: give a number")
    elif isinstance(value, bool) or not isinstance(value, int | float):
        faults.add(f"{field} is {quote(value)}: give a number")
    elif isinstance(value, float) and not math.isfinite(value):
        faults.add(f"{field} is {value}: give a finite number")
    elif not limits[0] <= value <= limits[1]:
        faults.add(f"{field} is {quote(value)}, expected {limits[0]:g} to {limits[1]:g}: check its unit")
    else:
        return float(value)
    return math.nan


def _pixels(detector: Mapping[str, Any], key: str, faults: Faults) -> int:
    value = _number(detector.get(key), f"detector.{key}", (1, _MOST_PIXELS), faults)
    if math.isnan(value):
        return 0
    if value != round(value):
        faults.add(f"detector.{key} is {value:g}: give a whole number of pixels")
    return round(value)


def _parity(value: Any, faults: Faults) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and value in {1, -1}:
        return value
    faults.add(f"parity is {quote(value)}: give 1 for a right-handed detector frame or -1 for an upright image")
    return 0


def _camera_model(value: Any, faults: Faults) -> CameraModel:
    """Return the model of a name; any model, with a fault, when there is none such."""
    if isinstance(value, str) and value in CAMERA_MODELS:
        return CAMERA_MODELS[value]
    faults.add(f"camera_model is {quote(value)}: choose {' or '.join(CAMERA_MODELS)}")
    return next(iter(CAMERA_MODELS.values()))


def _spreads(model: CameraModel) -> tuple[tuple[float, float], ...]:
    """Return the limits of each typical sigma: positive, and not wider than the plausible range."""
    return tuple((1e-15 * (high - low), high - low) for low, high in model.plausible)


def _parameters(
    document: Mapping[str, Any],
    key: str,
    model: CameraModel,
    limits: tuple[tuple[float, float], ...],
    pitch: float,
    faults: Faults,
) -> FloatArray:
    """Return (n_parameters,) values in the model's order, all of them given and none unknown."""
    values = in_metres(_mapping(document, key, faults), model.parameter_names, pitch)
    for name in values:
        if name not in model.parameter_names:
            faults.add(
                f"{key}.{name} is not a parameter of {model.name}: choose from {', '.join(model.parameter_names)}"
            )
    pairs = zip(model.parameter_names, limits, strict=True)
    return np.array([_number(values.get(name), f"{key}.{name}", limit, faults) for name, limit in pairs])


def in_metres(values: Mapping[str, Any], names: tuple[str, ...], pitch: float) -> Mapping[str, Any]:
    """Return values by name with the focal length in metres, where a file gives it in pixels, as OpenCV does."""
    if FOCAL_PX not in values or FOCAL_M in values or FOCAL_M not in names:
        return values
    focal = values[FOCAL_PX]
    is_number = isinstance(focal, int | float) and not isinstance(focal, bool)
    return {FOCAL_M: focal * pitch if is_number else focal} | {k: v for k, v in values.items() if k != FOCAL_PX}


def _free(value: Any, names: tuple[str, ...], faults: Faults) -> tuple[str, ...]:
    """Return the names of the free parameters in the model's order; all of them when none are named."""
    if value is None:
        return names
    if not isinstance(value, list | tuple) or not value:
        faults.add(f"free is {quote(value)}: list the parameters to estimate, or omit it for all")
        return ()
    if FOCAL_M in names:
        value = [FOCAL_M if name == FOCAL_PX else name for name in value]
    for name in value:
        if name not in names:
            faults.add(f"free names {quote(name)}: choose from {', '.join(names)}")
    return tuple(name for name in names if name in value)


def _magnitude_limit(value: Any, faults: Faults) -> float | None:
    return None if value is None else _number(value, "magnitude_limit", _MAGNITUDE, faults)


def check_geometry(sensor: Sensor, model: CameraModel, faults: Faults, subject: str = "initial") -> None:
    """Note in `faults` a camera that no star tracker is: principal point far off the detector, blind corners, an absurd field.

    `subject` is what the sensor's `initial` is called there, for a state that comes from elsewhere.
    """
    row, col = model.principal_point(sensor.initial)
    if not (-sensor.rows < row < 2 * sensor.rows and -sensor.columns < col < 2 * sensor.columns):
        faults.add(
            f"{subject} puts the principal point at row {row:g}, column {col:g}, far outside the detector: correct it"
        )
        return
    corner = model.blind_corner(sensor.initial, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    if corner is not None:
        faults.add(
            f"{subject} has a distortion that folds back before the corner at row {corner[0]:g}, column {corner[1]:g}, "
            "so this position has no direction: correct its distortion coefficients"
        )
        return
    rows, columns = np.array([0.0, sensor.rows - 1.0]), np.array([0.0, sensor.columns - 1.0])
    corners = model.directions_of_few(sensor.initial, rows, columns, sensor.pixel_pitch_m)
    with np.errstate(all="ignore"):
        field_deg = math.degrees(2.0 * math.asin(min(1.0, float(np.linalg.norm(corners[1] - corners[0])) / 2.0)))
    if not _FIELD_DEG[0] <= field_deg <= _FIELD_DEG[1]:
        faults.add(
            f"{subject} gives a field of view of {field_deg:.3g} degrees from corner to corner, expected "
            f"{_FIELD_DEG[0]:g} to {_FIELD_DEG[1]:g}: check focal length, distortion and pixel_pitch_m (all in metres)"
        )
