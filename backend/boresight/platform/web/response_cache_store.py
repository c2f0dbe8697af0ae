"""Storing responses in the response cache as they are sent; an entity tag for every JSON document that is read.

`same_for_all`, `same_for_roles` and `same_for_one` are dependencies by which an endpoint says what its answer follows from. The
first takes the place of `Who`: whoever is known may read, and the endpoint is not told who it is. A page `same_for_roles` asks for
`Roles` instead. The frame of a page that is kept for log-ins is told of nobody more than the roles: it has gaps for name and
token. `boresight.platform.web.response_cache` says when a kept answer is given again.

Tags. A row's tag, by which transitions say what was seen (`If-Match`), stays what it is; it stands for the whole document, and
saves sending it, where the row's state decides everything that is shown (`cover_with_tag`). Where more moves under it, as the
progress of a run does, it is weak. Every other JSON document of the API that is read has the hash of its bytes as a weak tag: the
same document is sent compressed or not. What says `no-store` has none.
"""

from __future__ import annotations

import gzip
import hashlib
import time
from collections.abc import MutableMapping
from typing import Annotated, Any

from fastapi import Depends
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boresight.console.access.credentials import get_actor, get_proof
from boresight.platform.web.compressed_pages import LEVEL, NAME_GAP, TOKEN_GAP, CompressedPage
from boresight.platform.web.response_cache import (
    ASKED,
    FOR_ALL,
    FOR_ONE,
    FOR_ROLES,
    CachedResponse,
    CacheRequest,
    ResponseCache,
)

COMPRESS_FROM_BYTES = 2048
COMPRESSION_LEVEL = LEVEL
SAME_FOR = "same_for"  # in the request's state: whom its answer is the same for
GAPS = "gaps"  # in the request's state: whether the page was written with gaps for who asks
OLDER = "is_older"  # in the request's state: whether part of its answer was read before a commit that its mark counts
WHOLE = "tag_is_whole"  # in the request's state: whether the tag changes with everything that is shown
ASK_AGAIN = b"private, no-cache"
VARY = b"Accept-Encoding, Authorization, Cookie"


async def same_for_all(request: Request) -> None:
    """Let whoever is known read what is the same for all: the answer follows from address and store alone."""
    await get_actor(request)
    request.scope["state"][SAME_FOR] = FOR_ALL


async def same_for_one(request: Request) -> None:
    """Say that the answer follows from address, store and who asks, and from what every page shows of this server."""
    await get_actor(request)
    request.scope["state"][SAME_FOR] = FOR_ONE


async def same_for_roles(request: Request) -> frozenset[str]:
    """Say that a page follows from address, store, these roles, and from what every page shows of this server and who asks.

    Its endpoint may ask for `Roles`, and for nothing else of who asks.
    """
    roles = (await get_actor(request)).roles
    request.scope["state"][SAME_FOR] = FOR_ROLES
    return roles


def has_gaps(request: Request) -> bool:
    """Whether a page is to be written with gaps for the name and the token of who asks: it will be filled on its way out."""
    state, proof = request.scope["state"], get_proof(request.scope)
    log_in = request.method == "GET" and ASKED in state and proof is not None and proof.roles is not None
    state[GAPS] = log_in and state.get(SAME_FOR) in {FOR_ROLES, FOR_ONE}
    return bool(state[GAPS])


def mark_outdated(request: Request) -> None:
    """Say that something was committed since part of an answer was read: it is good for who asked before, and not given again."""
    request.scope["state"][OLDER] = True


def cover_with_tag(request: Request, *, holds: bool = True) -> None:
    """Say that the row's tag changes whenever anything in the answer does."""
    request.scope["state"][WHOLE] = holds


SAME_FOR_ALL = Depends(same_for_all)
Roles = Annotated[frozenset[str], Depends(same_for_roles)]


class CacheStore:
    """The layer nearest to the endpoints: takes their answers as they are, before anything is added or compressed."""

    def __init__(self, app: ASGIApp, ready: ResponseCache) -> None:
        self.app = app
        self.ready = ready

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in and take its answer."""
        if scope["type"] == "http" and scope["method"] == "GET":
            send = _OutgoingResponse(self.ready, scope, send).send
        await self.app(scope, receive, send)


class _OutgoingResponse:
    """One answer on its way out."""

    def __init__(self, ready: ResponseCache, scope: Scope, send: Send) -> None:
        self._ready = ready
        self._scope = scope
        self._send = send
        self._state: MutableMapping[str, Any] = scope["state"]
        self._start: Message | None = None
        self._pieces: list[bytes] = []

    async def send(self, message: Message) -> None:
        """Hold back an answer that is tagged or kept until it is whole; let every other pass."""
        if message["type"] == "http.response.start" and self._is_taken(message):
            self._start = message
        elif self._start is not None and message["type"] == "http.response.body":
            self._pieces.append(message.get("body", b""))
            if not message.get("more_body", False):
                await self._finish(self._start, b"".join(self._pieces))
        else:
            await self._send(message)

    def _is_taken(self, message: Message) -> bool:
        """Whether an answer is whole at once, for nobody else to see, and worth it."""
        headers = dict(message["headers"])
        if message["status"] != 200 or b"set-cookie" in headers or b"content-length" not in headers:
            return False
        document = headers.get(b"content-type", b"").startswith(b"application/json")
        return SAME_FOR in self._state or (document and not headers.keys() & {b"etag", b"cache-control"})

    async def _finish(self, start: Message, body: bytes) -> None:
        """Tag the answer, keep it where it may be, and send it."""
        asked: CacheRequest | None = self._state.get(ASKED)
        same_for, proof = self._state.get(SAME_FOR), get_proof(self._scope)
        kept = self._kept(start, body, asked)
        if same_for is not None and asked is not None and asked.mark is not None:
            self._ready.keep(self._scope, asked, kept, proof, same_for)
        await kept.send(self._send, asked.known_tags if asked else b"", proof.gaps if proof else ())

    def _kept(self, start: Message, body: bytes, asked: CacheRequest | None) -> CachedResponse:
        """Write the answer as it is sent."""
        given = [(name, value) for name, value in start["headers"] if name != b"content-length"]
        headers = dict(given)
        tag = headers.get(b"etag", b"")
        whole = not tag or bool(self._state.get(WHOLE))
        storable = headers.get(b"cache-control", b"") != b"no-store"
        if not tag and storable:
            tag = b'W/"' + hashlib.sha256(body).hexdigest()[:32].encode() + b'"'
            given.append((b"etag", tag))
        if b"cache-control" not in headers:
            given.append((b"cache-control", ASK_AGAIN))
        given.append((b"vary", VARY))
        same_for = self._state.get(SAME_FOR)
        compressed = (
            same_for is not None and asked is not None and asked.address[2] and len(body) >= COMPRESS_FROM_BYTES
        )
        if compressed:
            given.append((b"content-encoding", b"gzip"))
        return CachedResponse(
            headers=tuple(given),
            body=self._body(body, compressed=compressed),
            tag=tag if storable else b"",
            whole=whole,
            mark=asked.mark if asked else None,
            is_older=OLDER in self._state,
            beside=asked.beside if asked and same_for in {FOR_ONE, FOR_ROLES} else None,
            made_s=time.monotonic(),
            route=self._scope.get("route"),
        )

    def _body(self, body: bytes, *, compressed: bool) -> bytes | CompressedPage:
        """Return the body as it is kept: with gaps where other log-ins get it too."""
        if self._state.get(GAPS):
            return CompressedPage(body, (TOKEN_GAP.encode(), NAME_GAP.encode()), compressed=compressed)
        return gzip.compress(body, COMPRESSION_LEVEL, mtime=0) if compressed else body
