"""The live feed as server-sent events, resumable with `Last-Event-ID`."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import orjson
from fastapi import Header, Query
from fastapi.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import StreamingResponse

from boresight.console.access.credentials import is_still_valid
from boresight.console.access.dependencies import Database, Who
from boresight.console.jobs.broadcast import (
    Broadcast,
    Event,
    EventBatch,
    EventCursor,
    Listener,
    list_events_after,
)
from boresight.console.jobs.dependencies import Feed
from boresight.console.operation import operations
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Engine, open_reading

router = operations("/events", tags=["events"])

PING_S = 15.0
ASK_AGAIN_S = 30.0  # a credential that expires, or ends without a commit, ends its stream within this time
RETRY_MS = 2000
HEADERS = {"Cache-Control": "no-cache", "X-Accel-Buffering": "no"}
PING = b": ping\n\n"


class EventStream(StreamingResponse):
    """Server-sent events, written by the feed itself: the framework's own writer would write each again for each listener."""

    media_type = "text/event-stream"


@dataclass(frozen=True)
class StreamFilter:
    """What one listener asked for: one run or all, and the run whose history it draws."""

    run: int | None
    history: int | None

    @property
    def is_everything(self) -> bool:
        """Whether the listener takes the whole feed, which is serialised once for all."""
        return self.run is None and self.history is None

    def written(self, event: Event, cursor: EventCursor) -> bytes:
        """Write an event, with new points of history for a listener that draws it; empty if the listener did not ask for it."""
        about = event.data.get("run_id") == self.run or event.data.get("object") == f"runs/{self.run}"
        if self.run is not None and not about:
            return b""
        return event.wire(cursor, with_history=event.data.get("run_id") == self.history)


@router.get("", summary="Follow the event feed", response_class=EventStream)
async def stream_events(
    actor: Who,
    request: Request,
    feed: Feed,
    database: Database,
    run: Annotated[int | None, Query(description="Only what concerns this run.")] = None,
    history: Annotated[
        int | None, Query(description="Include new points of the history in this run's progress events.")
    ] = None,
    last_event_id: Annotated[
        str | None, Header(description="The last `id` received; later events are sent first.")
    ] = None,
) -> EventStream:
    """Follow the feed: `run` (a change of state), `log` (another line of a run's log), `progress`, `audit`.

    Every event has an id and is sent again after a reconnection. Progress is kept for a short time only: after `missed` some of
    it was lost, so read the run again. A listener that falls too far behind gets `dropped` and the stream ends; reconnect
    with `Last-Event-ID` to miss nothing. When the log-in or the key ends, the stream says `logged-out` and ends.
    """
    return EventStream(
        _stream(request, actor, (feed, database), StreamFilter(run, history), last_event_id), headers=HEADERS
    )


async def _stream(
    request: Request, actor: Actor, told_by: tuple[Broadcast, Engine], wanted: StreamFilter, last_event_id: str | None
) -> AsyncIterator[bytes]:
    """Write a stream: its start, the missed events, then live ones."""
    broadcast, database = told_by
    with broadcast.open_listener(actor) as listener:
        brought, newest, told = EventCursor.parse(last_event_id or ""), broadcast.progress, broadcast.cursor
        cursor = brought or told
        yield f": connected\nid: {cursor}\nretry: {RETRY_MS}\n\n".encode()
        if brought is not None:
            async for event in _past(database, broadcast, cursor):
                cursor = event.move(cursor)
                yield wanted.written(event, cursor)
            if cursor.progress < newest or cursor.progress > broadcast.progress:
                cursor = replace(cursor, progress=newest)
                yield _write_event("missed", cursor)
        async for piece in _live(request, listener, _Live(cursor, wanted, told)):
            yield piece


def _write_event(word: str, cursor: EventCursor) -> bytes:
    """Write an event for this listener only."""
    return f"event: {word}\ndata: {orjson.dumps({'id': str(cursor)}).decode()}\nid: {cursor}\n\n".encode()


async def _past(database: Engine, broadcast: Broadcast, cursor: EventCursor) -> AsyncIterator[Event]:
    """Yield the events after a cursor, page by page, and its progress unless some is no longer kept."""
    while events := await run_in_threadpool(_missed, database, cursor):
        for event in events:
            cursor = event.move(cursor)
            yield event
    for event in broadcast.progress_after(cursor.progress) or ():
        yield event


def _missed(database: Engine, cursor: EventCursor) -> Iterable[Event]:
    """Return a page of the rows after a cursor."""
    with open_reading(database) as session:
        return list_events_after(session, cursor)


class _Live:
    """Writes the live events for one listener.

    What a listener heard of the past may lie ahead of what the feed has told: until the feed has caught up, each event is held
    against the listener's own cursor. From then on the feed's cursors are the listener's, and its bytes are sent as they are.
    """

    def __init__(self, cursor: EventCursor, wanted: StreamFilter, told: EventCursor) -> None:
        self.cursor = cursor
        self._wish = wanted
        self._is_level = told.covers(cursor)

    def written(self, telling: EventBatch) -> bytes:
        """Write a batch of events."""
        if self._is_level and self._wish.is_everything:
            self.cursor = telling.told[-1].cursor
            return telling.wire
        return b"".join(self._each(telling))

    def _each(self, telling: EventBatch) -> Iterable[bytes]:
        """Write each event of a batch that the listener has not received yet."""
        for one in telling.told:
            if self._is_level:
                self.cursor = one.cursor
            elif one.event.is_after(self.cursor):
                self.cursor = one.event.move(self.cursor)
            else:
                continue
            yield self._wish.written(one.event, self.cursor)
            self._is_level = self._is_level or one.cursor.covers(self.cursor)


async def _live(request: Request, listener: Listener, live: _Live) -> AsyncIterator[bytes]:
    """Write live events until the server stops, the listener is too slow, or the log-in ends."""
    asked_s = said_s = time.monotonic()
    while True:
        found = await listener.next(min(PING_S, ASK_AGAIN_S))
        piece = _piece(live, found)
        if found and found[-1] is None:
            yield piece + _write_event("dropped" if listener.dropped else "closing", live.cursor)
            return
        if not piece and time.monotonic() - said_s >= PING_S:
            piece = PING
        if piece:
            yield piece
            said_s = time.monotonic()
        if listener.doubted or time.monotonic() - asked_s > ASK_AGAIN_S:
            listener.doubted = False
            if not await run_in_threadpool(is_still_valid, request):
                yield _write_event("logged-out", live.cursor)
                return
            asked_s = time.monotonic()


def _piece(live: _Live, found: Sequence[EventBatch | None]) -> bytes:
    """Write all batches up to the end of the stream."""
    return b"".join(live.written(telling) for telling in found if telling is not None)
