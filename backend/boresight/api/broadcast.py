"""The event feed of one server: what changed, told to every listener, with nothing lost and nobody held up.

One thread follows the rows, at once when it is nudged and every half second otherwise, so changes made by other processes
(the command line, another server) are told too. Progress comes from the worker engine; the last few hundred events of it
are kept, so that who comes back after a break of seconds misses none. Each listener is a bounded queue on the event loop
and has no thread of its own. Who reads too slowly is told so and let go, and comes back with its place.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from boresight.api.feed import Event, Place, Ring, events_after
from boresight.api.rounds import Rounds
from boresight.store.sessions import Engine, reading

QUEUE_LENGTH = 256
KEPT = 512  # progress events: about a minute of two runs
LOOK_EVERY_S = 0.5


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
        self._place = Place(0, 0)
        self._ring = Ring(KEPT)
        self._rounds = Rounds("event feed", [self._follow], lambda: LOOK_EVERY_S)
        self._is_closed = False

    def start(self) -> None:
        """Begin to follow the rows, from where they end now."""
        self._is_closed = False
        with reading(self._database) as session:
            self._place = Place.now(session)
        self._rounds.start()

    def close(self) -> None:
        """End every stream and stop following; safe to call twice."""
        self._is_closed = True
        self._offer([None])
        self._rounds.close()

    def hear(self, event: dict[str, Any]) -> None:
        """Take an event of the worker engine: progress is passed on, a change of state is a row to be looked up."""
        if event.get("kind") != "progress":
            self.nudge()
            return
        data = {name: value for name, value in event.items() if name not in {"kind", "history"}}
        with self._lock:
            told = self._ring.add(data, event.get("history"))
            for listener in self._listeners:
                listener.offer([told])

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
    def listening(self) -> Iterator[Listener]:
        """Hear everything from now on."""
        listener = Listener()
        with self._lock:
            self._listeners.add(listener)
        if self._is_closed:
            listener.offer([None])
        try:
            yield listener
        finally:
            with self._lock:
                self._listeners.discard(listener)

    def _offer(self, events: Sequence[Event | None]) -> None:
        with self._lock:
            for listener in self._listeners:
                listener.offer(events)

    def _follow(self) -> None:
        """Tell the rows that are new."""
        with reading(self._database) as session:
            events = events_after(session, self._place)
        self._offer(events)
        for event in events:
            self._place = event.move(self._place)
