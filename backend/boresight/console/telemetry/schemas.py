"""Telemetry sets."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Document, Row


class TelemetrySet(Row):
    """An uploaded telemetry file."""

    versioned_by = ("id", "archived_utc", "diagnosed")
    location = "/telemetry-sets/{row.id}"

    id: int
    sensor_id: int
    name: str
    purpose: Literal["calibration", "validation"]
    frames: int
    stars: int
    quality: Document = Field(description="What the file is good for: counts, gaps, coverage, warnings.")
    original_sha256: str = Field(description="SHA-256 of the bytes that were uploaded.")
    table_sha256: str = Field(description="SHA-256 of the table that runs work on.")
    uploaded_utc: str
    uploaded_by: int | None
    archived_utc: str | None
