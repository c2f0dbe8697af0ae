"""People: who they are, how they log in, which roles they may hold together.

Who was given a password by somebody else must set their own before anything else, and cannot sign until then.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence

from boresight.console.access import queries as rows
from boresight.console.access import second_factors
from boresight.console.access.passwords import (
    CHANGED,
    CREATED,
    NO_PROOF,
    RESET,
    NewPassword,
    PasswordProof,
    require_proof,
)
from boresight.console.access.second_factors import FactorRules
from boresight.console.access.tables import ROLES, User
from boresight.errors import (
    ConflictError,
    FactorEnrolmentDueError,
    PasswordDueError,
    RefusedInputError,
    SessionEndedError,
)
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor, refuse_key, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.audit.security_log import note
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import comparison_key, normal_name


def known_roles(roles: Collection[str]) -> list[str]:
    """Return the roles in the table's order, each once."""
    if isinstance(roles, str) or (unknown := sorted(set(roles) - set(ROLES))):
        named = roles if isinstance(roles, str) else ", ".join(unknown)
        raise RefusedInputError(f"There is no role {named}; choose from {', '.join(ROLES)}.")
    if {"administrator", "approver"} <= set(roles):
        raise RefusedInputError(
            "An administrator cannot sign; give the role approver to another person.", code="administrator-cannot-sign"
        )
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
    return _add(session, actor, name, printed_name, password.hash, roles, must_change_password=must_change_password)


def create_external_user(session: Session, *, name: str, printed_name: str, roles: Collection[str]) -> User:
    """Add a person who logs in by single sign-on alone; names that others have are refused, for no account is taken over."""
    return _add(session, SYSTEM, name, printed_name, lambda: "", roles, source="single sign-on")


def _add(
    session: Session,
    actor: Actor,
    name: str,
    printed_name: str,
    password_hash: Callable[[], str],
    roles: Collection[str],
    *,
    must_change_password: bool = False,
    source: str = "administrator",
) -> User:
    name = normal_name("log-in name", name, LONGEST_LOGIN_NAME)
    if not LOGIN_NAME.fullmatch(name):
        raise RefusedInputError(f"{name!r} is not a log-in name: use 1 to 64 letters, digits and . _ @ -.")
    printed_name = normal_name("printed name", printed_name, LONGEST_PRINTED_NAME) or name
    _refuse_taken(session, name, printed_name)
    user = User(
        name=name,
        printed_name=printed_name,
        password_hash=password_hash(),
        roles=known_roles(roles),
        created_utc=utc_now(),
        must_change_password=int(must_change_password),
        name_key=comparison_key(name),
        printed_key=comparison_key(printed_name),
    )
    session.put(user)
    after = {"name": name, "printed_name": user.printed_name, "roles": user.roles}
    audit.append(session, actor, CREATED, _subject(user), None, after)
    note(session, "user_created", actor, user=user.id, name=name, roles=user.roles, source=source)
    return user


def _refuse_taken(session: Session, name: str, printed_name: str) -> None:
    """Refuse a name that could be mistaken for another person's or for Boresight's own, because signatures show it."""
    ours = {comparison_key(text) for own in (SYSTEM, COMMAND_LINE) for text in (own.name, own.printed_name)}
    if not ours.isdisjoint({comparison_key(name), comparison_key(printed_name)}):
        raise ConflictError(f"{printed_name!r} is reserved for Boresight's own records; choose another name.")
    if (other := rows.find_user(session, name, comparison_key(name))) is not None:
        raise ConflictError(f"The log-in name {other.name!r} exists already; choose another.", code="name-taken")
    if (other := rows.find_user_by_printed_name(session, printed_name, comparison_key(printed_name))) is not None:
        raise ConflictError(f"The printed name {other.printed_name!r} belongs to {other.name!r}; choose another.")


def get_person_names(session: Session, user_id: int) -> tuple[str, ...]:
    """Return the names of a person; none where the person does not exist."""
    user = session.get(User, user_id)
    return () if user is None else (user.name, user.printed_name)


def authenticate(session: Session, proof: PasswordProof, request_id: str | None = None) -> Actor:
    """Return the person whose name and password were proven."""
    return make_actor(require_proof(session, proof), request_id)


def make_actor(user: User, request_id: str | None = None, session_id: int | None = None) -> Actor:
    """Return a person as an actor."""
    roles = frozenset(user.roles)
    return Actor(user.id, user.name, user.printed_name, roles, "session", None, request_id, session_id=session_id)


def get_actor(
    session: Session,
    user_id: int,
    session_id: int | None = None,
    *,
    sets_password: bool = False,
    rules: FactorRules | None = None,
) -> Actor:
    """Return a person as the actor of a log-in, with the roles held now; with `rules` only one who has what their roles need."""
    user = session.get(User, user_id)
    if user is None or user.disabled_utc is not None:
        raise SessionEndedError("disabled")
    if not sets_password:
        refuse_password_of_another(user)
    if (
        rules is not None
        and rules.demand(user.roles)
        and not second_factors.needs_second_factor(session, user.id, rules)
    ):
        raise FactorEnrolmentDueError("Your roles need a second factor: enrol one first, then continue.")
    return make_actor(user, session_id=session_id)


def refuse_password_of_another(user: User) -> None:
    """Refuse a person whose password somebody else knows."""
    if user.must_change_password:
        raise PasswordDueError(
            "Somebody else set your password: set your own first, then continue.", code="password-due"
        )


def must_change_password(session: Session, actor: Actor) -> bool:
    """Whether somebody else set the password of this person."""
    return actor.user_id is not None and bool(session.get_known(User, actor.user_id).must_change_password)


def is_external(session: Session, user_id: int | None) -> bool:
    """Whether a person logs in by single sign-on and has no password here."""
    user = None if user_id is None else session.get(User, user_id)
    return user is not None and user.is_external


def change_password(
    session: Session, actor: Actor, user_id: int, password: NewPassword, current: PasswordProof = NO_PROOF
) -> User:
    """Set a password: one's own, knowing the current one, or as an administrator another's, who must set their own at log-in."""
    refuse_key(actor, "set a password")
    user = session.get_known(User, user_id)
    own = actor.user_id == user_id
    if not own:
        _require_administrator(actor)
    if user.is_external:
        raise ConflictError(
            f"{user.printed_name} logs in by single sign-on and has no password here; set it at the provider."
        )
    if own:
        require_person(actor, "set a password")
        require_proof(session, current, user_id)
    before = {"must_change_password": bool(user.must_change_password)}
    user.password_hash = password.hash()
    _end_sessions(session, user, "password_changed")
    user.must_change_password = int(not own)
    audit.append(session, actor, CHANGED if own else RESET, _subject(user), before, {"must_change_password": not own})
    note(session, "authn_password_change" if own else "authn_password_reset", actor, user=user.name)
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
    ended = rows.end_open_log_ins(session, user.id, utc_now(), because)
    rows.end_challenges(session, user.id, utc_now())
    if ended:
        note(session, "session_ended", None, user=user.name, reason=because, log_ins=ended)


def change_roles(session: Session, actor: Actor, user_id: int, roles: Collection[str]) -> User:
    """Give a person these roles instead of the ones held. Every log-in then ends."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    after = known_roles(roles)
    if user.is_external:
        raise ConflictError(
            f"The roles of {user.printed_name} follow from groups at the provider; change the groups there."
        )
    if "administrator" not in after:
        _keep_an_administrator(session, user)
    _set_roles(session, actor, user, after, "administrator")
    return user


def follow_groups(session: Session, user: User, roles: Collection[str]) -> None:
    """Give a person the roles of their groups at the provider, also the last administrator: the provider decides."""
    after = known_roles(roles)
    if user.roles != after:
        _set_roles(session, SYSTEM, user, after, "single sign-on")


def log_out_at_provider(session: Session, user: User, before_utc: str) -> int:
    """End the log-ins of a person that began before a time, because their provider logged them out; returns how many."""
    rows.end_challenges(session, user.id, utc_now())
    ended = rows.end_open_log_ins(session, user.id, utc_now(), "logged_out", created_before_utc=before_utc)
    if ended:
        audit.append(session, SYSTEM, "logged out at the provider", _subject(user), None, {"log_ins": ended})
        note(session, "session_ended", None, user=user.name, reason="logged_out_at_provider", log_ins=ended)
    return ended


def _set_roles(session: Session, actor: Actor, user: User, after: list[str], source: str) -> None:
    before, user.roles = user.roles, after
    _end_sessions(session, user, "roles_changed")
    audit.append(session, actor, "changed the roles of", _subject(user), {"roles": before}, {"roles": after})
    note(session, "authz_change", actor, user=user.name, before=before, after=after, source=source)


def disable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Keep a person out from now on; what they did stays."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    if user.disabled_utc is None:
        _keep_an_administrator(session, user)
        user.disabled_utc = utc_now()
        _end_sessions(session, user, "disabled")
        audit.append(session, actor, "disabled", _subject(user), {"disabled": False}, {"disabled": True})
        note(session, "user_disabled", actor, user=user.name)
    return user


def enable_user(session: Session, actor: Actor, user_id: int) -> User:
    """Let a disabled person in again."""
    _require_administrator(actor)
    user = session.get_known(User, user_id)
    if user.disabled_utc is not None:
        user.disabled_utc = None
        audit.append(session, actor, "enabled", _subject(user), {"disabled": True}, {"disabled": False})
        note(session, "user_enabled", actor, user=user.name)
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
