"""How long a request's body may take, counted only while the server waits for it.

What is announced must come: in every window of `WINDOW_S` at least `FLOOR_BYTES`, or the end. So one byte a second is
refused within a window, and a link that carries 20 kbit/s is not. All of it must have come within a time that goes by the
largest body its address takes: 512 MB in under six hours, a form in under a minute and a half.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.types import Message, Receive

CLOSE = {"Connection": "close"}  # what still comes is not read


@dataclass(frozen=True)
class Pace:
    """How fast a body must come.

    Parameters
    ----------
    window_s, floor_bytes
        So much at least in each such time.
    slowest_bytes_per_s
        Decides, with the largest body, how long all of it may take beyond one window.
    """

    window_s: float = 30.0
    floor_bytes: int = 64 << 10
    slowest_bytes_per_s: float = 25_000.0

    def longest_s(self, limit_bytes: int) -> float:
        """Return how long a body may take altogether."""
        return self.window_s + limit_bytes / self.slowest_bytes_per_s


class Body:
    """A body on its way in.

    Parameters
    ----------
    receive
        Gives its pieces.
    limit_bytes
        The largest that is taken.
    too_large
        The sentence that refuses a larger one.
    announced_bytes
        Its length, where it was announced.
    """

    def __init__(
        self, receive: Receive, pace: Pace, limit_bytes: int, too_large: str, announced_bytes: int = 0
    ) -> None:
        self._receive = receive
        self._pace = pace
        self._limit_bytes = limit_bytes
        self._too_large = too_large
        self._left_s = pace.longest_s(limit_bytes)
        self._window_left_s = pace.window_s
        self._window_bytes = 0
        self._received = announced_bytes if announced_bytes > limit_bytes else 0
        self._ended = False

    async def receive(self) -> Message:
        """Return the next piece.

        Raises
        ------
        HTTPException
            When the body is too large or too slow. In the framework's words: it takes any other exception of a body for a body
            that it cannot parse.
        """
        if self._ended:
            return await self._receive()  # now it is told when the asker leaves, which has no deadline
        if self._received > self._limit_bytes:
            raise self._refusal()
        message = await self._in_time()
        self._received += len(message.get("body", b""))
        if self._received > self._limit_bytes:
            raise self._refusal()
        self._ended = not message.get("more_body", False)
        return message

    def _refusal(self) -> HTTPException:
        return HTTPException(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE, self._too_large
        )  # what still comes is read away for a while

    async def _in_time(self) -> Message:
        """Wait for the next piece for as long as there is time."""
        clock = asyncio.get_running_loop().time
        began_s = clock()
        try:
            async with asyncio.timeout(min(self._window_left_s, self._left_s)):
                message = await self._receive()
        except TimeoutError as error:
            sentence = "The body of the request came too slowly or not at all; send it again over a faster link."
            raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, sentence, CLOSE) from error
        waited_s = clock() - began_s
        self._left_s -= waited_s
        self._window_left_s -= waited_s
        self._window_bytes += len(message.get("body", b""))
        if self._window_bytes >= self._pace.floor_bytes:
            self._window_bytes, self._window_left_s = 0, self._pace.window_s
        return message


async def read_whole(receive: Receive) -> Receive | None:
    """Read a body before anybody works on it; None where its sender has left.

    Returns
    -------
    Receive
        Gives the body at once.
    """
    pieces = bytearray()
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return None
        pieces += message.get("body", b"")
        if not message.get("more_body", False):
            break
    whole: Message | None = {"type": "http.request", "body": bytes(pieces), "more_body": False}

    async def given() -> Message:
        nonlocal whole
        if whole is None:
            return await receive()
        message, whole = whole, None
        return message

    return given
