"""Passwords: which may be used, how they are kept, and how a wrong one is answered.

They are kept as argon2id hashes. A name that does not exist costs the same hash as one that does, and too many failures
make a name wait, whether it exists or not, so that an answer does not tell who has an account.

A password proves a person only if nobody else chose it. Administrators create people and reset passwords, and one could
then sign as somebody else; that cannot be told from the person doing it, so `password_by` says of every signature what
the audit log knows, and it stays with the signature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from boresight.errors import RefusedInputError, TooManyAttemptsError, UnauthenticatedError
from boresight.store import audit as records
from boresight.store import users as rows
from boresight.store.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.store.tables import LoginFailure, User

MINIMUM_PASSWORD_LENGTH = 12
MAXIMUM_PASSWORD_LENGTH = 256  # a longer one only costs time
LOGIN_ATTEMPTS_PER_MINUTE = 5
FAILURE_COUNTS_S = 60.0
CREATED, CHANGED, RESET = "created", "changed the password of", "reset the password of"  # in the audit log
TOLD_FOR_S = 24 * 3600.0  # a password of one's own that followed another's within this time may be the other's too

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


def password_by(session: Session, user_id: int) -> str | None:
    """Say who else gave a person's password, as a signature keeps it; None when it is the person's own since long.

    It is somebody else's when they gave the one that is in use, and may be when the person set one within `TOLD_FOR_S`
    after somebody else had given one: whoever gave it could log in with it and set the next.
    """
    subject, actions = f"users/{user_id}", (CREATED, CHANGED, RESET)
    newest = records.newest_of(session, subject, actions)
    given = records.newest_of(session, subject, actions, not_by=user_id)
    if newest is None or given is None:
        return "given by nobody on record"
    given_at = datetime.fromisoformat(given.at_utc)
    how = f"{'given' if given.action == CREATED else 'reset'} by {given.actor} at {given_at:%Y-%m-%d %H:%M:%S} UTC"
    if newest.id == given.id:
        return f"{how}, not changed since"
    later_s = (datetime.fromisoformat(newest.at_utc) - given_at).total_seconds()
    return f"{how}, set anew {_span(later_s)} later" if later_s < TOLD_FOR_S else None


def _span(seconds: float) -> str:
    """Print a span of time under a day with its largest unit."""
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 3600.0 else f"{seconds / 3600.0:.0f} h"
