"""What no telemetry can show and an operator declares in the sensor file: readout, satellite velocity, directions, refraction.

A rolling shutter exposes line after line. The centroid of a star on line l (a row, or a column) was taken l * line_time_s later
than one on the first line, and the sky moved in between; along some axes a camera model takes that up as scale and distortion,
with residuals as small as ever. The other declarations say how star directions were formed: an error in them is as smooth over
the field. So each is asked once, by name; until it is answered a calibration states what it assumed (`calibration.assumptions`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

from boresight.telemetry.read.checks import Faults

GLOBAL: Final = "global"
ROLLING: Final = "rolling"
MODES = (GLOBAL, ROLLING)
AXES = ("rows", "columns")
#: Seconds a line may take, either way: a detector that is read from its last line has a negative line time.
LINE_TIME_S = (1e-9, 0.1)


@dataclass(frozen=True)
class Declaration:
    """One thing that is declared: its title, and what may be declared, each word with its meaning."""

    name: str
    title: str
    words: Mapping[str, str]


#: What is declared beside the readout, by name.
DECLARATIONS = {
    one.name: one
    for one in (
        Declaration(
            "satellite_velocity",
            "Satellite velocity",
            {
                "given": "the telemetry gives it, or its directions hold its aberration already",
                "negligible": "too small to matter, as on the ground",
            },
        ),
        Declaration(
            "directions",
            "Directions of the telemetry",
            {
                "apparent": "ra_deg and dec_deg hold aberration",
                "j2000": "ra_deg and dec_deg are of epoch J2000.0, without motion, parallax and aberration",
            },
        ),
        Declaration(
            "refraction",
            "Refraction by the air",
            {
                "none": "images from space",
                "corrected": "images from the ground, with refraction in their directions",
                "uncorrected": "images from the ground, as they came",
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
        return f"rolling shutter along {self.axis}, {abs(self.line_time_s or 0.0) * 1e6:.4g} µs a line, not corrected"


@dataclass(frozen=True)
class Declared:
    """A word of each of `DECLARATIONS`, None where nothing is declared."""

    satellite_velocity: str | None = None
    directions: str | None = None
    refraction: str | None = None

    def document(self) -> dict[str, str]:
        """Return what is declared as a sensor file has it."""
        return {name: word for name, word in vars(self).items() if word is not None}


NOTHING_DECLARED = Declared()


def parse_readout(value: Any, faults: Faults) -> Readout | None:
    """Read the `readout` of a sensor file; None where there is none, or a fault."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or value.get("mode") not in MODES:
        shown = value.get("mode") if isinstance(value, Mapping) else value
        faults.add(f"readout.mode is {shown!r}: write global, or rolling for a shutter that reads line after line")
        return None
    _refuse_unknown("readout", value, tuple(item.name for item in fields(Readout)), faults)
    if value["mode"] == GLOBAL:
        if set(value) - {"mode"}:
            faults.add(
                "readout.mode is global, where nothing else has a meaning: leave the others out, or write rolling"
            )
        return Readout(GLOBAL)
    axis, corrected = value.get("axis", AXES[0]), value.get("corrected", False)
    if axis not in AXES:
        faults.add(f"readout.axis is {axis!r}: write rows if a line is a row, or columns")
    if not isinstance(corrected, bool):
        faults.add(
            f"readout.corrected is {corrected!r}: write true if the telemetry's centroids are corrected, or false"
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
        f"readout.line_time_s is {'missing' if value is None else repr(value)}: give the seconds from one line to the next, "
        f"{low:g} to {high:g}, negative if the last line is read first"
    )
    return None


def parse_declared(value: Any, faults: Faults) -> Declared:
    """Read the `declared` of a sensor file."""
    if value is None:
        return Declared()
    if not isinstance(value, Mapping):
        faults.add(f"declared is {value!r}: write an object with {', '.join(DECLARATIONS)}")
        return Declared()
    _refuse_unknown("declared", value, tuple(DECLARATIONS), faults)
    for name, declaration in DECLARATIONS.items():
        if name in value and value[name] not in tuple(declaration.words):
            faults.add(f"declared.{name} is {value[name]!r}: write {' or '.join(declaration.words)}, or leave it out")
    return Declared(**{name: value[name] for name in DECLARATIONS if name in value})


def _refuse_unknown(key: str, value: Mapping[str, Any], known: tuple[str, ...], faults: Faults) -> None:
    for name in value:
        if name not in known:
            faults.add(f"{key}.{name} is not a field: it has {', '.join(known)}")
