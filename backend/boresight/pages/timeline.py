"""A sensor's timeline: what held at a time and who said so, and under it everything that happened.

The address holds the view: `?at=2026-11-21T03:04:05Z` asks, `&before=712` turns the page of the list.
"""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.api.numbers import row_number
from boresight.errors import RefusedInputError
from boresight.pages.rendering import render
from boresight.pages.runs import read_names
from boresight.services import sensors, timeline
from boresight.services.timeline import AsOf
from boresight.store.sessions import Session, utc_now

router = APIRouter()

EVENTS_A_PAGE = 50


@router.get("/sensors/{sensor_id:int}/timeline", response_class=HTMLResponse)
def timeline_page(
    request: Request, session: Reading, actor: Who, sensor_id: int, at: str = "", before: str = ""
) -> HTMLResponse:
    """Show what held at a time, now where none is asked for, and the events."""
    sensor = sensors.get_sensor(session, sensor_id)
    answer, refusal = _answer(session, sensor_id, at.strip())
    before_id = row_number(before)
    found = timeline.events(session, sensor_id, before_id=before_id, limit=EVENTS_A_PAGE + 1)
    events = found[:EVENTS_A_PAGE]
    return render(
        request,
        "fleet/timeline.html",
        status_code=422 if refusal else 200,
        sensor=sensor,
        at=at.strip(),
        now=utc_now()[:19] + "Z",
        known=answer,
        refusal=refusal,
        events=events,
        later=before_id is not None,
        older=events[-1].id if len(found) > EVENTS_A_PAGE else None,
        names=read_names(session),
        actor=actor,
    )


def _answer(session: Session, sensor_id: int, at: str) -> tuple[AsOf | None, str | None]:
    """Answer the question of the form, or say why it cannot be."""
    try:
        return timeline.as_of(session, sensor_id, at or None), None
    except RefusedInputError as error:
        return None, str(error)
