"""The response cache: JSON answers sent again without running the endpoint while the data version has not changed.

An endpoint whose answer follows from the address and the rows of the store says so by `same_for_all` or `same_for_one`
(`boresight.platform.web.response_cache_store`). Its answer is then kept, compressed and with its tag, and given again while all of
this holds:

1. Nothing was committed since: the store's mark (`boresight.platform.db.data_version`), looked for anew for this very request,
equals the
   mark that was looked for before the answer was read. So who commits reads their own writes, from whichever server or command.
2. Whoever asks is known *now*: exactly these credentials (the `Authorization` and `Cookie` headers, byte for byte) were proven
   under this mark, and their end by the clock has not come. Keys revoked, log-ins ended, people disabled, roles changed are all
   commits, so they act with the next request. Credentials not proven under this mark are proven first, by one read.
3. It is theirs: an answer `same_for_one` stands under the person, or the credentials where they are no log-in, and is given to no
   others. One `same_for_roles` stands under the roles: where the frame names the person it has gaps
   (`boresight.platform.web.compressed_pages`), which
   are filled for whoever gets it. One `same_for_all` was made by an endpoint that was never told who asks. Neither endpoint is told
   more, so their answers cannot hold anything of the one who happened to ask first.
4. It is young: what the rows say of time (an age, a key that expires) is never older than `HELD_S`.

When many ask for one answer that does not stand ready, the first makes it and the others wait for it: those who came before it
began to be made, whose question it answers whatever was committed while they waited for its turn, and those for whom the mark
is the one that it began under. The turn comes sooner the more wait (`boresight.platform.web.concurrency_limit`). Everything here
runs on the event loop, so nothing is locked.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.platform.db.data_version import DataVersion
from boresight.platform.web.compressed_pages import CompressedPage
from boresight.platform.web.data_version_poller import DataVersionPoller
from boresight.platform.web.middleware import takes_gzip

HELD_S = 30.0
KEPT_BYTES = 64 << 20
LARGEST_SHARE = 16
MOST_PROOFS = 10_000
MOST_ADDRESSES = 10_000
FOR_ALL, FOR_ROLES, FOR_ONE = "all", "roles", "one"
ASKED, COMING = "asked", "coming"
LISTENING = "/api/v1/events"
BACKGROUND = (b"x-boresight-background", b"1")  # a page that renews itself says so

Address = tuple[str, bytes, bool]
Asker = tuple[bytes, bytes]


class SessionUse(Protocol):
    """Tells whether credentials were not idle for too long, and notes their use."""

    def __call__(self, *, active: bool) -> bool:
        """Whether they hold; `active` where somebody did something."""


def is_active(scope: Scope) -> bool:
    """Whether somebody did something; not so where an open page listens, or renews what it shows by itself."""
    return not scope["path"].startswith(LISTENING) and BACKGROUND not in scope["headers"]


@dataclass(frozen=True)
class CacheRequest:
    """What decides a request's answer: its address, whether it takes gzip, and the credentials it carries.

    `active` says whether it counts as a use of a log-in.
    """

    address: Address
    asker: Asker
    known_tags: bytes
    active: bool = True
    mark: DataVersion | None = None
    beside: Hashable = None

    @classmethod
    def of(cls, scope: Scope) -> CacheRequest | None:
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
class CredentialProof:
    """That credentials hold."""

    until_s: float
    use: SessionUse
    unchanged: Callable[[], bool] = lambda: False
    person: Hashable = None
    roles: Hashable = None
    gaps: tuple[bytes, ...] = ()

    def holds(self, *, active: bool = True) -> bool:
        """Whether they hold still; counts as a use where somebody did something."""
        return time.time() < self.until_s and self.use(active=active)


@dataclass(frozen=True)
class CachedResponse:
    """An answer as it is sent."""

    headers: tuple[tuple[bytes, bytes], ...]
    body: bytes | CompressedPage
    tag: bytes
    whole: bool
    mark: DataVersion | None = None
    beside: Hashable = None
    made_s: float = 0.0
    route: Any = None
    is_older: bool = False

    async def send(self, send: Send, known_tags: bytes, gaps: tuple[bytes, ...] = ()) -> None:
        """Send it, its gaps filled, or say that the copy which the asker has is still right."""
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
    """An answer that is being made, or waits for its turn, and how long who asked for it has waited."""

    key: Hashable
    answer: asyncio.Future[CachedResponse | None]
    waiting: int = 0
    newest_s: float = 0.0  # when the last of them came
    came_s: float = field(default=0.0)  # the times at which they came, summed up

    def joined(self) -> None:
        """Count one more who waits."""
        self.waiting += 1
        self.newest_s = time.monotonic()
        self.came_s += self.newest_s

    def waited_s(self, now_s: float) -> float:
        """Return how long all who wait for it have waited until now, summed up."""
        return self.waiting * now_s - self.came_s


def waited_s(scope: Scope) -> Callable[[float], float] | None:
    """Return what tells how long those have waited, in sum, who will have the answer to a request."""
    making: PendingResponse | None = scope["state"].get(COMING)
    return None if making is None else making.waited_s


class ResponseCache:
    """The response cache of one server."""

    def __init__(
        self,
        changes: DataVersionPoller,
        prove: Callable[[Scope], Awaitable[CredentialProof | None]],
        beside: Callable[[], Hashable],
        limit_bytes: int = KEPT_BYTES,
    ) -> None:
        self.changes = changes
        self.beside = beside
        self.held_bytes = 0
        self._prove = prove
        self._limit_bytes = limit_bytes
        self._kept: OrderedDict[Hashable, CachedResponse] = OrderedDict()
        self._same_for: OrderedDict[Address, str] = OrderedDict()
        self._proofs: OrderedDict[Asker, tuple[DataVersion, CredentialProof]] = OrderedDict()
        self._coming: dict[Hashable, PendingResponse] = {}
        self._making: dict[tuple[Hashable, DataVersion], PendingResponse] = {}

    async def find(
        self, scope: Scope, asked: CacheRequest, data_version: DataVersion
    ) -> tuple[CachedResponse, CredentialProof] | None:
        """Return the answer that stands ready for who asks, waiting for it when it is being made, and the proof of who that is."""
        if asked.address not in self._same_for:
            return None  # nobody knows yet whose its answer will be
        proof = await self._known(scope, asked, data_version)
        if proof is None:
            return None
        key = self._key(asked, proof)
        kept = self._standing(key, data_version)
        if kept is not None:
            return kept, proof
        coming = self._coming.get(key)
        making = coming or self._making.get((key, data_version))
        if making is not None:
            return await self._wait(scope, asked, data_version, making, has_begun=coming is None)
        self._comes(scope, key)
        return None

    async def _wait(
        self, scope: Scope, asked: CacheRequest, data_version: DataVersion, making: PendingResponse, *, has_begun: bool
    ) -> tuple[CachedResponse, CredentialProof] | None:
        """Wait for an answer that is coming, or has begun to be made under our mark."""
        making.joined()
        kept = await asyncio.shield(making.answer)
        if kept is None:
            return None
        if kept.is_older and has_begun:  # part of it is of before a commit that who came so late may know of
            now = await self.changes.now()
            return None if now is None else await self.find(scope, asked, now)
        proof = await self._known(
            scope, asked, kept.mark or data_version
        )  # the mark may have been looked for later than ours
        return None if proof is None or self._key(asked, proof) != making.key else (kept, proof)

    def _key(self, asked: CacheRequest, proof: CredentialProof | None) -> Hashable:
        """Return under what the answer to who asks is kept; a proof that was lost on the way tells of the asker alone."""
        same_for = self._same_for.get(asked.address, FOR_ONE)
        if same_for == FOR_ALL:
            return asked.address
        sharing = None if proof is None else proof.roles if same_for == FOR_ROLES else proof.person
        return asked.address, same_for, asked.asker if sharing is None else sharing

    def _standing(self, key: Hashable, data_version: DataVersion) -> CachedResponse | None:
        """Return what is kept, where it still holds."""
        kept = self._kept.get(key)
        if kept is None or kept.mark != data_version or not self._is_young(kept):
            return None
        self._kept.move_to_end(key)
        return kept

    def _is_young(self, kept: CachedResponse) -> bool:
        """Whether an answer is not too old, and what it depends on besides the store is as it was."""
        return time.monotonic() - kept.made_s < HELD_S and kept.beside in {None, self.beside()}

    async def _known(self, scope: Scope, asked: CacheRequest, data_version: DataVersion) -> CredentialProof | None:
        """Return the proof of the credentials; None where they do not hold now."""
        before, proof = self._proofs.get(asked.asker, (None, None))
        if proof is None or (before != data_version and not proof.unchanged()):
            proof = await self._prove(scope)
            if proof is not None:
                self.remember(asked.asker, data_version, proof)
            return proof
        if before != data_version:
            self.remember(asked.asker, data_version, proof)
        return proof if proof.holds(active=asked.active) else None

    def remember(self, asker: Asker, data_version: DataVersion, proof: CredentialProof) -> None:
        """Note that credentials were proven by a read after a mark."""
        self._proofs[asker] = (data_version, proof)
        self._proofs.move_to_end(asker)
        if len(self._proofs) > MOST_PROOFS:
            self._proofs.popitem(last=False)

    def keep(
        self, scope: Scope, asked: CacheRequest, kept: CachedResponse, proof: CredentialProof | None, same_for: str
    ) -> None:
        """Let an answer stand ready, and give it to those who wait for it."""
        if asked.mark is not None and proof is not None:
            self.remember(asked.asker, asked.mark, proof)
        self._same_for[asked.address] = same_for
        self._same_for.move_to_end(asked.address)
        if len(self._same_for) > MOST_ADDRESSES:
            self._same_for.popitem(last=False)
        size, key = len(kept.body), self._key(asked, proof)
        if size * LARGEST_SHARE > self._limit_bytes:
            return
        self._drop(key)
        if kept.is_older:
            self._give(scope, key, kept)
            return
        self._kept[key] = kept
        self.held_bytes += size
        while self.held_bytes > self._limit_bytes:
            self._drop(next(iter(self._kept)))
        self._give(scope, key, kept)

    def _give(self, scope: Scope, key: Hashable, kept: CachedResponse) -> None:
        """Give an answer to those who wait for it."""
        making: PendingResponse | None = scope["state"].get(COMING)
        if making is not None and making.key == key and not making.answer.done():
            making.answer.set_result(kept)

    def _drop(self, key: Hashable) -> None:
        """Let go of an answer."""
        kept = self._kept.pop(key, None)
        self.held_bytes -= 0 if kept is None else len(kept.body)

    def _comes(self, scope: Scope, key: Hashable) -> None:
        """Say that an answer will be made when its turn has come."""
        making = PendingResponse(key, asyncio.get_running_loop().create_future())
        making.joined()
        self._coming[key] = scope["state"][COMING] = making

    async def begin(self, scope: Scope) -> None:
        """Begin to make an answer: it will tell of everything that is committed by now, and of nothing later for sure.

        Who asked meanwhile waits for it. Who asks from now on does so only if nothing is committed before.
        """
        asked: CacheRequest | None = scope["state"].get(ASKED)
        if asked is None or asked.mark is None:
            return
        making: PendingResponse | None = scope["state"].get(COMING)
        if making is not None and self._coming.get(making.key) is making:
            del self._coming[making.key]
        data_version = await self.changes.now()
        scope["state"][ASKED] = replace(asked, mark=data_version, beside=self.beside())
        if making is not None:
            scope["state"]["came_s"] = (
                making.newest_s
            )  # what is read for all of them must tell what the last to come may know
        if making is not None and data_version is not None:
            self._making.setdefault((making.key, data_version), making)

    def over(self, scope: Scope) -> None:
        """Say that a request was answered, however: who still waits for its answer makes one."""
        making: PendingResponse | None = scope["state"].get(COMING)
        if making is None:
            return
        began = (making.key, scope["state"][ASKED].mark)
        if self._coming.get(making.key) is making:
            del self._coming[making.key]
        if self._making.get(began) is making:
            del self._making[began]
        if not making.answer.done():
            making.answer.set_result(None)


class CacheLookup:
    """The middleware that answers from the cache, and passes on what is not in it."""

    def __init__(self, app: ASGIApp, ready: ResponseCache) -> None:
        self.app = app
        self.ready = ready

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        asked = CacheRequest.of(scope)
        if asked is None:
            await self.app(scope, receive, send)
            return
        data_version = await self.ready.changes.now()
        found = None if data_version is None else await self.ready.find(scope, asked, data_version)
        if found is not None:
            kept, proof = found
            scope["route"] = kept.route
            await kept.send(send, asked.known_tags, proof.gaps)
            return
        scope["state"][ASKED] = replace(asked, mark=data_version, beside=self.ready.beside())
        try:
            await self.app(scope, receive, send)
        finally:
            self.ready.over(scope)
