"""People: add, give roles, keep out, let in, set passwords, end log-ins."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.requests import Request

from boresight.api import schemas
from boresight.api.dependencies import MaybeSeenTag, PasswordChecks, Reading, Seen, SeenTag, Who, Writing, client_of
from boresight.api.numbers import Id
from boresight.api.openapi import refuses
from boresight.api.operation import operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import users
from boresight.services.passwords import NewPassword, PasswordProof
from boresight.store.sessions import Session
from boresight.store.tables import User

router = operations("/users", tags=["users"])


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


def _require_seen(session: Session, user_id: int, seen: Seen) -> None:
    """Refuse a change by someone who did not see the person's roles and state as they are."""
    row = users.get_user(session, user_id)
    seen.require(schemas.User, row, row.printed_name)


async def prepared_person(person: NewUser, actor: Who, passwords: PasswordChecks) -> NewPassword:
    """Hash the password before any transaction begins; of who may not add people nothing is worked on."""
    if "administrator" not in actor.roles or actor.is_key:
        return NewPassword(refusal="Only an administrator adds people.")
    return await passwords.prepare(person.password.get_secret_value(), person.name, person.printed_name)


@refuses(429)
async def prepared_change(
    user_id: Id, given: Password, actor: Who, passwords: PasswordChecks, request: Request
) -> tuple[NewPassword, PasswordProof]:
    """Check the current password and hash the new one before any transaction begins."""
    new, current = given.password.get_secret_value(), given.current.get_secret_value()
    return await passwords.prepare_change(actor, user_id, new, current, client_of(request))


@router.get("", summary="List people", response_model=Page[schemas.User])
def list_users(session: Reading, page: Paged) -> Listing[User]:
    """List everyone by log-in name."""
    return page.cut_whole(users.list_users(session))


@router.post("", summary="Add a person", status_code=201, response_model=schemas.User)
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
    return users.get_user(session, user_id)


@router.post("/{user_id}:change-roles", summary="Change roles", response_model=schemas.User)
def change_roles(user_id: Id, given: Roles, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Give a person these roles instead of those held; administrators only."""
    _require_seen(session, user_id, seen)
    return users.change_roles(session, actor, user_id, given.roles)


@router.post("/{user_id}:disable", summary="Keep a person out", response_model=schemas.User)
def disable_user(user_id: Id, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Keep a person out and end every log-in; what they did stays."""
    _require_seen(session, user_id, seen)
    return users.disable_user(session, actor, user_id)


@router.post("/{user_id}:enable", summary="Let a person in again", response_model=schemas.User)
def enable_user(user_id: Id, actor: Who, seen: SeenTag, session: Writing) -> User:
    """Let a disabled person in again."""
    _require_seen(session, user_id, seen)
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

    Who is given a password by an administrator must set their own before anything else.
    """
    _require_seen(session, user_id, seen)
    return users.change_password(session, actor, user_id, *prepared)


@router.post("/{user_id}:end-sessions", summary="End every log-in", status_code=204)
def end_sessions(user_id: Id, actor: Who, seen: MaybeSeenTag, session: Writing) -> None:
    """End every log-in of a person: one's own, or as an administrator another's."""
    _require_seen(session, user_id, seen)
    users.end_sessions(session, actor, user_id)
