"""Passwords: which may be used, how they are kept, and how a wrong one is answered.

They are kept as argon2id hashes. A name that does not exist costs the same hash as one that does, and too many failures
make a name wait, whether it exists or not, so that an answer does not tell who has an account.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from boresight.errors import RefusedInputError, TooManyAttemptsError, UnauthenticatedError
from boresight.store import users as rows
from boresight.store.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.store.tables import LoginFailure, User

MINIMUM_PASSWORD_LENGTH = 12
MAXIMUM_PASSWORD_LENGTH = 256  # a longer one only costs time
LOGIN_ATTEMPTS_PER_MINUTE = 5
FAILURE_COUNTS_S = 60.0

_HASHER = PasswordHasher()
_UNKNOWN = _HASHER.hash("nobody has this password")


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


def check_password(session: Session, name: str, user: User | None, password: str, attempts_per_minute: int) -> None:
    """Refuse a wrong password, after as much work as a right one costs, and count the failure.

    Raises
    ------
    UnauthenticatedError
        When the password is wrong, or there is no such person.
    TooManyAttemptsError
        When there were too many failures within a minute.
    """
    _refuse_too_many(rows.failures_since(session, name, utc_after(-FAILURE_COUNTS_S)), attempts_per_minute)
    if _fits(user.password_hash if user else _UNKNOWN, password) and user is not None:
        return
    rows.forget_failures(session, before_utc=utc_after(-3600.0))
    session.add(LoginFailure(name=name, at_utc=utc_now()))
    keep_despite_refusal(session, of_a_trial=True)
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
