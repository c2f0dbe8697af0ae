"""What confirms, for one act, that a person is still who logged in: a signature needs it, and a change of second factors.

====================================  =========================================================
a password here                       the password again
a password here and a second factor   the password again and the second factor
single sign-on                        the provider, which asks the person again, for one act
single sign-on and a second factor    the second factor
====================================  =========================================================

It is checked inside the transaction of what it allows, against what is stored then.
"""

from __future__ import annotations

from dataclasses import dataclass

from boresight.console.access import second_factors, sessions, users
from boresight.console.access.passwords import PasswordProof, require_proof
from boresight.console.access.second_factors import FactorRules, GivenFactor
from boresight.console.access.tables import User
from boresight.errors import SingleSignOnError
from boresight.platform.actors import Actor, require_person
from boresight.platform.db.sessions import Session

CONFIRM_FIRST = (
    "This action requires confirmation by single sign-on: choose Confirm, log in at the provider, then complete the action "
    "within 5 minutes."
)


@dataclass(frozen=True)
class Needed:
    """What a form must ask a person for."""

    password: bool = True
    code: bool = False
    security_key: bool = False
    provider: bool = False
    is_confirmed: bool = False  # the provider did so already


def describe_needed(session: Session, actor: Actor, rules: FactorRules) -> Needed:
    """Return what the acting person is asked for where something must be confirmed."""
    if actor.user_id is None or actor.is_key:
        return Needed()
    external = users.is_external(session, actor.user_id)
    known = second_factors.list_factors(session, actor) if rules.are_on else []
    return Needed(
        password=not external,
        code=bool(known),
        security_key=any(one.kind == "webauthn" for one in known),
        provider=external and not known,
        is_confirmed=external and sessions.is_confirmed(session, actor),
    )


def require(session: Session, actor: Actor, proof: PasswordProof) -> None:
    """Require what confirms the acting person, and use it: none of it confirms a second act."""
    user = session.get_known(User, require_person(actor, "confirm who they are"))
    users.refuse_password_of_another(user)
    if not user.is_external:
        require_proof(session, proof, user.id)
    if second_factors.needs_second_factor(session, user.id, proof.given.rules):
        second_factors.use(session, actor, user, proof.given, "signature")
    elif user.is_external and not sessions.use_confirmation(session, actor):
        raise SingleSignOnError(CONFIRM_FIRST, "confirmation")


def require_factor(session: Session, actor: Actor, given: GivenFactor) -> None:
    """Require the second factor of a person who is logged in and has one, where no password is asked for."""
    if (
        actor.user_id is None
        or actor.is_key
        or not second_factors.needs_second_factor(session, actor.user_id, given.rules)
    ):
        return
    second_factors.use(session, actor, session.get_known(User, actor.user_id), given, "signature")


def authenticate_beside(session: Session, proof: PasswordProof, request_id: str | None) -> Actor:
    """Return the second person whose name, password and second factor were given at another's console."""
    actor = users.authenticate(session, proof, request_id)
    user = session.get_known(User, require_person(actor, "sign"))
    if second_factors.needs_second_factor(session, user.id, proof.given.rules):
        second_factors.use(session, actor, user, proof.given, "signature")
    return actor
