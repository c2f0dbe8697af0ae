"""Whose a request is: the credential that it carries, looked up in the store, and the proof of it for answers that stand ready."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime
from functools import partial

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import Scope

from boresight.api.cookies import LogInCookie
from boresight.api.ready import Proof, is_active
from boresight.errors import BoresightError, PasswordDueError, SessionEndedError, UnauthenticatedError
from boresight.services import api_keys, sessions, users
from boresight.services.actors import Actor
from boresight.store.sessions import reading

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
    """Return who acts: the owner of the API key if one is given, else the person whose log-in cookie it is.

    Raises
    ------
    UnauthenticatedError
        When nobody is logged in, the log-in has ended, or the key is not valid.
    PasswordDueError
        When the person must set a password of their own first.
    """
    known = getattr(request.state, "actor", None)
    if known is None:
        known = request.state.actor = replace(_identify(request), request_id=request.state.request_id)
    return known


def _identify(request: Request, *, active: bool = True) -> Actor:
    """Look up the credential in the store."""
    secret = bearer(request.headers)
    if secret is not None:
        with reading(request.app.state.engine) as session:
            actor = api_keys.actor_of_key(session, secret)
        use = partial(request.app.state.upkeep.used, actor.credential)
        use(active=True)
        request.state.proof = Proof(_seconds(actor.until_utc), use)
        return actor
    cookie: LogInCookie = request.app.state.log_in_cookie
    if cookie.name not in request.cookies:
        raise UnauthenticatedError("You are not logged in; log in, or send an API key as a Bearer token.")
    content = cookie.read(request.cookies[cookie.name])
    request.state.csrf_token = content.csrf_token
    with reading(request.app.state.engine) as session:
        log_in = sessions.find(session, content.token)
        due = f"/api/v1/users/{log_in.user_id}:change-password"
        sets_password = request.url.path in (*WHILE_PASSWORD_IS_DUE, due)
        actor = users.actor_of(session, log_in.user_id, log_in.id, sets_password=sets_password)
    used = partial(request.app.state.upkeep.session_used, log_in.id, log_in.last_used_utc)
    if not used(active=active and is_active(request.scope)):
        raise SessionEndedError("idle")
    if not sets_password:  # what goes until one has set one's own password proves nothing for other addresses
        request.state.proof = Proof(content.ends_s, used)
    return actor


def _seconds(time_utc: str | None) -> float:
    """Return a time of the store as seconds of the clock; infinity for none."""
    return math.inf if time_utc is None else datetime.fromisoformat(time_utc).timestamp()


def proof_of(scope: Scope) -> Proof | None:
    """Return the proof of a request's credentials, if they were looked up and hold for every address."""
    proof: Proof | None = scope["state"].get("proof")
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


def prove(scope: Scope) -> Proof | None:
    """Look up a request's credentials; None where they do not hold, or not for every address."""
    try:
        current_actor(Request(scope))
    except BoresightError:
        return None
    return proof_of(scope)


def still_known(request: Request) -> bool:
    """Whether the credential of a long request still holds: not logged out everywhere, revoked, expired or disabled."""
    try:
        _identify(request, active=False)
    except UnauthenticatedError:
        return False
    return True
