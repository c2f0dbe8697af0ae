"""People: who they are, how they log in, which roles they may hold together.

Who was given a password by somebody else must set their own before anything else, and cannot sign until then.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from boresight.console.access import queries as rows
from boresight.console.access.passwords import (
    CHANGED,
    CREATED,
    NO_PROOF,
    RESET,
    NewPassword,
    PasswordProof,
    require_proof,
)
from boresight.console.access.tables import ROLES, User
from boresight.errors import ConflictError, PasswordDueError, RefusedInputError, SessionEndedError
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor, refuse_key, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import comparison_key, normal_name


def known_roles(roles: Collection[str]) -> list[str]:
    """Return the roles in the table's order, each once."""
    if isinstance(roles, str) or (unknown := sorted(set(roles) - set(ROLES))):
        named = roles if isinstance(roles, str) else ", ".join(unknown)
        raise RefusedInputError(f"There is no role {named}; choose from {', '.join(ROLES)}.")
    if {"administrator", "approver"} <= set(roles):
        raise RefusedInputError("An administrator cannot sign; give the role approver to another person.")
    return [role for role in ROLES if role in roles]


LONGEST_LOGIN_NAME, LONGEST_PRINTED_NAME = 64, 100
LOGIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")


def create_user(
    session: Session,
    actor: Actor,
    *,
    name: str,
    printed_name: str,
    password: NewPassword,
    roles: Collection[str],
    must_change_password: bool = False,
) -> User:
    """Add a person, who with `must_change_password` sets a password of their own at the first log-in."""
    _require_administrator(actor)
    name = normal_name("log-in name", name, LONGEST_LOGIN_NAME)
    if not LOGIN_NAME.fullmatch(name):
        raise RefusedInputError(f"{name!r} is not a log-in name: use 1 to 64 letters, digits and . _ @ -.")
    printed_name = normal_name("printed name", printed_name, LONGEST_PRINTED_NAME) or name
    _refuse_taken(session, name, printed_name)
    user = User(
        name=name,
        printed_name=printed_name,
        password_hash=password.hash(),
        roles=known_roles(roles),
        created_utc=utc_now(),
        must_change_password=int(must_change_password),
        name_key=comparison_key(name),
        printed_key=comparison_key(printed_name),
    )
    session.put(user)
    after = {"name": name, "printed_name": user.printed_name, "roles": user.roles}
    audit.append(session, actor, CREATED, _subject(user), None, after)
    return user


def _refuse_taken(session: Session, name: str, printed_name: str) -> None:
    """Refuse a name that could be mistaken for another person's or for Boresight's own, because signatures show it."""
    ours = {comparison_key(text) for own in (SYSTEM, COMMAND_LINE) for text in (own.name, own.printed_name)}
    if not ours.isdisjoint({comparison_key(name), comparison_key(printed_name)}):
        raise ConflictError(f"{printed_name!r} is reserved for Boresight's own records; choose another name.")
    if (other := rows.find_user(session, name, comparison_key(name))) is not None:
        raise ConflictError(f"The log-in name {other.name!r} exists already; choose another.")
    if (other := rows.find_user_by_printed_name(session, printed_name, comparison_key(printed_name))) is not None:
        raise ConflictError(f"The printed name {other.printed_name!r} belongs to {other.name!r}; choose another.")


def get_person_names(session: Session, user_id: int) -> tuple[str, ...]:
    """Return the names of a person; none where the person does not exist."""
    user = session.get(User, user_id)
    return () if user is None else (user.name, user.printed_name)


def authenticate(session: Session, proof: PasswordProof, request_id: str | None = None) -> Actor:
    """Return the person whose name and password were proven."""
    return _make_actor(require_proof(session, proof), request_id)


def _make_actor(user: User, request_id: str | None = None, session_id: int | None = None) -> Actor:
    roles = frozenset(user.roles)
    return Actor(user.id, user.name, user.printed_name, roles, "session", None, request_id, session_id=session_id)


def get_actor(session: Session, user_id: int, session_id: int | None = None, *, sets_password: bool = False) -> Actor:
    """Return a person as the actor of a log-in, with the roles held now."""
    user = session.get(User, user_id)
    if user is None or user.disabled_utc is not None:
        raise SessionEndedError("disabled")
    if not sets_password:
        _refuse_password_of_another(user)
    return _make_actor(user, session_id=session_id)


def _refuse_password_of_another(user: User) -> None:
    """Refuse a person whose password somebody else knows."""
    if user.must_change_password:
        raise PasswordDueError("Somebody else set your password: set your own first, then continue.")


def must_change_password(session: Session, actor: Actor) -> bool:
    """Whether somebody else set the password of this person."""
    return actor.user_id is not None and bool(session.get_known(User, actor.user_id).must_change_password)


def require_password(session: Session, actor: Actor, proof: PasswordProof) -> None:
    """Require the acting person's password again, as a signature needs."""
    user = session.get_known(User, require_person(actor, "confirm with a password"))
    _refuse_password_of_another(user)
    require_proof(session, proof, user.id)


def change_password(
    session: Session, actor: Actor, user_id: int, password: NewPassword, current: PasswordProof = NO_PROOF
) -> User:
    """Set a password: one's own, knowing the current one, or as an administrator another's, who must set their own at log-in."""
    refuse_key(actor, "set a password")
    user = session.get_known(User, user_id)
    own = actor.user_id == user_id
    if own:
        require_person(actor, "set a password")
        require_proof(session, current, user_id)
    else:
        _require_administrator(actor)
    before = {"must_change_password": bool(user.must_change_password)}
    user.password_hash = password.hash()
    _end_sessions(session, user, "password_changed")
    user.must_change_password = int(not own)
    audit.append(session, actor, CHANGED if own else RESET, _subject(user), before, {"must_change_password": not own})
    return user


def end_sessions(session: Session, actor: Actor, user_id: int) -> None:
    """End every log-in of a person, one's own or as an administrator another's."""
    refuse_key(actor, "end log-ins")
    user = session.get_known(User, user_id)
    own = actor.user_id == user_id
    if not own:
        _require_administrator(actor)
    _end_sessions(session, user, "ended" if own else "ended_by_administrator")
    audit.append(session, actor, "ended the log-ins of", _subject(user))


def _end_sessions(session: Session, user: User, because: str) -> None:
    """End every log-in of a person; the number of times is part of the row that the audit log seals."""
    user.session_epoch += 1
    rows.end_open_log_ins(session, user.id, utc_now(), because)


def change_roles(session: Session, actor: Actor, user_id: int, roles: Collection[str]) -> User:
    """Give a person these roles instead of the ones held. Every log-in then ends."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    before, after = user.roles, known_roles(roles)
    if "administrator" not in after:
        _keep_an_administrator(session, user)
    user.roles = after
    _end_sessions(session, user, "roles_changed")
    audit.append(session, actor, "changed the roles of", _subject(user), {"roles": before}, {"roles": after})
    return user


def disable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Keep a person out from now on; what they did stays."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    if user.disabled_utc is None:
        _keep_an_administrator(session, user)
        user.disabled_utc = utc_now()
        _end_sessions(session, user, "disabled")
        audit.append(session, actor, "disabled", _subject(user), {"disabled": False}, {"disabled": True})
    return user


def enable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Let a disabled person in again."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    if user.disabled_utc is not None:
        user.disabled_utc = None
        audit.append(session, actor, "enabled", _subject(user), {"disabled": True}, {"disabled": False})
    return user


def list_users(session: Session) -> Sequence[User]:
    """Return everyone, by log-in name."""
    return rows.list_users(session)


def list_administrators(session: Session) -> list[str]:
    """Return the printed names of the people who can give roles now."""
    people = list_users(session)
    return [one.printed_name for one in people if "administrator" in one.roles and one.disabled_utc is None]


def _require_administrator(actor: Actor) -> None:
    """Require an administrator in person; a key that gave roles or passwords could create a person who signs."""
    refuse_key(actor, "manage people")
    require_role(actor, "administrator")


def _keep_an_administrator(session: Session, leaving: User) -> None:
    """Refuse to leave the installation without an administrator."""
    others = (user for user in rows.list_users(session) if user.id != leaving.id and user.disabled_utc is None)
    if "administrator" in leaving.roles and not any("administrator" in user.roles for user in others):
        raise ConflictError(f"{leaving.printed_name} is the only administrator; make another one first.")


def _subject(user: User) -> str:
    return f"users/{user.id}"
