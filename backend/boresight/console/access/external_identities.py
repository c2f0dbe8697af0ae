"""Accounts of single sign-on: made at the first log-in, bound to issuer and subject, with the roles of the groups of each log-in.

An account is found by issuer and subject and never by a name: whoever takes a name at the provider that somebody has here is
refused, and gets no account of theirs.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from boresight.console.access import queries as rows
from boresight.console.access import sessions, users
from boresight.console.access.openid_connect import Attempt, ProviderAnswer, ProviderLogOut
from boresight.console.access.tables import ExternalIdentity, User
from boresight.errors import ConflictError, RefusedInputError, SingleSignOnError
from boresight.platform.actors import SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.platform.web.text_validation import comparison_key

LONGEST_SUBJECT = 255  # OpenID Connect Core, 2
CLOCKS_DIFFER_S = 10.0  # at most, where somebody is confirmed again: a log-in so short before counts as new


@dataclass(frozen=True)
class Entering:
    """A person whom the provider logged in, and the account here."""

    actor: Actor
    created: bool


def enter(session: Session, person: ProviderAnswer, request_id: str | None) -> Entering:
    """Return the account of a person of the provider, made or brought up to date; refuse who may not come in."""
    if not person.subject or len(person.subject) > LONGEST_SUBJECT:
        raise SingleSignOnError(
            "The provider's token does not identify a user; log in again, or tell an administrator.", "claims"
        )
    if {"administrator", "approver"} <= set(person.roles):
        raise SingleSignOnError(
            "Your groups give you both administrator and approver, which is not allowed; have one of them removed.",
            "roles",
        )
    known = rows.find_identity(session, person.issuer, person.subject)
    user = _make(session, person) if known is None else session.get_one(User, known.user_id)
    if user.disabled_utc is not None:
        raise SingleSignOnError("This account is disabled; ask an administrator.", "disabled")
    if known is not None:
        users.follow_groups(session, user, person.roles)
    if not person.roles:
        keep_despite_refusal(session)  # the roles of before are gone all the same
        raise SingleSignOnError(NO_ROLE, "no role")
    return Entering(users.make_actor(user, request_id), known is None)


NO_ROLE = "None of your groups gives you a role here; ask whoever manages the groups for one."


def _make(session: Session, person: ProviderAnswer) -> User:
    """Make an account for somebody who comes for the first time."""
    if not person.roles:
        raise SingleSignOnError(NO_ROLE, "no role")
    name = person.name
    printed = person.printed_name or name
    if rows.find_user_by_printed_name(session, printed, comparison_key(printed)) is not None:
        printed = f"{printed[: users.LONGEST_PRINTED_NAME - len(name) - 3]} ({name})"
    try:
        user = users.create_external_user(session, name=name, printed_name=printed, roles=person.roles)
    except ConflictError as error:
        raise SingleSignOnError(
            "Your provider name is already used by another account here. Ask an administrator to use a different name claim, "
            "or change your name at the provider.",
            "name taken",
        ) from error
    except RefusedInputError as error:
        raise SingleSignOnError(
            f"Your provider name is not valid as a log-in name here ({error}); ask for another one.", "name"
        ) from error
    bound = ExternalIdentity(user_id=user.id, issuer=person.issuer, subject=person.subject, created_utc=utc_now())
    session.put(bound)
    told = {"issuer": bound.issuer, "subject": bound.subject}
    audit.append(session, SYSTEM, "bound", f"users/{user.id}", None, told)
    return user


def confirm(session: Session, actor: Actor, person: ProviderAnswer, attempt: Attempt) -> None:
    """Record that the provider confirmed the acting person again, after they were sent there and as the same person."""
    known = rows.find_identity(session, person.issuer, person.subject)
    if known is None or known.user_id != actor.user_id or attempt.session_id != str(actor.session_id):
        sentence = "The provider confirmed another person than the one who is logged in; log in as yourself."
        raise SingleSignOnError(sentence, "confirmation")
    if person.authenticated_s is None or person.authenticated_s < float(attempt.began_s) - CLOCKS_DIFFER_S:
        raise SingleSignOnError(
            "The provider did not confirm a new log-in; try again, or have it configured to send auth_time.",
            "auth_time",
        )
    sessions.confirm(session, actor)


def log_out(session: Session, told: ProviderLogOut) -> int:
    """End the log-ins of whom the provider logged out, those that began before it said so: a token sent again ends no later one."""
    known = rows.find_identity(session, told.issuer, told.subject)
    if known is None:
        return 0
    before_utc = utc_after(told.issued_s - time.time() + CLOCKS_DIFFER_S)
    return users.log_out_at_provider(session, session.get_one(User, known.user_id), before_utc)
