"""The page of backups: the schedule, the newest that can be restored, and what became of each."""

from __future__ import annotations

from fastapi import Request
from fastapi.responses import HTMLResponse

from boresight.console.access.dependencies import Blobs, Reading, ServerSettings, Who
from boresight.console.backups import service
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.errors import BoresightError
from boresight.platform.web.paging import parse_row_id
from boresight.settings import Settings

router = PageRouter()

ROWS_A_PAGE = 50


def _find_key(settings: Settings) -> tuple[str | None, str | None]:
    """Return the id of the key that encrypts here, or why there is none."""
    try:
        return settings.backup_keys.first().id, None
    except BoresightError as error:
        return None, str(error)


@router.get("/backups", response_class=HTMLResponse)
def backups_page(
    request: Request, session: Reading, actor: Who, settings: ServerSettings, blobs: Blobs, before: str = ""
) -> HTMLResponse:
    """Show the schedule and the backups, a page of them."""
    key_id, fault = _find_key(settings)
    before_id = parse_row_id(before)
    found = service.list_backups(session, ROWS_A_PAGE + 1, before_id)
    return render(
        request,
        "backups/backups.html",
        overview=service.look(session),
        rows=found[:ROWS_A_PAGE],
        next_before=found[ROWS_A_PAGE - 1].id if len(found) > ROWS_A_PAGE else None,
        is_first=before_id is None,
        key_id=key_id,
        key_fault=fault,
        blobs_at=blobs.kept_at,
        administrator="administrator" in actor.roles,
    )
