"""Passwords in tests that call the services: made and proven where it is convenient, inside a transaction if need be."""

from __future__ import annotations

from functools import cache

from boresight.services import passwords
from boresight.services.actors import Actor
from boresight.services.passwords import NewPassword, PasswordProof
from boresight.store.sessions import Session


@cache
def new_password(password: str) -> NewPassword:
    """Hash a password once for all tests of a process."""
    return passwords.prepare_unjudged(password)


def proved(session: Session, who: Actor | str, password: str) -> PasswordProof:
    """Check the password of a person, or of a log-in name."""
    if isinstance(who, str):
        return passwords.check(passwords.stored_under(session, who), password)
    return passwords.check(passwords.stored_of(session, who.user_id), password)
