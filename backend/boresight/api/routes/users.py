"""People: add, give roles, keep out, let in, set passwords, end log-ins."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import MaybeSeenTag, Reading, SeenTag, Who, Writing, client_of, require_tag, tag_of
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.passwords import Passwords
from boresight.services import users
from boresight.services.passwords import NewPassword, PasswordProof
from boresight.store.sessions import Session

router = APIRouter(prefix="/users", tags=["users"])


class NewUser(BaseModel):
    """A person to be added."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(description="Log-in name.", examples=["ana"])
    printed_name: str = Field(description="As signatures and the audit log show it.", examples=["Ana Lima"])
    password: SecretStr
    roles: list[str] = Field(examples=[["analyst"]])
    must_change_password: bool = Field(
        False, description="Whether they set a password of their own at the first log-in."
    )


class Roles(BaseModel):
    """The roles that a person has from now on."""

    model_config = ConfigDict(extra="forbid")
    roles: list[str]


class Password(BaseModel):
    """A new password, and for one's own the current one."""

    model_config = ConfigDict(extra="forbid")
    password: SecretStr
    current: SecretStr = SecretStr("")


def _answer(row: Any, status: int = 200, **headers: str) -> Answer:
    return Answer(schemas.written(schemas.User, row), status, {"ETag": _tag(row), **headers})


def _tag(row: Any) -> str:
    return tag_of(row.id, row.roles, row.disabled_utc, row.session_epoch, row.must_change_password)


def _require_seen(session: Session, user_id: int, seen: str | None) -> None:
    """Refuse a change by someone who did not see the person's roles and state as they are."""
    row = users.get_user(session, user_id)
    if seen is not None:
        require_tag(seen, _tag(row), row.printed_name)


async def prepared_person(person: NewUser, actor: Who, request: Request) -> tuple[NewUser, NewPassword]:
    """Hash the password before any transaction begins; of who may not add people nothing is worked on."""
    if "administrator" not in actor.roles or actor.is_key:
        return person, NewPassword(refusal="Only an administrator adds people.")
    checks: Passwords = request.app.state.passwords
    return person, await checks.prepare(person.password.get_secret_value(), person.name, person.printed_name)


async def prepared_change(
    user_id: Id, given: Password, actor: Who, request: Request
) -> tuple[NewPassword, PasswordProof]:
    """Check the current password and hash the new one before any transaction begins."""
    checks: Passwords = request.app.state.passwords
    words = (given.password.get_secret_value(), given.current.get_secret_value())
    return await checks.prepare_change(actor, user_id, *words, client_of(request))


@router.get("", name="list_users", summary="List people", response_model=Page[schemas.User])
def list_users(actor: Who, session: Reading, page: Paged) -> Response:  # noqa: ARG001 - whoever is known may read
    """List everyone by log-in name."""
    return json_response(page.cut_whole(users.list_users(session), lambda row: schemas.written(schemas.User, row)))


@router.post(
    "",
    name="create_user",
    summary="Add a person",
    status_code=201,
    response_model=schemas.User,
    responses=refusals(409),
)
def create_user(
    actor: Who,
    prepared: Annotated[tuple[NewUser, NewPassword], Depends(prepared_person)],
    once: Idempotent,
    session: Writing,
) -> Response:
    """Add a person; administrators only."""
    person, password = prepared

    def act() -> Answer:
        row = users.create_user(
            session,
            actor,
            name=person.name,
            printed_name=person.printed_name,
            password=password,
            roles=person.roles,
            must_change_password=person.must_change_password,
        )
        return _answer(row, 201, Location=f"/api/v1/users/{row.id}")

    return once.answer(session, actor, act)


@router.get(
    "/{user_id}", name="get_user", summary="Read a person", response_model=schemas.User, responses=refusals(404)
)
def get_user(user_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a person."""
    return _answer(users.get_user(session, user_id)).response()


@router.post(
    "/{user_id}:change-roles",
    name="change_roles",
    summary="Change roles",
    response_model=schemas.User,
    responses=refusals(404, 409, 412, 428),
)
def change_roles(user_id: Id, given: Roles, actor: Who, seen: SeenTag, once: Idempotent, session: Writing) -> Response:
    """Give a person these roles instead of those held; administrators only."""

    def act() -> Answer:
        _require_seen(session, user_id, seen)
        return _answer(users.change_roles(session, actor, user_id, given.roles))

    return once.answer(session, actor, act)


@router.post(
    "/{user_id}:disable",
    name="disable_user",
    summary="Keep a person out",
    response_model=schemas.User,
    responses=refusals(404, 409, 412, 428),
)
def disable_user(user_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing) -> Response:
    """Keep a person out and end every log-in; what they did stays."""

    def act() -> Answer:
        _require_seen(session, user_id, seen)
        return _answer(users.disable_user(session, actor, user_id))

    return once.answer(session, actor, act)


@router.post(
    "/{user_id}:enable",
    name="enable_user",
    summary="Let a person in again",
    response_model=schemas.User,
    responses=refusals(404, 412, 428),
)
def enable_user(user_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing) -> Response:
    """Let a disabled person in again."""

    def act() -> Answer:
        _require_seen(session, user_id, seen)
        return _answer(users.enable_user(session, actor, user_id))

    return once.answer(session, actor, act)


@router.post(
    "/{user_id}:change-password",
    name="change_password",
    summary="Set a password",
    response_model=schemas.User,
    responses=refusals(404, 412, 429),
)
def change_password(
    user_id: Id,
    actor: Who,
    seen: MaybeSeenTag,
    prepared: Annotated[tuple[NewPassword, PasswordProof], Depends(prepared_change)],
    once: Idempotent,
    session: Writing,
) -> Response:
    """Set one's own password, knowing the current one, or as an administrator another's. Every log-in then ends.

    Who is given a password by an administrator must set their own before anything else.
    """

    def act() -> Answer:
        _require_seen(session, user_id, seen)
        return _answer(users.change_password(session, actor, user_id, *prepared))

    return once.answer(session, actor, act)


@router.post(
    "/{user_id}:end-sessions",
    name="end_sessions",
    summary="End every log-in",
    status_code=204,
    responses=refusals(404, 412),
)
def end_sessions(user_id: Id, actor: Who, seen: MaybeSeenTag, once: Idempotent, session: Writing) -> Response:
    """End every log-in of a person: one's own, or as an administrator another's."""

    def act() -> Answer:
        _require_seen(session, user_id, seen)
        users.end_sessions(session, actor, user_id)
        return Answer({}, 204)

    return once.answer(session, actor, act)
