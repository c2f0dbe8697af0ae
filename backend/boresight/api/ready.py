"""Answers that stand ready: given again without asking anybody, for as long as they are what would be answered.

An endpoint whose answer follows from the address and the rows of the store says so by `same_for_all` or `same_for_one`
(`boresight.api.keeping`). Its answer is then kept, compressed and with its tag, and given again while all of this holds:

1. Nothing was committed since: the store's mark (`boresight.store.marks`), looked for anew for this very request, equals the mark
   that was looked for before the answer was read. So who commits reads their own writes, from whichever server or command.
2. Whoever asks is known *now*: exactly these credentials (the `Authorization` and `Cookie` headers, byte for byte) were proven
   under this mark, and their end by the clock has not come. Keys revoked, log-ins ended, people disabled, roles changed are all
   commits, so they act with the next request. Credentials not proven under this mark are proven first, by one read.
3. It is theirs: an answer `same_for_one` stands under their credentials and is given to no others. One `same_for_all` was made by
   an endpoint that was never told who asks, so it cannot hold anything of the one who happened to ask first.
4. It is young: what the rows say of time (an age, a key that expires) is never older than `HELD_S`.

When many ask for one answer that does not stand ready, the first makes it and the others wait for it: those who came before it
began to be made, whose question it answers whatever was committed while they waited for its turn, and those for whom the mark is
the one that it began under. Everything here runs on the event loop, so nothing is locked.
"""

from __future__ import annotations

import asyncio
import gzip
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.api.changes import Changes
from boresight.api.codings import takes_gzip
from boresight.store.marks import Mark

HELD_S = 30.0
KEPT_BYTES = 64 << 20
LARGEST_SHARE = 16
FAST = 1  # level of compression for one log-in alone
MOST_PROOFS = 10_000
ASKED, COMING = "asked", "coming"
LISTENING = "/api/v1/events"
BACKGROUND = (b"x-boresight-background", b"1")  # a page that renews itself says so

Address = tuple[str, bytes, bool]
Asker = tuple[bytes, bytes]


class Use(Protocol):
    """Tells whether credentials were not idle for too long, and notes their use."""

    def __call__(self, *, active: bool) -> bool:
        """Whether they hold; `active` where somebody did something."""


def is_active(scope: Scope) -> bool:
    """Whether somebody did something; not so where an open page listens, or renews what it shows by itself."""
    return not scope["path"].startswith(LISTENING) and BACKGROUND not in scope["headers"]


@dataclass(frozen=True)
class Asked:
    """What decides a request's answer: its address, whether it takes gzip, and the credentials it carries.

    `active` says whether it counts as a use of a log-in.
    """

    address: Address
    asker: Asker
    known_tags: bytes
    active: bool = True
    mark: Mark | None = None
    beside: Hashable = None

    @property
    def keys(self) -> tuple[Hashable, Hashable]:
        """Under which its answer is kept: for all, and for who asks."""
        return self.address, (self.address, self.asker)

    @classmethod
    def of(cls, scope: Scope) -> Asked | None:
        """Read a request; None where it is none that an answer may stand ready for."""
        if scope["type"] != "http" or scope["method"] != "GET":
            return None
        credentials, found, accepted = {b"authorization": b"", b"cookie": b""}, b"", b""
        for name, value in scope["headers"]:
            if name in credentials:
                if credentials[name]:
                    return None  # given twice: let the endpoint decide which counts
                credentials[name] = value
            elif name == b"accept-encoding":
                accepted = value  # one at most: the border has read it
            elif name == b"if-none-match":
                found += value
        asker = (credentials[b"authorization"], credentials[b"cookie"])
        if not any(asker):
            return None
        return cls((scope["path"], scope["query_string"], takes_gzip(accepted)), asker, found, is_active(scope))


@dataclass(frozen=True)
class Proof:
    """That credentials hold.

    Parameters
    ----------
    until_s
        Until when by the clock.
    use
        What is to be done whenever they are used; whether they hold still.
    unchanged
        Whether the rows that they follow from say the same now; may be asked anywhere, for it takes some microseconds.
    person
        Whose log-in it is, and what its cookies say besides: the same for log-ins that get the same pages but for the token.
    csrf_token
        The token that stands in the pages of this log-in.
    """

    until_s: float
    use: Use
    unchanged: Callable[[], bool] = lambda: False
    person: Hashable = None
    csrf_token: bytes = b""

    def holds(self, *, active: bool = True) -> bool:
        """Whether they hold still; counts as a use where somebody did something."""
        return time.time() < self.until_s and self.use(active=active)


@dataclass(frozen=True)
class Kept:
    """An answer as it is sent.

    Parameters
    ----------
    headers
        Of the answer in full, without its length.
    body
        As it is sent, compressed or not.
    tag
        Its entity tag; empty where it is not to be stored by anybody.
    whole
        Whether the tag changes with everything in the body, so that it may stand for it.
    mark, beside, made_s
        The store before it was read, what else it depends on, and when it was made.
    route
        Of the endpoint, by which it is counted.
    csrf_token
        The token that stands in it, where it is kept plain for other log-ins of the same person, and sent to none as it is.
    """

    headers: tuple[tuple[bytes, bytes], ...]
    body: bytes
    tag: bytes
    whole: bool
    mark: Mark | None = None
    beside: Hashable = None
    made_s: float = 0.0
    route: Any = None
    csrf_token: bytes = b""

    def for_log_in(self, csrf_token: bytes) -> Kept:
        """Return the answer for another log-in of the same person, with its own token."""
        body = self.body.replace(self.csrf_token, csrf_token)
        if (b"content-encoding", b"gzip") in self.headers:
            body = gzip.compress(body, FAST, mtime=0)
        return replace(self, body=body, csrf_token=b"")

    async def send(self, send: Send, known_tags: bytes) -> None:
        """Send it, or that the copy which the asker has is still right."""
        if self.whole and self.tag and knows(known_tags, self.tag):
            headers = [pair for pair in self.headers if pair[0] in {b"etag", b"vary", b"cache-control"}]
            await send({"type": "http.response.start", "status": 304, "headers": headers})
            await send({"type": "http.response.body", "body": b""})
            return
        headers = [*self.headers, (b"content-length", str(len(self.body)).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": self.body})


def knows(known_tags: bytes, tag: bytes) -> bool:
    """Whether `If-None-Match` names a tag; weak and strong tags compare alike there (RFC 9110, 13.1.2)."""
    opaque = tag.removeprefix(b"W/")
    return known_tags.strip() == b"*" or opaque in [one.strip().removeprefix(b"W/") for one in known_tags.split(b",")]


class Ready:
    """The answers of one server that stand ready.

    Parameters
    ----------
    changes
        Asks for the store's mark.
    prove
        Proves a request's credentials by the store, as its endpoint would; None where they do not hold.
    beside
        What answers for one person depend on besides the store.
    """

    def __init__(
        self,
        changes: Changes,
        prove: Callable[[Scope], Awaitable[Proof | None]],
        beside: Callable[[], Hashable],
        limit_bytes: int = KEPT_BYTES,
    ) -> None:
        self.changes = changes
        self.beside = beside
        self.held_bytes = 0
        self._prove = prove
        self._limit_bytes = limit_bytes
        self._kept: OrderedDict[Hashable, Kept] = OrderedDict()
        self._proofs: OrderedDict[Asker, tuple[Mark, Proof]] = OrderedDict()
        self._coming: dict[Hashable, asyncio.Future[Kept | None]] = {}
        self._making: dict[tuple[Hashable, Mark], asyncio.Future[Kept | None]] = {}

    async def find(self, scope: Scope, asked: Asked, mark: Mark) -> Kept | None:
        """Return the answer that stands ready for who asks, waiting for it when it is being made for all."""
        kept = self._standing(asked, mark)
        if kept is None:
            making = self._being_made(asked, mark)
            kept = None if making is None else await asyncio.shield(making)
            if kept is not None and kept.mark is not None:
                mark = kept.mark  # looked for later than ours
        if kept is None or not await self._is_known(scope, asked, mark):
            return None
        if kept.csrf_token:
            kept = kept.for_log_in(self._proofs[asked.asker][1].csrf_token)
            self._put(asked.keys[1], kept)
        return kept

    def _keys(self, asked: Asked) -> tuple[Hashable, ...]:
        """Return under which its answer may be kept: for all, for the person, and for who asks."""
        proven = self._proofs.get(asked.asker)
        for_all, for_one = asked.keys
        person = None if proven is None else proven[1].person
        return (for_all, for_one) if person is None else (for_all, for_one, (asked.address, person))

    def _being_made(self, asked: Asked, mark: Mark) -> asyncio.Future[Kept | None] | None:
        """Return the answer that is being made and will tell of everything committed by now."""
        for key in self._keys(asked):
            making = self._coming.get(key) or self._making.get((key, mark))
            if making is not None:
                return making
        return None

    def _standing(self, asked: Asked, mark: Mark) -> Kept | None:
        """Return what stands under an address, for all or for who asks, and still holds."""
        for key in self._keys(asked):
            kept = self._kept.get(key)
            if kept is not None and kept.mark == mark and self._is_young(kept):
                self._kept.move_to_end(key)
                return kept
        return None

    def _is_young(self, kept: Kept) -> bool:
        """Whether an answer is not too old, and what it depends on besides the store is as it was."""
        return time.monotonic() - kept.made_s < HELD_S and kept.beside in {None, self.beside()}

    async def _is_known(self, scope: Scope, asked: Asked, mark: Mark) -> bool:
        """Whether the credentials hold now."""
        proven = self._proofs.get(asked.asker)
        if proven is not None and proven[0] == mark:
            return proven[1].holds(active=asked.active)
        if proven is not None and proven[1].unchanged():
            self.remember(asked.asker, mark, proven[1])
            return proven[1].holds(active=asked.active)
        proof = await self._prove(scope)
        if proof is not None:
            self.remember(asked.asker, mark, proof)
        return proof is not None

    def remember(self, asker: Asker, mark: Mark, proof: Proof) -> None:
        """Note that credentials were proven by a read after a mark."""
        self._proofs[asker] = (mark, proof)
        self._proofs.move_to_end(asker)
        if len(self._proofs) > MOST_PROOFS:
            self._proofs.popitem(last=False)

    def keep(self, asked: Asked, kept: Kept, *, for_all: bool) -> None:
        """Let an answer stand ready, and give it to those who wait for it."""
        self._put(asked.keys[0 if for_all else 1], kept)

    def share(self, asked: Asked, plain: Kept, proof: Proof) -> None:
        """Let a page stand ready for the other log-ins of the person who asked."""
        if proof.person is not None and proof.csrf_token:
            self._put((asked.address, proof.person), replace(plain, csrf_token=proof.csrf_token))

    def _put(self, key: Hashable, kept: Kept) -> None:
        size = len(kept.body)
        if size * LARGEST_SHARE > self._limit_bytes:
            return
        self._drop(key)
        self._kept[key] = kept
        self.held_bytes += size
        while self.held_bytes > self._limit_bytes:
            self._drop(next(iter(self._kept)))
        making = self._making.get((key, kept.mark)) if kept.mark else None
        if making is not None and not making.done():
            making.set_result(kept)

    def _drop(self, key: Hashable) -> None:
        """Let go of an answer."""
        kept = self._kept.pop(key, None)
        self.held_bytes -= 0 if kept is None else len(kept.body)

    def comes(self, scope: Scope, asked: Asked) -> Callable[[], None]:
        """Say that an answer will be made when its turn has come; returns what to call when that is over, however it went.

        Others wait only for what stood ready before: of other addresses nobody knows whose the answer will be.
        """
        for_all, for_one, *for_person = self._keys(asked)
        key = next((key for key in (for_all, *for_person, for_one) if key in self._kept), None)
        if asked.mark is None or key is None or key in self._coming:
            return lambda: None
        making: asyncio.Future[Kept | None] = asyncio.get_running_loop().create_future()
        self._coming[key] = making
        scope["state"][COMING] = key, making

        def over() -> None:
            began = (key, scope["state"][ASKED].mark)
            if self._coming.get(key) is making:
                del self._coming[key]
            if self._making.get(began) is making:
                del self._making[began]
            if not making.done():
                making.set_result(None)

        return over

    async def begin(self, scope: Scope) -> None:
        """Begin to make an answer: it will tell of everything that is committed by now, and of nothing later for sure.

        Who asked meanwhile waits for it. Who asks from now on does so only if nothing is committed before.
        """
        asked: Asked | None = scope["state"].get(ASKED)
        if asked is None or asked.mark is None:
            return
        key, making = scope["state"].get(COMING, (None, None))
        if making is not None and self._coming.get(key) is making:
            del self._coming[key]
        mark = await self.changes.now()
        scope["state"][ASKED] = replace(asked, mark=mark, beside=self.beside())
        if making is not None and mark is not None:
            self._making.setdefault((key, mark), making)


class Answering:
    """The layer that gives what stands ready, and passes on what does not."""

    def __init__(self, app: ASGIApp, ready: Ready) -> None:
        self.app = app
        self.ready = ready

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        asked = Asked.of(scope)
        if asked is None:
            await self.app(scope, receive, send)
            return
        mark = await self.ready.changes.now()
        kept = None if mark is None else await self.ready.find(scope, asked, mark)
        if kept is not None:
            scope["route"] = kept.route
            await kept.send(send, asked.known_tags)
            return
        scope["state"][ASKED] = replace(asked, mark=mark, beside=self.ready.beside())
        over = self.ready.comes(scope, scope["state"][ASKED])
        try:
            await self.app(scope, receive, send)
        finally:
            over()
