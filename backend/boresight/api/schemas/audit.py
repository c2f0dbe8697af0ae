"""The audit log."""

from __future__ import annotations

from boresight.api.schemas.row import Document, Row


class AuditRecord(Row):
    """One record of the hash-chained log."""

    id: int
    at_utc: str
    actor_id: int | None
    actor: str
    credential: str
    action: str
    object: str
    before: Document | None
    after: Document | None
    reason: str | None
    request_id: str | None
    previous_hash: str
    hash: str


class ChainReport(Row):
    """What a walk along the audit chain found."""

    ok: bool
    records: int
    head: str
    first_broken_id: int | None
    sentence: str
