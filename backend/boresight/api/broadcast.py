"""The event feed of one server: what changed, told to every listener, with nothing lost and nobody held up.

One thread follows the rows, at once when it is nudged and every half second otherwise, so changes made by other processes
(the command line, another server on the same store) are told too, after half a second at most. Progress comes from the worker
engine; the last few hundred events of it are kept, so that who comes back after a break of seconds misses none.

Hundreds of listeners cost one task each and nothing else: no thread, no query, and no work for an event but handing it on. Every
event is written once, with the place in the feed after it, and what happened since the last telling goes out to all as one piece
of bytes. Between two tellings lies a pause that grows with the number of listeners, 0.1 ms for each, so that a burst of events
costs many listeners more patience instead of the server more than part of one processor. What waits for a listener is bounded;
who reads too slowly is told so and let go, and comes back with their place.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from boresight.api.feed import PAGE, Event, Place, Ring, events_after
from boresight.api.rounds import Rounds
from boresight.services.actors import Actor
from boresight.store import login_sessions
from boresight.store.marks import Mark, Marks
from boresight.store.sessions import Engine, reading, utc_now

QUEUE_LENGTH = 4096  # events; they are shared by all who wait for them
KEPT = 512  # progress events: about a minute of two runs
LOOK_EVERY_S = 0.5
LOOK_AFTER_S = 0.1  # after a look that found something or not, however many commit
PAUSE_A_LISTENER_S = 1e-4


@dataclass(frozen=True)
class Told:
    """An event with the place of the feed after it."""

    event: Event
    place: Place

    @cached_property
    def wire(self) -> bytes:
        """The event as it is sent."""
        return self.event.wire(self.place)


class Telling:
    """What is told at once; written once for all who hear everything."""

    def __init__(self, told: Sequence[Told]) -> None:
        self.told = told

    @cached_property
    def wire(self) -> bytes:
        """All of it as it is sent."""
        return b"".join(one.wire for one in self.told)


class Listener:
    """What waits for one listener; filled and emptied on the event loop. None ends the stream."""

    def __init__(self, actor: Actor) -> None:
        self.actor = actor
        self.dropped = False
        self.doubted = False  # whether the credential under which it listens may have ended
        self._waiting: list[Telling | None] = []
        self._events = 0
        self._something = asyncio.Event()

    def put(self, telling: Telling | None) -> None:
        """Let something wait, and let go of a listener that is too far behind."""
        if self.dropped:
            return
        self._events += 0 if telling is None else len(telling.told)
        if self._waiting and self._events > QUEUE_LENGTH:
            self.dropped = True
            telling = None  # the end of the stream takes the place of what does not fit
        self._waiting.append(telling)
        self._something.set()

    def doubt(self) -> None:
        """Have the stream ask whether its credential still holds."""
        self.doubted = True
        self._something.set()

    async def next(self, timeout_s: float) -> Sequence[Telling | None]:
        """Wait for something and return all that waits; nothing when none came in time."""
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
        self._ring = Ring(KEPT)
        self._found = Place(0, 0, self._ring.newest)  # how far events were found
        self.place = self._found  # how far they were told
        self._pending: list[Told] = []
        self._told_s = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._marks = Marks(database)
        self._mark: Mark | None = None
        self._ended_utc = utc_now()  # the newest end of a log-in that was noticed
        self._revoked: tuple[str | None, str | None] = (None, None)  # when a key was last revoked, a person disabled
        self._rounds = Rounds("event feed", [self._follow], lambda: LOOK_EVERY_S, LOOK_AFTER_S)
        self._is_closed = False

    def start(self) -> None:
        """Begin to follow the rows, from where they end now."""
        self._is_closed = False
        with reading(self._database) as session:
            self.place = self._found = Place.now(session, self._ring.newest)
            self._revoked = login_sessions.newest_revocation(session)
        self._ended_utc = utc_now()
        self._rounds.start()

    def close(self) -> None:
        """End every stream and stop following; safe to call twice."""
        self._is_closed = True
        self._on_the_loop(self._end)
        self._rounds.close()
        self._marks.close()

    def hear(self, event: dict[str, Any]) -> None:
        """Take an event of the worker engine: progress is passed on, a change of state is a row to be looked up."""
        if event.get("kind") != "progress":
            self.nudge()
            return
        data = {name: value for name, value in event.items() if name not in {"kind", "history"}}
        with self._lock:
            self._find([self._ring.add(data, event.get("history"))])

    def nudge(self) -> None:
        """Look at the rows now."""
        self._rounds.nudge()

    @property
    def listeners(self) -> int:
        """How many streams are open."""
        return len(self._listeners)

    @property
    def progress(self) -> int:
        """The number of the newest progress."""
        return self._ring.newest

    def progress_after(self, number: int) -> list[Event] | None:
        """Return the progress after a number; None when some of it is kept no more, or was another server's."""
        with self._lock:
            return self._ring.after(number)

    @contextmanager
    def listening(self, actor: Actor) -> Iterator[Listener]:
        """Hear everything after `place` from now on, as who acts; to be called on the event loop."""
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
        """Tell the rows that are new, page by page until there is none, where anything was committed."""
        mark = self._marks.look()
        found = mark is None or mark != self._mark
        if found:
            self._find_endings()
        while found and not self._is_closed:
            with reading(self._database) as session:
                events = events_after(session, self._found)
            found = len(events) >= PAGE  # otherwise neither kind has more
            with self._lock:
                self._find(events)
        self._mark = mark

    def _find_endings(self) -> None:
        """Have the streams ask again whose log-in has ended, and all of them after a key was revoked or a person disabled."""
        with reading(self._database) as session:
            ended = login_sessions.ended_since(session, self._ended_utc)
            revoked = login_sessions.newest_revocation(session)
        if ended:
            self._ended_utc = max(ended.values())
        if ended or revoked != self._revoked:
            self._on_the_loop(self._doubt, set(ended), revoked != self._revoked)
        self._revoked = revoked

    def _doubt(self, ended: set[int], keys: bool) -> None:
        """Have the streams of ended log-ins ask whether they may go on, and where keys may have ended those of keys."""
        for listener in self._listeners:
            if listener.actor.session_id in ended or (keys and listener.actor.is_key):
                listener.doubt()

    def _find(self, events: Sequence[Event]) -> None:
        """Give events, under the lock and so in one order, the places after them, and hand them to the event loop."""
        told = []
        for event in events:
            self._found = event.move(self._found)
            told.append(Told(event, self._found))
        if told and not self._on_the_loop(self._take, told):
            self.place = self._found  # nobody has listened yet

    def _on_the_loop(self, act: Callable[..., None], *given: Any) -> bool:
        """Let something be done on the event loop; whether there is one."""
        if self._loop is None or self._loop.is_closed():
            return False
        self._loop.call_soon_threadsafe(act, *given)
        return True

    def _take(self, told: Sequence[Told]) -> None:
        """Tell events now, or together with what comes before the pause is over."""
        if not self._pending:
            pause_s = PAUSE_A_LISTENER_S * len(self._listeners)
            asyncio.get_running_loop().call_later(max(0.0, self._told_s + pause_s - time.monotonic()), self._tell)
        self._pending += told

    def _tell(self) -> None:
        """Tell everybody what waits; what was due may have been told when the feed was closed."""
        if not self._pending:
            return
        telling, self._pending = Telling(self._pending), []
        self.place = telling.told[-1].place
        for listener in self._listeners:
            listener.put(telling)
        self._told_s = time.monotonic()

    def _end(self) -> None:
        """Tell what waits, then end every stream."""
        self._tell()
        for listener in self._listeners:
            listener.put(None)
