"""Authentication: who asks, by the API key or the log-in cookie that a request carries, looked up in the store.

The layer `Authentication` stands in front of cache, queue and endpoints. What it found is remembered under exactly
these credentials until they expire, as long as nothing was committed or the rows behind them are unchanged: a key
that is revoked or a person who is disabled is out with the next request. The cookie is the signed pair `[token, csrf]`;
the CSRF token must come back in every unsafe request that the cookie authenticates.
"""

from __future__ import annotations

import math
import os
import secrets
import tempfile
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from itsdangerous import BadData, SignatureExpired, URLSafeTimedSerializer
from markupsafe import escape
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from boresight.console.access import api_keys, preferences, sessions, users
from boresight.console.access.queries import CredentialRows
from boresight.errors import (
    BoresightError,
    FactorEnrolmentDueError,
    PasswordDueError,
    SessionEndedError,
    UnauthenticatedError,
)
from boresight.platform.actors import Actor
from boresight.platform.audit.security_log import tell_actor, tell_once
from boresight.platform.db.data_version import DataVersion, DataVersionReader
from boresight.platform.db.sessions import Engine, open_reading
from boresight.platform.db.times import STYLE, TimeStyle
from boresight.platform.web.concurrency_limit import Refuse
from boresight.platform.web.middleware import FOR_MACHINES
from boresight.platform.web.response_cache import DATA_VERSION, SHARING, Sharing
from boresight.settings import Settings

SESSION_COOKIE = "boresight_session"
SECURE_PREFIX = "__Host-"  # browsers then take the cookie from this host alone, over HTTPS alone, for every path
SECRET_FILE = "secret.key"  # noqa: S105 - the name of a file
SECRET_BYTES = 32


@dataclass(frozen=True)
class CookieContent:
    """What the cookie says: the secret of the session, the token that unsafe requests repeat, and its end by the clock."""

    token: str
    csrf_token: str
    ends_s: float


def read_secret(folder: Path) -> bytes:
    """Return the secret key of this installation, made on first use and readable by its owner only.

    The file appears under its name complete or not at all, and an existing one is never replaced: two servers that
    start at once on one folder end with the same key.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / SECRET_FILE
    if not place.exists():
        handle, written = tempfile.mkstemp(prefix=".secret-", dir=folder)  # 0600 from the start
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(secrets.token_bytes(SECRET_BYTES))
            os.link(written, place)
        except FileExistsError:
            pass  # the other server was first: its key is the key
        finally:
            Path(written).unlink()
    return place.read_bytes()


class SignedCookie:
    """A cookie that this installation signs, out of reach of scripts."""

    def __init__(self, serializer: URLSafeTimedSerializer, name: str, longest_s: float, *, is_secure: bool) -> None:
        self._serializer, self._salt = serializer, name
        self._max_age_s, self._secure = round(longest_s), is_secure
        self.name = SECURE_PREFIX + name if is_secure else name

    def write_content(self, response: Response, content: list[str]) -> None:
        """Set it."""
        value = self._serializer.dumps(content, salt=self._salt)
        response.set_cookie(
            self.name,
            value if isinstance(value, str) else value.decode(),
            max_age=self._max_age_s,
            path="/",
            secure=self._secure,
            httponly=True,
            samesite="lax",
        )

    def read_content(self, value: str) -> tuple[Any, datetime]:
        """Return what a value says and when it was signed; raises BadData, ValueError or TypeError of one that is not ours."""
        content, signed = self._serializer.loads(value, max_age=self._max_age_s, return_timestamp=True, salt=self._salt)
        return content, signed

    def clear(self, response: Response) -> None:
        """Take it away from the browser."""
        response.delete_cookie(self.name, path="/", secure=self._secure, httponly=True, samesite="lax")


class LogInCookie(SignedCookie):
    """Writes and reads the log-in cookie of one installation."""

    def __init__(self, settings: Settings) -> None:
        serializer = URLSafeTimedSerializer(read_secret(settings.data_folder), salt=SESSION_COOKIE)
        hours_s = settings.session_hours * 3600
        super().__init__(serializer, SESSION_COOKIE, hours_s, is_secure=bool(settings.secure_cookies))

    def write(self, response: Response, token: str) -> str:
        """Set the cookie of a new session and return its CSRF token, which is new too."""
        csrf_token = secrets.token_urlsafe(24)
        self.write_content(response, [token, csrf_token])
        return csrf_token

    def write_theme(self, response: Response, theme: str) -> None:
        """Tell the browser which theme its person chose, before it paints a page; of the system's there is nothing to tell."""
        if theme == "system":
            response.delete_cookie(THEME_COOKIE, path="/", secure=self._secure, samesite="lax")
            return
        response.set_cookie(THEME_COOKIE, theme, max_age=THEME_S, path="/", secure=self._secure, samesite="lax")

    def short(self, name: str, longest_s: float) -> ShortCookie:
        """Return a cookie of the same installation for what takes a person some minutes."""
        return ShortCookie(self._serializer, name, longest_s, is_secure=self._secure)

    def read(self, value: str) -> CookieContent:
        """Return what a cookie says."""
        try:
            said, signed = self.read_content(value)
            token, csrf_token = said
        except SignatureExpired as error:
            raise SessionEndedError("expired") from error
        except (BadData, ValueError, TypeError) as error:
            raise UnauthenticatedError("This log-in is not known to this server; log in again.") from error
        if not isinstance(token, str) or not isinstance(csrf_token, str):  # an old version's cookie
            raise UnauthenticatedError("This log-in is not known to this server; log in again.")
        return CookieContent(token, csrf_token, signed.timestamp() + self._max_age_s)


class ShortCookie(SignedCookie):
    """A signed cookie of some minutes: what a log-in waits with before it is one."""

    def write(self, response: Response, content: list[str]) -> None:
        """Set it."""
        self.write_content(response, content)

    def read(self, request: Request) -> list[str] | None:
        """Return what it says; None where there is none that counts."""
        try:
            content, _ = self.read_content(request.cookies.get(self.name, ""))
        except (BadData, ValueError, TypeError):
            return None
        is_ours = isinstance(content, list) and all(isinstance(one, str) for one in content)
        return content if is_ours else None


MOST_REMEMBERED = 10_000
THEME_COOKIE, THEME_S = "boresight-theme", 365 * 86_400
LISTENING = "/api/v1/events"
TIMES = "times"  # in the state of a request: how its person has times shown
BACKGROUND = (b"x-boresight-background", b"1")  # a page that renews itself says so
WHILE_PASSWORD_IS_DUE = (
    "/api/v1/sessions",
    "/api/v1/sessions/current",
    "/password",
    "/logout",
)  # what remains allowed until a person has set a password of their own
WHILE_FACTOR_IS_DUE = (*WHILE_PASSWORD_IS_DUE, "/second-factor", "/api/v1/second-factors")
ENROLMENT = (
    "/second-factor/",
    "/api/v1/second-factors:",
    "/login/single-sign-on",
)  # what begins so is allowed then too
T = TypeVar("T")
U = TypeVar("U")
Carried = tuple[tuple[bytes, bytes], ...]


class CredentialUse(Protocol):
    """Tells whether credentials are still in use or were idle for too long, and records their use."""

    def __call__(self, *, active: bool) -> bool:
        """Return whether the credentials are still valid; `active` says that a person did something with this request."""


@dataclass(frozen=True)
class Identity:
    """Who was identified by their credentials; `sharing` is None where the identity holds for one address only."""

    actor: Actor
    csrf_token: str | None
    sharing: Sharing | None
    until_s: float
    use: CredentialUse
    rows: CredentialRows
    data_version: DataVersion | None = None  # the data version at which this was read
    times: TimeStyle = STYLE  # how the person has times shown


class CredentialCache:
    """The identities found recently, by the credentials that they were found by."""

    def __init__(self, data_versions: DataVersionReader) -> None:
        self._data_versions = data_versions
        self._lock = threading.Lock()
        self._known: OrderedDict[Carried, Identity] = OrderedDict()

    def find(self, scope: Scope, data_version: DataVersion | None, *, active: bool) -> Identity | None:
        """Return the identity of these credentials if it still holds at this data version."""
        known = self._known.get(carried(scope))
        if known is None or time.time() >= known.until_s or not known.use(active=active):
            return None
        if data_version is None or known.data_version != data_version:
            if not known.rows.say_so_still(self._data_versions):
                return None
            self.keep(scope, replace(known, data_version=data_version))
        return known

    def keep(self, scope: Scope, known: Identity) -> None:
        """Store an identity."""
        with self._lock:
            self._known[carried(scope)] = known
            self._known.move_to_end(carried(scope))
            if len(self._known) > MOST_REMEMBERED:
                self._known.popitem(last=False)


def carried(scope: Scope) -> Carried:
    """Return the credentials that a request carries."""
    return tuple((name, value) for name, value in scope["headers"] if name in {b"authorization", b"cookie"})


def is_active(scope: Scope) -> bool:
    """Whether a person did something; an open page that listens or renews itself does not count."""
    return not scope["path"].startswith(LISTENING) and BACKGROUND not in scope["headers"]


def bearer(headers: Headers) -> str | None:
    """Return the API key that the request carries, if any."""
    scheme, _, secret = headers.get("authorization", "").partition(" ")
    return secret.strip() if scheme.lower() == "bearer" else None


class Authentication:
    """The middleware that identifies who asks; a request without valid credentials goes on without an actor."""

    def __init__(self, app: ASGIApp, refuse: Refuse) -> None:
        self.app = app
        self._refuse = refuse

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in."""
        if scope["type"] == "http" and not scope["path"].startswith(FOR_MACHINES):
            try:
                await authenticate(scope)
            except BoresightError as error:  # of the store
                await self._refuse(Request(scope), error)(scope, receive, send)
                return
        await self.app(scope, receive, send)


async def authenticate(scope: Scope) -> None:
    """Identify who asks, from everything that is committed by now."""
    state, server = scope["state"], scope["app"].state
    state.pop("actor", None)
    state.pop(SHARING, None)
    state.pop(TIMES, None)
    if not carries_credentials(scope, server.log_in_cookie.name):
        return
    state[DATA_VERSION] = await server.data_version_poller.read_now()
    with suppress(
        UnauthenticatedError, PasswordDueError, FactorEnrolmentDueError
    ):  # the endpoint says so, where it asks for somebody
        await get_actor(Request(scope))


def carries_credentials(scope: Scope, cookie_name: str) -> bool:
    """Whether a request carries anything that could be a credential."""
    cookie = cookie_name.encode() + b"="
    return any(name == b"authorization" or (name == b"cookie" and cookie in value) for name, value in scope["headers"])


def current_actor(request: Request) -> Actor:
    """Return who acts: the owner of the API key if one is given, else the person whose log-in cookie it is."""
    return _remembered(request) or _note(request, _look_up(request))


async def get_actor(request: Request) -> Actor:
    """Return who acts, as `current_actor` does, but without a thread where the answer is cached or the store answers at once."""
    if (known := _remembered(request)) is not None:
        return known
    return await read_at_once(request.app.state.engine, current_actor, request)


def _remembered(request: Request) -> Actor | None:
    """Return who acts if that is cached, or can be read in one short query."""
    state = request.scope["state"]
    if "actor" in state:
        return state["actor"]  # type: ignore[no-any-return]  # the request's state is whatever is put there
    memory: CredentialCache = request.app.state.credential_cache
    known = memory.find(request.scope, state.get(DATA_VERSION), active=is_active(request.scope))
    return None if known is None else _note(request, known)


async def read_at_once(engine: Engine, read: Callable[[T], U], given: T) -> U:
    """Call a function that makes a short read of the store; with SQLite directly, which is faster than handing it to a thread."""
    if engine.dialect.name == "sqlite":
        return read(given)
    return await run_in_threadpool(read, given)


def _note(request: Request, known: Identity) -> Actor:
    """Store the actor in the request's state."""
    state = request.scope["state"]
    if known.csrf_token is not None:
        state["csrf_token"] = known.csrf_token
    if known.sharing is not None:
        state[SHARING] = known.sharing
    state[TIMES] = known.times
    actor = known.actor.with_request(state["request_id"])
    state["actor"] = actor
    tell_actor(actor)
    return actor


def _look_up(request: Request) -> Identity:
    known = _identify_key_owner(request) or _identify_log_in_owner(request)
    known = replace(known, data_version=request.scope["state"].get(DATA_VERSION))
    if known.sharing is not None:
        request.app.state.credential_cache.keep(request.scope, known)
    return known


def _identify_key_owner(request: Request) -> Identity | None:
    secret = bearer(request.headers)
    if secret is None:
        return None
    with open_reading(request.app.state.engine) as session:
        try:
            actor = api_keys.find_actor_of_key(session, secret)
        except UnauthenticatedError as error:
            tell_once("authn_token_fail", "failure", reason=str(error))
            raise
        rows = CredentialRows.read(session, "key", actor.key_prefix)
    use = partial(request.app.state.maintenance.used, actor.key_prefix)
    use(active=True)
    until_s = math.inf if actor.until_utc is None else datetime.fromisoformat(actor.until_utc).timestamp()
    own = carried(request.scope)
    return Identity(actor, None, Sharing(own, own), until_s, use, rows)


def _identify_log_in_owner(request: Request) -> Identity:
    cookie: LogInCookie = request.app.state.log_in_cookie
    if cookie.name not in request.cookies:
        raise UnauthenticatedError("You are not logged in; log in, or send an API key as a Bearer token.")
    content = cookie.read(request.cookies[cookie.name])
    request.state.csrf_token = content.csrf_token
    with open_reading(request.app.state.engine) as session:
        log_in = sessions.find(session, content.token)
        due = f"/api/v1/users/{log_in.user_id}:change-password"
        sets_password = request.url.path in (*WHILE_PASSWORD_IS_DUE, due)
        enrols = sets_password or is_for_enrolment(request.url.path)
        rules = None if enrols else request.app.state.factor_rules
        actor = users.get_actor(session, log_in.user_id, log_in.id, sets_password=sets_password, rules=rules)
        rows = CredentialRows.read(session, "session", log_in.id)
        times = preferences.get_time_style(session, log_in.user_id)
    use = partial(request.app.state.maintenance.session_used, log_in.id, log_in.last_used_utc)
    if not use(active=is_active(request.scope)):
        raise SessionEndedError("idle")
    others = tuple(sorted(pair for pair in request.cookies.items() if pair[0] != cookie.name))
    gaps = (content.csrf_token.encode(), str(escape(actor.printed_name or actor.name)).encode())
    sharing = None if enrols else Sharing((actor.user_id, others), (actor.roles, times, others), gaps)
    return Identity(actor, content.csrf_token, sharing, content.ends_s, use, rows, times=times)


def is_for_enrolment(path: str) -> bool:
    """Whether somebody whose roles need a second factor may ask for this before one is enrolled."""
    return path in WHILE_FACTOR_IS_DUE or path.startswith(ENROLMENT)


def get_times(request: Request) -> TimeStyle:
    """Return how the person who asks has times shown; of a key and of nobody, as they are shown until a person chooses."""
    times: TimeStyle = request.scope["state"].get(TIMES, STYLE)
    return times


def is_still_valid(request: Request) -> bool:
    """Whether the credential of a long request still holds: not logged out everywhere, revoked, expired or disabled."""
    if request.app.state.credential_cache.find(request.scope, None, active=False) is not None:
        return True
    try:
        _look_up(request)
    except UnauthenticatedError:
        return False
    return True
