"""In which order requests that were let in are worked on: few at once, and writers apart from readers.

An endpoint and each of its dependencies need a thread, one after the other. Were all requests let at the threads together, each
would wait for one again and again behind all others, and a writer would hold the store's write lock meanwhile: so twenty writers
among two hundred readers waited seven seconds. Here a request waits once, for its turn, and then finds a thread whenever it
needs one. More turns at once than `most` only take the interpreter from each other.

A turn is lent for `LENT_S`: who works longer, on a figure or a report, keeps the thread but makes room for the next.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

LENT_S = 0.25


class Turns:
    """The turns of one kind of requests, given in the order of their coming.

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
        self._waiting: deque[asyncio.Future[None]] = deque()

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait for a turn, and have it."""
        if self._free:
            self._free -= 1
        else:
            await self._wait()
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

    async def _wait(self) -> None:
        mine: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(mine)
        try:
            await mine
        except asyncio.CancelledError:
            if mine.done() and not mine.cancelled():
                self._next()  # it had just been given
            raise

    def _next(self) -> None:
        """Give a turn that is over to whoever waits longest."""
        while self._waiting:
            waiting = self._waiting.popleft()
            if not waiting.done():
                waiting.set_result(None)
                return
        self._free += 1
