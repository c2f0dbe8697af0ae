"""Which answers may stand ready, and taking them on their way out; a tag for every JSON document that is read.

`same_for_all` and `same_for_one` are dependencies by which an endpoint says what its answer follows from. The first takes the place
of `Who`: the endpoint lets whoever is known read, and is not told who it is. `boresight.api.ready` says when a kept answer is
given again.

Tags. A row's tag, by which transitions say what was seen (`If-Match`), stays what it is; it stands for the whole document, and
saves sending it, where the row's state decides everything that is shown (`whole_tag`). Where more moves under it, as the progress
of a run does, it is weak. Every other JSON document of the API that is read has the hash of its bytes as a weak tag: the same
document is sent compressed or not. What says `no-store` has none.
"""

from __future__ import annotations

import gzip
import hashlib
import time
from collections.abc import MutableMapping
from dataclasses import replace
from typing import Annotated, Any

from fastapi import Depends
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boresight.api.credentials import current_actor, proof_of
from boresight.api.ready import ASKED, Asked, Kept, Ready

COMPRESS_FROM_BYTES = 2048
COMPRESSION_LEVEL = 5
FOR_ALL, FOR_ONE = "all", "one"
SAME_FOR = "same_for"  # in the request's state: whom its answer is the same for
WHOLE = "tag_is_whole"  # in the request's state: whether the tag changes with everything that is shown
ASK_AGAIN = b"private, no-cache"
VARY = b"Accept-Encoding, Authorization, Cookie"


def same_for_all(request: Request) -> None:
    """Let whoever is known read what is the same for all: the answer follows from address and store alone.

    Raises
    ------
    UnauthenticatedError
        When nobody is logged in, the log-in has ended, or the key is not valid.
    """
    current_actor(request)
    request.scope["state"][SAME_FOR] = FOR_ALL


def same_for_one(request: Request) -> None:
    """Say that the answer follows from address, store and who asks, and from what every page shows of this server."""
    current_actor(request)
    request.scope["state"][SAME_FOR] = FOR_ONE


def whole_tag(request: Request, *, holds: bool = True) -> None:
    """Say that the row's tag changes whenever anything in the answer does."""
    request.scope["state"][WHOLE] = holds


Known = Annotated[None, Depends(same_for_all)]


class Keeping:
    """The layer nearest to the endpoints: takes their answers as they are, before anything is added or compressed."""

    def __init__(self, app: ASGIApp, ready: Ready) -> None:
        self.app = app
        self.ready = ready

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request in and take its answer."""
        if scope["type"] == "http" and scope["method"] == "GET":
            send = _Outgoing(self.ready, scope, send).send
        await self.app(scope, receive, send)


class _Outgoing:
    """One answer on its way out."""

    def __init__(self, ready: Ready, scope: Scope, send: Send) -> None:
        self._ready = ready
        self._scope = scope
        self._send = send
        self._state: MutableMapping[str, Any] = scope["state"]
        self._start: Message | None = None
        self._body: list[bytes] = []

    async def send(self, message: Message) -> None:
        """Hold back an answer that is tagged or kept until it is whole; let every other pass."""
        if message["type"] == "http.response.start" and self._is_taken(message):
            self._start = message
        elif self._start is not None and message["type"] == "http.response.body":
            self._body.append(message.get("body", b""))
            if not message.get("more_body", False):
                await self._finish(self._start, b"".join(self._body))
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
        asked: Asked | None = self._state.get(ASKED)
        same_for = self._state.get(SAME_FOR)
        kept = self._kept(start, body, asked, compressed=same_for is not None and asked is not None)
        if same_for is not None and asked is not None and asked.mark is not None:
            proof = proof_of(self._scope)
            self._ready.keep(asked, kept, for_all=same_for == FOR_ALL)
            if proof is not None:
                self._ready.remember(asked.asker, asked.mark, proof)
                if same_for == FOR_ONE and not kept.tag:
                    self._ready.share(asked, replace(kept, body=body), proof)
        await kept.send(self._send, asked.known_tags if asked else b"")

    def _kept(self, start: Message, body: bytes, asked: Asked | None, *, compressed: bool) -> Kept:
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
        if compressed and asked is not None and asked.address[2] and len(body) >= COMPRESS_FROM_BYTES:
            body = gzip.compress(body, COMPRESSION_LEVEL, mtime=0)
            given.append((b"content-encoding", b"gzip"))
        return Kept(
            headers=tuple(given),
            body=body,
            tag=tag if storable else b"",
            whole=whole,
            mark=asked.mark if asked else None,
            beside=asked.beside if asked and self._state.get(SAME_FOR) == FOR_ONE else None,
            made_s=time.monotonic(),
            route=self._scope.get("route"),
        )
