"""The quality report of a telemetry set and the findings in it; here what a calibration's JSON has of it too, without arrays."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StarOff:
    """A matched star off the detector: its row as an editor counts, its numbers, and how far it lies past the edge, pixels."""

    row: int
    frame: int
    exposure: int
    star_id: int | None
    off_px: float
