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
    source_sha256: str | None = Field(
        description="SHA-256 of the file it was imported from; null of telemetry as such."
    )
    import_record: Document | None = Field(
        description="How it was imported: sources, profile, what each column means, notes; of an upload the first rows too."
    )


class ImportProfile(Row):
    """A mapping profile."""

    versioned_by = ("id", "archived_utc")
    location = "/import-profiles/{row.id}"

    key: str = Field(description="What an upload names as its `profile`.")
    id: int | None = Field(description="Of a saved version; null for those that come with Boresight.")
    name: str
    number: int | None = Field(description="Version.")
    document: Document = Field(description="What it says; `docs/import-profile.schema.json` is its schema.")
    sha256: str = Field(description="Hash of what it says but its version.")
    created_utc: str | None
    created_by: int | None
    archived_utc: str | None
