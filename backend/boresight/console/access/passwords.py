"""Passwords: which may be used, how they are kept, how one is checked, and who else knew one.

They are kept as argon2id hashes, slow on purpose, so a check reads what is stored, works outside any transaction, and
holds the result against what is stored then; a name that does not exist costs the same. zxcvbn refuses what is guessed
easily (OWASP ASVS 4.0, 2.1.7); of a long password its ends are judged, for its time grows faster than the length.
`password_by` says of every signature who else gave the password, for an administrator could sign with it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from boresight.console.access import queries as rows
from boresight.console.access.second_factors import NO_FACTOR, GivenFactor
from boresight.console.access.tables import User
from boresight.errors import RefusedInputError, UnauthenticatedError
from boresight.platform.audit import queries as records
from boresight.platform.db.sessions import Session
from boresight.platform.web.text_validation import comparison_key

LEAST_GUESSES = 1e8  # zxcvbn's score 3: safe against guessing at the rate that logging in allows, many times over
JUDGED_LETTERS = 40  # at either end; the costliest text of this length takes 0.1 s
SHORTEST_NAME = 3  # a shorter one is part of words in half of all sentences: it counts where it stands as a word

CONTAINS_NAME = "The password contains the log-in name or the printed name; use one that does not."


def describe_weakness(password: str, names: tuple[str, ...] = ()) -> str | None:
    """Return why a password is easy to guess; None when it is not."""
    known = _parts(names)
    plain = comparison_key(password)
    letters = "".join(letter for letter in plain if letter.isalnum())
    for name in known:
        if any(form in text for form in (name, name[::-1]) for text in (plain, letters)):
            return CONTAINS_NAME
    if _words(plain) & {name for name in map(comparison_key, names) if len(name) < SHORTEST_NAME}:
        return CONTAINS_NAME
    ends = {plain[:JUDGED_LETTERS], plain[-JUDGED_LETTERS:], password[:JUDGED_LETTERS], password[-JUDGED_LETTERS:]}
    if len(plain) <= JUDGED_LETTERS:
        ends = {plain, password}
        strong = all(_guesses(end, known) >= LEAST_GUESSES for end in ends)
    else:
        strong = any(_guesses(end, known) >= LEAST_GUESSES for end in ends)
    if not strong:
        return "The password is common, or made of common parts, and is easy to guess; use several unrelated words."
    return None


def _words(text: str) -> set[str]:
    return set("".join(letter if letter.isalnum() else " " for letter in text).split())


def _parts(names: tuple[str, ...]) -> list[str]:
    """Return the names and their words, folded, that are long enough to mean something."""
    whole = [comparison_key(name) for name in names]
    joined = ["".join(letter for letter in name if letter.isalnum()) for name in whole]
    words = [word for name in whole for word in name.split() if len(word) > SHORTEST_NAME]
    return sorted({part for part in (*whole, *joined, *words) if len(part) >= SHORTEST_NAME})


def _guesses(text: str, known: list[str]) -> float:
    """Estimate after how many guesses a text falls."""
    from zxcvbn import zxcvbn  # noqa: PLC0415 - its lists take 60 ms to read, and few processes set passwords

    return float(zxcvbn(text, user_inputs=["boresight", *known])["guesses"])


MINIMUM_PASSWORD_LENGTH = 12
MAXIMUM_PASSWORD_LENGTH = 128  # of a new one (ASVS 2.1.2); a longer one only costs time
LONGEST_PASSWORD_CHECKED = 256  # the length that older versions allowed
CREATED, CHANGED, RESET = "created", "changed the password of", "reset the password of"  # in the audit log
TOLD_FOR_S = 24 * 3600.0  # a password of one's own that followed another's within this time may be the other's too

# RFC 9106, second recommendation, for 64 MiB; OWASP asks for 46 MiB and one pass, or 19 MiB and two
_HASHER = PasswordHasher(time_cost=3, memory_cost=65_536, parallelism=4, hash_len=32, salt_len=16)


def write_dummy_hash(hasher: PasswordHasher) -> str:
    """Write a hash that costs as much to check as the hasher's own and that no password is known to fit."""
    costs = f"m={hasher.memory_cost},t={hasher.time_cost},p={hasher.parallelism}"
    return f"$argon2id$v=19${costs}${'A' * 22}${'A' * 43}"  # salt and digest in base 64, all zero


_UNKNOWN = write_dummy_hash(_HASHER)


@dataclass(frozen=True)
class StoredPassword:
    """A person's stored password hash; for an unknown name or a disabled person, a dummy hash that costs as much to check."""

    user_id: int | None = None
    password_hash: str = field(default_factory=lambda: _UNKNOWN, repr=False)


@dataclass(frozen=True)
class PasswordProof:
    """Whether a password was the person's when it was checked, outside any transaction, against what was stored then.

    `given` is the second factor that came with it, which is used inside the transaction.
    """

    stored: StoredPassword
    fits: bool
    given: GivenFactor = NO_FACTOR


NO_PROOF = PasswordProof(StoredPassword(), fits=False)  # where no password was given


@dataclass(frozen=True)
class NewPassword:
    """A password that may be stored, hashed outside any transaction; or why it may not be used."""

    password_hash: str = field(default="", repr=False)
    refusal: str | None = None

    def hash(self) -> str:
        """Return the hash to store."""
        if self.refusal is not None:
            raise RefusedInputError(self.refusal)
        return self.password_hash


def read_stored_under(session: Session, name: str) -> StoredPassword:
    """Read what is stored under a log-in name."""
    name = name.strip()
    return _stored(rows.find_user(session, name, comparison_key(name)) if _is_text(name) else None)


def read_stored(session: Session, user_id: int | None) -> StoredPassword:
    """Read what is stored of a person."""
    return _stored(None if user_id is None else session.get(User, user_id))


def _stored(user: User | None) -> StoredPassword:
    known = user is not None and user.disabled_utc is None and not user.is_external
    return StoredPassword(user.id, user.password_hash) if known and user is not None else StoredPassword()


def check(stored: StoredPassword, password: str) -> PasswordProof:
    """Check a password against what is stored; slow on purpose, never to be done in a transaction."""
    if len(password) > LONGEST_PASSWORD_CHECKED or not _is_text(password):
        password = ""  # an unknown name: the dummy hash costs as much as any other
    fits = False
    with suppress(VerificationError, InvalidHashError):
        fits = _HASHER.verify(stored.password_hash, password)
    return PasswordProof(stored, fits and stored.user_id is not None)


def _is_text(text: str) -> bool:
    """Whether a text can be encoded in UTF-8; a lone surrogate cannot."""
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def require_proof(session: Session, proof: PasswordProof, user_id: int | None = None) -> User:
    """Return the person whose password was proven, if it is what is stored now."""
    user = None if proof.stored.user_id is None else session.get(User, proof.stored.user_id)
    stands = user is not None and _stored(user) == proof.stored and user_id in {None, user.id}
    if user is None or not (proof.fits and stands):
        raise UnauthenticatedError("Wrong name or password; try again or ask an administrator.", code="wrong-password")
    return user


def prepare(password: str, *names: str) -> NewPassword:
    """Hash a password that is to be stored, if it may be used; slow on purpose, never to be done in a transaction."""
    refusal = _refusal(password, names)
    return NewPassword(refusal=refusal) if refusal else NewPassword(_HASHER.hash(password))


def prepare_unjudged(password: str) -> NewPassword:
    """Hash a password without judging its strength, for the demonstration, whose passwords are printed on the screen."""
    return NewPassword(_HASHER.hash(password))


def _refusal(password: str, names: tuple[str, ...]) -> str | None:
    """Say why a password may not be used; None when it may."""
    if not _is_text(password):
        return "The password has a character that cannot be written (a lone surrogate); leave it out."
    if len(password) < MINIMUM_PASSWORD_LENGTH:
        return f"The password has {len(password)} characters; use at least {MINIMUM_PASSWORD_LENGTH}."
    if len(password) > MAXIMUM_PASSWORD_LENGTH:
        return f"The password is over {MAXIMUM_PASSWORD_LENGTH} characters; use a shorter one."
    return describe_weakness(password, names)


def name_password_setter(session: Session, user_id: int) -> str | None:
    """Return who else knows a person's password, as a signature records it; None when it has long been the person's own.

    It is somebody else's when they gave the one that is in use, and may be when the person set one within `TOLD_FOR_S`
    after somebody else had given one: whoever gave it could log in with it and set the next.
    """
    if (user := session.get(User, user_id)) is not None and user.is_external:
        return None
    subject, actions = f"users/{user_id}", (CREATED, CHANGED, RESET)
    newest = records.find_newest(session, subject, actions)
    given = records.find_newest(session, subject, actions, not_by=user_id)
    if newest is None or given is None:
        return "given by nobody on record"
    given_at = datetime.fromisoformat(given.at_utc)
    how = f"{'given' if given.action == CREATED else 'reset'} by {given.actor} at {given_at:%Y-%m-%dT%H:%M:%SZ}"
    if newest.id == given.id:
        return f"{how}, not changed since"
    later_s = (datetime.fromisoformat(newest.at_utc) - given_at).total_seconds()
    return f"{how}, changed {_span(later_s)} later" if later_s < TOLD_FOR_S else None


def _span(seconds: float) -> str:
    """Print a duration of less than a day in its largest unit."""
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 3600.0 else f"{seconds / 3600.0:.0f} h"
