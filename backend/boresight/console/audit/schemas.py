"""The audit log."""

from __future__ import annotations

from pydantic import Field

from boresight.console.schemas import Document, Row


class AuditRecord(Row):
    """One record of the hash-chained log."""

    id: int
    at_utc: str
    actor_id: int | None
    actor: str
    roles: list[str] | None
    credential: str
    action: str
    object: str
    before: Document | None
    after: Document | None
    reason: str | None
    request_id: str | None
    rows: Document | None
    previous_hash: str
    hash: str


class ChainReport(Row):
    """What a walk along the audit chain, and through the rows that it seals, found."""

    ok: bool
    records: int
    rows: int
    head: str
    first_broken_id: int | None
    first_broken_row: str | None
    files: int = Field(description="Stored files that were compared with their addresses.")
    bad_files: list[str] = Field(description="Which files are wrong and how; the first twenty.")
    sentence: str
