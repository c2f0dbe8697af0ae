"""The middleware for every request: request id, security headers, body limit, HEAD and `Allow`, and a problem for every failure.

The policy allows nothing but what this server sends: no inline script, no other host, no framing. Styles have three
exceptions, all for Plotly and none of which can load anything, for `default-src` is this server. Plotly makes an empty
`<style>` element that it fills through the CSSOM, and one with the style of its maps: each is admitted by the hash of its
text. It sets `style` attributes on the SVG that it draws: `style-src-attr` admits them. HEAD is a GET whose answer is cut off at
its first piece, because the event stream would never end.
"""

from __future__ import annotations

import asyncio
import logging
import os
import re
import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from contextlib import suppress
from functools import lru_cache
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boresight.platform.audit.security_log import SecurityLog
from boresight.platform.observability.logs import BELONGS_TO, REQUESTS
from boresight.platform.observability.traces import Span, Traces, read_traceparent
from boresight.platform.web.request_bodies import BodyRate, RequestBody

log = logging.getLogger(__name__)

EMPTY_STYLE = "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='"
MAP_STYLE = "'sha256-ji27qzEtxXZW+7dun6UwjHXJ18e6WAin1VvNtkzIE/o='"  # of plotly.js 4.1
STYLES = f"'self' {EMPTY_STYLE} {MAP_STYLE}"
SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self'",
        f"style-src {STYLES}",
        "style-src-attr 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
SECURITY_HEADERS = {
    "Content-Security-Policy": SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}
STRICT_TRANSPORT = (b"strict-transport-security", b"max-age=31536000; includeSubDomains")
SECURITY_PAIRS = tuple((name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items())
FOUR_EYES = "Boresight-Four-Eyes"
ALONE = "four-eyes-off-"  # prefix of file names
FILE_NAME = re.compile(r"""(filename\*?=(?:"|utf-8''|))""")
USABLE_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
BODY_LIMIT_BYTES = 1_000_000  # for JSON, plain forms, and the other parts of a multipart form
ATTACHMENT_LIMIT_BYTES = 5_000_000
ATTACHED = re.compile(r"/notes/(?:[a-z-]+/\d+|\d+/attachments)$")  # paths that take an attachment
UPLOADED = ("/telemetry-sets", "/telemetry", "/sensors/propose")  # paths that take a file

#: Asked by browsers and monitoring by themselves, or endless: neither traced nor limited, and not asked who they are.
FOR_MACHINES = ("/static/", "/healthz", "/readyz", "/metrics", "/api/v1/events")
SERVER_FAULT = 500

HeaderPairs = tuple[tuple[bytes, bytes], ...]
Observe = Callable[[Scope, int, float], None]
Refuse = Callable[[Request, Exception], Awaitable[Response]]


def get_request_id(headers: Mapping[bytes, bytes]) -> str:
    """Return the caller's request id when it can stand in a log line, else a new one."""
    given = headers.get(b"x-request-id", b"").decode("latin-1")
    return given if USABLE_ID.fullmatch(given) else os.urandom(16).hex()


class RequestMiddleware:
    """The outermost middleware."""

    def __init__(  # noqa: PLR0913 - what the server gives it, each by its name
        self,
        app: ASGIApp,
        observe: Observe,
        refuse: Refuse,
        upload_limit_mb: float,
        four_eyes: Callable[[], bool],
        *,
        pace: BodyRate | None = None,
        https_only: bool = False,
        traces: Traces | None = None,
        security_log: SecurityLog | None = None,
    ) -> None:
        self.app = app
        self.traces = traces if traces is not None and traces.on else None
        self.security_log = security_log or SecurityLog()
        self.pairs = (*SECURITY_PAIRS, STRICT_TRANSPORT) if https_only else SECURITY_PAIRS
        self.pace = pace or BodyRate()
        self.four_eyes = four_eyes
        self.observe = observe
        self.refuse = refuse
        self.upload_limit_mb = upload_limit_mb

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in and its answer out."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        answer = _Response(scope, send, get_request_id(headers), self.pairs, four_eyes=self.four_eyes())
        BELONGS_TO.set(scope["state"])
        span = None if self.traces is None else _begin_span(self.traces, scope, headers)
        client = scope.get("client")
        about = (scope["state"]["request_id"], client[0] if client else None, scope["method"], scope["path"])
        try:
            with self.security_log.following(*about):
                await self.app(scope, self._limited(scope, headers, receive), answer.send)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is logged whole and answered without its words
            await answer.fail(error, self.refuse)
        finally:
            seconds = time.perf_counter() - answer.began_s
            self.observe(scope, answer.status, seconds)
            if span is not None:
                _end_span(span, scope, answer.status)
            if REQUESTS.isEnabledFor(logging.INFO):
                _log_request(scope, answer.status, seconds)

    def _limited(self, scope: Scope, headers: Mapping[bytes, bytes], receive: Receive) -> Receive:
        """Limit a body's size, announced or not, and its duration."""
        if b"content-length" not in headers and b"transfer-encoding" not in headers:
            return receive  # there is none (RFC 9112, 6.3)
        limit, sentence = BODY_LIMIT_BYTES, f"The request is over {BODY_LIMIT_BYTES:,} bytes; send less at once."
        multipart = headers.get(b"content-type", b"").startswith(b"multipart/form-data")
        if multipart and scope["path"].rstrip("/").endswith(UPLOADED):
            limit += round(self.upload_limit_mb * 1e6)
            sentence = f"The file is over the limit of {self.upload_limit_mb:g} MB; split it by frames, or have the limit raised."
        elif multipart and ATTACHED.search(scope["path"]):
            limit += ATTACHMENT_LIMIT_BYTES
            sentence = (
                f"The attachment is over the limit of {ATTACHMENT_LIMIT_BYTES / 1e6:g} MB; attach a smaller file."
            )
        announced = headers.get(b"content-length", b"0")
        return RequestBody(receive, self.pace, limit, sentence, int(announced) if announced.isdigit() else 0).receive


def _begin_span(traces: Traces, scope: Scope, headers: Mapping[bytes, bytes]) -> Span | None:
    """Begin the span of a request, in its caller's trace where that names one; requests that are nobody's act have none."""
    if scope["path"].startswith(FOR_MACHINES):
        return None
    parent = read_traceparent(headers.get(b"traceparent", b"").decode("latin-1"))
    state = scope["state"]
    told = {"http.request.method": scope["method"], "url.path": scope["path"][:200]}
    told["boresight.request_id"] = state["request_id"]
    span = traces.begin(scope["method"], parent, told, kind="SERVER")
    state["traceparent"] = span.traceparent
    return span


def _end_span(span: Span, scope: Scope, status: int) -> None:
    route = getattr(scope.get("route"), "path", None)
    if route is not None:
        span.rename(f"{scope['method']} {route}")
    person = getattr(scope["state"].get("actor"), "name", None)
    span.tell({"http.route": route, "http.response.status_code": status, "boresight.person": person})
    if status >= SERVER_FAULT:
        span.fail(f"Answered {status}.")
    span.end()


def _log_request(scope: Scope, status: int, seconds: float) -> None:
    told = {"method": scope["method"], "route": getattr(scope.get("route"), "path", None), "status": status}
    said = f"{scope['method']} {scope['path'][:200]} {status}"
    REQUESTS.info("%s", said, extra={"told": told | {"milliseconds": round(1e3 * seconds, 1)}})


class _Response:
    """One answer on its way out."""

    def __init__(self, scope: Scope, send: Send, request_id: str, pairs: HeaderPairs, *, four_eyes: bool) -> None:
        self.began_s = time.perf_counter()
        self.status = 0
        self._scope = scope
        self._send = send
        self._pairs = pairs
        self._four_eyes = four_eyes
        self._state: MutableMapping[str, Any] = scope.setdefault("state", {})
        self._state["request_id"] = request_id
        self._state["came_s"] = time.monotonic()

    async def send(self, message: Message) -> None:
        """Add the headers to the start of the answer."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            given = message["headers"]
            names = {name for name, _ in given}
            given = [*given, *(pair for pair in self._pairs if pair[0] not in names)]
            message["headers"] = [*given, (b"x-request-id", self._state["request_id"].encode())]
            if not self._four_eyes:
                _add_isolation_headers(MutableHeaders(scope=message))
        await self._send(message)

    async def fail(self, error: Exception, refuse: Refuse) -> None:
        """Log an unexpected error and answer with a problem, unless an answer has begun."""
        log.error("Request %s failed", self._state["request_id"], exc_info=error)
        if self.status:
            raise error
        response = await refuse(Request(self._scope), error)
        await response(self._scope, _nothing, self.send)


def _add_isolation_headers(headers: MutableHeaders) -> None:
    """Mark an answer, and the name of its file, where four-eyes is off."""
    headers[FOUR_EYES] = "off"
    named = headers.get("content-disposition")
    if named is not None:
        headers["content-disposition"] = FILE_NAME.sub(rf"\g<1>{ALONE}", named)


async def _nothing() -> Message:
    """Receive an empty body."""
    return {"type": "http.disconnect"}


METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")
NOT_ALLOWED = 405


def allowed(request: Request) -> list[str]:
    """Return the methods that a request's address allows."""
    routes: list[BaseRoute] = request.app.router.routes
    scope = {name: value for name, value in request.scope.items() if name not in {"route", "endpoint", "path_params"}}
    takes = [
        method
        for method in METHODS
        if any(route.matches({**scope, "method": method})[0] is Match.FULL for route in routes)
    ]
    return [*takes, *(["HEAD"] if "GET" in takes else []), "OPTIONS"]


def answer_options(request: Request, error: Exception) -> Response | None:
    """Answer OPTIONS of an existing address; None for any other request."""
    if request.method != "OPTIONS" or getattr(error, "status_code", None) != NOT_ALLOWED:
        return None
    return Response(status_code=204, headers={"Allow": ", ".join(allowed(request))})


def with_allow(request: Request, error: Exception) -> Exception:
    """Return the error, with a complete `Allow` header if it is 405."""
    if not isinstance(error, HTTPException) or error.status_code != NOT_ALLOWED:
        return error
    takes = ", ".join(allowed(request))
    sentence = f"This address does not accept {request.method}; use {takes}."
    return HTTPException(NOT_ALLOWED, sentence, headers={"Allow": takes})


class HeadMiddleware:
    """The middleware that answers HEAD."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in, and only the head of the answer out."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        inner = {**scope, "method": "GET"}  # the server reads the method from its own scope when it sends
        head = _HeadResponse(send)
        answering = asyncio.ensure_future(self.app(inner, receive, head.send))
        answering.add_done_callback(lambda _: head.over.set())
        try:
            await head.over.wait()
        finally:
            if "route" in inner:
                scope["route"] = inner["route"]  # used for metrics
            await _cancel(answering)


class _HeadResponse:
    """The head of an outgoing answer; `over` is set once the rest is not needed."""

    def __init__(self, send: Send) -> None:
        self.over = asyncio.Event()
        self._send = send
        self._is_sent = False

    async def send(self, message: Message) -> None:
        """Send the start, and an empty end instead of the body."""
        if message["type"] == "http.response.start":
            await self._send(message)
        elif message["type"] == "http.response.body" and not self._is_sent:
            self._is_sent = True
            await self._send({"type": "http.response.body", "body": b""})
        if message.get("more_body", False):
            self.over.set()


async def _cancel(answering: asyncio.Future[None]) -> None:
    """Cancel the endpoint; an error of its own is raised."""
    answering.cancel()
    with suppress(asyncio.CancelledError):
        await answering


ACCEPT_ENCODING = b"accept-encoding"
GZIP = b"gzip"
SPELLINGS = (b"gzip", b"x-gzip")  # RFC 9110, 8.4.1.3


@lru_cache(maxsize=64)  # few different values occur
def takes_gzip(accepted: bytes) -> bool:
    """Return whether the client accepts gzip."""
    weights = dict(_parse_coding(element) for element in accepted.lower().split(b","))
    named = [weights[name] for name in SPELLINGS if name in weights]
    weight = max(named) if named else weights.get(b"*", 0.0)
    return weight > 0 and weight >= weights.get(b"identity", 0.0)


def _parse_coding(element: bytes) -> tuple[bytes, float]:
    name, _, parameter = element.partition(b";")
    key, _, value = parameter.partition(b"=")
    if not parameter.strip():
        return name.strip(), 1.0
    try:
        weight = float(value) if key.strip() == b"q" else 0.0
    except ValueError:
        weight = 0.0
    return name.strip(), weight if 0 <= weight <= 1 else 0.0


class AcceptEncodingMiddleware:
    """The middleware that normalises `Accept-Encoding` to `gzip` or removes it."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in."""
        if scope["type"] == "http":
            accepted = b",".join(value for name, value in scope["headers"] if name == ACCEPT_ENCODING)
            others = [pair for pair in scope["headers"] if pair[0] != ACCEPT_ENCODING]
            scope["headers"] = [*others, (ACCEPT_ENCODING, GZIP)] if takes_gzip(accepted) else others
        await self.app(scope, receive, send)
