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


class Anchor(Row):
    """A signed head of the log; `signature` is Ed25519 over canonical JSON of schema, record, head, at_utc, made_by and key."""

    location = "/audit/anchors"
    id: int
    record_id: int = Field(description="The newest record that it covers.")
    head: str = Field(description="The hash of that record.")
    at_utc: str
    made_by: str
    key: str = Field(description="Id of the key: the first 16 digits of the SHA-256 of `public_key`.")
    public_key: str = Field(description="Base64.")
    signature: str = Field(description="Base64.")
    stamped_utc: str | None = Field(description="The time that a time-stamp service gave.")
    time_stamp: str | None = Field(description="Its answer (RFC 3161), base64; it is of the SHA-256 of `signature`.")


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
    anchors: int = Field(description="Signed heads that were verified.")
    time_stamped: int = Field(description="How many of them have a valid time-stamp.")
    anchored_id: int = Field(description="The newest record that a valid anchor covers, 0 for none.")
    anchored_utc: str | None
    sentence: str
