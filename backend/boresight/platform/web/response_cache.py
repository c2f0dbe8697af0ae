"""The response cache: stored answers, sent after authentication without running the endpoint while nothing was committed.

Whoever asks has been found out by then, as for every request (`boresight.console.access.credentials`). An endpoint whose answer
follows from the address and the rows of the store says so, and for whom it is the same (`share`): for all, for people of the same
roles, or for one person. The answer is then kept, compressed and with its tag, and given again while all of this holds:

1. Nothing was committed since: the data version (`boresight.platform.db.data_version`), looked for again for this very request, is
   the one that was looked for before the answer was read. So who commits reads their own writes, from whichever server or command.
2. It is theirs: what is the same for one stands under the person, or the key, and is given to no others. What is the same for roles
   stands under these: where the frame names the person it has gaps, which are filled for whoever gets it. What is the same for all
   was made by an endpoint that is never told who asks.
3. It is young: what the rows say of time (an age, a key that expires) is never older than `HELD_S`.

When many ask for one answer that is not kept, the first makes it and the others wait for it: those who came before it began to be
made, whose question it answers whatever was committed while they waited for its turn, and those for whom the data version is the
one that it began under. Then they are authenticated again. The turn comes sooner the more wait
(`boresight.platform.web.concurrency_limit`). Everything here runs on the event loop, so nothing is locked.

Tags. A row's tag, by which transitions say what was seen (`If-Match`), stays what it is; it stands for the whole document, and
saves sending it, where the row's state decides everything that is shown (`cover_with_tag`). Where more moves under it, as the
progress of a run does, it is weak. Every other JSON document of the API that is read has the hash of its bytes as a weak tag: the
same document is sent compressed or not. What says `no-store` has none.

Pages with gaps. Compressing a page of 60 kB takes 0.8 to 5 ms, filling its gaps 0.1 ms. What stands between two gaps is compressed
by itself, without reference to what was before (a full flush, RFC 1951 and zlib's manual); what fills a gap goes between as a
stored block. So a filled page is one ordinary gzip stream.
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import re
import secrets
import struct
import time
import zlib
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boresight.platform.db.data_version import DataVersion, DataVersionPoller
from boresight.platform.web.middleware import takes_gzip

HELD_S = 30.0
KEPT_BYTES = 64 << 20
LARGEST_SHARE = 16
MOST_ADDRESSES = 10_000
COMPRESS_FROM_BYTES = 2048
COMPRESSION_LEVEL = 5
ASK_AGAIN = b"private, no-cache"
VARY = b"Accept-Encoding, Authorization, Cookie"
FOR_ALL, FOR_ROLES, FOR_ONE = "all", "roles", "one"

# In the state of a request:
DATA_VERSION = "data_version"  # the data version at which the actor was identified
SHARING = "sharing"  # whose answers the client may be given; absent without an actor
ASKED, COMING = "asked", "coming"  # its cache key, and the pending response that it computes for others too
SAME_FOR = "same_for"  # for whom its answer is the same
GAPS = "gaps"  # whether the page was written with gaps for the actor
OLDER = "is_older"  # whether part of its answer is older than its data version
WHOLE = "tag_is_whole"  # whether the tag changes with everything that is shown

HEAD = b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\xff"
LAST = b"\x01\x00\x00\xff\xff"  # an empty stored block that ends the stream
MOST_STORED = 0xFFFF
TOKEN_GAP, NAME_GAP = (f"gap-{secrets.token_hex(16)}" for _ in range(2))  # never sent, so no content can contain it

Address = tuple[str, bytes, bool]


class CompressedPage:
    """A page compressed once, with gaps that are filled for each reader: the CSRF token and the name."""

    def __init__(self, page: bytes, gaps: Sequence[bytes], *, compressed: bool) -> None:
        pieces = re.split(b"(" + b"|".join(map(re.escape, gaps)) + b")", page)
        self._texts, self._gaps = pieces[::2], [gaps.index(mark) for mark in pieces[1::2]]
        self._packed = [_compress(text) for text in self._texts] if compressed else []

    def __len__(self) -> int:
        """Return its size in bytes."""
        return sum(map(len, self._texts)) + sum(map(len, self._packed))

    def filled(self, values: Sequence[bytes]) -> bytes:
        """Return the page with these values in its gaps, in the order in which the gaps were named."""
        fills = [values[gap] for gap in self._gaps]
        if not self._packed:
            return b"".join(_interleave(self._texts, fills))
        crc, length = 0, 0
        for text in _interleave(self._texts, fills):
            crc, length = zlib.crc32(text, crc), length + len(text)
        stored = [_store_blocks(fill) for fill in fills]
        end = struct.pack("<II", crc, length & 0xFFFFFFFF)
        return b"".join([HEAD, *_interleave(self._packed, stored), LAST, end])


def _interleave(texts: Sequence[bytes], fills: Sequence[bytes]) -> list[bytes]:
    """Interleave texts and gap values; there is one text more."""
    return [piece for pair in zip(texts, (*fills, b""), strict=True) for piece in pair]


def _compress(text: bytes) -> bytes:
    """Compress a text as a block independent of those before and after it."""
    packing = zlib.compressobj(COMPRESSION_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    return packing.compress(text) + packing.flush(zlib.Z_FULL_FLUSH)


def _store_blocks(text: bytes) -> bytes:
    parts = [text[begin : begin + MOST_STORED] for begin in range(0, len(text), MOST_STORED)]
    return b"".join(b"\x00" + struct.pack("<HH", len(part), len(part) ^ MOST_STORED) + part for part in parts)


@dataclass(frozen=True)
class Sharing:
    """Whose answers a client may be given: those for the same person or the same roles; and the values for their gaps."""

    person: Hashable
    roles: Hashable
    gaps: tuple[bytes, ...] = ()  # none for an API key, whose pages are written without gaps


@dataclass
class CacheRequest:
    """The parts of a request that determine its answer, besides the actor."""

    address: Address
    known_tags: bytes
    data_version: DataVersion | None = None
    beside: Hashable = None

    @classmethod
    def of(cls, scope: Scope) -> CacheRequest:
        """Read the head of a request."""
        accepted = b"".join(value for name, value in scope["headers"] if name == b"accept-encoding")
        found = b"".join(value for name, value in scope["headers"] if name == b"if-none-match")
        return cls((scope["path"], scope["query_string"], takes_gzip(accepted)), found)


@dataclass(frozen=True)
class CachedResponse:
    """A stored answer."""

    headers: tuple[tuple[bytes, bytes], ...]
    body: bytes | CompressedPage
    tag: bytes
    whole: bool
    data_version: DataVersion | None = None
    beside: Hashable = None
    made_s: float = 0.0
    route: Any = None
    is_older: bool = False

    async def send(self, send: Send, known_tags: bytes, gaps: tuple[bytes, ...] = ()) -> None:
        """Send it with its gaps filled, or answer 304 if the client's copy is current."""
        if self.whole and self.tag and matches_tag(known_tags, self.tag):
            headers = [pair for pair in self.headers if pair[0] in {b"etag", b"vary", b"cache-control"}]
            await send({"type": "http.response.start", "status": 304, "headers": headers})
            await send({"type": "http.response.body", "body": b""})
            return
        body = self.body.filled(gaps) if isinstance(self.body, CompressedPage) else self.body
        headers = [*self.headers, (b"content-length", str(len(body)).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def matches_tag(known_tags: bytes, tag: bytes) -> bool:
    """Whether `If-None-Match` names a tag; weak and strong tags compare alike there (RFC 9110, 13.1.2)."""
    opaque = tag.removeprefix(b"W/")
    return known_tags.strip() == b"*" or opaque in [one.strip().removeprefix(b"W/") for one in known_tags.split(b",")]


@dataclass(eq=False)
class PendingResponse:
    """An answer that is being computed or queued, with the waiting time of its clients."""

    key: Hashable
    answer: asyncio.Future[CachedResponse | None]
    waiting: int = 0
    newest_s: float = 0.0  # when the last of them came
    came_s: float = 0.0  # the times at which they came, summed up

    def joined(self) -> None:
        """Count one more waiting client."""
        self.waiting += 1
        self.newest_s = time.monotonic()
        self.came_s += self.newest_s

    def waited_s(self, now_s: float) -> float:
        """Return the total waiting time of its clients."""
        return self.waiting * now_s - self.came_s


def waited_s(scope: Scope) -> Callable[[float], float] | None:
    """Return a function for the total waiting time of all clients of a request's answer."""
    pending: PendingResponse | None = scope["state"].get(COMING)
    return None if pending is None else pending.waited_s


def share(request: Request, same_for: str) -> None:
    """Declare for whom an answer is the same; besides, it depends on address, store and what pages show of this server."""
    request.scope["state"][SAME_FOR] = same_for


def has_gaps(request: Request) -> bool:
    """Whether a page is written with gaps for the actor's name and token, which are filled when it is sent."""
    state = request.scope["state"]
    log_in = ASKED in state and SHARING in state and bool(state[SHARING].gaps)
    state[GAPS] = log_in and state.get(SAME_FOR) in {FOR_ROLES, FOR_ONE}
    return bool(state[GAPS])


def mark_outdated(request: Request) -> None:
    """Mark an answer as partly older than the newest commit: it is sent to the clients that wait for it, and not stored."""
    request.scope["state"][OLDER] = True


def cover_with_tag(request: Request, *, holds: bool = True) -> None:
    """Declare that the row's tag changes whenever anything in the answer does."""
    request.scope["state"][WHOLE] = holds


class ResponseCache:
    """The response cache of one server."""

    def __init__(
        self,
        data_version_poller: DataVersionPoller,
        authenticate: Callable[[Scope], Awaitable[None]],
        beside: Callable[[], Hashable],
        limit_bytes: int = KEPT_BYTES,
    ) -> None:
        self.data_version_poller = data_version_poller
        self.beside = beside
        self.held_bytes = 0
        self._authenticate = authenticate
        self._limit_bytes = limit_bytes
        self._cached: OrderedDict[Hashable, CachedResponse] = OrderedDict()
        self._same_for: OrderedDict[Address, str] = OrderedDict()
        self._coming: dict[Hashable, PendingResponse] = {}
        self._pending: dict[tuple[Hashable, DataVersion], PendingResponse] = {}

    async def find(self, scope: Scope, asked: CacheRequest) -> CachedResponse | None:
        """Return the stored answer for a request, waiting for it if it is being computed."""
        asked.data_version = scope["state"].get(DATA_VERSION)
        key = self._key(scope, asked)
        if key is None or asked.data_version is None:
            return None
        cached = self._cached.get(key)
        if cached is not None and cached.data_version == asked.data_version and self._is_young(cached):
            self._cached.move_to_end(key)
            return cached
        coming = self._coming.get(key)
        pending = coming or self._pending.get((key, asked.data_version))
        if pending is not None:
            return await self._wait(scope, asked, pending, has_begun=coming is None)
        pending = PendingResponse(key, asyncio.get_running_loop().create_future())
        pending.joined()
        self._coming[key] = scope["state"][COMING] = pending
        return None

    async def _wait(
        self, scope: Scope, asked: CacheRequest, pending: PendingResponse, *, has_begun: bool
    ) -> CachedResponse | None:
        """Wait for an answer that is queued, or computed at our data version, and authenticate again."""
        pending.joined()
        cached = await asyncio.shield(pending.answer)
        if cached is None:
            return None
        await self._authenticate(scope)
        if cached.is_older and has_begun:  # part of it is older than a commit that a late client may know of
            return await self.find(scope, asked)
        return cached if self._key(scope, asked) == pending.key else None

    def _key(self, scope: Scope, asked: CacheRequest) -> Hashable:
        """Return the cache key of the answer for a client; None without an actor, or where its sharing is not known yet."""
        sharing: Sharing | None = scope["state"].get(SHARING)
        same_for = self._same_for.get(asked.address)
        if sharing is None or same_for is None:
            return None
        if same_for == FOR_ALL:
            return asked.address
        return asked.address, same_for, sharing.roles if same_for == FOR_ROLES else sharing.person

    def _is_young(self, cached: CachedResponse) -> bool:
        """Whether an answer is recent enough and its inputs besides the store are unchanged."""
        return time.monotonic() - cached.made_s < HELD_S and cached.beside in {None, self.beside()}

    def keep(self, scope: Scope, asked: CacheRequest, cached: CachedResponse, same_for: str) -> None:
        """Store an answer, and give it to the waiting clients."""
        self._same_for[asked.address] = same_for
        self._same_for.move_to_end(asked.address)
        if len(self._same_for) > MOST_ADDRESSES:
            self._same_for.popitem(last=False)
        size, key = len(cached.body), self._key(scope, asked)
        if key is None or size * LARGEST_SHARE > self._limit_bytes:
            return
        self._drop(key)
        if not cached.is_older:
            self._cached[key] = cached
            self.held_bytes += size
            while self.held_bytes > self._limit_bytes:
                self._drop(next(iter(self._cached)))
        pending: PendingResponse | None = scope["state"].get(COMING)
        if pending is not None and pending.key == key and not pending.answer.done():
            pending.answer.set_result(cached)

    def _drop(self, key: Hashable) -> None:
        cached = self._cached.pop(key, None)
        self.held_bytes -= 0 if cached is None else len(cached.body)

    async def begin(self, scope: Scope) -> None:
        """Begin to compute an answer, which will reflect everything committed by now.

        The client is authenticated again, because it may have waited for its turn. Clients that asked before wait for this
        answer; later ones do only if nothing is committed before they ask.
        """
        pending: PendingResponse | None = scope["state"].get(COMING)
        if pending is not None and self._coming.get(pending.key) is pending:
            del self._coming[pending.key]
        await self._authenticate(scope)
        asked: CacheRequest | None = scope["state"].get(ASKED)
        if asked is None:
            return
        asked.data_version, asked.beside = scope["state"].get(DATA_VERSION), self.beside()
        if pending is not None:  # the answer must include every commit that the last client may know of
            scope["state"]["came_s"] = pending.newest_s
            if asked.data_version is not None:
                self._pending.setdefault((pending.key, asked.data_version), pending)

    def over(self, scope: Scope) -> None:
        """End a request, answered or failed; a client that still waits computes its own answer."""
        pending: PendingResponse | None = scope["state"].get(COMING)
        if pending is None:
            return
        began = (pending.key, scope["state"][ASKED].data_version)
        if self._coming.get(pending.key) is pending:
            del self._coming[pending.key]
        if self._pending.get(began) is pending:
            del self._pending[began]
        if not pending.answer.done():
            pending.answer.set_result(None)


class CacheLookupMiddleware:
    """The middleware after authentication: answers from the cache, or passes the request on."""

    def __init__(self, app: ASGIApp, cache: ResponseCache) -> None:
        self.app = app
        self.cache = cache

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http" or scope["method"] != "GET":
            await self.app(scope, receive, send)
            return
        asked = CacheRequest.of(scope)
        cached = await self.cache.find(scope, asked)
        if cached is not None:
            scope["route"] = cached.route
            await cached.send(send, asked.known_tags, scope["state"][SHARING].gaps)
            return
        scope["state"][ASKED] = asked
        try:
            await self.app(scope, receive, send)
        finally:
            self.cache.over(scope)


class CacheStoreMiddleware:
    """The innermost middleware: stores the endpoints' answers before anything is added or compressed."""

    def __init__(self, app: ASGIApp, cache: ResponseCache) -> None:
        self.app = app
        self.cache = cache

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in and take its answer."""
        if scope["type"] == "http" and scope["method"] == "GET":
            send = _OutgoingResponse(self.cache, scope, send).send
        await self.app(scope, receive, send)


class _OutgoingResponse:
    """One outgoing answer."""

    def __init__(self, cache: ResponseCache, scope: Scope, send: Send) -> None:
        self._cache = cache
        self._scope = scope
        self._send = send
        self._start: Message | None = None
        self._pieces: list[bytes] = []

    async def send(self, message: Message) -> None:
        """Hold back an answer to be tagged or stored until it is complete; pass any other on."""
        if message["type"] == "http.response.start" and self._is_taken(message):
            self._start = message
        elif self._start is not None and message["type"] == "http.response.body":
            self._pieces.append(message.get("body", b""))
            if not message.get("more_body", False):
                await self._finish(self._start, b"".join(self._pieces))
        else:
            await self._send(message)

    def _is_taken(self, message: Message) -> bool:
        """Return whether to hold back an answer for a tag or the cache, from its first message."""
        headers = dict(message["headers"])
        if message["status"] != 200 or b"set-cookie" in headers or b"content-length" not in headers:
            return False
        document = headers.get(b"content-type", b"").startswith(b"application/json")
        return SAME_FOR in self._scope["state"] or (document and not headers.keys() & {b"etag", b"cache-control"})

    async def _finish(self, start: Message, body: bytes) -> None:
        """Tag the answer, store it if allowed, and send it."""
        state = self._scope["state"]
        asked: CacheRequest = state[ASKED]
        same_for, sharing = state.get(SAME_FOR), state.get(SHARING)
        cached = self._written(start, body, asked, same_for)
        if same_for is not None and asked.data_version is not None:
            self._cache.keep(self._scope, asked, cached, same_for)
        await cached.send(self._send, asked.known_tags, sharing.gaps if sharing else ())

    def _written(self, start: Message, body: bytes, asked: CacheRequest, same_for: str | None) -> CachedResponse:
        state = self._scope["state"]
        given = [(name, value) for name, value in start["headers"] if name != b"content-length"]
        headers = dict(given)
        tag = headers.get(b"etag", b"")
        whole = not tag or bool(state.get(WHOLE))
        storable = headers.get(b"cache-control", b"") != b"no-store"
        if not tag and storable:
            tag = b'W/"' + hashlib.sha256(body).hexdigest()[:32].encode() + b'"'
            given.append((b"etag", tag))
        if b"cache-control" not in headers:
            given.append((b"cache-control", ASK_AGAIN))
        given.append((b"vary", VARY))
        compressed = same_for is not None and asked.address[2] and len(body) >= COMPRESS_FROM_BYTES
        if compressed:
            given.append((b"content-encoding", b"gzip"))
        content: bytes | CompressedPage = body
        if state.get(GAPS):
            content = CompressedPage(body, (TOKEN_GAP.encode(), NAME_GAP.encode()), compressed=compressed)
        elif compressed:
            content = gzip.compress(body, COMPRESSION_LEVEL, mtime=0)
        return CachedResponse(
            headers=tuple(given),
            body=content,
            tag=tag if storable else b"",
            whole=whole,
            data_version=asked.data_version,
            is_older=OLDER in state,
            beside=asked.beside if same_for in {FOR_ONE, FOR_ROLES} else None,
            made_s=time.monotonic(),
            route=self._scope.get("route"),
        )
