"""Logging in and out, and who one is."""

from __future__ import annotations

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import json_response
from boresight.api.dependencies import LoggingIn, Reading, Who, log_in_person, log_out_person, never_tried
from boresight.api.openapi import refusals
from boresight.services import users
from boresight.services.actors import Actor

router = APIRouter(prefix="/sessions", tags=["sessions"], dependencies=[Depends(never_tried)])


class Credentials(BaseModel):
    """A log-in name and its password."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(examples=["ana"])
    password: SecretStr


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
    "", name="log_in", summary="Log in", status_code=201, response_model=schemas.Session, responses=refusals(429)
)
def log_in(credentials: Credentials, session: LoggingIn, request: Request) -> Response:
    """Log in: sets the cookie and returns the token for `X-CSRF-Token`. Too many failures make a name wait."""
    carrier = Response()
    password = credentials.password.get_secret_value()
    actor, opened = log_in_person(request, carrier, session, credentials.name, password)
    response = _shown(actor, opened.csrf_token, must_change_password=users.must_change_password(session, actor))
    response.status_code = 201
    response.headers["Set-Cookie"] = carrier.headers["Set-Cookie"]
    return response


@router.get("/current", name="get_session", summary="Who am I", response_model=schemas.Session)
def get_session(actor: Who, session: Reading, request: Request) -> Response:
    """Say who acts, with which roles and scopes, and give the CSRF token again."""
    due = not actor.is_key and users.must_change_password(session, actor)
    return _shown(actor, getattr(request.state, "csrf_token", None), must_change_password=due)


@router.delete("/current", name="log_out", summary="Log out", status_code=204)
def log_out(actor: Who, request: Request) -> Response:  # noqa: ARG001 - only who is logged in can log out
    """Take the log-in away from this browser; `users/{id}:end-sessions` ends every one."""
    response = Response(status_code=204)
    log_out_person(request, response)
    return response
