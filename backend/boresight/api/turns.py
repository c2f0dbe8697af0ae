"""In which order requests that were let in are worked on: few at once, writers apart from readers, and first what most wait for.

An endpoint and each of its dependencies need a thread, one after the other. Were all requests let at the threads together, each
would wait for one again and again behind all others, and a writer would hold the store's write lock meanwhile: so twenty writers
among two hundred readers waited seven seconds. Here a request waits once, for its turn, and then finds a thread whenever it
needs one. More turns at once than `most` only take the interpreter from each other.

The next turn goes to the request for whose answer the longest time was waited, summed up over all who will have it
(`boresight.api.ready`). Among requests of one asker each that is the order of their coming; of an answer that two hundred wait for
it makes the first. Nobody waits for ever: how long they have waited grows until it is the most.

A turn is lent for `LENT_S`: who works longer, on a figure or a report, keeps the thread but makes room for the next.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

LENT_S = 0.25


class Turns:
    """The turns of one kind of requests, given to those that were waited for longest.

    Parameters
    ----------
    most
        At once.
    lent_s
        After so long the next has a turn too.
    """

    def __init__(self, most: int, lent_s: float = LENT_S) -> None:
        self._free = most
        self._lent_s = lent_s
        self._waiting: dict[asyncio.Future[None], Callable[[float], float]] = {}

    @asynccontextmanager
    async def turn(self, waited_s: Callable[[float], float] | None = None) -> AsyncIterator[None]:
        """Wait for a turn, and have it.

        Parameters
        ----------
        waited_s
            Tells how long, at a time of the monotonic clock, was waited for what will be done in it, by all who wait for that; by
            whoever asks alone, where not given.
        """
        if self._free:
            self._free -= 1
        else:
            came_s = time.monotonic()
            await self._wait(waited_s or (lambda now_s: now_s - came_s))
        is_over = False

        def end() -> None:
            nonlocal is_over
            if not is_over:
                is_over = True
                self._next()

        lent = asyncio.get_running_loop().call_later(self._lent_s, end)
        try:
            yield
        finally:
            lent.cancel()
            end()

    async def _wait(self, waited_s: Callable[[float], float]) -> None:
        mine: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting[mine] = waited_s
        try:
            await mine
        except asyncio.CancelledError:
            if mine.done() and not mine.cancelled():
                self._next()  # it had just been given
            self._waiting.pop(mine, None)
            raise

    def _next(self) -> None:
        """Give a turn that is over to what was waited for longest."""
        now_s = time.monotonic()
        while self._waiting:
            waiting = max(self._waiting, key=lambda one: self._waiting[one](now_s))
            del self._waiting[waiting]
            if not waiting.done():
                waiting.set_result(None)
                return
        self._free += 1
