"""A whole sensor file from what a data sheet says: detector, pixel and lens; every other number derived, each with its reason.

A focal length f and a field of view W across a side of N pixels of size Delta tell the same,

    f = N Delta / (2 tan(W / 2)),

so either will do. The spreads from unit to unit are what a lens and its mount are off by before anybody calibrates them:

===================  ==================================================================================================
focal length         `FOCAL_SHARE` of it: makers state 1 to 2 %, and a lens is focused by hand
principal point      `MOUNT_UM` of mounting, at most `MOST_OF_SIDE` of the longer side
radial terms         what moves a star in the corner by `DISTORTED` of its distance from the middle
decentring terms     what moves it by `DECENTRED` of that
tilt, aspect         the camera's own, as of the trackers in E Table II
===================  ==================================================================================================

A term's slope there, pixels a unit, is |ds/dp| over the angle of a pixel at the corner of a plain camera, from the camera's own
derivatives; so this holds of every camera there is. Estimated are focal length, principal
point and the lowest radial term, whose displacement falls slowest toward the middle; `boresight choose` tells what a set asks for
beyond.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras import CAMERA_MODELS, CameraModel, usual_camera
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.site import SITE_FIELDS
from boresight.telemetry.data_sheets import ASKED, DATA_SHEETS, DataSheet, LensAndDetector
from boresight.telemetry.declarations import GLOBAL, Readout, parse_site
from boresight.telemetry.read.checks import Faults
from boresight.telemetry.sensors import Sensor, parse_sensor, sensor_document

FOCAL_SHARE, MOUNT_UM, MOST_OF_SIDE, DISTORTED, DECENTRED = 0.01, 100.0, 0.02, 0.005, 0.0005
#: Centroid noise where nobody gives one, pixels.
CENTROID_SIGMA_PX = 0.2
UPRIGHT = -1


@dataclass(frozen=True)
class Described:
    """A sensor that was made, and why its numbers are what they are: a sentence by field of its file."""

    sensor: Sensor
    reasons: dict[str, str]

    @property
    def document(self) -> dict[str, Any]:
        """The sensor file."""
        return sensor_document(self.sensor)


def describe_typed(typed: Mapping[str, str], subject: str = "The new sensor") -> Described:
    """Make a sensor of what was typed into a form, a text by name, of `ASKED`, of a site, and of the names of `LensAndDetector`.

    Raises RefusedInputError with every fault at once; empty texts are left out, and a comma may stand for the point.
    """
    faults = Faults(subject)
    found = _read_typed(typed, faults)
    try:
        described = describe_sensor(found, subject)
    except RefusedInputError as refusal:
        raise join_refusals(faults, refusal) from refusal
    faults.refuse()
    return described


def read_typed(typed: Mapping[str, str], subject: str = "The new sensor") -> LensAndDetector:
    """Read what was typed into a form as `describe_typed` does, of which nothing need be known."""
    faults = Faults(subject)
    found = _read_typed(typed, faults)
    faults.refuse()
    return found


def _read_typed(typed: Mapping[str, str], faults: Faults) -> LensAndDetector:
    given = {name: text for name, text in typed.items() if text}
    known: dict[str, Any] = {}
    for name, text in given.items():
        if name in ASKED:
            known[name] = _number(name, text, faults)
        elif name == "parity":
            known[name] = _parity(text, faults)
        elif name not in SITE_FIELDS:
            known[name] = text
    site = {name: _plain(given[name]) for name in SITE_FIELDS if name in given}
    return LensAndDetector(**known, site=parse_site(site or None, faults))


def join_refusals(faults: Faults, refusal: RefusedInputError) -> RefusedInputError:
    """Return the refusal of these faults and those of another one, less what is missing because it could not be read."""
    if not faults.count:
        return refusal
    unread = {one.name for one in faults.refusal().faults} - {""}
    for one in refusal.faults:
        if one.name not in unread:
            faults.add(one.detail, column=one.column, row=one.row, name=one.name)
    return faults.refusal()


def _plain(text: str) -> float | str:
    """Read a number; what is none, or not finite, stays as it was typed."""
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def _number(name: str, text: str, faults: Faults) -> float | int | None:
    asked = ASKED[name]
    value = _plain(text)
    if isinstance(value, str):
        faults.add(f"{name} is {text!r}: give a number of {asked.unit}", name=name)
        return None
    if asked.whole and value == round(value):
        return round(value)
    return value


def _parity(text: str, faults: Faults) -> int | None:
    if text in {"1", "+1", "-1", "−1"}:
        return -1 if text in {"-1", "−1"} else 1
    faults.add(f"parity is {text!r}: give -1 for an upright image, as on a screen, or 1 for one that is mirrored")
    return None


def complete(known: LensAndDetector, subject: str = "The new sensor") -> LensAndDetector:
    """Return what is known with what its data sheet tells beside it; nothing need be known.

    Raises RefusedInputError with every fault at once: what is out of bounds, and unknown names with what was probably meant.
    """
    faults = Faults(subject)
    sheet = _sheet(known.sheet, faults)
    at_hand = {name: _given(name, known, sheet) for name in ASKED}
    at_hand = {name: _checked(name, value, faults) for name, value in at_hand.items()}
    _camera(known.camera_model, faults)
    faults.refuse()
    whole = {name: value if value is None or not ASKED[name].whole else round(value) for name, value in at_hand.items()}
    return replace(known, **whole)  # type: ignore[arg-type]  # each by its own name


def describe_sensor(known: LensAndDetector, subject: str = "The new sensor") -> Described:
    """Make a whole sensor of what is known.

    Raises RefusedInputError with every fault at once: what is missing, out of bounds or contradicts itself, and unknown names with
    what was probably meant.
    """
    faults = Faults(subject)
    sheet = _sheet(known.sheet, faults)
    at_hand = {name: _given(name, known, sheet) for name in ASKED}
    at_hand = {name: _checked(name, value, faults) for name, value in at_hand.items()}
    model = _camera(known.camera_model, faults)
    if known.parity not in {None, 1, -1}:
        faults.add(f"parity is {known.parity!r}: give -1 for an upright image, or 1")
    for name in ("rows", "columns", "pixel_pitch_um"):
        if at_hand[name] is None and (sheet is not None or known.sheet is None):
            faults.add(f"{name} is missing: give it in {ASKED[name].unit}, or name a data sheet", name=name)
    focal_mm = _focal_mm(at_hand, sheet, faults) if sheet is not None or known.sheet is None else None
    faults.refuse()
    return _describe(known, sheet, at_hand, focal_mm or math.nan, model)


def _sheet(name: str | None, faults: Faults) -> DataSheet | None:
    if name is None or name in DATA_SHEETS:
        return None if name is None else DATA_SHEETS[name]
    folded = {one.casefold(): one for one in DATA_SHEETS}
    within = [one for low, one in folded.items() if name.casefold() in low]
    exact = folded.get(name.casefold())
    if exact or len(within) == 1:
        return DATA_SHEETS[exact or within[0]]
    meant = difflib.get_close_matches(name.casefold(), folded, 1, 0.4)
    guesses = within or [folded[one] for one in meant]
    hint = f"did you mean {' or '.join(guesses)}?" if guesses else f"choose from {', '.join(DATA_SHEETS)}"
    faults.add(f"there is no data sheet {name!r}: {hint}")
    return None


def _given(name: str, known: LensAndDetector, sheet: DataSheet | None) -> float | None:
    """What a person says of a number, else what the data sheet does."""
    value: float | None = getattr(known, name)
    if value is None and sheet is not None and not (name == "focal_length_mm" and known.field_of_view_deg is not None):
        value = getattr(sheet, name, None)
    return value


def _checked(name: str, value: Any, faults: Faults) -> float | None:
    """The value, or NaN with a fault where it is no number: it was given, and nothing follows from it."""
    asked = ASKED[name]
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not asked.lowest <= value <= asked.highest:
        hint = "check its unit" if isinstance(value, int | float) else "give a number"
        limits = f"{asked.lowest:g} to {asked.highest:g} {asked.unit}"
        faults.add(f"{name} is {value!r}, expected {limits}: {hint}", name=name)
    elif asked.whole and value != round(value):
        faults.add(f"{name} is {value:g}: give a whole number of pixels", name=name)
    return float(value) if isinstance(value, int | float) else math.nan


def _camera(name: str | None, faults: Faults) -> CameraModel | None:
    if name is None or name in CAMERA_MODELS:
        return None if name is None else CAMERA_MODELS[name]
    meant = difflib.get_close_matches(name, CAMERA_MODELS, 1, 0.4)
    faults.add(
        f"there is no camera model {name!r}: "
        + (f"did you mean {meant[0]}?" if meant else f"choose {' or '.join(CAMERA_MODELS)}")
    )
    return None


def _focal_mm(at_hand: Mapping[str, float | None], sheet: DataSheet | None, faults: Faults) -> float | None:
    """Focal length in millimetres, as given or by the field of view; None with a fault where neither tells it."""
    focal, view = at_hand["focal_length_mm"], at_hand["field_of_view_deg"]
    if focal is None and view is None:
        of = f" ({sheet.name} does not include a lens)" if sheet is not None else ""
        faults.add(
            f"focal_length_mm is missing{of}: give it in mm, or field_of_view_deg across the longer side",
            name="focal_length_mm",
        )
        return None
    rows, columns, pitch = (at_hand[name] for name in ("rows", "columns", "pixel_pitch_um"))
    if view is None or rows is None or columns is None or pitch is None or not 0 < view < 180:
        return focal
    from_view = max(rows, columns) * pitch * 1e-3 / (2 * math.tan(math.radians(view) / 2))
    if focal is not None and abs(from_view / focal - 1) > 0.05:
        faults.add(
            f"focal_length_mm is {focal:g} and field_of_view_deg {view:g}, which would be {from_view:.4g} mm across "
            f"{max(rows, columns):g} pixels of {pitch:g} µm: omit one of them, or correct rows, columns or pixel_pitch_um",
            name="focal_length_mm",
        )
    return from_view if focal is None else focal


def _describe(
    known: LensAndDetector,
    sheet: DataSheet | None,
    at_hand: Mapping[str, float | None],
    focal_mm: float,
    model: CameraModel | None,
) -> Described:
    """Derive the sensor of numbers that are sound, and say why."""
    rows, columns, pitch_um = (float(at_hand[name] or 0.0) for name in ("rows", "columns", "pixel_pitch_um"))
    focal_px = focal_mm * 1e3 / pitch_um
    half_field = math.degrees(math.atan(math.hypot(rows, columns) / 2 / focal_px))
    camera = model or usual_camera(half_field)
    x = camera.plain(focal_px, (rows - 1) / 2, (columns - 1) / 2, pitch_um / 1e6)
    sigma, why = _spreads(camera, x, int(rows), int(columns), pitch_um)
    names = camera.parameter_names
    free = _free(camera, x, int(rows), int(columns), pitch_um / 1e6)
    noise = at_hand["centroid_sigma_px"]
    reasons = {
        "detector": f"From the data sheet: {sheet.name} ({sheet.source})." if sheet else "As given.",
        "initial.focal_length": _why_focal(known, focal_mm, focal_px, rows, columns),
        "initial": "Without distortion, the principal point in the middle of the detector: a calibration starts from there.",
        **why,
        "free": f"{', '.join(free)}: needed for every lens. The others are held fixed until `boresight choose` shows that they "
        "are needed.",
        "camera_model": (
            "As given."
            if camera.usual is None or model
            else f"The corner is {half_field:.0f}° off the axis: {camera.usual.reason}."
        ),
        "centroid_sigma_px": (
            "As given."
            if noise is not None
            else f"{CENTROID_SIGMA_PX:g} px is usual for stars of a few pixels; each calibration measures that of its set."
        ),
        "parity": (
            "As given."
            if known.parity is not None
            else "An upright image, as on a screen, is -1; if no exposure is recognised, try 1, a mirrored one."
        ),
    }  # fmt: skip
    document: dict[str, Any] = {
        "name": known.name,
        "detector": {"rows": int(rows), "columns": int(columns), "pixel_pitch_m": pitch_um / 1e6},
        "camera_model": camera.name,
        "parity": known.parity or UPRIGHT,
        "centroid_sigma_px": CENTROID_SIGMA_PX if noise is None else noise,
        "initial": dict(zip(names, x.tolist(), strict=True)),
        "typical_sigma": dict(zip(names, sigma, strict=True)),
        "free": free,
    }
    if at_hand["magnitude_limit"] is not None:
        document["magnitude_limit"] = at_hand["magnitude_limit"]
    if sheet is not None and sheet.shutter is not None:
        if sheet.shutter == GLOBAL:
            document["readout"] = Readout(GLOBAL).document()
        reasons["readout"] = (
            "A global shutter, from the data sheet."
            if sheet.shutter == GLOBAL
            else "A rolling shutter: declare `readout` with its line_time_s, which the data sheet does not give."
        )
    if known.site is not None:
        document["site"] = known.site.document()
    return Described(parse_sensor(document), reasons)


def _why_focal(known: LensAndDetector, focal_mm: float, focal_px: float, rows: float, columns: float) -> str:
    across = 2 * math.degrees(math.atan(max(rows, columns) / 2 / focal_px))
    down = 2 * math.degrees(math.atan(min(rows, columns) / 2 / focal_px))
    start = "From the field of view" if known.focal_length_mm is None and known.field_of_view_deg else "Lens"
    return f"{start}: {focal_mm:.4g} mm, {focal_px:.0f} px; field of view {across:.3g}° by {down:.3g}°."


def _spreads(
    camera: CameraModel, x: FloatArray, rows: int, columns: int, pitch_um: float
) -> tuple[list[float], dict[str, str]]:
    """Spread of each parameter, and the sentences that explain them."""
    corner = math.hypot(rows, columns) / 2
    slope = _slopes(camera, x, rows, columns, pitch_um / 1e6, 1.0)
    off = min(MOUNT_UM / pitch_um, MOST_OF_SIDE * max(rows, columns))
    focal = camera.place(Role.FOCAL)
    by_role = {Role.RADIAL: DISTORTED * corner, Role.DECENTRING: DECENTRED * corner}
    found, why = [], dict[str, str]()
    for place, (name, one) in enumerate(zip(camera.parameter_names, camera.parameters, strict=True)):
        if place == focal:
            found.append(FOCAL_SHARE * float(x[place]))
            why[f"typical_sigma.{name}"] = (
                f"{FOCAL_SHARE:.0%} of it: makers state 1 to 2 %, and a lens is focused by hand."
            )
        elif one.role in {Role.ROW, Role.COLUMN}:
            found.append(off)
            why[f"typical_sigma.{name}"] = (
                f"{MOUNT_UM:g} µm of mounting, at most {MOST_OF_SIDE:.0%} of the longer side."
            )
        elif one.role in by_role and slope[place] > 0:
            found.append(float(by_role[one.role] / slope[place]))
            why[f"typical_sigma.{name}"] = f"One sigma moves a star in the corner by {by_role[one.role]:.2g} px."
        else:
            found.append(one.typical_sigma)
            why[f"typical_sigma.{name}"] = "The spread of the trackers in E Table II."
    return found, why


def _slopes(camera: CameraModel, x: FloatArray, rows: int, columns: int, pitch: float, share: float) -> FloatArray:
    """How far a unit of each parameter moves a star at a share of the way to the corner, pixels, (n_parameters,)."""
    row, col = (share * (side - 1) / 2 + (side - 1) / 2 for side in (rows, columns))
    _, D = camera.directions_and_jacobian(x, np.array([row]), np.array([col]), pitch)
    pixel = math.sqrt(float(camera.solid_angle(x, np.array([row]), np.array([col]), pitch)[0]))
    return np.asarray(np.linalg.norm(D[0], axis=0) / pixel)


def _free(camera: CameraModel, x: FloatArray, rows: int, columns: int, pitch: float) -> list[str]:
    """Focal length, principal point and the radial term that falls slowest toward the middle, in parameter order."""
    corner, halfway = (_slopes(camera, x, rows, columns, pitch, share) for share in (1.0, 0.5))
    radial = [place for place, one in enumerate(camera.parameters) if one.role is Role.RADIAL and corner[place] > 0]
    lowest = max(radial, key=lambda place: halfway[place] / corner[place], default=None)
    kept = {camera.place(Role.FOCAL), *camera.principal_places, *(() if lowest is None else (lowest,))}
    return [name for place, name in enumerate(camera.parameter_names) if place in kept]
