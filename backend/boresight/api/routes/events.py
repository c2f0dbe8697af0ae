"""The live feed as server-sent events, resumable with `Last-Event-ID`."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Iterable
from typing import Annotated

from fastapi import APIRouter, Header, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.requests import Request

from boresight.api.broadcast import Broadcast, Event, Listener, Place, events_after
from boresight.api.dependencies import Who, still_known
from boresight.store.sessions import Engine, reading

router = APIRouter(prefix="/events", tags=["events"])

WAIT_S = 5.0
ASK_AGAIN_S = 30.0  # who is disabled or logged out everywhere stops hearing within this time
RETRY_MS = 2000


@router.get("", name="stream_events", summary="Follow what happens", response_class=EventSourceResponse)
async def stream_events(
    actor: Who,  # noqa: ARG001 - whoever is known may listen
    request: Request,
    run: Annotated[int | None, Query(description="Only what concerns this run.")] = None,
    last_event_id: Annotated[
        str | None, Header(description="The last `id` heard; what came after is told first.")
    ] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Follow the feed: `run` (a change of state), `progress`, `audit`.

    `run` and `audit` carry an id and are told again after a break; `progress` is told once. A listener that falls too far
    behind gets `dropped` and the stream ends; come back with `Last-Event-ID` and nothing is missed.
    """
    broadcast: Broadcast = request.app.state.broadcast
    with broadcast.listening() as listener:
        place = await run_in_threadpool(_begin, request.app.state.engine, last_event_id)
        yield ServerSentEvent(comment="connected", id=str(place), retry=RETRY_MS)
        while events := await run_in_threadpool(_missed, request.app.state.engine, place):
            for event in events:
                place = event.move(place)
                if _concerns(event, run):
                    yield _sent(event, place)
        async for told in _live(request, listener, place, run):
            yield told


def _begin(database: Engine, last_event_id: str | None) -> Place:
    """Return where a listener goes on: after the id it brings, else from now."""
    brought = Place.parse(last_event_id or "")
    if brought is not None:
        return brought
    with reading(database) as session:
        return Place.now(session)


def _missed(database: Engine, place: Place) -> Iterable[Event]:
    """Return a page of the rows after a place."""
    with reading(database) as session:
        return events_after(session, place)


async def _live(request: Request, listener: Listener, place: Place, run: int | None) -> AsyncIterator[ServerSentEvent]:
    """Tell what happens from here on, until the server stops, the listener is too slow, or the log-in ends."""
    asked_s = time.monotonic()
    while True:
        for event in await listener.next(WAIT_S):
            if event is None:
                yield ServerSentEvent(event="dropped" if listener.dropped else "closing", data={"id": str(place)})
                return
            if event.is_after(place):
                place = event.move(place)
                if _concerns(event, run):
                    yield _sent(event, place)
        if time.monotonic() - asked_s > ASK_AGAIN_S:
            if not await run_in_threadpool(still_known, request):
                return
            asked_s = time.monotonic()


def _concerns(event: Event, run: int | None) -> bool:
    """Whether an event is about a run, or any will do."""
    return run is None or event.data.get("run_id") == run or event.data.get("object") == f"runs/{run}"


def _sent(event: Event, place: Place) -> ServerSentEvent:
    """Write an event; progress has no id of its own."""
    return ServerSentEvent(event=event.kind, data=event.data, id=None if event.number is None else str(place))
