"""People in tests that call the services: their passwords are made and proven inside a transaction if need be."""

from functools import cache
from typing import Any

import pytest
from argon2 import PasswordHasher

from boresight.console.access import passwords, users
from boresight.console.access.passwords import NewPassword, PasswordProof
from boresight.console.access.tables import User
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, Signature
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.db.sessions import Session

PASSWORD = "correct horse battery"

# The product's hashes are slow on purpose, and thousands of tests log somebody in; argon2's own tests take the product's.
CHEAP = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
PRODUCT = passwords._HASHER


def use_hasher(patch: pytest.MonkeyPatch, hasher: PasswordHasher = CHEAP) -> None:
    patch.setattr(passwords, "_HASHER", hasher)
    patch.setattr(passwords, "_UNKNOWN", passwords.write_dummy_hash(hasher))


@cache
def new_password(password: str) -> NewPassword:
    return passwords.prepare_unjudged(password)


def proved(session: Session, who: Actor | str, password: str) -> PasswordProof:
    if isinstance(who, str):
        return passwords.check(passwords.read_stored_under(session, who), password)
    return passwords.check(passwords.read_stored(session, who.user_id), password)


def add_person(session: Session, name: str, *roles: str, printed_name: str | None = None) -> User:
    named = {"name": name, "printed_name": printed_name or name.title(), "password": new_password(PASSWORD)}
    return users.create_user(session, COMMAND_LINE, **named, roles=roles)


def approve(session: Session, actor: Actor, approval: Approval, *, password: str = PASSWORD, **given: Any) -> Signature:
    decided = approvals.Decision("APPROVE", given.pop("meaning", "I approve"), given.pop("comment", ""))
    proof = proved(session, actor, password)
    return approvals.sign(session, actor, approval.id, decided, proof, **{"seen_version": approval.version} | given)
