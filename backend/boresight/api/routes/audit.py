"""The audit log: read it, and have its chain verified."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import json_response
from boresight.api.dependencies import Reading, Who
from boresight.api.paging import Page, Paged
from boresight.services import audit

router = APIRouter(prefix="/audit", tags=["audit"])


@router.get("", name="list_audit", summary="List records", response_model=Page[schemas.AuditRecord])
def list_audit(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    subject: Annotated[str | None, Query(alias="object", examples=["parameter-sets/3"])] = None,
) -> Response:
    """List records, newest first, with what each changed."""
    found = audit.list_records(session, before_id=page.last_id, subject=subject, limit=page.limit + 1)
    return json_response(page.cut(found, lambda row: schemas.written(schemas.AuditRecord, row)))


@router.get("/verification", name="verify_audit", summary="Verify the chain", response_model=schemas.ChainReport)
def verify_audit(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    expected_head: Annotated[str | None, Query(description="A head from an earlier export.")] = None,
) -> Response:
    """Walk the whole chain; say whether every record is as it was written, else which is the first that is not."""
    return json_response(schemas.written(schemas.ChainReport, audit.verify(session, expected_head)))
