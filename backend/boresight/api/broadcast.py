"""The event feed: what changed, told to every listener, with nothing lost and nobody held up.

What is told of runs and of the audit log are rows: `run_events` and `audit`, both numbered in the order of their
commits. A place in the feed is therefore a pair of numbers, written `<run event>.<audit record>`, and is the id of every
event; whoever comes back with a place is told all the rows after it. Progress is not a row: it has no number of its own
and is not told again.

One thread follows the rows, at once when it is nudged and every half second otherwise, so changes
made by other processes (the command line, another server) are told too. Each listener has a bounded queue. Who reads too
slowly is told so and let go; the browser then comes back with its place and misses nothing.
"""

from __future__ import annotations

import asyncio
import heapq
import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from boresight.services import audit
from boresight.store import run_events
from boresight.store.sessions import Engine, Session, reading

log = logging.getLogger(__name__)

QUEUE_LENGTH = 256
LOOK_EVERY_S = 0.5
PAGE = 500


@dataclass(frozen=True)
class Place:
    """How far somebody has been told: the newest run event and the newest audit record."""

    run_event: int
    record: int

    def __str__(self) -> str:
        """Write the place as an event id."""
        return f"{self.run_event}.{self.record}"

    @classmethod
    def parse(cls, text: str) -> Place | None:
        """Read an event id; None when it is none of ours."""
        first, _, second = text.partition(".")
        if not (first.isdecimal() and second.isdecimal()):
            return None
        return cls(int(first), int(second))

    @classmethod
    def now(cls, session: Session) -> Place:
        """Return the place after everything stored."""
        newest = audit.list_records(session, limit=1)
        return cls(run_events.newest_event_id(session), newest[0].id if newest else 0)


@dataclass(frozen=True)
class Event:
    """One event: `kind` is run, progress or audit; `number` its row, None for progress."""

    kind: str
    data: dict[str, Any]
    number: int | None = None

    def is_after(self, place: Place) -> bool:
        """Whether somebody at a place has not been told this yet."""
        return self.number is None or self.number > (place.run_event if self.kind == "run" else place.record)

    def move(self, place: Place) -> Place:
        """Return the place of somebody who has now been told this."""
        if self.number is None:
            return place
        return replace(place, **{"run_event" if self.kind == "run" else "record": self.number})


def events_after(session: Session, place: Place) -> list[Event]:
    """Return the rows after a place as events, those of either kind in their order, at most a page of each."""
    runs = [
        Event(
            "run",
            {
                "run_id": row.run_id,
                "attempt": row.attempt,
                "state": row.message.partition(":")[0],
                "message": row.message,
                "at_utc": row.at_utc,
            },
            row.id,
        )
        for row in run_events.state_events(session, place.run_event, PAGE)
    ]
    return list(heapq.merge(runs, _records_after(session, place.record), key=lambda event: str(event.data["at_utc"])))


def _records_after(session: Session, record: int) -> list[Event]:
    """Return a page of the audit records after a number, oldest first; what they changed is left to the log itself."""
    newest = audit.list_records(session, limit=1)
    last = newest[0].id if newest else 0
    for top in range(record + PAGE, last + PAGE, PAGE):  # the next window, further on where numbers have gaps
        page = audit.list_records(session, before_id=top + 1, limit=PAGE)
        if page and page[0].id > record:
            return [_told(row) for row in reversed(page) if row.id > record]
    return []


def _told(row: Any) -> Event:
    """Tell an audit record as an event."""
    names = ("id", "at_utc", "actor", "action", "object")
    return Event("audit", {name: getattr(row, name) for name in names}, row.id)


class Listener:
    """One listener's queue, filled from any thread, emptied on the event loop."""

    def __init__(self) -> None:
        self.dropped = False
        self._loop = asyncio.get_running_loop()
        self._queue: asyncio.Queue[Event | None] = asyncio.Queue()

    def offer(self, events: Sequence[Event | None]) -> None:
        """Queue events from any thread; None ends the stream."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._put, events)

    def _put(self, events: Sequence[Event | None]) -> None:
        """Queue on the loop, and let go of a listener that is too far behind."""
        for event in events:
            if self.dropped:
                return
            if event is not None and self._queue.qsize() >= QUEUE_LENGTH:
                self.dropped = True
                event = None  # noqa: PLW2901 - the end of the stream takes the place of what does not fit
            self._queue.put_nowait(event)

    async def next(self, timeout_s: float) -> Sequence[Event | None]:
        """Wait for the next event; returns nothing when none came in time."""
        try:
            return [await asyncio.wait_for(self._queue.get(), timeout_s)]
        except TimeoutError:
            return []


class Broadcast:
    """The feed of one server."""

    def __init__(self, database: Engine) -> None:
        self._database = database
        self._listeners: set[Listener] = set()
        self._lock = threading.Lock()
        self._nudge = threading.Event()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to follow the rows, from where they end now."""
        self._closing.clear()
        with reading(self._database) as session:
            place = Place.now(session)
        self._thread = threading.Thread(target=self._follow, args=(place,), name="boresight-broadcast", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End every stream and stop following; safe to call twice."""
        self._closing.set()
        self._nudge.set()
        self._offer([None])
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
            self._thread = None

    def hear(self, event: dict[str, Any]) -> None:
        """Take an event of the worker engine: progress is passed on, a change of state is a row to be looked up."""
        if event.get("kind") == "progress":
            self._offer([Event("progress", {name: value for name, value in event.items() if name != "kind"})])
        else:
            self.nudge()

    def nudge(self) -> None:
        """Look at the rows now."""
        self._nudge.set()

    @property
    def listeners(self) -> int:
        """How many streams are open."""
        return len(self._listeners)

    @contextmanager
    def listening(self) -> Iterator[Listener]:
        """Hear everything from now on."""
        listener = Listener()
        with self._lock:
            self._listeners.add(listener)
        if self._closing.is_set():
            listener.offer([None])
        try:
            yield listener
        finally:
            with self._lock:
                self._listeners.discard(listener)

    def _offer(self, events: Sequence[Event | None]) -> None:
        with self._lock:
            listeners = tuple(self._listeners)
        for listener in listeners:
            listener.offer(events)

    def _follow(self, place: Place) -> None:
        """Tell new rows until closed; an error is logged and the next look tries again."""
        while not self._closing.is_set():
            try:
                with reading(self._database) as session:
                    events = events_after(session, place)
            except Exception:
                log.exception("The event feed could not read the store and tries again")
                events = []
            self._offer(events)
            for event in events:
                place = event.move(place)
            self._nudge.wait(LOOK_EVERY_S)
            self._nudge.clear()
