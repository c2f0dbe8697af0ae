"""Scheduled backups, for whoever monitors them."""

from __future__ import annotations

from boresight.console.access.dependencies import Reading
from boresight.console.backups import schemas, service
from boresight.console.backups.tables import Backup
from boresight.console.operation import operations
from boresight.platform.web.paging import Listing, Page, Paged

router = operations("/backups", tags=["backups"])


@router.get("", summary="List backups", response_model=Page[schemas.Backup])
def list_backups(session: Reading, page: Paged) -> Listing[Backup]:
    """List the scheduled backups, newest first, each with its restore test."""
    return page.cut(service.list_backups(session, page.limit + 1, page.last_id))
