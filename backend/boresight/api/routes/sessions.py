"""Logging in and out, who one is, and the log-ins that one has."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import (
    LoggingIn,
    Reading,
    Who,
    Writing,
    clear_cookie,
    client_of,
    log_in_person,
    never_tried,
)
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.passwords import Passwords
from boresight.services import sessions, users
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.store.tables import LoginSession

router = APIRouter(prefix="/sessions", tags=["sessions"])
STORED = ("id", "user_id", "created_utc", "last_used_utc", "ended_utc", "ended_because", "address", "user_agent")
NEVER_TRIED = [Depends(never_tried)]


class Credentials(BaseModel):
    """A log-in name and its password."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(examples=["ana"])
    password: SecretStr


async def proven(credentials: Credentials, request: Request) -> PasswordProof:
    """Check name and password before any transaction begins."""
    checks: Passwords = request.app.state.passwords
    password = credentials.password.get_secret_value()
    return await checks.check_log_in(credentials.name, password, client_of(request))


def _shown(actor: Actor, csrf_token: str | None, *, must_change_password: bool) -> Response:
    body = {
        "user_id": actor.user_id,
        "name": actor.name,
        "printed_name": actor.printed_name,
        "roles": sorted(actor.roles),
        "credential": actor.credential,
        "scopes": None if actor.scopes is None else sorted(actor.scopes),
        "must_change_password": must_change_password,
        "csrf_token": csrf_token,
    }
    return json_response(body, headers={"Cache-Control": "no-store"})


@router.post(
    "",
    name="log_in",
    summary="Log in",
    status_code=201,
    response_model=schemas.Session,
    responses=refusals(429),
    dependencies=NEVER_TRIED,
)
def log_in(proof: Annotated[PasswordProof, Depends(proven)], session: LoggingIn, request: Request) -> Response:
    """Log in: sets the cookie and returns the token for `X-CSRF-Token`. Failures make further tries from there wait."""
    carrier = Response()
    actor, csrf_token = log_in_person(request, carrier, session, proof)
    response = _shown(actor, csrf_token, must_change_password=users.must_change_password(session, actor))
    response.status_code = 201
    response.headers["Set-Cookie"] = carrier.headers["Set-Cookie"]
    return response


@router.get(
    "/current",
    name="get_session",
    summary="Who am I",
    response_model=schemas.Session,
    dependencies=NEVER_TRIED,
)
def get_session(actor: Who, session: Reading, request: Request) -> Response:
    """Say who acts, with which roles and scopes, and give the CSRF token again."""
    due = not actor.is_key and users.must_change_password(session, actor)
    return _shown(actor, getattr(request.state, "csrf_token", None), must_change_password=due)


@router.delete("/current", name="log_out", summary="Log out", status_code=204, dependencies=NEVER_TRIED)
def log_out(actor: Who, request: Request, session: LoggingIn) -> Response:
    """End this log-in, wherever its cookie was copied to; `users/{id}:end-sessions` ends every one."""
    sessions.log_out(session, actor)
    response = Response(status_code=204)
    clear_cookie(request, response)
    return response


@router.get("", name="list_sessions", summary="List log-ins", response_model=Page[schemas.LoginSession])
def list_sessions(
    actor: Who,
    session: Reading,
    request: Request,
    page: Paged,
    user_id: Annotated[Id | None, Query(description="Whose; one's own when left out. Administrators only.")] = None,
    open: Annotated[bool | None, Query(description="Only those that are open, or only those that ended.")] = None,  # noqa: A002 - the name in the address
) -> Response:
    """List one's log-ins, newest first, with where they were made and why they ended."""
    found = sessions.list_sessions(session, actor, user_id, is_open=open, before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, lambda row: _written(request, actor, row)))


@router.post(
    "/current:end-others", name="end_other_sessions", summary="End all others", response_model=schemas.EndedSessions
)
def end_other_sessions(actor: Who, once: Idempotent, session: Writing) -> Response:
    """End every log-in of one's own but this one."""
    return once.answer(session, actor, lambda: Answer({"ended": sessions.end_other_sessions(session, actor)}))


@router.post(
    "/{session_id}:end",
    name="end_session",
    summary="End a log-in",
    response_model=schemas.LoginSession,
    responses=refusals(404),
)
def end_session(session_id: Id, actor: Who, once: Idempotent, request: Request, session: Writing) -> Response:
    """End one log-in: one's own, or as an administrator another's."""

    def act() -> Answer:
        return Answer(_written(request, actor, sessions.end_session(session, actor, session_id)))

    return once.answer(session, actor, act)


def _written(request: Request, actor: Actor, row: LoginSession) -> dict[str, Any]:
    """Lay out a log-in, with when it ends at the latest."""
    limits = request.app.state.settings.session_limits
    own = {name: getattr(row, name) for name in STORED}
    more = {"ends_utc": limits.ends_utc(row.created_utc), "current": row.id == actor.session_id}
    return schemas.LoginSession(**own, **more).model_dump(mode="json")
