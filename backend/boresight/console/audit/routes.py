"""The audit log: read it, have its chain verified, and its head signed."""

from __future__ import annotations

import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from fastapi import Query
from pydantic import Field
from starlette.background import BackgroundTask
from starlette.responses import FileResponse

from boresight.console.access.dependencies import Blobs, Reading, ServerPolicy, Who, Writing
from boresight.console.audit.service import anchor_now
from boresight.console.jobs.dependencies import ServerAnchoring, ServerMaintenance
from boresight.console.operation import operations
from boresight.console.schemas import Document, Row
from boresight.platform.audit import export as audit_export
from boresight.platform.audit import log as audit
from boresight.platform.audit import tables
from boresight.platform.web.media import PemFile, PythonFile
from boresight.platform.web.paging import Listing, Page, Paged


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
    time_stamp: str | None = Field(
        description="The service's response (RFC 3161), base64, for the SHA-256 of `signature`."
    )


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


router = operations("/audit", tags=["audit"])
MEDIA_TYPES = {"zip": "application/zip", "jsonl": "application/x-ndjson"}


class Form(StrEnum):
    """Format of the export."""

    ZIP = "zip"
    JSONL = "jsonl"


@router.get("", summary="List records", response_model=Page[AuditRecord])
def list_audit(
    session: Reading,
    page: Paged,
    subject: Annotated[str | None, Query(alias="object", examples=["parameter-sets/3"])] = None,
    person: Annotated[str | None, Query(alias="actor", examples=["Ana Lima"])] = None,
    action: Annotated[str | None, Query(examples=["promoted"])] = None,
    since: Annotated[str | None, Query(description="ISO 8601; from this time on.")] = None,
    until: Annotated[str | None, Query(description="ISO 8601; before this time.")] = None,
) -> Listing[tables.AuditRecord]:
    """List records, newest first, with what each changed."""
    sought = audit.sought(object=subject, actor=person, action=action, since=since, until=until)
    return page.cut(audit.list_records(session, before_id=page.last_id, sought=sought, limit=page.limit + 1))


@router.get("/verification", summary="Verify the chain", response_model=ChainReport)
def verify_audit(
    session: Reading,
    stored: Blobs,
    anchoring: ServerAnchoring,
    expected_head: Annotated[str | None, Query(description="A head from an earlier export.")] = None,
    blobs: Annotated[bool, Query(description="Whether to check the stored files too.")] = True,
) -> audit.ChainReport:
    """Check the whole chain, its anchors, every row that it seals, and the stored files; say which are not as they were written.

    A file that this server has checked is read again only if anything about it has changed; the server's maintenance
    reads all of them again, a few each minute.
    """
    return audit.verify(session, expected_head, stored if blobs else None, again=False, trust=anchoring.trust())


@router.get("/anchors", summary="List anchors", response_model=Page[Anchor])
def list_anchors(session: Reading, page: Paged) -> Listing[tables.AuditAnchor]:
    """List the heads of the log that were signed, newest first."""
    return page.cut(audit.list_anchors(session, before_id=page.last_id, limit=page.limit + 1))


@router.post("/anchors", summary="Anchor the log now", status_code=201, response_model=Anchor)
def make_anchor(
    actor: Who, session: Writing, anchoring: ServerAnchoring, maintenance: ServerMaintenance
) -> tables.AuditAnchor:
    """Sign the newest head; if an anchor covers it already, that one is the answer. For administrators."""
    made = anchor_now(session, actor, anchoring.key, maintenance.broken)
    maintenance.nudge()
    return made


@router.get("/keys", summary="The public keys", response_class=PemFile)
def get_public_keys(anchoring: ServerAnchoring) -> PemFile:
    """Return the public keys that verify anchors and uplink packages, the present one first; empty before the first signature."""
    return PemFile("".join(key.pem for key in anchoring.key.list_public_keys()))


@router.get(
    "/export",
    summary="Export the log",
    response_class=FileResponse,
    responses={200: {"content": {media_type: {"schema": {"type": "string"}} for media_type in MEDIA_TYPES.values()}}},
)
def export_audit(
    session: Reading,
    policy: ServerPolicy,
    form: Annotated[Form, Query(description="A ZIP with its verifier, or the JSON Lines alone.")] = Form.ZIP,
) -> FileResponse:
    """Export every record as JSON Lines, with the program that verifies them without Boresight."""
    with tempfile.NamedTemporaryFile(prefix="boresight-audit-", delete=False) as stream:
        audit_export.write_export(session, stream, form.value, policy)
    path = Path(stream.name)
    name = f"boresight-audit-{audit.head(session)[:12]}.{form.value}"
    return FileResponse(path, media_type=MEDIA_TYPES[form], filename=name, background=BackgroundTask(path.unlink))


@router.get("/verifier", summary="The program that verifies an export", response_class=PythonFile)
def get_audit_verifier() -> PythonFile:
    """Return the program that verifies an export; it runs on any Python 3.8 or newer, without Boresight."""
    return PythonFile(audit_export.verifier())
