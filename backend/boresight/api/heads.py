"""HEAD of every address that can be read: the answer to GET without its body (RFC 9110, 9.3.2).

The endpoints know GET only. A request with HEAD reaches them as GET, so that headers, tags and lengths are those of GET by
construction, and its body goes nowhere. An answer in several pieces, a long file or the event stream, which would never end, is
broken off at the first: its headers are all that was asked for.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Heads:
    """The layer that answers HEAD."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in, and only the head of the answer out."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        inner = {**scope, "method": "GET"}  # the server looks at the method in its own when it sends
        head = _Head(send)
        answering = asyncio.ensure_future(self.app(inner, receive, head.send))
        answering.add_done_callback(lambda _: head.over.set())
        try:
            await head.over.wait()
        finally:
            if "route" in inner:
                scope["route"] = inner["route"]  # by which it is counted
            await _end(answering)


class _Head:
    """The head of one answer on its way out; `over` once there is no need to wait for the rest."""

    def __init__(self, send: Send) -> None:
        self.over = asyncio.Event()
        self._send = send
        self._is_sent = False

    async def send(self, message: Message) -> None:
        """Send the start, and an end in the place of the body's first piece."""
        if message["type"] == "http.response.start":
            await self._send(message)
        elif message["type"] == "http.response.body" and not self._is_sent:
            self._is_sent = True
            await self._send({"type": "http.response.body", "body": b""})
        if message.get("more_body", False):
            self.over.set()


async def _end(answering: asyncio.Future[None]) -> None:
    """Break off what still answers; what it failed with is passed on."""
    answering.cancel()
    with suppress(asyncio.CancelledError):
        await answering
