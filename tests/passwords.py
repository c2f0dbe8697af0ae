"""Passwords in tests that call the services: made and proven where it is convenient, inside a transaction if need be."""

from __future__ import annotations

from functools import cache

import pytest
from argon2 import PasswordHasher

from boresight.console.access import passwords
from boresight.console.access.passwords import NewPassword, PasswordProof
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session

# The product's hashes are slow on purpose, and thousands of tests log somebody in; argon2's own tests take the product's.
CHEAP = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
PRODUCT = passwords._HASHER


def use_hasher(patch: pytest.MonkeyPatch, hasher: PasswordHasher = CHEAP) -> None:
    """Hash with these parameters in this process, also for a name that does not exist."""
    patch.setattr(passwords, "_HASHER", hasher)
    patch.setattr(passwords, "_UNKNOWN", hasher.hash("nobody has this password"))


@cache
def new_password(password: str) -> NewPassword:
    """Hash a password once for all tests of a process."""
    return passwords.prepare_unjudged(password)


def proved(session: Session, who: Actor | str, password: str) -> PasswordProof:
    """Check the password of a person, or of a log-in name."""
    if isinstance(who, str):
        return passwords.check(passwords.stored_under(session, who), password)
    return passwords.check(passwords.stored_of(session, who.user_id), password)
