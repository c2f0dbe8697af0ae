"""Table definitions, and the uplink packages that are built by them."""

from __future__ import annotations

from pydantic import Field

from boresight.api.schemas.row import Document, Row


class TableDefinition(Row):
    """How a sensor's camera lies in the table on board; every version is kept."""

    id: int
    sensor_id: int
    number: int = Field(description='Counts the sensor\'s definitions; the ETag is `"v<number>"`.')
    document: Document
    sha256: str = Field(description="SHA-256 of the canonical JSON of `document`.")
    reason: str
    created_utc: str
    created_by: int | None


class Package(Row):
    """An uplink package: the ZIP is at `/content`."""

    id: int
    parameter_set_id: int
    table_definition_id: int | None = Field(description="Null where none was in force: the package holds no table.")
    sha256: str = Field(description="SHA-256 of the ZIP.")
    inputs: Document = Field(
        description="Everything that the bytes follow from, with the audit head of the first building."
    )
    created_utc: str
    created_by: int | None
