"""Telemetry sets."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Document, Row


class TelemetrySet(Row):
    """An uploaded telemetry file."""

    versioned_by = ("id", "archived_utc", "removed_utc", "diagnosed")
    location = "/telemetry-sets/{row.id}"

    id: int
    sensor_id: int
    name: str
    purpose: Literal["calibration", "validation"]
    frames: int
    stars: int
    quality: Document = Field(description="Quality of the file: counts, gaps, coverage, warnings.")
    original_sha256: str = Field(description="SHA-256 of the bytes that were uploaded.")
    table_sha256: str = Field(description="SHA-256 of the table that runs work on.")
    uploaded_utc: str
    uploaded_by: int | None
    archived_utc: str | None
    removed_utc: str | None = Field(description="When its files were removed by the retention of telemetry.")
    source_sha256: str | None = Field(
        description="SHA-256 of the file it was imported from; null for telemetry that was not imported."
    )
    import_record: Document | None = Field(
        description="How it was imported: sources, profile, what each column means, notes; for an upload also the first rows."
    )


class ImportProfile(Row):
    """A mapping profile."""

    versioned_by = ("id", "archived_utc")
    location = "/import-profiles/{row.id}"

    key: str = Field(description="The value of `profile` in an upload.")
    id: int | None = Field(description="Of a saved version; null for built-in ones.")
    name: str
    number: int | None = Field(description="Version.")
    document: Document = Field(description="The profile; `docs/import-profile.schema.json` is its schema.")
    sha256: str = Field(description="Hash of the profile without its version.")
    created_utc: str | None
    created_by: int | None
    archived_utc: str | None
