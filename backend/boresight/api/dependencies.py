"""What every endpoint asks for: who acts, a transaction, proof that the request was meant.

One request is one transaction. It ends before the answer is sent (`scope="function"`), so an answer that says "done"
tells of something that is committed. Writers of this process queue on a lock of the event loop and not in the thread
pool: were they to wait for the database inside it, they could take every thread from the one who holds the database.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any

from fastapi import Depends, Header, Query
from fastapi.concurrency import contextmanager_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from boresight.api.credentials import bearer, who_acts
from boresight.api.numbers import row_number
from boresight.api.origins import SAFE_METHODS
from boresight.api.passwords import Passwords
from boresight.errors import (
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.services import sessions, users
from boresight.services.actors import Actor, Policy, require_person
from boresight.services.forecasts import Sight
from boresight.services.passwords import PasswordProof
from boresight.services.sessions import Client
from boresight.store.sessions import Session, only_try, reading, writing

FORM_TYPES = ("application/x-www-form-urlencoded", "multipart/form-data")
CSRF_HEADER = "X-CSRF-Token"
CSRF_FIELD = "csrf_token"
DRY = "Check everything, change nothing: 200 with what would be, and `X-Validate-Only: true`."


async def read_session(request: Request) -> AsyncIterator[Session]:
    """Open the request's transaction for reading: one state of the database, from its first query on."""
    engine = request.app.state.engine
    if engine.dialect.name == "sqlite":  # neither beginning nor ending to read waits for anything there
        with reading(engine) as session:
            yield session
        return
    async with contextmanager_in_threadpool(reading(engine)) as session:
        yield session


async def write_session(request: Request) -> AsyncIterator[Session]:
    """Open the request's transaction for writing; commits when the endpoint returns, before the answer is sent.

    Whoever follows the store is then told to look at once: the event feed, and the engine that waits for runs.
    """
    state = request.app.state
    async with state.write_lock, contextmanager_in_threadpool(writing(state.engine)) as session:
        yield session
    state.broadcast.nudge()
    state.deliveries.nudge()
    state.workers.notify()


async def only_asked(validate_only: Annotated[bool, Query(description=DRY)] = False) -> bool:
    """Whether the request only asks what would come of it."""
    return validate_only


OnlyAsked = Annotated[bool, Depends(only_asked)]


async def never_tried(request: Request) -> None:
    """Refuse `validate_only` where there is nothing to try.

    Raises
    ------
    RefusedInputError
        When it was given.
    """
    if "validate_only" in request.query_params:
        raise RefusedInputError("Logging in and out cannot be tried with validate_only; leave it out.")


async def write_or_try(request: Request, asked: OnlyAsked) -> AsyncIterator[Session]:
    """Open the request's transaction for writing, or with `validate_only` for a trial that is rolled back at its end.

    A trial holds the same lock and makes the same checks; files that it stored stay, referred to by nothing.
    """
    state = request.app.state
    if not asked:
        async with asynccontextmanager(write_session)(request) as session:
            yield session
        return
    async with state.write_lock, contextmanager_in_threadpool(writing(state.engine)) as session:
        only_try(session)
        yield session


async def csrf(request: Request) -> None:
    """Refuse an unsafe request that a cookie authenticates unless it repeats the log-in's CSRF token.

    The token comes as the header `X-CSRF-Token` or, from a plain form of a page, as the field `csrf_token`. Requests
    with an API key need none: no other site can make a browser send that header.

    Raises
    ------
    ForbiddenError
        When the token is missing or another.
    """
    if request.method in SAFE_METHODS or bearer(request.headers) is not None:
        return
    if request.app.state.log_in_cookie.name not in request.cookies:
        return  # nothing to abuse; whoever needs an actor refuses it
    try:
        await who_acts(request)
    except UnauthenticatedError:
        return  # neither is there with a log-in that has ended; it must not keep anybody from logging in anew
    given = request.headers.get(CSRF_HEADER) or await _form_token(request)
    if not hmac.compare_digest(given.encode(), request.state.csrf_token.encode()):
        raise ForbiddenError(f"The {CSRF_HEADER} of this log-in is missing or another's; reload the page, do it again.")


async def _form_token(request: Request) -> str:
    """Return the token of a page's plain form; empty where there is none. The API reads its uploads itself."""
    if request.url.path.startswith("/api/") or not request.headers.get("content-type", "").startswith(FORM_TYPES):
        return ""
    value = (await request.form()).get(CSRF_FIELD, "")
    return value if isinstance(value, str) else ""


def weak(tag: str) -> str:
    """Return a row's tag for an answer in which more may change than the tag tells of (RFC 9110, 8.8.1)."""
    return f"W/{tag}"


def strong(given: str) -> str:
    """Return the row's tag that a client read, weak or not: it names the row's state, and says nothing of bytes."""
    return given.strip().removeprefix("W/")


async def seen_tag(
    if_match: Annotated[str | None, Header(alias="If-Match", description="The ETag that you read.")] = None,
) -> str:
    """Return the tag in `If-Match`, which every transition must state.

    Raises
    ------
    PreconditionRequiredError
        When the header is absent.
    """
    if if_match is None:
        raise PreconditionRequiredError('Say which version you saw: send its ETag in If-Match, as in If-Match: "v3".')
    return strong(if_match)


SeenTag = Annotated[str, Depends(seen_tag)]


async def seen_version(given: SeenTag) -> int:
    """Return the version that the tag in `If-Match` names.

    Raises
    ------
    StaleError
        When it cannot be the tag of any version.
    """
    digits = given.removeprefix('"v').removesuffix('"')
    version = row_number(digits)
    if given != f'"v{digits}"' or version is None:
        raise StaleError(f"No version has the tag {given[:40]}; read it again and send its ETag in If-Match.")
    return version


def etag(version: int) -> str:
    """Return the entity tag of a version."""
    return f'"v{version}"'


async def maybe_seen_tag(
    if_match: Annotated[str | None, Header(alias="If-Match", description="The ETag that you read, if you did.")] = None,
) -> str | None:
    """Return the tag in `If-Match`, where a transition may be asked without having looked."""
    return None if if_match is None else strong(if_match)


MaybeSeenTag = Annotated[str | None, Depends(maybe_seen_tag)]


def tag_of(*parts: Any) -> str:
    """Return the entity tag of a row without a version, from the columns that its transitions change."""
    return f'"{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}"'


def require_tag(given: str, current: str, name: str) -> None:
    """Refuse a transition by someone who did not see the row as it is.

    Raises
    ------
    StaleError
        When it changed since.
    """
    if given != current:
        raise StaleError(f"{name} has changed since you looked; read it again and send its new ETag in If-Match.")


async def policy_of(request: Request) -> Policy:
    """Return what this installation asks of a request for approval."""
    policy: Policy = request.app.state.policy
    return policy


async def sight_of(request: Request) -> Sight:
    """Return what a dry run may look at."""
    sight: Sight = request.app.state.sight
    return sight


def log_in_person(request: Request, response: Response, session: Session, proof: PasswordProof) -> tuple[Actor, str]:
    """Give the browser of who proved to be a person a log-in; returns the person and the CSRF token.

    Raises
    ------
    UnauthenticatedError
        When name and password do not belong together.
    """
    actor = users.authenticate(session, proof, request.state.request_id)
    _, token = sessions.begin(session, require_person(actor, "log in"), client_of(request))
    return actor, request.app.state.log_in_cookie.write(response, token)


def client_of(request: Request) -> Client:
    """Return where a request comes from; behind a proxy that uvicorn trusts, whom the proxy names."""
    address = None if request.client is None else request.client.host
    return Client.of(address, request.headers.get("user-agent"))


async def check_own(request: Request, actor: Actor, password: str) -> PasswordProof:
    """Check the password of who acts, before any transaction begins."""
    checks: Passwords = request.app.state.passwords
    return await checks.check_own(actor, password, client_of(request))


def clear_cookie(request: Request, response: Response) -> None:
    """Take the cookie of a log-in that has ended away from the browser."""
    request.app.state.log_in_cookie.clear(response)


Who = Annotated[Actor, Depends(who_acts)]
Reading = Annotated[Session, Depends(read_session, scope="function")]
Writing = Annotated[Session, Depends(write_or_try, scope="function")]
LoggingIn = Annotated[Session, Depends(write_session, scope="function")]
SeenVersion = Annotated[int, Depends(seen_version)]
Held = Annotated[Policy, Depends(policy_of)]
Sighted = Annotated[Sight, Depends(sight_of)]
