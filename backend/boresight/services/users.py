"""People: who they are, how they log in, what they may do.

Passwords are kept as argon2id hashes. A name that does not exist costs the same hash as one that does, and too many
failures make a name wait, whether it exists or not, so that an answer does not tell who has an account.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from datetime import UTC, datetime, timedelta

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from boresight.errors import (
    ConflictError,
    NotFoundError,
    RefusedInputError,
    TooManyAttemptsError,
    UnauthenticatedError,
)
from boresight.services import audit
from boresight.services.actors import Actor, refuse_key, require_person, require_role
from boresight.services.roles import known_roles
from boresight.services.words import refuse_control_characters
from boresight.store import users as rows
from boresight.store.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.store.tables import LoginFailure, User

MINIMUM_PASSWORD_LENGTH = 12
MAXIMUM_PASSWORD_LENGTH = 256  # a longer one only costs time
LOGIN_ATTEMPTS_PER_MINUTE = 5
FAILURE_COUNTS_S = 60.0
LOGIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")

_HASHER = PasswordHasher()
_UNKNOWN = _HASHER.hash("nobody has this password")


def create_user(
    session: Session, actor: Actor, *, name: str, printed_name: str, password: str, roles: Collection[str]
) -> User:
    """Add a person.

    Raises
    ------
    ForbiddenError
        When the actor is not an administrator.
    RefusedInputError
        When name, password or roles cannot be used.
    ConflictError
        When the name is taken.
    """
    _require_administrator(actor)
    name = name.strip()
    if not LOGIN_NAME.fullmatch(name):
        raise RefusedInputError(f"{name!r} is no log-in name: use 1 to 64 letters, digits and . _ @ -.")
    refuse_control_characters(printed_name=printed_name)
    if rows.user_named(session, name) is not None:
        raise ConflictError(f"There is a user {name!r} already; choose another log-in name.")
    user = User(
        name=name,
        printed_name=printed_name.strip() or name,
        password_hash=hash_password(name, password),
        roles=known_roles(roles),
        created_utc=utc_now(),
    )
    session.add(user)
    session.flush()
    audit.append(session, actor, "created", _subject(user), None, {"name": name, "roles": user.roles})
    return user


def hash_password(name: str, password: str) -> str:
    """Return the argon2id hash of a password that may be used.

    Raises
    ------
    RefusedInputError
        When the password is too short, too long, or is made from the name or one character.
    """
    if len(password) < MINIMUM_PASSWORD_LENGTH:
        raise RefusedInputError(f"The password has {len(password)} characters; use at least {MINIMUM_PASSWORD_LENGTH}.")
    if len(password) > MAXIMUM_PASSWORD_LENGTH:
        raise RefusedInputError(f"The password is over {MAXIMUM_PASSWORD_LENGTH} characters; use a shorter one.")
    if len(set(password)) == 1 or password.lower().replace(name.lower(), "") == "":
        raise RefusedInputError("The password repeats one character or the log-in name; use another one.")
    return _HASHER.hash(password)


def authenticate(
    session: Session,
    name: str,
    password: str,
    *,
    attempts_per_minute: int = LOGIN_ATTEMPTS_PER_MINUTE,
    request_id: str | None = None,
) -> Actor:
    """Return the person with this name and password. Needs a writing transaction, for failures are counted.

    Raises
    ------
    UnauthenticatedError
        When name and password do not fit, or the person is disabled.
    TooManyAttemptsError
        When there were too many failures within a minute.
    """
    user = rows.user_named(session, name.strip())
    _check_password(session, name.strip(), user, password, attempts_per_minute)
    if user is None or user.disabled_utc is not None:
        raise UnauthenticatedError("Name and password do not fit; try again or ask an administrator.")
    return _actor(user, request_id)


def _check_password(session: Session, name: str, user: User | None, password: str, attempts_per_minute: int) -> None:
    """Refuse a wrong password, after as much work as a right one costs, and count the failure."""
    _refuse_too_many(rows.failures_since(session, name, utc_after(-FAILURE_COUNTS_S)), attempts_per_minute)
    if _fits(user.password_hash if user else _UNKNOWN, password) and user is not None:
        return
    rows.forget_failures(session, before_utc=utc_after(-3600.0))
    session.add(LoginFailure(name=name, at_utc=utc_now()))
    keep_despite_refusal(session)
    raise UnauthenticatedError("Name and password do not fit; try again or ask an administrator.")


def _refuse_too_many(failed_utc: Sequence[str], attempts_per_minute: int) -> None:
    """Refuse while so many failures count, the newest first, until so few do that another attempt is allowed."""
    if len(failed_utc) < attempts_per_minute:
        return
    last_to_lapse = failed_utc[attempts_per_minute - 1] if attempts_per_minute else utc_now()
    lapsed = datetime.fromisoformat(last_to_lapse) + timedelta(seconds=FAILURE_COUNTS_S)
    wait_s = math.ceil((lapsed - datetime.now(UTC)).total_seconds())
    raise TooManyAttemptsError("Too many failed log-ins with this name; wait a minute and try again.", max(wait_s, 1))


def _fits(password_hash: str, password: str) -> bool:
    """Whether a password is the one of a hash."""
    try:
        return _HASHER.verify(password_hash, password[: MAXIMUM_PASSWORD_LENGTH + 1])
    except (VerificationError, InvalidHashError):
        return False


def _actor(user: User, request_id: str | None) -> Actor:
    """Let a person act under a log-in."""
    return Actor(user.id, user.name, user.printed_name, frozenset(user.roles), "session", None, request_id)


def session_epoch(session: Session, actor: Actor) -> int:
    """Return the number that a log-in cookie must carry; it changes when all log-ins of a person end."""
    return get_user(session, require_person(actor, "log in")).session_epoch


def actor_of_session(session: Session, user_id: int, epoch: int, request_id: str | None = None) -> Actor:
    """Return the person of a log-in cookie, with the roles held now.

    Raises
    ------
    UnauthenticatedError
        When the person is gone or disabled, or the log-ins of before were ended.
    """
    user = session.get(User, user_id)
    if user is None or user.disabled_utc is not None or user.session_epoch != epoch:
        raise UnauthenticatedError("This log-in has ended; log in again.")
    return _actor(user, request_id)


def verify_password(
    session: Session, actor: Actor, password: str, *, attempts_per_minute: int = LOGIN_ATTEMPTS_PER_MINUTE
) -> None:
    """Make sure that the person at the keyboard is the one who logged in, as a signature needs.

    Raises
    ------
    UnauthenticatedError
        When the password is wrong.
    TooManyAttemptsError
        When there were too many failures within a minute.
    """
    user = get_user(session, require_person(actor, "confirm with a password"))
    _check_password(session, user.name, user, password, attempts_per_minute)


def change_password(session: Session, actor: Actor, user_id: int, password: str, current: str = "") -> User:
    """Set a password: one's own, knowing the current one, or as an administrator another's. Every log-in then ends.

    Raises
    ------
    UnauthenticatedError
        When the current password is wrong: who finds a screen unlocked must not come to sign.
    """
    refuse_key(actor, "set a password")
    user = get_user(session, user_id)
    if actor.user_id == user_id:
        verify_password(session, actor, current)
    else:
        _require_administrator(actor)
    user.password_hash = hash_password(user.name, password)
    user.session_epoch += 1
    audit.append(session, actor, "changed the password of", _subject(user))
    return user


def end_sessions(session: Session, actor: Actor, user_id: int) -> None:
    """End every log-in of a person, one's own or as an administrator another's."""
    refuse_key(actor, "end log-ins")
    user = get_user(session, user_id)
    if actor.user_id != user_id:
        _require_administrator(actor)
    user.session_epoch += 1
    audit.append(session, actor, "ended the log-ins of", _subject(user))


def change_roles(session: Session, actor: Actor, user_id: int, roles: Collection[str]) -> User:
    """Give a person these roles instead of the ones held.

    Raises
    ------
    ConflictError
        When nobody would be administrator any more.
    """
    _require_administrator(actor)
    user = get_user(session, user_id)
    before, after = user.roles, known_roles(roles)
    if "administrator" not in after:
        _keep_an_administrator(session, user)
    user.roles = after
    audit.append(session, actor, "changed the roles of", _subject(user), {"roles": before}, {"roles": after})
    return user


def disable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Keep a person out from now on; what they did stays.

    Raises
    ------
    ConflictError
        When nobody would be administrator any more.
    """
    _require_administrator(actor)
    user = get_user(session, user_id)
    if user.disabled_utc is None:
        _keep_an_administrator(session, user)
        user.disabled_utc = utc_now()
        user.session_epoch += 1
        audit.append(session, actor, "disabled", _subject(user), {"disabled": False}, {"disabled": True})
    return user


def enable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Let a disabled person in again."""
    _require_administrator(actor)
    user = get_user(session, user_id)
    if user.disabled_utc is not None:
        user.disabled_utc = None
        audit.append(session, actor, "enabled", _subject(user), {"disabled": True}, {"disabled": False})
    return user


def get_user(session: Session, user_id: int) -> User:
    """Return a person.

    Raises
    ------
    NotFoundError
        When there is none with this number.
    """
    user = session.get(User, user_id)
    if user is None:
        raise NotFoundError(f"There is no user {user_id}.")
    return user


def list_users(session: Session) -> Sequence[User]:
    """Return everyone, by log-in name."""
    return rows.users(session)


def _require_administrator(actor: Actor) -> None:
    """Refuse keys too: one that gave roles or passwords could make itself a person who signs."""
    refuse_key(actor, "manage people")
    require_role(actor, "administrator")


def _keep_an_administrator(session: Session, leaving: User) -> None:
    """Refuse to leave the installation without an administrator."""
    others = (user for user in rows.users(session) if user.id != leaving.id and user.disabled_utc is None)
    if "administrator" in leaving.roles and not any("administrator" in user.roles for user in others):
        raise ConflictError(f"{leaving.printed_name} is the only administrator; make another one first.")


def _subject(user: User) -> str:
    """Name a person as the audit log does."""
    return f"users/{user.id}"
