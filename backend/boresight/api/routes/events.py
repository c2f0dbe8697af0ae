"""The live feed as server-sent events, resumable with `Last-Event-ID`."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass, replace
from typing import Annotated

from fastapi import APIRouter, Header, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.requests import Request

from boresight.api.broadcast import Broadcast, Listener
from boresight.api.dependencies import Who, still_known
from boresight.api.feed import Event, Place, events_after
from boresight.store.sessions import Engine, reading

router = APIRouter(prefix="/events", tags=["events"])

WAIT_S = 5.0
ASK_AGAIN_S = 30.0  # who is disabled or logged out everywhere stops hearing within this time
RETRY_MS = 2000


@dataclass(frozen=True)
class _Wish:
    """What one listener wants to hear: of one run or of all, and whose course is to be drawn."""

    run: int | None
    history: int | None

    def concerns(self, event: Event) -> bool:
        """Whether an event is about the run, or any will do."""
        about = event.data.get("run_id") == self.run or event.data.get("object") == f"runs/{self.run}"
        return self.run is None or about

    def sent(self, event: Event, place: Place) -> ServerSentEvent:
        """Write an event, with the new points of its course for who draws it."""
        follows = event.history is not None and event.data.get("run_id") == self.history
        text = event.text_with_history if follows else event.text
        return ServerSentEvent(event=event.kind, raw_data=text, id=str(place))


@router.get("", name="stream_events", summary="Follow what happens", response_class=EventSourceResponse)
async def stream_events(
    actor: Who,  # noqa: ARG001 - whoever is known may listen
    request: Request,
    run: Annotated[int | None, Query(description="Only what concerns this run.")] = None,
    history: Annotated[
        int | None, Query(description="Let the progress of this run carry the new points of its course.")
    ] = None,
    last_event_id: Annotated[
        str | None, Header(description="The last `id` heard; what came after is told first.")
    ] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Follow the feed: `run` (a change of state), `log` (another line of a run's log), `progress`, `audit`.

    Every event carries an id and is told again after a break. Progress is kept for a short time only: after `missed` some of
    it was lost, so read the run again. A listener that falls too far behind gets `dropped` and the stream ends; come back
    with `Last-Event-ID` and nothing is missed.
    """
    broadcast: Broadcast = request.app.state.broadcast
    wish = _Wish(run, history)
    with broadcast.listening() as listener:
        newest = broadcast.progress
        place = await run_in_threadpool(_begin, request.app.state.engine, last_event_id, newest)
        yield ServerSentEvent(comment="connected", id=str(place), retry=RETRY_MS)
        async for event in _past(request.app.state.engine, broadcast, place):
            place = event.move(place)
            if wish.concerns(event):
                yield wish.sent(event, place)
        if place.progress < newest or place.progress > broadcast.progress:
            place = replace(place, progress=newest)
            yield ServerSentEvent(event="missed", data={"id": str(place)}, id=str(place))
        async for told in _live(request, listener, place, wish):
            yield told


async def _past(database: Engine, broadcast: Broadcast, place: Place) -> AsyncIterator[Event]:
    """Return the rows after a place, page by page, and the progress after it, none where some is kept no more."""
    while events := await run_in_threadpool(_missed, database, place):
        for event in events:
            place = event.move(place)
            yield event
    for event in broadcast.progress_after(place.progress) or ():
        yield event


def _begin(database: Engine, last_event_id: str | None, progress: int) -> Place:
    """Return where a listener goes on: after the id it brings, else from now."""
    brought = Place.parse(last_event_id or "")
    if brought is not None:
        return brought
    with reading(database) as session:
        return Place.now(session, progress)


def _missed(database: Engine, place: Place) -> Iterable[Event]:
    """Return a page of the rows after a place."""
    with reading(database) as session:
        return events_after(session, place)


async def _live(request: Request, listener: Listener, place: Place, wish: _Wish) -> AsyncIterator[ServerSentEvent]:
    """Tell what happens from here on, until the server stops, the listener is too slow, or the log-in ends."""
    asked_s = time.monotonic()
    while True:
        for event in await listener.next(WAIT_S):
            if event is None:
                yield ServerSentEvent(event="dropped" if listener.dropped else "closing", data={"id": str(place)})
                return
            if event.is_after(place):
                place = event.move(place)
                if wish.concerns(event):
                    yield wish.sent(event, place)
        if time.monotonic() - asked_s > ASK_AGAIN_S:
            if not await run_in_threadpool(still_known, request):
                return
            asked_s = time.monotonic()
