"""Table definitions, and the uplink packages that are built by them."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from boresight.api.schemas.row import Document, Row


class TableDefinition(Row):
    """How a sensor's camera lies in the table on board; every version is kept."""

    versioned_by = ("number",)
    location = "/sensors/{row.sensor_id}/table-definitions"

    id: int
    sensor_id: int
    number: int = Field(description='Counts the sensor\'s definitions; the ETag is `"v<number>"`.')
    document: Document
    sha256: str = Field(description="SHA-256 of the canonical JSON of `document`.")
    reason: str
    created_utc: str
    created_by: int | None


class Package(Row):
    """An uplink package: the ZIP is at `/content`, and everything that its bytes follow from is in its manifest."""

    location = "/packages/{row.id}"

    id: int
    parameter_set_id: int
    table_definition_id: int | None = Field(description="Null where none was in force: the package holds no table.")
    flight_software_version: str | None
    table_id: str | None
    sha256: str = Field(description="SHA-256 of the ZIP.")
    backout: str = Field(description="The set that it goes back to, in the folder `backout/`.")
    four_eyes: str = Field(description="Whether a second person approved the set.")
    audit_head: str = Field(description="Head of the audit log when the package was first built.")
    created_utc: str
    created_by: int | None

    @model_validator(mode="before")
    @classmethod
    def _from_row(cls, row: Any) -> Any:
        """Take what is shown out of the inputs of a stored package."""
        if not hasattr(row, "inputs"):
            return row
        columns = ("id", "parameter_set_id", "table_definition_id", "sha256", "created_utc", "created_by")
        document = (row.inputs["definition"] or {}).get("document", {})
        return {name: getattr(row, name) for name in columns} | {
            "flight_software_version": document.get("flight_software_version"),
            "table_id": document.get("table_id"),
            "backout": row.inputs["backout"]["name"],
            "four_eyes": row.inputs["four_eyes"]["sentence"],
            "audit_head": row.inputs["first_built"]["audit_head"],
        }
