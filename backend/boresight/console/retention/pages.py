"""The page of retention: what the policy would remove now, and why the rest stays."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request
from fastapi.responses import HTMLResponse

from boresight.console.access.dependencies import Reading, ServerSettings
from boresight.console.fleet.queries import list_sensor_heads
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.console.retention import service

MOST_DAYS = 36_500.0
TRIED_DAYS = 365.0  # shown where nothing is removed

router = PageRouter()


@router.get("/retention", response_class=HTMLResponse)
def retention_page(
    request: Request,
    session: Reading,
    settings: ServerSettings,
    days: Annotated[float | None, Query(gt=0, le=MOST_DAYS)] = None,
) -> HTMLResponse:
    """Show what a number of days would remove, by default those of the policy."""
    shown = days or settings.telemetry_keep_days or TRIED_DAYS
    return render(
        request,
        "retention/retention.html",
        preview=service.preview(session, shown),
        keep_days=settings.telemetry_keep_days,
        sensors={row.id: row.name for row in list_sensor_heads(session, None)},
    )
