"""Operations on people, API keys, log-ins and preferences, and logging in and out."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from fastapi import Depends, Query
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.console.access import api_keys, preferences, schemas, sessions, users
from boresight.console.access.dependencies import (
    EntityTag,
    LoggingIn,
    MaybeSeenTag,
    PasswordChecks,
    Reading,
    SeenTag,
    ServerSettings,
    Who,
    Writing,
    clear_cookie,
    factor_field,
    get_client,
    get_site,
    log_in_person,
    refuse_dry_run,
)
from boresight.console.access.passwords import NewPassword, PasswordProof
from boresight.console.access.tables import ApiKey, LoginSession, User
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.schemas import Shape
from boresight.platform.actors import SCOPES, Actor
from boresight.platform.db.sessions import Session
from boresight.platform.web.openapi import refuses
from boresight.platform.web.paging import Id, Listing, Page, Paged
from boresight.settings import Settings

router = operations("/users", tags=["users"])


class NewUser(Shape):
    """A person to be added."""

    name: str = Field(description="Log-in name.", examples=["ana"])
    printed_name: str = Field(description="As signatures and the audit log show it.", examples=["Ana Lima"])
    password: SecretStr
    roles: list[str] = Field(examples=[["analyst"]])
    must_change_password: bool = Field(
        False, description="Whether they must set their own password at the first log-in."
    )


class Roles(Shape):
    """The roles that a person has from now on."""

    roles: list[str]


class Password(Shape):
    """A new password, and for one's own the current one."""

    password: SecretStr
    current: SecretStr = SecretStr("")


def require_seen(session: Session, user_id: int, seen: EntityTag) -> None:
    """Refuse a change by someone who saw older roles or an older state of the person."""
    row = session.get_known(User, user_id)
    seen.require(schemas.User, row, row.printed_name)


async def prepared_person(person: NewUser, actor: Who, passwords: PasswordChecks) -> NewPassword:
    """Hash the password before any transaction begins, only for an actor who may add people."""
    if "administrator" not in actor.roles or actor.is_key:
        return NewPassword(refusal="Only an administrator can add people.")
    return await passwords.prepare(person.password.get_secret_value(), person.name, person.printed_name)


@refuses(429)
async def prepared_change(
    user_id: Id, given: Password, actor: Who, passwords: PasswordChecks, request: Request
) -> tuple[NewPassword, PasswordProof]:
    """Check the current password and hash the new one before any transaction begins."""
    new, current = given.password.get_secret_value(), given.current.get_secret_value()
    return await passwords.prepare_change(actor, user_id, new, current, get_client(request))


@router.get("", summary="List users", response_model=Page[schemas.User])
def list_users(session: Reading, page: Paged) -> Listing[User]:
    """List everyone by log-in name."""
    return page.cut_whole(users.list_users(session))


@router.post("", summary="Add a user", status_code=201, response_model=schemas.User)
def create_user(
    person: NewUser, actor: Who, password: Annotated[NewPassword, Depends(prepared_person)], session: Writing
) -> User:
    """Add a person; administrators only."""
    return users.create_user(
        session,
        actor,
        name=person.name,
        printed_name=person.printed_name,
        password=password,
        roles=person.roles,
        must_change_password=person.must_change_password,
    )


@router.get("/{user_id}", summary="Read a person", response_model=schemas.User)
def get_user(user_id: Id, session: Reading) -> User:
    """Read a person."""
    return session.get_known(User, user_id)


@router.post("/{user_id}:change-roles", summary="Change roles", response_model=schemas.User)
def change_roles(user_id: Id, given: Roles, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Replace the roles of a person; administrators only."""
    require_seen(session, user_id, seen)
    return users.change_roles(session, actor, user_id, given.roles)


@router.post("/{user_id}:disable", summary="Disable a person", response_model=schemas.User)
def disable_user(user_id: Id, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Disable a person and end every log-in; what they did stays on record."""
    require_seen(session, user_id, seen)
    return users.disable_user(session, actor, user_id)


@router.post("/{user_id}:enable", summary="Enable a person", response_model=schemas.User)
def enable_user(user_id: Id, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Enable a disabled person."""
    require_seen(session, user_id, seen)
    return users.enable_user(session, actor, user_id)


@router.post("/{user_id}:change-password", summary="Set a password", response_model=schemas.User)
def change_password(
    user_id: Id,
    actor: Who,
    seen: MaybeSeenTag,
    prepared: Annotated[tuple[NewPassword, PasswordProof], Depends(prepared_change)],
    session: Writing,
) -> User:
    """Set one's own password, knowing the current one, or as an administrator another's. Every log-in then ends.

    A person whose password an administrator set must first set their own.
    """
    require_seen(session, user_id, seen)
    return users.change_password(session, actor, user_id, *prepared)


@router.post("/{user_id}:end-sessions", summary="End every log-in", status_code=204)
def end_sessions(user_id: Id, actor: Who, seen: MaybeSeenTag, session: Writing) -> None:
    """End every log-in of a person: one's own, or as an administrator another's."""
    require_seen(session, user_id, seen)
    users.end_sessions(session, actor, user_id)


api_key_router = operations("/api-keys", tags=["API keys"])


class NewKey(BaseModel):
    """A key to be made for the person who asks."""

    model_config = ConfigDict(extra="forbid")
    label: str = Field(description="The program that uses it.", examples=["nightly downlink"])
    scopes: Annotated[
        list[Annotated[str, Field(json_schema_extra={"enum": list(SCOPES)})]],
        Field(description="What it may write. None: read only."),
    ] = []
    expires_days: int | None = Field(90, description="Null: never.")


@api_key_router.get("", summary="List keys", response_model=Page[schemas.ApiKey])
def list_api_keys(actor: Who, session: Reading, page: Paged) -> Listing[ApiKey]:
    """List one's own keys, newest first; administrators see everyone's."""
    owner = None if "administrator" in actor.roles else actor.user_id
    return page.cut_whole(api_keys.list_keys(session, owner))


@api_key_router.post("", summary="Create a key", status_code=201, response_model=schemas.NewApiKey)
def create_api_key(wanted: NewKey, actor: Who, session: Writing) -> OperationResponse:
    """Create a key. `secret` is in this answer and nowhere else."""
    row, secret = api_keys.create_key(session, actor, **dict(wanted))
    return OperationResponse(
        RowWithFields(row, secret=secret), headers={"Cache-Control": "no-store"}, shown_once=("secret",)
    )


@api_key_router.post("/{key_id}:revoke", summary="Revoke a key", response_model=schemas.ApiKey)
def revoke_api_key(key_id: Id, actor: Who, seen: MaybeSeenTag, session: Writing) -> ApiKey:
    """End a key at once."""
    key = session.get_known(ApiKey, key_id)
    seen.require(schemas.ApiKey, key, f"The API key {key.label!r}")
    return api_keys.revoke_key(session, actor, key_id)


session_router = operations("/sessions", tags=["sessions"])
entrance = operations("/sessions", tags=["sessions"], open_to_all=True)
NO_DRY_RUN = [Depends(refuse_dry_run)]


class Credentials(Shape):
    """A log-in name and its password."""

    name: str = Field(examples=["ana"])
    password: SecretStr
    factor: SecretStr = factor_field()


@refuses(429)
async def proven(credentials: Credentials, passwords: PasswordChecks, request: Request) -> PasswordProof:
    """Check name and password, and a second factor, before any transaction begins."""
    password, factor = credentials.password.get_secret_value(), credentials.factor.get_secret_value()
    return await passwords.check_log_in(credentials.name, password, get_client(request), factor, get_site(request))


def _who(session: Session, actor: Actor, csrf_token: str | None) -> OperationResponse:
    body = RowWithFields(
        actor,
        roles=sorted(actor.roles),
        scopes=None if actor.scopes is None else sorted(actor.scopes),
        must_change_password=not actor.is_key and users.must_change_password(session, actor),
        csrf_token=csrf_token,
    )
    return OperationResponse(body, headers={"Cache-Control": "no-store"})


@entrance.post("", summary="Log in", status_code=201, response_model=schemas.Session, dependencies=NO_DRY_RUN)
def log_in(proof: Annotated[PasswordProof, Depends(proven)], session: LoggingIn, request: Request) -> OperationResponse:
    """Log in: sets the cookie and returns the token for `X-CSRF-Token`. Failures make further tries from there wait.

    Who has a second factor gives it too, a code or a recovery code; a security key logs in on the page `/login` alone.
    """
    carrier = Response()
    answer = _who(session, *log_in_person(request, carrier, session, proof))
    return replace(answer, headers={**answer.headers, "Set-Cookie": carrier.headers["Set-Cookie"]})


@session_router.get("/current", summary="Who am I", response_model=schemas.Session, dependencies=NO_DRY_RUN)
def get_session(actor: Who, session: Reading, request: Request) -> OperationResponse:
    """Say who acts, with which roles and scopes, and give the CSRF token again."""
    return _who(session, actor, getattr(request.state, "csrf_token", None))


@session_router.delete("/current", summary="Log out", status_code=204, dependencies=NO_DRY_RUN)
def log_out(actor: Who, request: Request, session: LoggingIn) -> Response:
    """End this log-in, wherever its cookie was copied to; `users/{id}:end-sessions` ends every one."""
    sessions.log_out(session, actor)
    response = Response(status_code=204)
    clear_cookie(request, response)
    return response


@session_router.get("", summary="List log-ins", response_model=Page[schemas.LoginSession])
def list_sessions(
    actor: Who,
    session: Reading,
    settings: ServerSettings,
    page: Paged,
    user_id: Annotated[
        Id | None, Query(description="User id; your own if omitted. Others: administrators only.")
    ] = None,
    open: Annotated[bool | None, Query(description="Only those that are open, or only those that ended.")] = None,  # noqa: A002 - the name in the address
) -> Listing[LoginSession]:
    """List one's log-ins, newest first, with where they were started and why they ended."""
    found = sessions.list_sessions(session, actor, user_id, is_open=open, **page.rows)
    return page.cut(found, lambda row: make_row(row, actor, settings))


@session_router.post("/current:end-others", summary="End all others", response_model=schemas.EndedSessions)
def end_other_sessions(actor: Who, session: Writing) -> dict[str, int]:
    """End every log-in of one's own but this one."""
    return {"ended": sessions.end_other_sessions(session, actor)}


@session_router.post("/{session_id}:end", summary="End a log-in", response_model=schemas.LoginSession)
def end_session(session_id: Id, actor: Who, settings: ServerSettings, session: Writing) -> RowWithFields:
    """End one log-in: one's own, or as an administrator another's."""
    return make_row(sessions.end_session(session, actor, session_id), actor, settings)


def make_row(row: LoginSession, actor: Actor, settings: Settings) -> RowWithFields:
    """Return a log-in, with when it ends at the latest."""
    ends_utc = settings.session_limits.ends_utc(row.created_utc)
    return RowWithFields(row, ends_utc=ends_utc, current=row.id == actor.session_id)


session_router.routes.extend(entrance.routes)


preference_router = operations("/preferences", tags=["preferences"])


class PreferenceValue(Shape):
    """What a person prefers from now on."""

    value: Any = Field(description="As `GET /preferences` shows it.", examples=[{"form": "iso"}])


@preference_router.get("", summary="Read one's preferences", response_model=dict[str, Any])
def get_preferences(actor: Who, session: Reading) -> dict[str, Any]:
    """Return how one has pages shown, by the name of the preference; `times` has `form` (day_of_year, iso, local) and `zone`."""
    return preferences.get_preferences(session, actor.user_id)


@preference_router.post("/{name}:set", summary="Set a preference", response_model=dict[str, Any])
def set_preference(name: str, given: PreferenceValue, actor: Who, session: Writing) -> dict[str, Any]:
    """Keep what one prefers under a name, and return every preference; people only."""
    preferences.set_preference(session, actor, name, given.value)
    return preferences.get_preferences(session, actor.user_id)
