"""What telemetry never shows and an operator declares in the sensor file: readout, velocity, directions, refraction, site, lens.

A rolling shutter exposes line after line. The centroid of a star on line l (a row, or a column) was taken l * line_time_s later
than one on the first line, and the sky moved in between; along some axes a camera model takes that up as scale and distortion,
with residuals as small as ever. The other declarations say how star directions were formed: an error in them is as smooth over
the field. So each is asked once, by name; until it is answered a calibration states what it assumed (`calibration.assumptions`).

A camera on the ground has a `site`: where it stands, and the air above it (`sky.ground` bends the stars' directions by it).
Latitude and longitude are asked; the rest has the values of `SITE_FIELDS` where nobody gives it, and the pressure that of the
height.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

from boresight.cameras.model import CameraModel, Role
from boresight.site import SITE_FIELDS, Site, SiteField
from boresight.telemetry.read.checks import Faults
from boresight.wording import quote

GLOBAL: Final = "global"
ROLLING: Final = "rolling"
MODES = (GLOBAL, ROLLING)
AXES = ("rows", "columns")
#: Seconds a line may take, either way: a detector that is read from its last line has a negative line time.
LINE_TIME_S = (1e-9, 0.1)


@dataclass(frozen=True)
class Declaration:
    """One thing that is declared: its title, and what may be declared, each word with its meaning.

    `role`: cameras with a parameter of this role estimate it, and nobody need declare it. `condition`: of what telemetry it tells.
    """

    name: str
    title: str
    words: Mapping[str, str]
    role: Role | None = None
    condition: str = ""

    def is_asked(self, camera: CameraModel) -> bool:
        """Whether it is asked of a camera."""
        return self.role is None or all(one.role is not self.role for one in camera.parameters)


#: What is declared beside the readout, by name.
DECLARATIONS = {
    one.name: one
    for one in (
        Declaration(
            "satellite_velocity",
            "Satellite velocity",
            {
                "given": "the telemetry contains it, or its directions already include aberration",
                "negligible": "too small to matter, as on the ground",
            },
        ),
        Declaration(
            "directions",
            "Directions of the telemetry",
            {
                "apparent": "ra_deg and dec_deg include aberration",
                "j2000": "ra_deg and dec_deg are of epoch J2000.0, without motion, parallax and aberration",
            },
            condition="where the file gives them",
        ),
        Declaration(
            "refraction",
            "Refraction by the air",
            {
                "none": "images from space",
                "corrected": "images from the ground, with refraction in their directions",
                "uncorrected": "images from the ground, uncorrected, and directions without refraction",
            },
        ),
        Declaration(
            "tilt",
            "Tilt of the detector",
            {"aligned": "the detector was measured to be square to the optical axis, or its tilt is negligible"},
            Role.TILT,
        ),
        Declaration(
            "decentring",
            "Decentring of the lens",
            {"centred": "the lens was measured to have no tangential distortion, or it is negligible"},
            Role.DECENTRING,
        ),
        Declaration(
            "centroids",
            "Centroids over the detector",
            {
                "unbiased": "they were measured to have no systematic displacements with position or brightness (readout seams, "
                "charge left behind, the window), or these are negligible"
            },
        ),
    )
}


@dataclass(frozen=True)
class Readout:
    """How a detector is read.

    `mode`: `global`, or `rolling`, line after line. `line_time_s`: seconds from one line to the next, negative where the last is
    read first. `axis`: whether a line is one of the `rows` or of the `columns`. `corrected`: whether the centroids of the telemetry
    are free of it.
    """

    mode: str
    line_time_s: float | None = None
    axis: str = AXES[0]
    corrected: bool = False

    @property
    def is_in_centroids(self) -> bool:
        """Whether centroids are displaced by the readout as they come."""
        return self.mode == ROLLING and not self.corrected

    def document(self) -> dict[str, Any]:
        """Return it as a sensor file has it."""
        if self.mode == GLOBAL:
            return {"mode": self.mode}
        times = {} if self.line_time_s is None else {"line_time_s": self.line_time_s}
        return {"mode": self.mode, **times, "axis": self.axis, "corrected": self.corrected}

    @property
    def words(self) -> str:
        """Say it in words."""
        if self.mode == GLOBAL:
            return "global shutter"
        if self.corrected:
            return "rolling shutter, corrected in the telemetry"
        return f"rolling shutter along {self.axis}, {abs(self.line_time_s or 0.0) * 1e6:.4g} µs per line, not corrected"


@dataclass(frozen=True)
class Declared:
    """A word of each of `DECLARATIONS`, None where nothing is declared."""

    satellite_velocity: str | None = None
    directions: str | None = None
    refraction: str | None = None
    tilt: str | None = None
    decentring: str | None = None
    centroids: str | None = None

    def document(self) -> dict[str, str]:
        """Return what is declared as a sensor file has it."""
        return {name: word for name, word in vars(self).items() if word is not None}


NOTHING_DECLARED = Declared()

BYTE_ORDERS = ("little", "big")
#: Bits of a number of a raw image, and bytes before the first.
RAW_BITS, MOST_HEADER_BYTES = (8, 16), 1 << 20
#: Electrons a DN, and DN, that a detector may have.
GAIN_E_PER_DN, SATURATION_DN = (1e-3, 1e4), (1.0, 1e9)


@dataclass(frozen=True)
class ImageFormat:
    """How images of a sensor are to be read where their files do not say it.

    `bits`: of a number of a raw image, which has one byte up to 8 of them and two beyond. `byte_order`: of two bytes.
    `header_bytes`: before the first number. `gain_e_per_dn`: electrons a DN. `saturation_dn`: from here on a pixel says nothing.
    """

    bits: int | None = None
    byte_order: str = BYTE_ORDERS[0]
    header_bytes: int = 0
    gain_e_per_dn: float | None = None
    saturation_dn: float | None = None

    def document(self) -> dict[str, Any]:
        """Return it as a sensor file has it: what is not the default."""
        return {name: value for name, value in vars(self).items() if value != getattr(NO_FORMAT, name)}


NO_FORMAT = ImageFormat()


def parse_image_format(value: Any, faults: Faults) -> ImageFormat:
    """Read the `image` of a sensor file."""
    if value is None:
        return NO_FORMAT
    names = tuple(item.name for item in fields(ImageFormat))
    if not isinstance(value, Mapping):
        faults.add(f"image is {value!r}: write an object with {', '.join(names)}")
        return NO_FORMAT
    _refuse_unknown("image", value, names, faults)
    limits = {"bits": RAW_BITS, "header_bytes": (0, MOST_HEADER_BYTES)}
    for name, (low, high) in (limits | {"gain_e_per_dn": GAIN_E_PER_DN, "saturation_dn": SATURATION_DN}).items():
        number = value.get(name)
        whole = name in limits
        kinds = int if whole else (int, float)
        if number is not None and (
            isinstance(number, bool) or not isinstance(number, kinds) or not low <= number <= high
        ):
            faults.add(
                f"image.{name} is {number!r}: give a {'whole ' * whole}number from {low:g} to {high:g}, or omit it"
            )
            return NO_FORMAT
    if value.get("byte_order", BYTE_ORDERS[0]) not in BYTE_ORDERS:
        faults.add(f"image.byte_order is {value['byte_order']!r}: write {' or '.join(BYTE_ORDERS)}")
        return NO_FORMAT
    return ImageFormat(**{name: value[name] for name in names if value.get(name) is not None})


def parse_site(value: Any, faults: Faults) -> Site | None:
    """Read the `site` of a sensor file; None where there is none, or a fault."""
    if value is None:
        return None
    if not isinstance(value, Mapping):
        faults.add(f"site is {value!r}: write an object with latitude_deg and longitude_deg")
        return None
    _refuse_unknown("site", value, tuple(SITE_FIELDS), faults)
    numbers = {name: _site_number(one, value.get(name), faults) for name, one in SITE_FIELDS.items()}
    return None if numbers["latitude_deg"] is None or numbers["longitude_deg"] is None else Site(**numbers)  # type: ignore[arg-type] # both are there


def _site_number(one: SiteField, value: Any, faults: Faults) -> float | None:
    """Return a number of a site within its bounds, None with a fault where it is none."""
    if value is None:
        if not one.optional:
            faults.add(f"site.{one.name} is missing: give it in degrees", name=one.name)
        return None
    if isinstance(value, int | float) and not isinstance(value, bool) and one.lowest <= value <= one.highest:
        return float(value)
    faults.add(
        f"site.{one.name} is {value!r}: give a number from {one.lowest:g} to {one.highest:g}{one.unit and f' {one.unit}'}, "
        f"{one.sentence}",
        name=one.name,
    )
    return None


def parse_readout(value: Any, faults: Faults) -> Readout | None:
    """Read the `readout` of a sensor file; None where there is none, or a fault."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or value.get("mode") not in MODES:
        given = value.get("mode") if isinstance(value, Mapping) else value
        faults.add(f"readout.mode is {quote(given)}: write global, or rolling for a shutter that reads line after line")
        return None
    _refuse_unknown("readout", value, tuple(item.name for item in fields(Readout)), faults)
    if value["mode"] == GLOBAL:
        if set(value) - {"mode"}:
            faults.add("readout.mode is global, which allows no other fields: omit the others, or write rolling")
        return Readout(GLOBAL)
    axis, corrected = value.get("axis", AXES[0]), value.get("corrected", False)
    if axis not in AXES:
        faults.add(f"readout.axis is {quote(axis)}: write rows if a line is a row, or columns")
    if not isinstance(corrected, bool):
        faults.add(
            f"readout.corrected is {quote(corrected)}: write true if the telemetry's centroids are corrected, or false"
        )
    return Readout(
        ROLLING, _line_time(value.get("line_time_s"), corrected is True, faults), str(axis), corrected is True
    )


def _line_time(value: Any, corrected: bool, faults: Faults) -> float | None:
    """Return the time of a line; it may be left out only where it is not needed."""
    if value is None and corrected:
        return None
    low, high = LINE_TIME_S
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and low <= abs(value) <= high:
        return float(value)
    faults.add(
        f"readout.line_time_s is {'missing' if value is None else quote(value)}: give the seconds from one line to the next, "
        f"{low:g} to {high:g}, negative if the last line is read first"
    )
    return None


def parse_declared(value: Any, faults: Faults) -> Declared:
    """Read the `declared` of a sensor file."""
    if value is None:
        return Declared()
    if not isinstance(value, Mapping):
        faults.add(f"declared is {quote(value)}: write an object with {', '.join(DECLARATIONS)}")
        return Declared()
    _refuse_unknown("declared", value, tuple(DECLARATIONS), faults)
    for name, declaration in DECLARATIONS.items():
        if name in value and value[name] not in tuple(declaration.words):
            faults.add(f"declared.{name} is {quote(value[name])}: write {' or '.join(declaration.words)}, or omit it")
    return Declared(**{name: value[name] for name in DECLARATIONS if name in value})


def _refuse_unknown(key: str, value: Mapping[str, Any], known: tuple[str, ...], faults: Faults) -> None:
    for name in value:
        if name not in known:
            meant = difflib.get_close_matches(str(name)[:40], known, 1, 0.6)
            faults.add(
                f"{key}.{str(name)[:40]} is not a field: "
                + (f"did you mean {meant[0]}?" if meant else f"choose from {', '.join(known)}")
            )
