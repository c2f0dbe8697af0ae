"""Proposed changes of gate limits and table layouts, with the entries that they change."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Document, Row


class Difference(Row):
    """An entry that a proposal changes."""

    place: str = Field(description="Path in the document.", examples=["gates[coverage].limit"])
    before: bool | int | float | str | None = Field(
        description="In the version that it was made against; null where there was nothing."
    )
    after: bool | int | float | str | None = Field(description="If it is confirmed; null where there is nothing.")


class ProposedChange(Row):
    """A change of a sensor's gate limits or table layout that takes effect when another person confirms it."""

    versioned_by = ("version",)
    location = "/change-proposals/{row.id}"

    id: int
    sensor_id: int
    kind: Literal["gate-profile", "table-definition"]
    base_number: int = Field(description="The version in force that it was made against; 0: the default, or none.")
    document: Document
    sha256: str
    reason: str
    proposed_utc: str
    proposed_by: int = Field(description="The person who cannot confirm it; for an API key, its owner.")
    expires_utc: str
    state: Literal["OPEN", "CONFIRMED", "REFUSED", "WITHDRAWN", "STALE", "EXPIRED"]
    version: int = Field(description='Counts transitions; the ETag is `"v<version>"`.')
    closed_utc: str | None
    closed_by: int | None = Field(description="Who confirmed, refused or withdrew it, or made it stale.")
    comment: str | None
    number: int | None = Field(description="The version that it became; null unless it is CONFIRMED.")


class ChangeProposal(ProposedChange):
    """A proposed change with the entries that it changes."""

    differences: list[Difference] = Field(default_factory=list)
