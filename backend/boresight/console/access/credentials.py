"""Authentication: the credential of a request looked up in the store, and its proof for the response cache.

The log-in cookie: a signed value that holds the secret of a session and its CSRF token.

The value is `[token, csrf]` signed with the installation's secret key, so it can be read by its holder and altered by nobody.
Whether the session still holds is the store's to say (`boresight.console.access.sessions`), with every request. HttpOnly keeps the
cookie
from scripts, SameSite=Lax from other sites' forms; the CSRF token must come back in every unsafe request that it authenticates.
"""

from __future__ import annotations

import math
import os
import secrets
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TypeVar

from itsdangerous import BadData, SignatureExpired, URLSafeTimedSerializer
from markupsafe import escape
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope

from boresight.console.access import api_keys, sessions, users
from boresight.console.access.queries import CredentialRows
from boresight.errors import BoresightError, PasswordDueError, SessionEndedError, UnauthenticatedError
from boresight.platform.actors import Actor
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import Engine, open_reading
from boresight.platform.web.response_cache import CredentialProof, is_active
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


class LogInCookie:
    """Writes and reads the cookie of one installation."""

    def __init__(self, settings: Settings) -> None:
        self._max_age_s = round(settings.session_hours * 3600)
        self._secure = bool(settings.secure_cookies)
        self.name = SECURE_PREFIX + SESSION_COOKIE if self._secure else SESSION_COOKIE
        self._serializer = URLSafeTimedSerializer(read_secret(settings.data_folder), salt=SESSION_COOKIE)

    def write(self, response: Response, token: str) -> str:
        """Give the browser a session; returns its CSRF token, which no earlier one had."""
        csrf_token = secrets.token_urlsafe(24)
        value = self._serializer.dumps([token, csrf_token])
        response.set_cookie(
            self.name,
            value if isinstance(value, str) else value.decode(),
            max_age=self._max_age_s,
            path="/",
            secure=self._secure,
            httponly=True,
            samesite="lax",
        )
        return csrf_token

    def clear(self, response: Response) -> None:
        """Take the cookie away from the browser."""
        response.delete_cookie(self.name, path="/", secure=self._secure, httponly=True, samesite="lax")

    def read(self, value: str) -> CookieContent:
        """Return what a cookie says."""
        try:
            said, signed = self._serializer.loads(value, max_age=self._max_age_s, return_timestamp=True)
            token, csrf_token = said
        except SignatureExpired as error:
            raise SessionEndedError("expired") from error
        except (BadData, ValueError, TypeError) as error:
            raise UnauthenticatedError("This log-in is not known here; log in again.") from error
        if not isinstance(token, str) or not isinstance(csrf_token, str):  # a cookie of before log-ins were rows
            raise UnauthenticatedError("This log-in is not known here; log in again.")
        return CookieContent(token, csrf_token, signed.timestamp() + self._max_age_s)


MOST_REMEMBERED = 10_000
T = TypeVar("T")
U = TypeVar("U")
Carried = tuple[tuple[bytes, bytes], ...]

WHILE_PASSWORD_IS_DUE = (
    "/api/v1/sessions",
    "/api/v1/sessions/current",
    "/password",
    "/logout",
)  # what goes until one has set one's own


def bearer(headers: Headers) -> str | None:
    """Return the API key that the request carries, if any."""
    scheme, _, secret = headers.get("authorization", "").partition(" ")
    return secret.strip() if scheme.lower() == "bearer" else None


def current_actor(request: Request) -> Actor:
    """Return who acts: the owner of the API key if one is given, else the person whose log-in cookie it is."""
    known = getattr(request.state, "actor", None)
    if known is None:
        known = request.state.actor = replace(_identify(request), request_id=request.state.request_id)
    return known


async def get_actor(request: Request) -> Actor:
    """Return who acts, as `current_actor` does: without a thread where that is known already, or the store answers on the spot."""
    if (known := getattr(request.state, "actor", None)) is not None:
        return known  # type: ignore[no-any-return]  # the request's state is whatever is put there
    return await identify_at_once(request.app.state.engine, current_actor, request)


async def identify_at_once(engine: Engine, read: Callable[[T], U], given: T) -> U:
    """Call what makes a short read of the store: SQLite answers sooner than a thread could be asked."""
    if engine.dialect.name == "sqlite":
        return read(given)
    return await run_in_threadpool(read, given)


@dataclass(frozen=True)
class Identified:
    """Somebody who was identified, and the proof of it."""

    actor: Actor
    csrf_token: str | None
    proof: CredentialProof


class CredentialCache:
    """Who was identified lately by which credentials, byte for byte; known again while the rows behind say the same."""

    def __init__(self, marks: DataVersionReader) -> None:
        self.marks = marks
        self._lock = threading.Lock()
        self._known: OrderedDict[Carried, Identified] = OrderedDict()

    def find(self, scope: Scope, *, active: bool) -> Identified | None:
        """Return who carries these credentials, where that holds still."""
        known = self._known.get(_carried(scope))
        if known is None or not known.proof.unchanged() or not known.proof.holds(active=active):
            return None
        return known

    def keep(self, scope: Scope, known: Identified) -> None:
        """Note who was identified."""
        with self._lock:
            self._known[_carried(scope)] = known
            self._known.move_to_end(_carried(scope))
            if len(self._known) > MOST_REMEMBERED:
                self._known.popitem(last=False)


def _carried(scope: Scope) -> Carried:
    """Return what a request carries that may decide whose it is."""
    return tuple((name, value) for name, value in scope["headers"] if name in {b"authorization", b"cookie"})


def _identify(request: Request, *, active: bool = True) -> Actor:
    """Return whose credentials a request carries: as they were last identified, or by looking them up in the store."""
    active = active and is_active(request.scope)
    memory: CredentialCache = request.app.state.known
    known = memory.find(request.scope, active=active)
    if known is None:
        known, holds_anywhere = _looked_up(request, memory.marks, active=active)
        if not holds_anywhere:
            request.state.csrf_token = known.csrf_token
            return known.actor
        memory.keep(request.scope, known)
    if known.csrf_token is not None:
        request.state.csrf_token = known.csrf_token
    request.state.proof = known.proof
    return known.actor


def _looked_up(request: Request, marks: DataVersionReader, *, active: bool) -> tuple[Identified, bool]:
    """Look up the credential in the store; tells too whether what was found holds for every address."""
    secret = bearer(request.headers)
    if secret is not None:
        with open_reading(request.app.state.engine) as session:
            actor = api_keys.actor_of_key(session, secret)
            rows = CredentialRows.read(session, "key", actor.credential.removeprefix("key:"))
        use = partial(request.app.state.upkeep.used, actor.credential)
        use(active=True)
        return Identified(
            actor, None, CredentialProof(_seconds(actor.until_utc), use, partial(rows.say_so_still, marks))
        ), True
    cookie: LogInCookie = request.app.state.log_in_cookie
    if cookie.name not in request.cookies:
        raise UnauthenticatedError("You are not logged in; log in, or send an API key as a Bearer token.")
    content = cookie.read(request.cookies[cookie.name])
    request.state.csrf_token = content.csrf_token
    with open_reading(request.app.state.engine) as session:
        log_in = sessions.find(session, content.token)
        due = f"/api/v1/users/{log_in.user_id}:change-password"
        sets_password = request.url.path in (*WHILE_PASSWORD_IS_DUE, due)
        actor = users.get_actor(session, log_in.user_id, log_in.id, sets_password=sets_password)
        rows = CredentialRows.read(session, "session", log_in.id)
    used = partial(request.app.state.upkeep.session_used, log_in.id, log_in.last_used_utc)
    if not used(active=active):
        raise SessionEndedError("idle")
    others = tuple(sorted(pair for pair in request.cookies.items() if pair[0] != cookie.name))
    proof = CredentialProof(
        content.ends_s,
        used,
        partial(rows.say_so_still, marks),
        person=(actor.user_id, others),
        roles=(actor.roles, others),
        gaps=(content.csrf_token.encode(), str(escape(actor.printed_name or actor.name)).encode()),
    )
    return Identified(
        actor, content.csrf_token, proof
    ), not sets_password  # what sets one's password proves nothing elsewhere


def _seconds(time_utc: str | None) -> float:
    """Return a time of the store as seconds of the clock; infinity for none."""
    return math.inf if time_utc is None else datetime.fromisoformat(time_utc).timestamp()


def get_proof(scope: Scope) -> CredentialProof | None:
    """Return the proof of a request's credentials, if they were looked up and hold for every address."""
    proof: CredentialProof | None = scope["state"].get("proof")
    return proof


def carries_credentials(scope: Scope, cookie_name: str) -> bool:
    """Whether a request carries anything that could be a credential."""
    cookie = cookie_name.encode() + b"="
    return any(name == b"authorization" or (name == b"cookie" and cookie in value) for name, value in scope["headers"])


def identify(scope: Scope) -> Actor | None:
    """Return who acts; None where the credentials are absent, forged, ended or of somebody whose password is due."""
    try:
        return current_actor(Request(scope))
    except (UnauthenticatedError, PasswordDueError):
        return None


def prove(scope: Scope) -> CredentialProof | None:
    """Look up a request's credentials; None where they do not hold, or not for every address."""
    try:
        current_actor(Request(scope))
    except BoresightError:
        return None
    return get_proof(scope)


def is_still_valid(request: Request) -> bool:
    """Whether the credential of a long request still holds: not logged out everywhere, revoked, expired or disabled."""
    try:
        _identify(request, active=False)
    except UnauthenticatedError:
        return False
    return True
