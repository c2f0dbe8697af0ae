"""Broadcasting the event feed of one server: no event is lost and a slow listener delays nobody.

One thread follows the rows of `run_events` and `audit`, so changes by other processes are told too; progress comes from
the dispatcher, numbered from the server's start on. A cursor is `<run event>.<audit record>.<progress>`,
the id of every event: who comes back with it misses nothing. Events are written once and go out together, after a pause
of 0.1 ms for each listener; who reads too slowly is let go.
"""

from __future__ import annotations

import asyncio
import heapq
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import orjson

from boresight.console.access import queries as login_sessions
from boresight.console.runs import queries as run_events
from boresight.console.runs.tables import RunEvent
from boresight.platform.actors import Actor
from boresight.platform.audit import queries as audit
from boresight.platform.db.data_version import DataVersion, DataVersionReader
from boresight.platform.db.sessions import Engine, Session, open_reading, utc_now
from boresight.platform.jobs.periodic_thread import PeriodicThread
from boresight.platform.jobs.worker_news import RunMoved, RunProgress
from boresight.platform.web.paging import parse_row_id

PAGE = 500
LINE_LENGTH = 400  # of a log line that is sent; the log has it whole


@dataclass(frozen=True)
class EventCursor:
    """How far a listener has received the feed: the newest run event, audit record and progress."""

    run_event: int
    record: int
    progress: int = 0

    def __str__(self) -> str:
        """Write the cursor as an event id."""
        return f"{self.run_event}.{self.record}.{self.progress}"

    def covers(self, other: EventCursor) -> bool:
        """Whether this cursor is at or after another one in every part."""
        return self.run_event >= other.run_event and self.record >= other.record and self.progress >= other.progress

    @classmethod
    def parse(cls, text: str) -> EventCursor | None:
        """Read an event id; None when it is not a cursor."""
        numbers = [number for part in text.split(".") if (number := parse_row_id(part)) is not None]
        return cls(*numbers) if len(numbers) in {2, 3} and len(numbers) == text.count(".") + 1 else None

    @classmethod
    def now(cls, session: Session, progress: int = 0) -> EventCursor:
        """Return the cursor after everything stored, and after this progress."""
        return cls(run_events.read_newest_event_id(session), audit.read_newest_id(session), progress)


PART_OF_KIND = {"run": "run_event", "log": "run_event", "audit": "record", "progress": "progress"}


@dataclass(frozen=True)
class Event:
    """One event."""

    kind: str
    data: dict[str, Any]
    number: int
    history: dict[str, Any] | None = None

    def is_after(self, cursor: EventCursor) -> bool:
        """Whether the event comes after a cursor."""
        told: int = getattr(cursor, PART_OF_KIND[self.kind])
        return self.number > told

    def move(self, cursor: EventCursor) -> EventCursor:
        """Return a cursor moved past this event."""
        return replace(cursor, **{PART_OF_KIND[self.kind]: self.number})

    @cached_property
    def text(self) -> str:
        """The event as JSON, written once for all listeners."""
        return orjson.dumps(self.data).decode()

    @cached_property
    def text_with_history(self) -> str:
        """The event as JSON with its history, for listeners that follow the run."""
        return orjson.dumps(self.data | {"history": self.history}).decode()

    def wire(self, cursor: EventCursor, *, with_history: bool = False) -> bytes:
        """Write it as a server-sent event, its id the cursor after it."""
        text = self.text_with_history if with_history and self.history is not None else self.text
        return f"event: {self.kind}\ndata: {text}\nid: {cursor}\n\n".encode()


class RecentProgress:
    """The newest progress events, numbered."""

    def __init__(self, length: int) -> None:
        self._kept: deque[Event] = deque(maxlen=length)
        self.newest = int(1000 * time.time())

    def add(self, data: dict[str, Any], history: dict[str, Any] | None) -> Event:
        """Give a progress event its number, and keep it."""
        self.newest += 1
        self._kept.append(Event("progress", data, self.newest, history))
        return self._kept[-1]

    def after(self, number: int) -> list[Event] | None:
        """Return the events after a number; None when some are no longer kept, or the number is another server's."""
        oldest = self._kept[0].number if self._kept else self.newest + 1
        if not oldest - 1 <= number <= self.newest:
            return None
        return [event for event in self._kept if event.number > number]


def list_events_after(session: Session, cursor: EventCursor) -> list[Event]:
    """Return the rows after a cursor as events, those of either kind in their order, at most a page of each."""
    lines = [_make_run_event(row) for row in run_events.list_events_after(session, cursor.run_event, PAGE)]
    records = [_make_record_event(row) for row in audit.list_heads_after(session, cursor.record, PAGE)]
    return list(heapq.merge(lines, records, key=lambda event: str(event.data["at_utc"])))


def _make_run_event(row: RunEvent) -> Event:
    """Make the event of a line of a run's log: `run` for a change of state, `log` for any other."""
    told = {"run_id": row.run_id, "attempt": row.attempt, "at_utc": row.at_utc, "message": row.message[:LINE_LENGTH]}
    if row.kind == "state":
        return Event("run", told | {"state": row.state}, row.id)
    return Event("log", told | {"kind": row.kind}, row.id)


def _make_record_event(row: Mapping[str, Any]) -> Event:
    """Make the event of an audit record, without what it changed, which the log has."""
    return Event("audit", dict(row), row["id"])


QUEUE_LENGTH = 4096  # events; they are shared by all who wait for them
KEPT = 512  # progress events: about a minute of two runs
LOOK_EVERY_S = 0.5
LOOK_AFTER_S = 0.1  # after a look that found something or not, however many commit
PAUSE_A_LISTENER_S = 1e-4


@dataclass(frozen=True)
class DeliveredEvent:
    """An event with the cursor of the feed after it."""

    event: Event
    cursor: EventCursor

    @cached_property
    def wire(self) -> bytes:
        """The event as it is sent."""
        return self.event.wire(self.cursor)


class EventBatch:
    """Events sent together, serialised once for all listeners of the whole feed."""

    def __init__(self, told: Sequence[DeliveredEvent]) -> None:
        self.told = told

    @cached_property
    def wire(self) -> bytes:
        """All events as they are sent."""
        return b"".join(one.wire for one in self.told)


class Listener:
    """The queue of one listener, used on the event loop only; None ends the stream."""

    def __init__(self, actor: Actor) -> None:
        self.actor = actor
        self.dropped = False
        self.doubted = False  # whether the credential under which it listens may have ended
        self._waiting: list[EventBatch | None] = []
        self._events = 0
        self._something = asyncio.Event()

    def put(self, telling: EventBatch | None) -> None:
        """Queue a batch, or drop a listener that is too far behind."""
        if self.dropped:
            return
        self._events += 0 if telling is None else len(telling.told)
        if self._waiting and self._events > QUEUE_LENGTH:
            self.dropped = True
            telling = None  # the end of the stream takes the place of what does not fit
        self._waiting.append(telling)
        self._something.set()

    def doubt(self) -> None:
        """Have the stream check again whether its credential is valid."""
        self.doubted = True
        self._something.set()

    async def next(self, timeout_s: float) -> Sequence[EventBatch | None]:
        """Wait for batches and return all that are queued; none when no batch came in time."""
        if not self._waiting:
            try:
                await asyncio.wait_for(self._something.wait(), timeout_s)
            except TimeoutError:
                return []
        found, self._waiting, self._events = self._waiting, [], 0
        self._something.clear()
        return found


class Broadcast:
    """The feed of one server."""

    def __init__(self, database: Engine) -> None:
        self._database = database
        self._listeners: set[Listener] = set()
        self._lock = threading.Lock()
        self._ring = RecentProgress(KEPT)
        self._found = EventCursor(0, 0, self._ring.newest)  # how far events were found
        self.cursor = self._found  # how far they were sent
        self._pending: list[DeliveredEvent] = []
        self._told_s = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._data_versions = DataVersionReader(database)
        self._data_version: DataVersion | None = None
        self._ended_utc = utc_now()  # the newest end of a log-in that was noticed
        self._revoked: tuple[str | None, str | None] = (None, None)  # when a key was last revoked, a person disabled
        self._thread = PeriodicThread("event feed", [self._follow], lambda: LOOK_EVERY_S, LOOK_AFTER_S)
        self._is_closed = False

    def start(self) -> None:
        """Begin to follow the rows, from the newest one on."""
        self._is_closed = False
        with open_reading(self._database) as session:
            self.cursor = self._found = EventCursor.now(session, self._ring.newest)
            self._revoked = login_sessions.read_newest_revocation(session)
        self._ended_utc = utc_now()
        self._thread.start()

    def close(self) -> None:
        """End every stream and stop following; safe to call twice."""
        self._is_closed = True
        self._on_the_loop(self._end)
        self._thread.close()
        self._data_versions.close()

    def hear(self, news: RunMoved | RunProgress) -> None:
        """Handle news of the dispatcher: progress is passed on, a change of state makes the feed read its row."""
        if isinstance(news, RunMoved):
            self.nudge()
            return
        with self._lock:
            self._find([self._ring.add(news.to_dict(), news.history)])

    def nudge(self) -> None:
        """Look at the rows now."""
        self._thread.nudge()

    @property
    def listeners(self) -> int:
        """How many streams are open."""
        return len(self._listeners)

    @property
    def progress(self) -> int:
        """The number of the newest progress."""
        return self._ring.newest

    def progress_after(self, number: int) -> list[Event] | None:
        """Return the progress events after a number; None when some are no longer kept, or the number is another server's."""
        with self._lock:
            return self._ring.after(number)

    @contextmanager
    def open_listener(self, actor: Actor) -> Iterator[Listener]:
        """Register a listener for everything after `cursor`, in the name of an actor; call this on the event loop."""
        self._loop = asyncio.get_running_loop()
        listener = Listener(actor)
        self._listeners.add(listener)
        if self._is_closed:
            listener.put(None)
        try:
            yield listener
        finally:
            self._listeners.discard(listener)

    def _follow(self) -> None:
        """Broadcast the new rows, page by page, after anything was committed."""
        data_version = self._data_versions.look()
        found = data_version is None or data_version != self._data_version
        if found:
            self._find_endings()
        while found and not self._is_closed:
            with open_reading(self._database) as session:
                events = list_events_after(session, self._found)
            found = len(events) >= PAGE  # otherwise neither kind has more
            with self._lock:
                self._find(events)
        self._data_version = data_version

    def _find_endings(self) -> None:
        """Have streams check their credential: of log-ins that ended, and all after a key was revoked or a person disabled."""
        with open_reading(self._database) as session:
            ended = login_sessions.read_ends_since(session, self._ended_utc)
            revoked = login_sessions.read_newest_revocation(session)
        if ended:
            self._ended_utc = max(ended.values())
        if ended or revoked != self._revoked:
            self._on_the_loop(self._recheck_credentials, set(ended), revoked != self._revoked)
        self._revoked = revoked

    def _recheck_credentials(self, ended: set[int], keys: bool) -> None:
        """Have the streams of ended log-ins check their credential, and on request those of API keys."""
        for listener in self._listeners:
            if listener.actor.session_id in ended or (keys and listener.actor.is_key):
                listener.doubt()

    def _find(self, events: Sequence[Event]) -> None:
        """Assign cursors to events in order, under the lock, and hand them to the event loop."""
        told = []
        for event in events:
            self._found = event.move(self._found)
            told.append(DeliveredEvent(event, self._found))
        if told and not self._on_the_loop(self._take, told):
            self.cursor = self._found  # nobody has listened yet

    def _on_the_loop(self, act: Callable[..., None], *given: Any) -> bool:
        """Call a function on the event loop; return whether there is one."""
        if self._loop is None or self._loop.is_closed():
            return False
        self._loop.call_soon_threadsafe(act, *given)
        return True

    def _take(self, told: Sequence[DeliveredEvent]) -> None:
        """Send events at once, or with those that come before the pause is over."""
        if not self._pending:
            pause_s = PAUSE_A_LISTENER_S * len(self._listeners)
            asyncio.get_running_loop().call_later(max(0.0, self._told_s + pause_s - time.monotonic()), self._tell)
        self._pending += told

    def _tell(self) -> None:
        """Send the pending events to every listener; there may be none after the feed was closed."""
        if not self._pending:
            return
        telling, self._pending = EventBatch(self._pending), []
        self.cursor = telling.told[-1].cursor
        for listener in self._listeners:
            listener.put(telling)
        self._told_s = time.monotonic()

    def _end(self) -> None:
        """Send the pending events, then end every stream."""
        self._tell()
        for listener in self._listeners:
            listener.put(None)
