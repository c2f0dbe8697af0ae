"""Telemetry sets: the list, and uploading one.

The form works without scripts. With them the same form is sent with its progress shown (`upload.js`): then a refusal
replaces only the place for refusals, so that the chosen file stays chosen. The file is streamed to the disk and checked
before the transaction; a refused one leaves nothing behind.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import contextmanager_in_threadpool, run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import CSRF_FIELD, Reading, Who
from boresight.api.uploads import Upload, Uploaded
from boresight.errors import BoresightError, ForbiddenError, RefusedInputError
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.services import sensors, telemetry_sets
from boresight.services.actors import Actor, require_role
from boresight.services.telemetry_sets import PURPOSES, Prepared
from boresight.store.sessions import Session, reading
from boresight.store.tables import TelemetrySet

ROWS_A_PAGE = 50
SCRIPTED = "x-boresight-upload"  # the header of an upload whose progress a script shows

router = APIRouter()


@dataclass(frozen=True)
class Filters:
    """What of the list is shown; None shows all."""

    sensor: int | None
    purpose: str | None
    archived: bool

    def query(self, before: int | None = None) -> str:
        """Return the address's query for these filters and a page."""
        named = {"sensor": self.sensor, "purpose": self.purpose, "archived": int(self.archived) or None}
        return urlencode({name: value for name, value in (named | {"before": before}).items() if value is not None})


def read_filters(sensor: str = "", purpose: str = "", archived: str = "") -> Filters:
    """Read the filters from the address; what is no filter is left out."""
    return Filters(
        int(sensor) if sensor.isdecimal() else None, purpose if purpose in PURPOSES else None, archived == "1"
    )


@dataclass(frozen=True)
class Shown:
    """What the upload form left behind: what was chosen and why it was refused."""

    sensor: int | None = None
    purpose: str = PURPOSES[0]
    refusal: Refusal | None = None


def _page(
    request: Request, session: Session, actor: Actor, chosen: Filters, before: int | None, shown: Shown
) -> HTMLResponse:
    """Render the list and the form."""
    found = telemetry_sets.list_telemetry_sets(
        session,
        sensor_id=chosen.sensor,
        purpose=chosen.purpose,
        archived=chosen.archived,
        before_id=before,
        limit=ROWS_A_PAGE + 1,
    )
    sets = found[:ROWS_A_PAGE]
    return render(
        request,
        "telemetry.html",
        status_code=422 if shown.refusal else 200,
        sets=sets,
        next_query=chosen.query(sets[-1].id) if len(found) > ROWS_A_PAGE else "",
        later=before is not None,
        chosen=chosen,
        sensors=sensors.list_sensors(session),
        names=read_names(session),
        purposes=PURPOSES,
        may_upload="analyst" in actor.roles,
        limit_mb=request.app.state.settings.upload_limit_mb,
        shown=shown,
    )


@router.get("/telemetry", response_class=HTMLResponse)
def telemetry_page(
    request: Request,
    session: Reading,
    actor: Who,
    chosen: Annotated[Filters, Depends(read_filters)],
    before: str = "",
) -> HTMLResponse:
    """Show a page of sets, newest first, and the form."""
    before_id = int(before) if before.isdecimal() else None
    return _page(request, session, actor, chosen, before_id, Shown(sensor=chosen.sensor))


@router.post("/telemetry", response_class=HTMLResponse)
async def upload(request: Request, actor: Who, upload: Uploaded) -> Response:
    """Check and store the file, then show its quality report."""
    _require_meant(request, upload)
    outcome = await _attempt(request, actor, upload)
    if outcome.value is None:
        return await run_in_threadpool(_again, request, actor, upload, outcome.refusal)
    row = outcome.value
    response = redirect(f"/telemetry/{row.id}", flash=f"{row.name} is telemetry set {row.id}.")
    if SCRIPTED in request.headers:
        response.status_code = 201  # a script follows no redirect on its own: it opens the Location
    return response


def _require_meant(request: Request, upload: Upload) -> None:
    """Refuse a form without this log-in's token; it comes with the body, which is streamed and read only once.

    Raises
    ------
    ForbiddenError
        When the token is missing or another's, or another site sent the form.
    """
    given, expected = upload.fields.get(CSRF_FIELD, ""), getattr(request.state, CSRF_FIELD, None)
    meant = expected is None or hmac.compare_digest(given.encode(), expected.encode())
    if not meant or request.headers.get("sec-fetch-site") == "cross-site":
        raise ForbiddenError("This form is of another log-in; reload the page and choose the file again.")


async def _attempt(request: Request, actor: Actor, upload: Upload) -> Outcome[TelemetrySet]:
    """Read and check the file, then store it in a transaction."""
    try:
        async with contextmanager_in_threadpool(_prepared(request, actor, upload)) as ready:
            return await attempt(request, partial(_store, request, actor, upload, ready))
    except BoresightError as error:
        return Outcome(None, Refusal.of(error))


@contextmanager
def _prepared(request: Request, actor: Actor, upload: Upload) -> Iterator[Prepared]:
    """Read and check the file without the database."""
    require_role(actor, "analyst")
    if not upload.fields.get("sensor_id", "").isdecimal():
        raise RefusedInputError("Choose the sensor that the telemetry is of.")
    if upload.path is None or not upload.file_name:
        raise RefusedInputError("No file was chosen: choose a CSV, JSON Lines or Parquet file.")
    state = request.app.state
    with reading(state.engine) as session:
        document = sensors.get_sensor(session, upload.number("sensor_id")).document
    with telemetry_sets.prepared(document, state.catalogue(), upload.path, upload.file_name) as ready:
        yield ready


def _store(request: Request, actor: Actor, upload: Upload, ready: Prepared, session: Session) -> TelemetrySet:
    """Store the checked file."""
    purpose = upload.fields.get("purpose", PURPOSES[0])
    blobs = request.app.state.blobs
    return telemetry_sets.store_prepared(session, actor, blobs, upload.number("sensor_id"), ready, purpose)


def _again(request: Request, actor: Actor, upload: Upload, refusal: Refusal | None) -> HTMLResponse:
    """Render the page after a refusal, with what was chosen."""
    sensor, purpose = upload.fields.get("sensor_id", ""), upload.fields.get("purpose", "")
    shown = Shown(int(sensor) if sensor.isdecimal() else None, purpose if purpose in PURPOSES else PURPOSES[0], refusal)
    with reading(request.app.state.engine) as session:
        return _page(request, session, actor, Filters(None, None, archived=False), None, shown)
