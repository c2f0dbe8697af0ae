"""Connections: deadlines for what each sends, and a limit on their number."""

from __future__ import annotations

import asyncio
import resource
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from typing import Any, cast

import orjson
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from boresight.platform.web.origins import get_network
from boresight.platform.web.problems import MEDIA_TYPE

CONNECTION = "connection"  # in the request's state: its connection
MOST_OPEN = 4096
OTHER_FILES = 256  # file descriptors of the store, blobs, workers, libraries
COME_BACK_S = 2
LONGEST_HEAD_BYTES = 64 << 10


@dataclass(frozen=True)
class Deadlines:
    """How long a connection may take."""

    head_s: float = 10.0
    idle_s: float = 15.0
    linger_s: float = 30.0
    stuck_s: float = 60.0

    @property
    def look_s(self) -> float:
        """How often deadlines are checked."""
        return min(0.5, min(self.head_s, self.linger_s, self.stuck_s) / 5)


class Connections:
    """All connections of one server."""

    def __init__(self, most: int = MOST_OPEN, deadlines: Deadlines | None = None) -> None:
        self.most = most
        self.deadlines = deadlines or Deadlines()
        self._open: set[Connection] = set()
        self._look: asyncio.TimerHandle | None = None

    def protocol(self) -> type[asyncio.Protocol]:
        """Return the protocol class for uvicorn."""
        return cast("type[asyncio.Protocol]", partial(Connection, self))

    @property
    def count(self) -> int:
        """The number of open connections."""
        return len(self._open)

    def join(self, connection: Connection) -> None:
        """Accept a new connection, closing another where the limit is reached, or refuse it."""
        if len(self._open) >= self.most:
            other = self._least()
            (other or connection).refuse(
                HTTPStatus.SERVICE_UNAVAILABLE,
                f"{self.most} connections are open, the most that this server allows; try again in {COME_BACK_S} s.",
            )
            if other is None:
                return
            self._open.discard(other)
        self._open.add(connection)
        if self._look is None:
            self._look = connection.loop.call_later(self.deadlines.look_s, self._judge, connection.loop)

    def leave(self, connection: Connection) -> None:
        """Forget a connection that has ended."""
        self._open.discard(connection)

    def _least(self) -> Connection | None:
        """Return the connection to close first when the limit is reached."""
        waiting = [one for one in self._open if one.is_dispensable()]
        counts = Counter(one.address for one in waiting)
        return min(waiting, key=lambda one: (-counts[one.address], one.since_s), default=None)

    def _judge(self, loop: asyncio.AbstractEventLoop) -> None:
        """Close the connections past their deadline."""
        now_s = loop.time()
        for connection in list(self._open):
            connection.judge(now_s)
        self._look = loop.call_later(self.deadlines.look_s, self._judge, loop) if self._open else None


class Connection(HttpToolsProtocol):
    """One connection."""

    def __init__(self, connections: Connections, **given: Any) -> None:
        super().__init__(**given)
        self.timeout_keep_alive = connections.deadlines.idle_s  # type: ignore[assignment]  # any number of seconds will do
        self.address = ""
        self.known = False  # whether its last request was of a known actor
        self.since_s = 0.0  # since when it is in its phase
        self._connections = connections
        self._phase: Hashable = None
        self._requests = 0
        self._head_bytes = 0
        self._head_since_s: float | None = None
        self._in_body = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.address = get_network(self.client[0]) if self.client else ""
        self.since_s = self._head_since_s = self.loop.time()
        self._connections.join(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection."""
        self._connections.leave(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read a piece of a request."""
        if not self._in_body:
            self._begin_head()
            self._head_bytes += len(data)
        super().data_received(data)
        if self._head_since_s is not None and self._head_bytes > LONGEST_HEAD_BYTES:
            self._refuse_head()

    def _refuse_head(self) -> None:
        self.refuse(
            HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
            f"The head of the request is over {LONGEST_HEAD_BYTES} bytes; send a shorter address and fewer headers.",
        )

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        self.scope["state"][CONNECTION] = self
        self._begin_head()

    def on_headers_complete(self) -> None:
        """Handle the head; a body may follow."""
        if len(self.url) + sum(len(name) + len(value) for name, value in self.headers) > LONGEST_HEAD_BYTES:
            self._refuse_head()
            raise ValueError("Expected a head within its limit")  # the parser reads no further
        self._head_since_s, self._head_bytes, self._in_body = None, 0, True
        self._requests += 1
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """End the body."""
        self._in_body = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the next request from now on."""
        super().on_response_complete()
        if self._head_since_s is not None:  # another request has begun already
            self._head_since_s = self.loop.time()
            self._unset_keepalive_if_required()  # it is not idle

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - ours says more
        """Answer an invalid request."""
        self.refuse(HTTPStatus.BAD_REQUEST, "This is not an HTTP request; use http://, or the proxy that serves HTTPS.")

    def _begin_head(self) -> None:
        if self._head_since_s is None:
            self._head_since_s, self._head_bytes = self.loop.time(), 0

    def is_dispensable(self) -> bool:
        """Whether it may be closed: it has no complete request of a known actor under way."""
        return not self.known and (self._in_body or self.cycle is None or self.cycle.response_complete)

    def judge(self, now_s: float) -> None:
        """Close the connection if it is past its deadline."""
        deadlines = self._connections.deadlines
        phase, longest_s, end = self._state(deadlines)
        if phase != self._phase:
            self._phase = phase
            self.since_s = self._head_since_s if phase[0] == "head" and self._head_since_s is not None else now_s
        if end is not None and now_s - self.since_s > longest_s:
            end()

    def _state(self, deadlines: Deadlines) -> tuple[tuple[str, int], float, Callable[[], None] | None]:
        """Return the start of the phase, its deadline and how it is ended; None where other code enforces one."""
        waiting = self.transport.get_write_buffer_size()
        if self.transport.is_closing() or self.flow.write_paused:
            return ("sending", waiting), deadlines.stuck_s, self.transport.abort
        if self._in_body and self.cycle is not None and self.cycle.response_complete:
            return ("lingering", self._requests), deadlines.linger_s, self.transport.close
        answered = self.cycle is None or self.cycle.response_complete
        if answered and not self._in_body and self._head_since_s is not None:
            return ("head", self._requests), deadlines.head_s, self._refuse_slow
        return ("asking", self._requests), 0.0, None

    def _refuse_slow(self) -> None:
        self.refuse(
            HTTPStatus.REQUEST_TIMEOUT,
            f"The request headers did not arrive within {self._connections.deadlines.head_s:g} s; send them without delay.",
        )

    def refuse(self, status: HTTPStatus, sentence: str) -> None:
        """Answer an invalid request, and close."""
        if self.transport.is_closing():
            return
        if self.cycle is None or not self.cycle.response_started or self.cycle.response_complete:
            self.transport.write(_refusal(status, sentence))
        self.transport.close()


def _refusal(status: HTTPStatus, sentence: str) -> bytes:
    title = status.phrase.capitalize()
    problem = {
        "type": "urn:boresight:problem:" + title.lower().replace(" ", "-"),
        "title": title,
        "status": status,
        "detail": sentence,
        "instance": None,
        "request_id": None,
        "errors": [],
    }
    body = orjson.dumps(problem)
    head = [
        f"HTTP/1.1 {status} {status.phrase}",
        f"content-type: {MEDIA_TYPE}",
        f"content-length: {len(body)}",
        "x-content-type-options: nosniff",
        "connection: close",
    ]
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        head.append(f"retry-after: {COME_BACK_S}")
    return "\r\n".join([*head, "", ""]).encode() + body


def open_file_limit() -> int:
    """Let this process open as many files as it may, and return how many connections that leaves."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_OPEN + OTHER_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if soft == resource.RLIM_INFINITY:
        return MOST_OPEN
    return min(MOST_OPEN, max(soft - OTHER_FILES, soft // 2))
