"""The audit log: read it, have its chain verified, and its head signed."""

from __future__ import annotations

import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from fastapi import Query
from starlette.background import BackgroundTask
from starlette.responses import FileResponse

from boresight.console.access.dependencies import Blobs, Reading, ServerPolicy, Who, Writing
from boresight.console.audit import schemas
from boresight.console.audit.service import anchor_now
from boresight.console.jobs.dependencies import ServerAnchoring, ServerMaintenance
from boresight.console.operation import operations
from boresight.platform.audit import export as audit_export
from boresight.platform.audit import log as audit
from boresight.platform.audit.log import ChainReport
from boresight.platform.audit.tables import AuditAnchor, AuditRecord
from boresight.platform.web.media import PemFile, PythonFile
from boresight.platform.web.paging import Listing, Page, Paged

router = operations("/audit", tags=["audit"])
MEDIA_TYPES = {"zip": "application/zip", "jsonl": "application/x-ndjson"}


class Form(StrEnum):
    """Format of the export."""

    ZIP = "zip"
    JSONL = "jsonl"


@router.get("", summary="List records", response_model=Page[schemas.AuditRecord])
def list_audit(
    session: Reading,
    page: Paged,
    subject: Annotated[str | None, Query(alias="object", examples=["parameter-sets/3"])] = None,
    person: Annotated[str | None, Query(alias="actor", examples=["Ana Lima"])] = None,
    action: Annotated[str | None, Query(examples=["promoted"])] = None,
    since: Annotated[str | None, Query(description="ISO 8601; from this time on.")] = None,
    until: Annotated[str | None, Query(description="ISO 8601; before this time.")] = None,
) -> Listing[AuditRecord]:
    """List records, newest first, with what each changed."""
    sought = audit.sought(object=subject, actor=person, action=action, since=since, until=until)
    return page.cut(audit.list_records(session, before_id=page.last_id, sought=sought, limit=page.limit + 1))


@router.get("/verification", summary="Verify the chain", response_model=schemas.ChainReport)
def verify_audit(
    session: Reading,
    stored: Blobs,
    anchoring: ServerAnchoring,
    expected_head: Annotated[str | None, Query(description="A head from an earlier export.")] = None,
    blobs: Annotated[bool, Query(description="Whether to check the stored files too.")] = True,
) -> ChainReport:
    """Check the whole chain, its anchors, every row that it seals, and the stored files; say which are not as they were written.

    A file that this server has checked is read again only if anything about it has changed; the server's maintenance
    reads all of them again, a few each minute.
    """
    return audit.verify(session, expected_head, stored if blobs else None, again=False, trust=anchoring.trust())


@router.get("/anchors", summary="List anchors", response_model=Page[schemas.Anchor])
def list_anchors(session: Reading, page: Paged) -> Listing[AuditAnchor]:
    """List the heads of the log that were signed, newest first."""
    return page.cut(audit.list_anchors(session, before_id=page.last_id, limit=page.limit + 1))


@router.post("/anchors", summary="Anchor the log now", status_code=201, response_model=schemas.Anchor)
def make_anchor(
    actor: Who, session: Writing, anchoring: ServerAnchoring, maintenance: ServerMaintenance
) -> AuditAnchor:
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
