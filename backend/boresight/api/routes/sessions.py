"""Logging in and out, who one is, and the log-ins that one has."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from fastapi import Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.dependencies import (
    LoggingIn,
    PasswordChecks,
    Reading,
    ServerSettings,
    Who,
    Writing,
    clear_cookie,
    client_of,
    log_in_person,
    never_tried,
)
from boresight.api.numbers import Id
from boresight.api.openapi import refuses
from boresight.api.operation import Answer, Beside, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import sessions, users
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.settings import Settings
from boresight.store.sessions import Session
from boresight.store.tables import LoginSession

router = operations("/sessions", tags=["sessions"])
entrance = operations("/sessions", tags=["sessions"], open_to_all=True)
NEVER_TRIED = [Depends(never_tried)]


class Credentials(BaseModel):
    """A log-in name and its password."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(examples=["ana"])
    password: SecretStr


@refuses(429)
async def proven(credentials: Credentials, passwords: PasswordChecks, request: Request) -> PasswordProof:
    """Check name and password before any transaction begins."""
    password = credentials.password.get_secret_value()
    return await passwords.check_log_in(credentials.name, password, client_of(request))


def _who(session: Session, actor: Actor, csrf_token: str | None) -> Answer:
    """Say who acts."""
    body = {
        "user_id": actor.user_id,
        "name": actor.name,
        "printed_name": actor.printed_name,
        "roles": sorted(actor.roles),
        "credential": actor.credential,
        "scopes": None if actor.scopes is None else sorted(actor.scopes),
        "must_change_password": not actor.is_key and users.must_change_password(session, actor),
        "csrf_token": csrf_token,
    }
    return Answer(body, headers={"Cache-Control": "no-store"})


@entrance.post("", summary="Log in", status_code=201, response_model=schemas.Session, dependencies=NEVER_TRIED)
def log_in(proof: Annotated[PasswordProof, Depends(proven)], session: LoggingIn, request: Request) -> Answer:
    """Log in: sets the cookie and returns the token for `X-CSRF-Token`. Failures make further tries from there wait."""
    carrier = Response()
    answer = _who(session, *log_in_person(request, carrier, session, proof))
    return replace(answer, headers={**answer.headers, "Set-Cookie": carrier.headers["Set-Cookie"]})


@router.get("/current", summary="Who am I", response_model=schemas.Session, dependencies=NEVER_TRIED)
def get_session(actor: Who, session: Reading, request: Request) -> Answer:
    """Say who acts, with which roles and scopes, and give the CSRF token again."""
    return _who(session, actor, getattr(request.state, "csrf_token", None))


@router.delete("/current", summary="Log out", status_code=204, dependencies=NEVER_TRIED)
def log_out(actor: Who, request: Request, session: LoggingIn) -> Response:
    """End this log-in, wherever its cookie was copied to; `users/{id}:end-sessions` ends every one."""
    sessions.log_out(session, actor)
    response = Response(status_code=204)
    clear_cookie(request, response)
    return response


@router.get("", summary="List log-ins", response_model=Page[schemas.LoginSession])
def list_sessions(
    actor: Who,
    session: Reading,
    settings: ServerSettings,
    page: Paged,
    user_id: Annotated[Id | None, Query(description="Whose; one's own when left out. Administrators only.")] = None,
    open: Annotated[bool | None, Query(description="Only those that are open, or only those that ended.")] = None,  # noqa: A002 - the name in the address
) -> Listing[LoginSession]:
    """List one's log-ins, newest first, with where they were made and why they ended."""
    found = sessions.list_sessions(session, actor, user_id, is_open=open, before_id=page.last_id, limit=page.limit + 1)
    return page.cut(found, lambda row: _shown(row, actor, settings))


@router.post("/current:end-others", summary="End all others", response_model=schemas.EndedSessions)
def end_other_sessions(actor: Who, session: Writing) -> dict[str, int]:
    """End every log-in of one's own but this one."""
    return {"ended": sessions.end_other_sessions(session, actor)}


@router.post("/{session_id}:end", summary="End a log-in", response_model=schemas.LoginSession)
def end_session(session_id: Id, actor: Who, settings: ServerSettings, session: Writing) -> Beside:
    """End one log-in: one's own, or as an administrator another's."""
    return _shown(sessions.end_session(session, actor, session_id), actor, settings)


def _shown(row: LoginSession, actor: Actor, settings: Settings) -> Beside:
    """Return a log-in, with when it ends at the latest."""
    ends_utc = settings.session_limits.ends_utc(row.created_utc)
    return Beside(row, ends_utc=ends_utc, current=row.id == actor.session_id)


router.routes.extend(entrance.routes)
