"""What was found of why a telemetry set does not match, as frozen dataclasses, and its JSON, `boresight.diagnosis/1`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from boresight.calibration.calibration import parse_part, to_plain
from boresight.errors import RefusedInputError

SCHEMA: Final = "boresight.diagnosis/1"
#: Every cause, with what it says of the file in a clause; the first says that nothing is wrong and the last that nobody knows.
CAUSES: Final = {
    "none": "sensor file and telemetry match",
    "parity": "the image is mirrored",
    "swapped_axes": "rows and columns are swapped",
    "flipped_rows": "rows are counted from the other edge",
    "flipped_columns": "columns are counted from the other edge",
    "half_pixel": "pixels are counted from another origin",
    "centred_origin": "pixels are counted from the middle of the detector",
    "length_unit": "centroids are lengths, not pixels",
    "focal_length": "the focal length is wrong",
    "j2000_directions": "star directions are not of the declared kind",
    "quaternion_order": "quaternions are written in another order or sense",
    "no_time": "the telemetry has no time",
    "wrong_epoch": "times are counted from another epoch",
    "magnitude_limit": "the magnitude limit is wrong",
    "unknown": "none of the tested causes explains it",
}

#: Share of the centroids that may lie off the detector where sensor file and telemetry are said to match.
MOST_OFF: Final = 0.2


@dataclass(frozen=True, kw_only=True)
class FoundCause:
    """A cause: how many of the exposures looked at are solved once all causes that are no alternatives are mended.

    `alternative`: whether it explains the same as well as the causes named before it, and stars cannot tell them apart.
    """

    name: str
    exposures_solved: int
    exposures: int
    alternative: bool = False


@dataclass(frozen=True, kw_only=True)
class Tried:
    """Something that was tried, and how many exposures and stars matched with it."""

    what: str
    exposures_solved: int
    stars: int


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why a telemetry set does not match its sensor file, or that it does.

    `of_exposures`: in the whole set, of which `exposures` were looked at, and `exposures_solved_before` match as the files stand.
    `sensor_document`: the mended sensor file, as it was where nothing of it is to be mended; None where the cause is unknown.
    `mapping`: how the telemetry is to be read (`TelemetryMapping`), None where as it stands. `cut_short`: whether the time limit
    ended the search. `off_detector`: share of the centroids that lie off the detector as the files stand. `log10_chance`: of the
    matches being coincidence, None where nothing was mended.
    """

    sensor: str
    causes: list[FoundCause]
    sentence: str
    tried: list[Tried] = field(default_factory=list)
    exposures: int = 0
    of_exposures: int = 0
    exposures_solved_before: int = 0
    exposures_solved: int = 0
    log10_chance: float | None = None
    cut_short: bool = False
    off_detector: float = 0.0
    sensor_document: dict[str, Any] | None = None
    mapping: dict[str, Any] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The causes that together explain the set."""
        return tuple(cause.name for cause in self.causes if not cause.alternative)

    @property
    def fits(self) -> bool:
        """Whether nothing is wrong."""
        return self.names == ("none",)

    @property
    def mends_sensor(self) -> bool:
        """Whether the sensor file is one of the things to mend."""
        return self.sensor_document is not None and bool(set(self.names) & IN_SENSOR)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON."""
        document: dict[str, Any] = {"schema": SCHEMA, **to_plain(self)}
        return document


#: Causes that the sensor file is mended for; the others are in the telemetry.
IN_SENSOR: Final = frozenset({"parity", "focal_length", "magnitude_limit", "j2000_directions"})


def parse_diagnosis(document: Mapping[str, Any]) -> Diagnosis:
    """Read a diagnosis; a member that is not known here is dropped."""
    if document.get("schema") != SCHEMA:
        raise RefusedInputError(
            f"This is not a diagnosis, its schema is {document.get('schema')!r}, not {SCHEMA!r}: diagnose the set again."
        )
    return parse_part(
        Diagnosis,
        document,
        lambda fault: RefusedInputError(f"A diagnosis is damaged ({fault}): diagnose the set again."),
    )
