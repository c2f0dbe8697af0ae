"""Dependencies of the endpoints: the actor, a transaction, the CSRF check.

One request is one transaction, which ends before the answer is sent (`scope="function"`). Writers queue on a lock of
the event loop: in the thread pool they could take every thread from the one who holds the database.
"""

from __future__ import annotations

import hmac
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, cast

from fastapi import Depends, Header, Query
from fastapi.concurrency import contextmanager_in_threadpool
from pydantic import BaseModel, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.console.access import confirmations, preferences, second_factors, sessions, users
from boresight.console.access.confirmations import Needed
from boresight.console.access.credentials import THEME_COOKIE, LogInCookie, ShortCookie, bearer, get_actor
from boresight.console.access.password_checks import PasswordWorker
from boresight.console.access.passwords import NO_PROOF, PasswordProof
from boresight.console.access.second_factors import WAITS_S, FactorRules, GivenFactor
from boresight.console.access.sessions import ClientAddress
from boresight.console.access.tables import User
from boresight.console.access.webauthn_ceremonies import RelyingParty
from boresight.console.schemas import Row
from boresight.errors import (
    ForbiddenError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
    UnauthenticatedError,
)
from boresight.platform.actors import Actor, Policy, require_person
from boresight.platform.audit.security_log import note, tell
from boresight.platform.audit.signing import SigningKey
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Engine, Session, mark_dry_run, open_reading, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.worker_news import WorkerState
from boresight.platform.web.figure_cache import FigureCache
from boresight.platform.web.openapi import refuses
from boresight.platform.web.origins import SAFE_METHODS
from boresight.platform.web.paging import parse_row_id, register
from boresight.platform.web.response_cache import FOR_ALL, FOR_ONE, FOR_ROLES, share
from boresight.settings import Settings
from boresight.sky.catalogue import Catalogue

register()  # what a parameter in a path may be, before the first route is made: every module of routes or pages imports this one

FORM_TYPES = ("application/x-www-form-urlencoded", "multipart/form-data")
CSRF_HEADER = "X-CSRF-Token"
CSRF_FIELD = "csrf_token"
DRY_RUN_SENTENCE = (
    "Validate only, without changes: returns 200 with the result that would follow, and `X-Validate-Only: true`."
)


async def open_read_session(request: Request) -> AsyncIterator[Session]:
    """Open the request's transaction for reading: one state of the database, from its first query on."""
    engine = request.app.state.engine
    if engine.dialect.name == "sqlite":  # neither beginning nor ending to read waits for anything there
        with open_reading(engine) as session:
            yield session
        return
    async with contextmanager_in_threadpool(open_reading(engine)) as session:
        yield session


async def open_write_session(request: Request) -> AsyncIterator[Session]:
    """Open the request's transaction for writing, committed before the answer is sent; then wake what follows the store."""
    state = request.app.state
    async with state.write_lock, contextmanager_in_threadpool(open_writing(state.engine)) as session:
        yield session
    state.broadcast.nudge()
    state.webhook_sender.nudge()
    state.workers.notify()


async def same_for_all(request: Request, _actor: Who) -> None:
    """Require a known actor without passing it to the endpoint: its answer depends on address and store alone."""
    share(request, FOR_ALL)


async def same_for_one(request: Request, _actor: Who) -> None:
    """Declare that the answer depends only on the address, the store, the actor and what every page shows of this server."""
    share(request, FOR_ONE)


async def same_for_roles(request: Request, actor: Who) -> frozenset[str]:
    """Declare that a page depends only on the address, the store, these roles and what every page shows of server and actor.

    Its endpoint may ask for `Roles`, and for nothing else of who asks.
    """
    share(request, FOR_ROLES)
    return actor.roles


async def get_dry_run(validate_only: Annotated[bool, Query(description=DRY_RUN_SENTENCE)] = False) -> bool:
    """Return whether the request is a dry run."""
    return validate_only


IsDryRun = Annotated[bool, Depends(get_dry_run)]


async def refuse_dry_run(request: Request) -> None:
    """Refuse `validate_only` where no dry run is possible."""
    if "validate_only" in request.query_params:
        raise RefusedInputError("Logging in and out does not support validate_only; leave it out.")


async def open_write_or_dry_run(request: Request, asked: IsDryRun) -> AsyncIterator[Session]:
    """Open the request's transaction for writing, or with `validate_only` for a trial that is rolled back at its end."""
    state = request.app.state
    if not asked:
        async with asynccontextmanager(open_write_session)(request) as session:
            yield session
        return
    async with state.write_lock, contextmanager_in_threadpool(open_writing(state.engine)) as session:
        mark_dry_run(session)
        yield session


async def csrf(request: Request) -> None:
    """Refuse an unsafe request that a cookie authenticates unless it repeats the log-in's CSRF token.

    The token comes as the header `X-CSRF-Token` or, from a plain form of a page, as the field `csrf_token`. Requests
    with an API key need none: no other site can make a browser send that header.
    """
    if request.method in SAFE_METHODS or bearer(request.headers) is not None:
        return
    if request.app.state.log_in_cookie.name not in request.cookies:
        return  # nothing to abuse; whoever needs an actor refuses it
    try:
        await get_actor(request)
    except UnauthenticatedError:
        return  # neither is there with a log-in that has ended; it must not keep anybody from logging in again
    given = request.headers.get(CSRF_HEADER) or await _form_token(request)
    if not hmac.compare_digest(given.encode(), request.state.csrf_token.encode()):
        tell("malicious_csrf", "failure")
        raise ForbiddenError(
            f"The {CSRF_HEADER} is missing or belongs to another log-in; reload the page and try again.",
            code="csrf-token",
        )


async def _form_token(request: Request) -> str:
    """Return the token of a page's plain form; empty where there is none. The API reads its uploads itself."""
    if request.url.path.startswith("/api/") or not request.headers.get("content-type", "").startswith(FORM_TYPES):
        return ""
    value = (await request.form()).get(CSRF_FIELD, "")
    return value if isinstance(value, str) else ""


def strong(given: str) -> str:
    """Return the row's tag that a client read, weak or not: it names the row's state, and says nothing of bytes."""
    return given.strip().removeprefix("W/")


@dataclass(frozen=True)
class EntityTag:
    """The entity tag of the row that the client saw; None where a transition may be requested without one."""

    tag: str | None

    def require(self, shape: type[Row], row: Any, name: str = "It") -> None:
        """Refuse a transition by someone who saw an older version of the row."""
        if self.tag is not None and self.tag != shape.etag(row):
            raise StaleError(
                f"{name} has changed since you read it; read it again and send its new ETag in If-Match.",
                code="changed-since-read",
            )


@refuses(412, 428)
async def seen(
    if_match: Annotated[str | None, Header(alias="If-Match", description="The ETag that you read.")] = None,
) -> EntityTag:
    """Return the tag in `If-Match`, which every transition must state."""
    if if_match is None:
        raise PreconditionRequiredError('Say which version you saw: send its ETag in If-Match, as in If-Match: "v3".')
    return EntityTag(strong(if_match))


@refuses(412)
async def maybe_seen(
    if_match: Annotated[str | None, Header(alias="If-Match", description="The ETag that you read, if you did.")] = None,
) -> EntityTag:
    """Return the tag in `If-Match`, if there is one."""
    return EntityTag(None if if_match is None else strong(if_match))


async def seen_version(given: Annotated[EntityTag, Depends(seen)]) -> int:
    """Return the version that the tag in `If-Match` names."""
    tag = given.tag or ""
    digits = tag.removeprefix('"v').removesuffix('"')
    version = parse_row_id(digits)
    if tag != f'"v{digits}"' or version is None:
        raise StaleError(f"{tag[:40]} is not the ETag of any version; read it again and send its ETag in If-Match.")
    return version


def password_field(description: str) -> Any:
    """Return the field of a body for a password; people who log in by single sign-on have none and leave it out."""
    return Field(SecretStr(""), description=f"{description} Omit with single sign-on.")


def factor_field() -> Any:
    """Return the field of a body for a second factor."""
    return Field(
        SecretStr(""),
        description="The second factor, where one is enrolled: an app's code, a recovery code, or a security key's answer as JSON.",
    )


def own_factor(body: Any) -> Any:
    """Return a dependency that checks the acting person's second factor, a field of the body, which may be left out."""

    @refuses(429)
    async def proven(actor: Who, request: Request, given: Any = None) -> GivenFactor:
        return await check_own_factor(request, actor, "" if given is None else given.factor.get_secret_value())

    proven.__annotations__["given"] = body
    return Depends(proven)


class WorkerControl(Protocol):
    """The part of the dispatcher that endpoints use; absent until the server has started."""

    def notify(self) -> None:
        """Have the dispatcher look for runs at once."""

    def state(self) -> WorkerState:
        """Return the state of the workers."""


class Server(Protocol):
    """The parts of the server that a page or a route may use."""

    settings: Settings
    policy: Policy
    engine: Engine
    blobs: BlobStore
    catalogue: Callable[[], Catalogue]
    forecast_sources: ForecastSources
    passwords: PasswordWorker
    workers: WorkerControl | None


def get_server(request: Request) -> Server:
    """Return the server that answers a request, for code that is not an endpoint and has no dependencies."""
    return cast("Server", request.app.state)


def depend_on_server(name: str) -> Any:
    """Return a dependency on a part of the server, by its name in the state of the application."""

    async def part(request: Request) -> Any:
        return getattr(request.app.state, name)

    return Depends(part)


def get_site(request: Request) -> RelyingParty:
    """Return the site that a browser sees this server as: its public address, or the one that the request was sent to."""
    return RelyingParty.of(get_server(request).settings.public_url or str(request.base_url))


def get_factor_rules(request: Request) -> FactorRules:
    """Return of whom this server asks a second factor."""
    rules: FactorRules = request.app.state.factor_rules
    return rules


def get_needed(request: Request, session: Session, actor: Actor) -> Needed:
    """Return what the acting person is asked for where something must be confirmed."""
    return confirmations.describe_needed(session, actor, get_factor_rules(request))


def waiting_cookie(request: Request) -> ShortCookie:
    """Return the cookie of a log-in that waits for its second factor."""
    cookie: LogInCookie = request.app.state.log_in_cookie
    return cookie.short("boresight_second_factor", WAITS_S)


def log_in_person(request: Request, response: Response, session: Session, proof: PasswordProof) -> tuple[Actor, str]:
    """Log a person in by one request, with the second factor that it carries where one is asked for."""
    actor = users.authenticate(session, proof, request.state.request_id)
    user_id, kind = require_person(actor, "log in"), None
    if second_factors.needs_second_factor(session, user_id, get_factor_rules(request)):
        kind = second_factors.use(session, actor, session.get_known(User, user_id), proof.given, "log-in")
    return actor, begin_session(request, response, session, actor, "password", kind)


def log_in_or_wait(request: Request, response: Response, session: Session, actor: Actor, method: str) -> bool:
    """Log in a person whose password or provider was right; whether the log-in waits for a second factor instead."""
    user_id = require_person(actor, "log in")
    if not second_factors.needs_second_factor(session, user_id, get_factor_rules(request)):
        begin_session(request, response, session, actor, method)
        return False
    waiting_cookie(request).write(response, [second_factors.begin_waiting(session, user_id, method)])
    return True


def begin_session(
    request: Request, response: Response, session: Session, actor: Actor, method: str, factor_kind: str | None = None
) -> str:
    """Begin a log-in of somebody who gave all that is asked for, set its cookie, and return the CSRF token."""
    user_id = require_person(actor, "log in")
    row, token = sessions.begin(session, user_id, get_client(request), method, factor_kind)
    note(session, "authn_login_success", actor, method=method, factor=factor_kind, log_in=row.id)
    cookie: LogInCookie = request.app.state.log_in_cookie
    csrf_token = cookie.write(response, token)
    theme = preferences.get_preferences(session, user_id)["theme"]
    if theme != request.cookies.get(THEME_COOKIE, "system"):
        cookie.write_theme(response, theme)
    return csrf_token


def get_client(request: Request) -> ClientAddress:
    """Return the address of the client; behind a proxy that uvicorn trusts, the one that the proxy names."""
    address = None if request.client is None else request.client.host
    return ClientAddress.of(address, request.headers.get("user-agent"))


def clear_cookie(request: Request, response: Response) -> None:
    """Remove the cookie of a log-in that has ended."""
    request.app.state.log_in_cookie.clear(response)


async def check_own(request: Request, actor: Actor, password: str, code: str = "") -> PasswordProof:
    """Check what confirms the acting person before any transaction begins."""
    return await get_server(request).passwords.check_own(actor, password, get_client(request), code, get_site(request))


async def check_own_factor(request: Request, actor: Actor, code: str) -> GivenFactor:
    """Check the acting person's second factor alone before any transaction begins."""
    return await get_server(request).passwords.check_own_factor(actor, code, get_site(request))


def own_password(body: type[BaseModel]) -> Any:
    """Return a dependency that checks what confirms the acting person, fields of the body, which may be optional."""

    @refuses(429)
    async def proven(signed: Any, actor: Who, request: Request) -> PasswordProof:
        password: SecretStr | None = signed.password
        if password is None:
            return NO_PROOF
        return await check_own(request, actor, password.get_secret_value(), signed.factor.get_secret_value())

    proven.__annotations__["signed"] = body  # the same parameter as its endpoint's, so the body is one
    return Depends(proven)


Who = Annotated[Actor, Depends(get_actor)]
KNOWN = Depends(get_actor)  # of a route that requires a known actor but does not use it
SAME_FOR_ALL = Depends(same_for_all)
Roles = Annotated[frozenset[str], Depends(same_for_roles)]
Reading = Annotated[Session, Depends(open_read_session, scope="function")]
Writing = Annotated[Session, Depends(open_write_or_dry_run, scope="function")]
LoggingIn = Annotated[Session, Depends(open_write_session, scope="function")]
SeenVersion = Annotated[int, Depends(seen_version)]
SeenTag = Annotated[EntityTag, Depends(seen)]
MaybeSeenTag = Annotated[EntityTag, Depends(maybe_seen)]
Blobs = Annotated[BlobStore, depend_on_server("blobs")]
Database = Annotated[Engine, depend_on_server("engine")]
ServerFigureCache = Annotated[FigureCache, depend_on_server("figure_cache")]
OwnKey = Annotated[SigningKey, depend_on_server("own_key")]
SecretKeeper = Annotated[SecretBox, depend_on_server("secret_box")]
ServerPolicy = Annotated[Policy, depend_on_server("policy")]
PasswordChecks = Annotated[PasswordWorker, depend_on_server("passwords")]
ServerFactorRules = Annotated[FactorRules, depend_on_server("factor_rules")]
ServerSettings = Annotated[Settings, depend_on_server("settings")]
DryRunSources = Annotated[ForecastSources, depend_on_server("forecast_sources")]
Stars = Annotated[Callable[[], Catalogue], depend_on_server("catalogue")]
Cookie = Annotated[LogInCookie, depend_on_server("log_in_cookie")]
Workers = Annotated[WorkerControl | None, depend_on_server("workers")]
