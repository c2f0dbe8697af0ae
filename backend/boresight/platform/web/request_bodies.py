"""Request bodies: deadlines while the server waits for them, and strict JSON and UTF-8 before any endpoint."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from email.message import Message as Headed
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote_to_bytes

import orjson
from fastapi.exceptions import RequestValidationError
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CLOSE = {"Connection": "close"}  # the rest is not read


@dataclass(frozen=True)
class BodyRate:
    """How fast a body must come."""

    window_s: float = 30.0
    floor_bytes: int = 64 << 10
    slowest_bytes_per_s: float = 25_000.0

    def longest_s(self, limit_bytes: int) -> float:
        """Return how long a body may take altogether."""
        return self.window_s + limit_bytes / self.slowest_bytes_per_s


class RequestBody:
    """A body on its way in."""

    def __init__(
        self, receive: Receive, pace: BodyRate, limit_bytes: int, too_large: str, announced_bytes: int = 0
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
        """Return the next piece."""
        if self._ended:
            return await self._receive()  # from now on only the client's disconnect is awaited, without a deadline
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
        )  # the rest is read and discarded for a while

    async def _in_time(self) -> Message:
        """Wait for the next piece until the deadline."""
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


async def read_body(receive: Receive) -> Receive | None:
    """Read a whole body; None where the client has left."""
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


DEEPEST = 32
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
CHARSETS = ("utf-8", "utf8", "us-ascii")
NUL = "\0"
Refuse = Callable[[Request, Exception], Awaitable[Response]]


class RequestValidation:
    """The middleware that refuses invalid UTF-8 and invalid JSON."""

    def __init__(self, app: ASGIApp, refuse: Refuse) -> None:
        self.app = app
        self._refuse = refuse

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        try:
            received = await _checked(scope, receive)
        except (RequestValidationError, HTTPException) as error:
            response = await self._refuse(Request(scope), error)
            await response(scope, receive, send)
        else:
            await self.app(scope, received, send)


async def _checked(scope: Scope, receive: Receive) -> Receive:
    """Return the receive function for a request's body; refuse an invalid request."""
    if NUL in scope["path"]:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    if b"\0" in unquote_to_bytes(scope["query_string"]):
        raise _malformed("query", "A parameter contains a NUL character")
    told = Headed()
    told["content-type"] = Headers(scope=scope).get("content-type", "")
    if str(told.get_param("charset", CHARSETS[0])).lower() not in CHARSETS:
        raise HTTPException(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "Send text as UTF-8; other charsets are not read.")
    is_json = told.get_content_maintype() == "application" and told.get_content_subtype().endswith("json")
    return await _strict(receive) if is_json and scope["method"] not in {"GET", "HEAD", "OPTIONS"} else receive


async def _strict(receive: Receive) -> Receive:
    """Read a whole JSON body, and return a receive function with its normalised form."""
    pieces: list[bytes] = []
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return _giving(message, receive)  # the client has left
        pieces.append(message.get("body", b""))
        if not message.get("more_body", False):
            break
    body = b"".join(pieces)
    understood = orjson.dumps(read_json(body)) if body.strip() else b""
    return _giving({"type": "http.request", "body": understood, "more_body": False}, receive)


def _giving(first: Message, receive: Receive) -> Receive:
    """Return a receive function that gives one message first and then the original ones."""
    waiting = [first]

    async def given() -> Message:
        return waiting.pop() if waiting else await receive()

    return given


def read_json(body: bytes) -> Any:
    """Parse JSON strictly by RFC 8259."""
    try:
        document = orjson.loads(body.removeprefix(BYTE_ORDER_MARK))
    except orjson.JSONDecodeError as error:
        raise _malformed("body", f"It is not JSON: {error}") from error
    _refuse_unkeepable(document)
    return document


def _refuse_unkeepable(document: Any) -> None:
    """Refuse NUL in any text, and nesting too deep for later parsers."""
    level, depth = [document], 0
    while level:
        if depth > DEEPEST:
            raise _malformed("body", f"It is nested more than {DEEPEST} deep")
        texts = [one for one in level if isinstance(one, str)]
        keys = [key for one in level if isinstance(one, dict) for key in one]
        if any(NUL in text for text in (*texts, *keys)):
            raise _malformed("body", "A text contains a NUL character")
        objects = [value for one in level if isinstance(one, dict) for value in one.values()]
        level = [*objects, *(value for one in level if isinstance(one, list) for value in one)]
        depth += 1


def _malformed(where: str, sentence: str) -> RequestValidationError:
    """Return a refusal in the form of the framework's validation errors."""
    return RequestValidationError([{"loc": (where,), "msg": sentence, "type": "malformed"}])
