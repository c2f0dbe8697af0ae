"""Checking and hashing passwords for requests: outside every transaction and lock, in threads of their own, in bounded queues.

An argon2 hash takes 64 MiB and all cores for a moment. Those for people who are logged in and those for anybody have a thread
each, so that a flood of log-ins holds up no signature; the thread of anybody's yields the processors to the rest of the server. A
wait that the limiter orders is an `asyncio.sleep`: it holds no thread, no lock and no connection to the store, and few may wait
at once.
"""

from __future__ import annotations

import asyncio
import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import TypeVar

from fastapi.concurrency import run_in_threadpool

from boresight.api.rounds import Rounds
from boresight.errors import OverloadedError
from boresight.services import failed_log_ins, passwords, users
from boresight.services.actors import Actor
from boresight.services.failed_log_ins import Attempt, Failures
from boresight.services.login_limiter import LoginLimiter, place_of_address
from boresight.services.passwords import NO_PROOF, NewPassword, PasswordProof, StoredPassword
from boresight.services.sessions import Client
from boresight.services.words import comparison_key
from boresight.store.sessions import Engine, Session, reading, writing

MOST_QUEUED = 16  # hashes; at less than 0.2 s each the last waits some seconds
MOST_HELD = 64  # attempts that wait because others failed
TELL_EVERY_S = 60.0
PROMPT = 10  # first failures that are told at once, in `TELL_EVERY_S`
NICE = 10

T = TypeVar("T")


class _Lane:
    """One thread for slow work, and a queue before it that is never long."""

    def __init__(self, name: str, *, yields: bool) -> None:
        self._queued = 0
        self._threads = ThreadPoolExecutor(1, f"boresight-{name}", _yield_processors if yields else None)

    async def run(self, work: Callable[[], T]) -> T:
        """Work when it is one's turn.

        Raises
        ------
        OverloadedError
            When too many wait.
        """
        if self._queued >= MOST_QUEUED:
            raise OverloadedError("Too many passwords are being checked at once; try again in 2 s.", 2)
        self._queued += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, work)
        finally:
            self._queued -= 1

    def close(self) -> None:
        """Stop after what is under way."""
        self._threads.shutdown(wait=False, cancel_futures=True)


def _yield_processors() -> None:
    """Let this thread, and those that argon2 starts from it, run after others; where the system has no such thing, not."""
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)


class Passwords:
    """The passwords of one server's requests.

    Parameters
    ----------
    database
        The store.
    free
        Failures of a name at a place before attempts wait.
    """

    def __init__(self, database: Engine, free: int) -> None:
        self._database = database
        self._limiter = LoginLimiter(free)
        self._known, self._anybody = _Lane("passwords", yields=False), _Lane("log-ins", yields=True)
        self._held = 0
        self._guard = threading.Lock()
        self._failed: dict[Attempt, Failures] = {}
        self._prompt: set[Attempt] = set()
        self._told: set[Attempt] = set()
        self._told_s = time.monotonic()
        self._rounds = Rounds("record of wrong passwords", [self.record_failures], self._rest_s)

    def start(self) -> None:
        """Begin to tell the audit log of failures."""
        self._rounds.start()

    def close(self) -> None:
        """Stop, and tell what was not told yet; safe to call twice."""
        self._rounds.close()
        self._rounds.take(partial(self.record_failures, whole=True))
        self._known.close()
        self._anybody.close()

    async def check_log_in(self, name: str, password: str, client: Client) -> PasswordProof:
        """Check name and password of somebody who is not known yet."""
        attempt = Attempt.of(name, client.address)
        stored = partial(passwords.stored_under, name=name)
        return await self._check(attempt, place_of_address(client.address), self._anybody, stored, password)

    async def check_own(self, actor: Actor, password: str, client: Client) -> PasswordProof:
        """Check the password of who acts; only what failed under the same log-in makes it wait."""
        if actor.is_key:
            return NO_PROOF  # whatever it says: a key never signs
        attempt = Attempt.of(actor.name, client.address, actor.session_id)
        stored = partial(passwords.stored_of, user_id=actor.user_id)
        return await self._check(attempt, _place(actor), self._known, stored, password)

    async def check_beside(self, actor: Actor, name: str, password: str, client: Client) -> PasswordProof:
        """Check name and password of a second person at the console of who acts."""
        attempt = Attempt.of(name, client.address, actor.session_id)
        stored = partial(passwords.stored_under, name=name)
        return await self._check(attempt, _place(actor), self._known, stored, password)

    async def prepare(self, password: str, *names: str) -> NewPassword:
        """Hash a password that is to be stored."""
        return await self._known.run(partial(passwords.prepare, password, *names))

    async def prepare_change(
        self, actor: Actor, user_id: int, password: str, current: str, client: Client
    ) -> tuple[NewPassword, PasswordProof]:
        """Hash a password that is to follow another, and check the current one where it is one's own."""
        own = actor.user_id == user_id
        if actor.is_key or not (own or "administrator" in actor.roles):
            return NewPassword(refusal="Only an administrator sets another's password."), NO_PROOF
        names = await self._read(partial(users.names_of, user_id=user_id))
        if not own:
            return await self.prepare(password, *names), NO_PROOF
        proof = await self.check_own(actor, current, client)
        if proof.fits and password == current:
            return NewPassword(refusal="The new password is the current one; use another."), proof
        return (await self.prepare(password, *names) if proof.fits else NewPassword()), proof

    async def _read(self, read: Callable[[Session], T]) -> T:
        """Read something in a transaction of its own, which is over before any work begins."""

        def in_transaction() -> T:
            with reading(self._database) as session:
                return read(session)

        return await run_in_threadpool(in_transaction)

    async def _check(
        self, attempt: Attempt, place: str, lane: _Lane, read: Callable[[Session], StoredPassword], password: str
    ) -> PasswordProof:
        """Check a password when the limiter lets it, and note how that went."""
        name = comparison_key(attempt.name)
        wait_s = self._limiter.admit(name, place)
        failed = None
        try:
            await self._wait(wait_s)
            proof = await lane.run(partial(passwords.check, await self._read(read), password))
            failed = not proof.fits
        finally:
            self._limiter.ended(name, place, failed=failed)
        if failed:
            self._note(attempt)
        return proof

    async def _wait(self, wait_s: float) -> None:
        """Wait, if not too many do."""
        if wait_s <= 0.0:
            return
        if self._held >= MOST_HELD:
            retry_s = math.ceil(wait_s)
            raise OverloadedError(f"Too many attempts wait already; try again in {retry_s} s.", retry_s)
        self._held += 1
        try:
            await asyncio.sleep(wait_s)
        finally:
            self._held -= 1

    def _note(self, attempt: Attempt) -> None:
        """Count a failure; the first of a name and an address is told soon."""
        with self._guard:
            self._failed.setdefault(attempt, Failures()).add()
            prompt = attempt not in self._told and len(self._told) < PROMPT
            if prompt:
                self._told.add(attempt)
                self._prompt.add(attempt)
        if prompt:
            self._rounds.nudge()

    def _rest_s(self) -> float:
        """Return how long until everything is told."""
        return max(0.05, self._told_s + TELL_EVERY_S - time.monotonic())

    def record_failures(self, *, whole: bool = False) -> None:
        """Write what is to be told at once, and once a minute everything."""
        with self._guard:
            if whole or time.monotonic() - self._told_s >= TELL_EVERY_S:
                failed, self._failed = self._failed, {}
                self._told_s, self._told = time.monotonic(), set()
            else:
                failed = {one: self._failed.pop(one) for one in self._prompt if one in self._failed}
            self._prompt = set()
        if failed:
            with writing(self._database) as session:
                failed_log_ins.record(session, failed)


def _place(actor: Actor) -> str:
    return f"session {actor.session_id}" if actor.session_id is not None else actor.credential
