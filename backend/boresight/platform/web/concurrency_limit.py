"""The concurrency limit: too many requests at once are refused with 503 and `Retry-After`.

A request that needs the store waits for one of a few threads. Without a bound a crowd would fill the queue until everybody's
patience is over before their turn comes, and the server would work for people who have left. With it, whoever is let in is answered
within seconds, and the rest know it within a millisecond: 503 and `Retry-After`. Cached answers, files of the pages, event
streams and the routes by which the server is watched need no thread of the few, and are always let in.

There are three kinds of slots, and no kind takes another's. Requests of somebody known; requests of nobody known, of which each
address has a share; and large bodies, of which each person has a share, for these are read while their slot is held. Every other
body is read before a slot is taken, so that whoever sends half of one holds none. A forged or ended credential counts as none, and
an unknown client may send no more than a form.

Of those let in few run at once, writers apart from readers (`RequestQueue`).
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.errors import BoresightError, OverloadedError, UnauthenticatedError
from boresight.platform.actors import Actor
from boresight.platform.web.connections import CONNECTION, Connection
from boresight.platform.web.middleware import FOR_MACHINES
from boresight.platform.web.origins import SAFE_METHODS, get_network
from boresight.platform.web.request_bodies import CLOSE, read_body
from boresight.platform.web.response_cache import waited_s

LENT_S = 0.25


class RequestQueue:
    """A queue that limits the requests that run at once; next is the one with the longest total wait of all clients of its answer.

    An endpoint and each of its dependencies need a thread, one after the other. Were all let at the threads together, each would
    wait for one again and again, and a writer would hold the store's write lock meanwhile. So a request waits once, for its turn.
    Nobody waits forever: what was waited grows until it is the most. Who works longer than `LENT_S` keeps the thread but makes
    room for the next.
    """

    def __init__(self, most: int, lent_s: float = LENT_S) -> None:
        self._free = most
        self._lent_s = lent_s
        self._waiting: dict[asyncio.Future[None], Callable[[float], float]] = {}

    @asynccontextmanager
    async def turn(self, waited_s: Callable[[float], float] | None = None) -> AsyncIterator[None]:
        """Wait for a turn, and hold it within the block."""
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
                self._next()  # the turn had just been given
            self._waiting.pop(mine, None)
            raise

    def _next(self) -> None:
        """Give a free turn to the request with the longest total wait."""
        now_s = time.monotonic()
        while self._waiting:
            waiting = max(self._waiting, key=lambda one: self._waiting[one](now_s))
            del self._waiting[waiting]
            if not waiting.done():
                waiting.set_result(None)
                return
        self._free += 1


COME_BACK_S = 2
SMALL_BODY_BYTES = 64_000
Refuse = Callable[[Request, Exception], Response]
Begin = Callable[[Scope], Awaitable[None]]
READERS, WRITERS = 2, 2  # run at once; all writers but one wait for the store


@dataclass(frozen=True)
class ConcurrencyLimits:
    """How many requests of each kind may run at once."""

    known: int = 512
    unknown: int = 64
    unknown_each: int = 16
    large: int = 32
    large_each: int = 8
    unknown_body_s: float = 10.0


class Slots:
    """A number of slots for requests of one kind."""

    def __init__(self, most: int, most_each: int) -> None:
        self.most = most
        self.most_each = most_each
        self.taken = 0
        self._by_key: Counter[str] = Counter()

    def take(self, key: str) -> bool:
        """Take a slot, if there is one."""
        if self.taken >= self.most or self._by_key[key] >= self.most_each:
            return False
        self.taken += 1
        self._by_key[key] += 1
        return True

    def give_back(self, key: str) -> None:
        """Free a slot that was taken."""
        self.taken -= 1
        self._by_key[key] -= 1
        if not self._by_key[key]:
            del self._by_key[key]


class ConcurrencyLimit:
    """The middleware that counts requests."""

    def __init__(self, app: ASGIApp, refuse: Refuse, begin: Begin, limits: ConcurrencyLimits | None = None) -> None:
        self.app = app
        self.limits = limits or ConcurrencyLimits()
        self.known = Slots(self.limits.known, self.limits.known)
        self.unknown = Slots(self.limits.unknown, self.limits.unknown_each)
        self.large = Slots(self.limits.large, self.limits.large_each)
        self.readers, self.writers = RequestQueue(READERS), RequestQueue(WRITERS)
        self._refuse = refuse
        self._begin = begin

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in, or turn it away."""
        if scope["type"] != "http" or scope["path"].startswith(FOR_MACHINES):
            await self.app(scope, receive, send)
            return
        try:
            actor: Actor | None = scope["state"].get("actor")
            person = None if actor is None else actor.user_id
            _mark_connection(scope, known=person is not None)
            body = _AnnouncedBody.of(scope)
            if person is None:
                slots, key = self.unknown, _address(scope)
                buffered = await self._small(body, receive) if body.comes else receive
            elif body.is_large:
                slots, key, buffered = self.large, str(person), receive
            else:
                slots, key = self.known, ""
                buffered = await read_body(receive) if body.comes else receive
            if buffered is None:
                return  # the client has left
            if not slots.take(key):
                raise _make_refusal(slots)
        except (BoresightError, HTTPException) as error:
            await self._refuse(Request(scope), error)(scope, receive, send)
            return
        try:
            async with (self.readers if scope["method"] in SAFE_METHODS else self.writers).turn(waited_s(scope)):
                await self._begin(scope)
                await self.app(scope, buffered, send)
        finally:
            slots.give_back(key)

    async def _small(self, body: _AnnouncedBody, receive: Receive) -> Receive | None:
        if body.is_large:
            raise UnauthenticatedError(
                f"Only requests with a log-in or a valid API key may send over {SMALL_BODY_BYTES:,} bytes; log in first."
            )
        try:
            async with asyncio.timeout(self.limits.unknown_body_s):
                return await read_body(receive)
        except TimeoutError as error:
            sentence = (
                f"The request body did not arrive within {self.limits.unknown_body_s:g} s; send it without delay."
            )
            raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, sentence, CLOSE) from error


@dataclass(frozen=True)
class _AnnouncedBody:
    """What a request's headers announce: whether it has a body, and whether that may be large."""

    comes: bool
    is_large: bool

    @classmethod
    def of(cls, scope: Scope) -> _AnnouncedBody:
        headers = Headers(scope=scope)
        length = headers.get("content-length", "")
        if not length.isdecimal():
            chunked = "transfer-encoding" in headers
            return cls(chunked, chunked)
        return cls(int(length) > 0, int(length) > SMALL_BODY_BYTES)


def _mark_connection(scope: Scope, *, known: bool) -> None:
    """Tell the connection whether its request is of a known actor; in tests there is no connection."""
    connection: Connection | None = scope["state"].get(CONNECTION)
    if connection is not None:
        connection.known = known


def _address(scope: Scope) -> str:
    """Return where a request comes from: the client that a trusted proxy names, else who opened the connection."""
    client = scope.get("client")
    return get_network(client[0]) if client else ""


def _make_refusal(slots: Slots) -> OverloadedError:
    said = f"{slots.most} requests of this kind are being answered, the most that this server allows"
    if slots.taken < slots.most:
        said = f"{slots.most_each} of your requests are being answered, the most that one address or person may have"
    return OverloadedError(f"{said}; try again in {COME_BACK_S} s.", COME_BACK_S)
