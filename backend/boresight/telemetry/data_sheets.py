"""What public data sheets say of trackers and cameras, and what a person is asked of one: tables that load nothing else.

`telemetry.new_sensor` makes a sensor of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypedDict

from boresight.site import Site


@dataclass(frozen=True)
class DataSheet:
    """What a public data sheet says of a tracker or a camera; None where the lens is not part of it, or it is not said.

    `source`: where it says so.
    """

    name: str
    rows: int
    columns: int
    pixel_pitch_um: float
    focal_length_mm: float | None
    shutter: str | None
    source: str


_PI = "Raspberry Pi documentation, Camera: hardware specification, www.raspberrypi.com/documentation/accessories/camera.html"
_SSTL = "SSTL, Star trackers: frequently asked questions, www.sstl.co.uk"
#: Public COTS trackers and cameras, by name.
DATA_SHEETS: dict[str, DataSheet] = {
    sheet.name: sheet
    for sheet in (
        DataSheet("Sinclair ST-16", 1944, 2592, 2.2, 16.0, "rolling", "Enright et al. 2018, Table II"),
        DataSheet("SSTL Altair HB+", 512, 768, 9.0, 25.0, None, _SSTL),
        DataSheet(
            "SSTL Rigel-L", 1024, 1024, 18.0, 47.7, None,
            f"{_SSTL}; its field there, 22.6 degrees, would be a focal length of 46.1 mm",
        ),
        DataSheet(
            "FLIR BFS-U3-31S4M", 1536, 2048, 3.45, None, "global",
            "Teledyne FLIR, Blackfly S BFS-U3-31S4 (Sony IMX265), softwareservices.flir.com/BFS-U3-31S4/latest/Model/spec.html",
        ),
        DataSheet(
            "FLIR BFS-U3-31S4M, 2x2", 768, 1024, 6.9, None, "global",
            "the same, binned two by two, as in the test images of github.com/esa/tetra3 (35 mm lens)",
        ),
        DataSheet("Raspberry Pi Camera Module 1", 1944, 2592, 1.4, 3.6, "rolling", _PI),
        DataSheet("Raspberry Pi Camera Module 2", 2464, 3280, 1.12, 3.04, "rolling", _PI),
        DataSheet(
            "Raspberry Pi Camera Module 3", 2592, 4608, 1.4, 4.74, "rolling",
            f"{_PI}; its field there, 66 by 41 degrees, would be a focal length of 4.85 to 4.97 mm",
        ),
        DataSheet("Raspberry Pi HQ Camera", 3040, 4056, 1.55, None, "rolling", _PI),
        DataSheet("Raspberry Pi Global Shutter Camera", 1088, 1456, 3.45, None, "global", _PI),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """One number that a sensor file is made from: its flag on the command line, its label, unit, bounds and what it is."""

    label: str
    unit: str
    lowest: float
    highest: float
    sentence: str
    whole: bool = False

    @property
    def metadata(self) -> dict[str, Asked]:
        """As a dataclass field keeps it."""
        return {"asked": self}


@dataclass(frozen=True)
class LensAndDetector:
    """What a person knows of a camera; None where nothing is known. `sheet`: name of a data sheet that tells the rest."""

    name: str = "New sensor"
    sheet: str | None = None
    camera_model: str | None = None
    parity: int | None = None
    rows: int | None = field(
        default=None, metadata=Asked("Rows", "px", 16, 65536, "Height of the image.", whole=True).metadata
    )
    columns: int | None = field(
        default=None, metadata=Asked("Columns", "px", 16, 65536, "Width of the image.", whole=True).metadata
    )
    pixel_pitch_um: float | None = field(
        default=None, metadata=Asked("Pixel pitch", "µm", 0.1, 1000.0, "From pixel to pixel, after binning.").metadata
    )
    focal_length_mm: float | None = field(
        default=None,
        metadata=Asked("Focal length", "mm", 0.1, 100_000.0, "From the lens, or give the field of view.").metadata,
    )
    field_of_view_deg: float | None = field(
        default=None,
        metadata=Asked(
            "Field of view", "°", 0.1, 170.0, "Across the longer side, instead of the focal length."
        ).metadata,
    )
    centroid_sigma_px: float | None = field(
        default=None,
        metadata=Asked("Centroid noise", "px", 1e-4, 100.0, "One axis, one sigma; 0.2 px if omitted.").metadata,
    )
    magnitude_limit: float | None = field(
        default=None,
        metadata=Asked(
            "Faintest magnitude", "mag", -2.0, 20.0, "Of the stars that it sees; found from each set if omitted."
        ).metadata,
    )
    site: Site | None = None


class Known(TypedDict, total=False):
    """`LensAndDetector` by name, as a call gives it; `site` as a sensor file has it."""

    name: str
    sheet: str
    camera_model: str
    parity: int
    rows: int
    columns: int
    pixel_pitch_um: float
    focal_length_mm: float
    field_of_view_deg: float
    centroid_sigma_px: float
    magnitude_limit: float
    site: Mapping[str, Any]


#: Every number that is asked, by name.
ASKED: dict[str, Asked] = {
    one.name: one.metadata["asked"] for one in fields(LensAndDetector) if "asked" in one.metadata
}
