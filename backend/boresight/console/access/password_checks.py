"""Checking and hashing passwords for requests: outside every transaction and lock, in threads of their own, in bounded queues.

An argon2 hash takes 64 MiB and all cores for a moment, so people who are logged in, names that logged in from the same
place before, and anybody have a thread each: a flood of log-ins holds up neither a signature nor a return.
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
from dataclasses import replace
from functools import partial
from typing import TypeVar

from fastapi.concurrency import run_in_threadpool

from boresight.console.access import log_in_attempts as failed_log_ins
from boresight.console.access import passwords, second_factors, sessions, users
from boresight.console.access.log_in_attempts import (
    FailedAttempt,
    Failures,
    LoginAttempt,
    LoginLimiter,
    name_network,
)
from boresight.console.access.passwords import NO_PROOF, NewPassword, PasswordProof, StoredPassword
from boresight.console.access.second_factors import FactorRules, GivenFactor
from boresight.console.access.sessions import ClientAddress
from boresight.console.access.webauthn_ceremonies import RelyingParty
from boresight.errors import BoresightError, OverloadedError
from boresight.platform.actors import Actor
from boresight.platform.audit.security_log import tell
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker
from boresight.platform.web.text_validation import comparison_key

MOST_QUEUED = 16  # hashes; at less than 0.2 s each the last waits some seconds
MOST_HELD = 64  # attempts that wait because others failed
TELL_EVERY_S = 60.0
PROMPT = 10  # failures that are recorded at once, per `TELL_EVERY_S`; the rest wait
NICE = 10

T = TypeVar("T")


class _PasswordThread:
    """One thread for slow work, with a short bounded queue."""

    def __init__(self, name: str, *, yields: bool) -> None:
        self._queued = 0
        self._threads = ThreadPoolExecutor(1, f"boresight-{name}", _yield_processors if yields else None)

    async def run(self, work: Callable[[], T]) -> T:
        """Run a function in the thread when its turn comes."""
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
    """Lower the priority of this thread and of those that argon2 starts from it, where the system can."""
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)


class PasswordWorker(PeriodicWorker):
    """The passwords of one server's requests."""

    def __init__(self, database: Engine, free: int, rules: FactorRules | None = None) -> None:
        self._database = database
        self._rules = rules
        self._limiter = LoginLimiter(free)
        self._known, self._returning = (
            _PasswordThread("passwords", yields=False),
            _PasswordThread("returns", yields=False),
        )
        self._anybody = _PasswordThread("log-ins", yields=True)
        self._held = 0
        self._guard = threading.Lock()
        self._failed: dict[FailedAttempt, Failures] = {}
        self._prompt: set[FailedAttempt] = set()
        self._told: set[FailedAttempt] = set()
        self._told_s = time.monotonic()
        self._thread = PeriodicThread("record of wrong passwords", [self.record_failures], self._rest_s)

    def close(self) -> None:
        """Stop, and record the failures that are not recorded yet; safe to call twice."""
        super().close()
        self._thread.take(partial(self.record_failures, whole=True))
        self._known.close()
        self._returning.close()
        self._anybody.close()

    async def check_log_in(
        self, name: str, password: str, client: ClientAddress, code: str = "", site: RelyingParty | None = None
    ) -> PasswordProof:
        """Check name and password of somebody who is not known yet, and the code of a second factor where one is given."""
        place = name_network(client.address)
        stored, known = await self._read(partial(_read_stored_at, name=name, place=place))
        tried = LoginAttempt(comparison_key(name), place, known)
        lane = self._returning if known else self._anybody
        proof = await self._check(FailedAttempt.of(name, client.address), tried, lane, stored, password)
        return await self._with_factor(proof, tried, code, site)

    async def check_own(
        self, actor: Actor, password: str, client: ClientAddress, code: str = "", site: RelyingParty | None = None
    ) -> PasswordProof:
        """Check the acting person's password, and a second factor; only failures under the same log-in delay it."""
        if actor.is_key:
            return NO_PROOF  # whatever it says: a key never signs
        attempt = FailedAttempt.of(actor.name, client.address, actor.session_id)
        stored = await self._read(partial(passwords.read_stored, user_id=actor.user_id))
        tried = LoginAttempt(comparison_key(actor.name), f"session {actor.session_id}", known=True)
        if await self._read(partial(users.is_external, user_id=actor.user_id)):
            return await self._with_factor(NO_PROOF, tried, code, site, actor.user_id)
        proof = await self._check(attempt, tried, self._known, stored, password)
        return await self._with_factor(proof, tried, code, site)

    async def check_own_factor(self, actor: Actor, code: str, site: RelyingParty) -> GivenFactor:
        """Check the acting person's second factor alone."""
        tried = LoginAttempt(comparison_key(actor.name), f"session {actor.session_id}", known=True)
        user_id = None if actor.is_key else actor.user_id
        return (await self._with_factor(NO_PROOF, tried, code, site, user_id)).given

    async def check_code(self, user_id: int, code: str, client: ClientAddress, site: RelyingParty) -> GivenFactor:
        """Check the code of a person whose log-in waits for a second factor."""
        place = name_network(client.address)
        names = await self._read(partial(users.get_person_names, user_id=user_id))
        known = await self._read(partial(sessions.has_logged_in_from, user_id=user_id, place=place))
        tried = LoginAttempt(comparison_key(names[0] if names else ""), place, known)
        return (await self._with_factor(NO_PROOF, tried, code, site, user_id)).given

    async def check_beside(
        self,
        actor: Actor,
        name: str,
        password: str,
        client: ClientAddress,
        refuse: Callable[[Session], None],
        code: str = "",
    ) -> PasswordProof:
        """Check name and password of a second person at the acting person's console, and the code of their second factor."""
        place = name_network(client.address)

        def read(session: Session) -> tuple[StoredPassword, bool] | None:
            try:
                refuse(session)
            except BoresightError:
                return None  # the service checks this again, in its transaction
            return _read_stored_at(session, name, place)

        found = await self._read(read)
        if found is None:
            return NO_PROOF
        stored, known = found
        tried = LoginAttempt(comparison_key(name), place, known, console=f"person {actor.user_id}")
        attempt = FailedAttempt.of(name, client.address, actor.session_id)
        proof = await self._check(attempt, tried, self._known, stored, password)
        return await self._with_factor(proof, tried, code, None)

    async def _with_factor(
        self,
        proof: PasswordProof,
        tried: LoginAttempt,
        code: str,
        site: RelyingParty | None,
        user_id: int | None = None,
    ) -> PasswordProof:
        """Look at a typed code when the limiter allows it; it is used in the transaction of what it allows."""
        rules, typed = self._rules, code.strip()
        owner_id = proof.stored.user_id if proof.fits else user_id
        if rules is None or not rules.are_on:
            return proof
        given = GivenFactor(typed, site, rules)
        if owner_id is None or not typed or typed.startswith("{"):
            return replace(proof, given=given)
        if not await self._read(partial(second_factors.needs_second_factor, user_id=owner_id, rules=rules)):
            return replace(proof, given=given)
        tried = replace(tried, is_code=True)
        wait_s, failed = self._limiter.admit(tried), None
        try:
            await self._wait(wait_s)
            fits = await self._read(partial(second_factors.fits, user_id=owner_id, code=typed, rules=rules))
            failed = not fits
        finally:
            self._limiter.record_outcome(tried, failed=failed)
        if failed:
            self._note(FailedAttempt.of(tried.name, tried.place))
        return replace(proof, given=replace(given, fits=fits))

    async def prepare(self, password: str, *names: str) -> NewPassword:
        """Hash a password that is to be stored."""
        return await self._known.run(partial(passwords.prepare, password, *names))

    async def prepare_change(
        self, actor: Actor, user_id: int, password: str, current: str, client: ClientAddress
    ) -> tuple[NewPassword, PasswordProof]:
        """Hash a password that is to follow another, and check the current one where it is one's own."""
        own = actor.user_id == user_id
        if actor.is_key or not (own or "administrator" in actor.roles):
            return NewPassword(refusal="Only an administrator can set another person's password; ask one."), NO_PROOF
        names = await self._read(partial(users.get_person_names, user_id=user_id))
        if not own:
            return await self.prepare(password, *names), NO_PROOF
        proof = await self.check_own(actor, current, client)
        if proof.fits and password == current:
            return NewPassword(refusal="The new password is the current one; use another."), proof
        return (await self.prepare(password, *names) if proof.fits else NewPassword()), proof

    async def _read(self, read: Callable[[Session], T]) -> T:
        def in_transaction() -> T:
            with open_reading(self._database) as session:
                return read(session)

        return await run_in_threadpool(in_transaction)

    async def _check(
        self, attempt: FailedAttempt, tried: LoginAttempt, lane: _PasswordThread, stored: StoredPassword, password: str
    ) -> PasswordProof:
        """Check a password when the limiter allows it, and record the outcome."""
        wait_s = self._limiter.admit(tried)
        failed = None
        try:
            await self._wait(wait_s)
            proof = await lane.run(partial(passwords.check, stored, password))
            failed = not proof.fits
        finally:
            self._limiter.record_outcome(tried, failed=failed)
        if failed:
            tell("authn_login_fail", "failure", name=attempt.name, reason="password", method="password")
            self._note(attempt)
        return proof

    async def _wait(self, wait_s: float) -> None:
        """Wait, or refuse when too many attempts wait already."""
        if wait_s <= 0.0:
            return
        if self._held >= MOST_HELD:
            retry_s = math.ceil(wait_s)
            raise OverloadedError(f"Too many attempts are waiting already; try again in {retry_s} s.", retry_s)
        self._held += 1
        try:
            await asyncio.sleep(wait_s)
        finally:
            self._held -= 1

    def _note(self, attempt: FailedAttempt) -> None:
        """Count a failure; the first one of a name and an address is recorded soon."""
        with self._guard:
            self._failed.setdefault(attempt, Failures()).add()
            prompt = attempt not in self._told and len(self._told) < PROMPT
            if prompt:
                self._told.add(attempt)
                self._prompt.add(attempt)
        if prompt:
            self._thread.nudge()

    def _rest_s(self) -> float:
        """Return the time until all failures are due to be recorded."""
        return max(0.05, self._told_s + TELL_EVERY_S - time.monotonic())

    def record_failures(self, *, whole: bool = False) -> None:
        """Write the failures that are due at once, and once a minute all of them."""
        with self._guard:
            if whole or time.monotonic() - self._told_s >= TELL_EVERY_S:
                failed, self._failed = self._failed, {}
                self._told_s, self._told = time.monotonic(), set()
            else:
                failed = {one: self._failed.pop(one) for one in self._prompt if one in self._failed}
            self._prompt = set()
        if failed:
            with open_writing(self._database) as session:
                failed_log_ins.record(session, failed)


def _read_stored_at(session: Session, name: str, place: str) -> tuple[StoredPassword, bool]:
    """Read what is stored under a log-in name, and whether the person logged in from a place before."""
    stored = passwords.read_stored_under(session, name)
    return stored, sessions.has_logged_in_from(session, stored.user_id, place)
