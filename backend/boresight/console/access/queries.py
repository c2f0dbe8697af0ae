"""Queries on people, API keys, log-ins, second factors and preferences, and on the rows that a cached identity depends on."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from boresight.console.access.tables import (
    ApiKey,
    ExternalIdentity,
    FactorChallenge,
    LoginSession,
    RecoveryCode,
    SecondFactor,
    User,
    UserPreference,
)
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import Session


def find_user(session: Session, name: str, key: str) -> User | None:
    """Return the person with exactly this log-in name, else the one whose name has this key."""
    found = session.scalar(sa.select(User).where(User.name == name))
    return found or session.scalar(sa.select(User).where(User.name_key == key))


def find_user_by_printed_name(session: Session, printed_name: str, key: str) -> User | None:
    """Return a person whose printed name is this one, or has this key."""
    alike = (User.printed_name == printed_name) | (User.printed_key == key)
    return session.scalar(sa.select(User).where(alike).limit(1))


def list_users(session: Session) -> Sequence[User]:
    """Return everyone, by log-in name."""
    return session.scalars(sa.select(User).order_by(User.name)).all()


def find_key_by_prefix(session: Session, prefix: str) -> ApiKey | None:
    """Return the key with this prefix."""
    return session.scalar(sa.select(ApiKey).where(ApiKey.prefix == prefix))


def list_keys(session: Session, user_id: int | None) -> Sequence[ApiKey]:
    """Return a person's keys, or everyone's, newest first."""
    query = sa.select(ApiKey).order_by(ApiKey.id.desc())
    if user_id is not None:
        query = query.where(ApiKey.user_id == user_id)
    return session.scalars(query).all()


def find_log_in(session: Session, token_hash: str) -> LoginSession | None:
    """Return the log-in whose secret has this hash."""
    return session.scalar(sa.select(LoginSession).where(LoginSession.token_hash == token_hash))


def list_addresses(session: Session, user_id: int) -> Sequence[str]:
    """Return the addresses that a person's log-ins were made from, as far back as log-ins are kept."""
    return session.scalars(sa.select(LoginSession.address).where(LoginSession.user_id == user_id).distinct()).all()


def end_open_log_ins(
    session: Session,
    user_id: int,
    ended_utc: str,
    because: str,
    *,
    spare_id: int | None = None,
    created_before_utc: str | None = None,
) -> int:
    """End the open log-ins of a person except one, or those begun before a time; returns how many were ended."""
    change = sa.update(LoginSession).where(LoginSession.user_id == user_id, LoginSession.ended_utc.is_(None))
    if spare_id is not None:
        change = change.where(LoginSession.id != spare_id)
    if created_before_utc is not None:
        change = change.where(LoginSession.created_utc < created_before_utc)
    ended = session.execute(change.values(ended_utc=ended_utc, ended_because=because))
    return int(ended.rowcount)  # type: ignore[attr-defined]  # an UPDATE's result has it


def write_uses(session: Session, used_utc: Mapping[int, str]) -> None:
    """Write when open log-ins were last used, by id; another server may have written a later time."""
    for session_id, at_utc in used_utc.items():
        session.execute(
            sa.update(LoginSession)
            .where(LoginSession.id == session_id, LoginSession.last_used_utc < at_utc, LoginSession.ended_utc.is_(None))
            .values(last_used_utc=at_utc)
        )


def _lapsed(created_before_utc: str, used_before_utc: str) -> sa.ColumnElement[bool]:
    too_old = LoginSession.created_utc < created_before_utc
    return LoginSession.ended_utc.is_(None) & (too_old | (LoginSession.last_used_utc < used_before_utc))


def has_lapsed(session: Session, *, created_before_utc: str, used_before_utc: str) -> bool:
    """Whether a log-in is open that was made or used too long ago."""
    query = sa.select(LoginSession.id).where(_lapsed(created_before_utc, used_before_utc)).limit(1)
    return session.scalar(query) is not None


def list_lapsed_log_ins(
    session: Session, *, created_before_utc: str, used_before_utc: str
) -> Sequence[tuple[int, int, str]]:
    """Return id, person and beginning of the open log-ins that were made or used too long ago."""
    columns = (LoginSession.id, LoginSession.user_id, LoginSession.created_utc)
    query = sa.select(*columns).where(_lapsed(created_before_utc, used_before_utc))
    return [(row[0], row[1], row[2]) for row in session.execute(query)]


def end_lapsed_log_ins(session: Session, ended_utc: str, *, created_before_utc: str, used_before_utc: str) -> None:
    """Write the end of the log-ins that were made or used too long ago."""
    because = sa.case((LoginSession.created_utc < created_before_utc, "expired"), else_="idle")
    change = sa.update(LoginSession).where(_lapsed(created_before_utc, used_before_utc))
    session.execute(change.values(ended_utc=ended_utc, ended_because=because))


def has_ended_before(session: Session, before_utc: str) -> bool:
    """Whether a log-in ended before a time."""
    query = sa.select(LoginSession.id).where(LoginSession.ended_utc < before_utc).limit(1)
    return session.scalar(query) is not None


def forget_ended_log_ins(session: Session, before_utc: str) -> None:
    """Remove the log-ins that ended before a time."""
    session.execute(sa.delete(LoginSession).where(LoginSession.ended_utc < before_utc))


def read_ends_since(session: Session, since_utc: str) -> dict[int, str]:
    """Return the ends of the log-ins that ended after a time, by id."""
    query = sa.select(LoginSession.id, LoginSession.ended_utc).where(LoginSession.ended_utc > since_utc)
    return {row[0]: row[1] or "" for row in session.execute(query)}


def read_newest_revocation(session: Session) -> tuple[str | None, str | None]:
    """Return when a key was last revoked and a person last disabled."""
    revoked = session.scalar(sa.select(sa.func.max(ApiKey.revoked_utc)))
    return revoked, session.scalar(sa.select(sa.func.max(User.disabled_utc)))


def find_identity(session: Session, issuer: str, subject: str) -> ExternalIdentity | None:
    """Return the account that is bound to a person of a provider."""
    query = sa.select(ExternalIdentity).where(ExternalIdentity.issuer == issuer, ExternalIdentity.subject == subject)
    return session.scalar(query)


def list_factors(session: Session, user_id: int) -> Sequence[SecondFactor]:
    """Return the second factors that a person has, in the order of their enrolment."""
    query = sa.select(SecondFactor).where(SecondFactor.user_id == user_id, SecondFactor.ended_utc.is_(None))
    return session.scalars(query.order_by(SecondFactor.id)).all()


def list_encrypted_factors(session: Session) -> Sequence[SecondFactor]:
    """Return everybody's second factors that have not ended."""
    return session.scalars(sa.select(SecondFactor).where(SecondFactor.ended_utc.is_(None))).all()


def list_enrolled_ids(session: Session) -> frozenset[int]:
    """Return who has a second factor."""
    query = sa.select(SecondFactor.user_id).where(SecondFactor.ended_utc.is_(None)).distinct()
    return frozenset(session.scalars(query))


def find_credential(session: Session, credential_id: str) -> SecondFactor | None:
    """Return the second factor of a security key's credential, whoever has or had it."""
    return session.scalar(sa.select(SecondFactor).where(SecondFactor.credential_id == credential_id))


def list_recovery_codes(session: Session, user_id: int) -> Sequence[RecoveryCode]:
    """Return a person's recovery codes that can be used."""
    query = sa.select(RecoveryCode).where(RecoveryCode.user_id == user_id, RecoveryCode.ended_utc.is_(None))
    return session.scalars(query).all()


def find_challenge_by_token(session: Session, token_hash: str) -> FactorChallenge | None:
    """Return the log-in that waits under a cookie."""
    return session.scalar(sa.select(FactorChallenge).where(FactorChallenge.token_hash == token_hash))


def find_challenge(session: Session, user_id: int, session_id: int, challenge: str) -> FactorChallenge | None:
    """Return the challenge of these random bytes that was given to a person under one log-in."""
    query = sa.select(FactorChallenge).where(
        FactorChallenge.user_id == user_id,
        FactorChallenge.session_id == session_id,
        FactorChallenge.challenge == challenge,
    )
    return session.scalar(query)


def count_challenges(session: Session, user_id: int, since_utc: str) -> int:
    """Count the challenges that a person was given since a time."""
    query = sa.select(sa.func.count()).where(
        FactorChallenge.user_id == user_id, FactorChallenge.created_utc > since_utc
    )
    return session.scalar(query) or 0


def end_challenges(session: Session, user_id: int, ended_utc: str) -> None:
    """End everything of a person that waits for a second factor."""
    open_ones = sa.update(FactorChallenge).where(
        FactorChallenge.user_id == user_id, FactorChallenge.ended_utc.is_(None)
    )
    session.execute(open_ones.values(ended_utc=ended_utc))


def has_old_challenge(session: Session, before_utc: str) -> bool:
    """Whether a challenge was made before a time."""
    query = sa.select(FactorChallenge.id).where(FactorChallenge.created_utc < before_utc).limit(1)
    return session.scalar(query) is not None


def forget_challenges(session: Session, before_utc: str) -> None:
    """Remove the challenges that were made before a time."""
    session.execute(sa.delete(FactorChallenge).where(FactorChallenge.created_utc < before_utc))


def read_preferences(session: Session, user_id: int) -> dict[str, Any]:
    """Return what a person chose, by name."""
    query = sa.select(UserPreference.name, UserPreference.value).where(UserPreference.user_id == user_id)
    return {row[0]: row[1] for row in session.execute(query)}


def write_preference(session: Session, user_id: int, name: str, value: Any) -> None:
    """Keep what a person chose, in place of what they chose before."""
    query = sa.select(UserPreference).where(UserPreference.user_id == user_id, UserPreference.name == name)
    row = session.scalar(query)
    if row is None:
        session.put(UserPreference(user_id=user_id, name=name, value=value))
    else:
        row.value = value


_TIMES = "(SELECT p.value FROM user_preferences p WHERE p.user_id = u.id AND p.name = 'times')"
_OWNER = "u.id, u.name, u.printed_name, u.roles, u.disabled_utc, u.must_change_password"
_QUESTIONS = {
    "session": f"SELECT s.token_hash, s.ended_because, {_OWNER}, {_TIMES} FROM login_sessions s "  # noqa: S608 - our own words
    "JOIN users u ON u.id = s.user_id WHERE s.id = :number",
    "key": f"SELECT k.key_hash, k.scopes, k.expires_utc, k.revoked_utc, {_OWNER} FROM api_keys k "  # noqa: S608 - likewise
    "JOIN users u ON u.id = k.user_id WHERE k.prefix = :number",
}


@dataclass(frozen=True)
class CredentialRows:
    """The rows behind a credential as they were read."""

    kind: str
    number: int | str
    said: tuple[Hashable, ...] | None

    @classmethod
    def read(cls, session: Session, kind: str, number: int | str) -> CredentialRows:
        """Read the rows in the transaction that identifies the actor, so that both see the same state."""
        row = session.connection().execute(sa.text(_QUESTIONS[kind]), {"number": number}).one_or_none()
        return cls(kind, number, None if row is None else tuple(row))

    def say_so_still(self, data_versions: DataVersionReader) -> bool:
        """Whether the rows are unchanged now; False where that cannot be read at once."""
        return self.said is not None and self.said == data_versions.row(_QUESTIONS[self.kind], {"number": self.number})
