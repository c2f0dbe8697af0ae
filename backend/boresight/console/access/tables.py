"""People, their keys, their log-ins, their second factors and their preferences."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only
from boresight.platform.db.documents import JsonText, TypedText

ROLES = ("viewer", "analyst", "operator", "approver", "administrator")
SESSION_ENDINGS = (
    "logged_out",
    "ended",
    "ended_by_administrator",
    "password_changed",
    "roles_changed",
    "disabled",
    "idle",
    "expired",
)
FACTOR_KINDS = ("totp", "webauthn")
FACTOR_ENDINGS = ("removed", "reset")
CODE_ENDINGS = ("used", "replaced", "reset")
CHALLENGE_PURPOSES = ("log-in", "sign", "totp", "webauthn")


class User(Base):
    """A person. Roles are a list of words; an administrator cannot sign.

    The keys are the names in the form in which they are compared, NULL where an older version allowed two people similar names.
    """

    __tablename__ = "users"
    noun = "user"
    __table_args__ = (
        sa.Index("uq_users_name_key", "name_key", unique=True),
        sa.Index("uq_users_printed_key", "printed_key", unique=True),
        STRICT,
    )
    sealing = Sealing(
        fleeting={"name_key": "follows from the name", "printed_key": "follows from the printed name"},
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(sa.Text, unique=True)
    printed_name: Mapped[str] = mapped_column(sa.Text)
    password_hash: Mapped[str] = mapped_column(sa.Text)
    roles: Mapped[list[str]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    disabled_utc: Mapped[str | None] = mapped_column(sa.Text)
    session_epoch: Mapped[int] = mapped_column(default=0)
    must_change_password: Mapped[int] = mapped_column(default=0, server_default=sa.text("0"))  # somebody else set it
    name_key: Mapped[str | None] = mapped_column(sa.Text)
    printed_key: Mapped[str | None] = mapped_column(sa.Text)

    @property
    def is_external(self) -> bool:
        """Whether the person logs in by single sign-on and has no password here."""
        return not self.password_hash


class ApiKey(Base):
    """A scoped key for automation, stored hashed, shown once."""

    __tablename__ = "api_keys"
    noun = "API key"
    __table_args__ = (STRICT,)
    sealing = Sealing(fleeting={"last_used_utc": "moves with every use"})
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    label: Mapped[str] = mapped_column(TypedText)
    prefix: Mapped[str] = mapped_column(sa.Text, unique=True)
    key_hash: Mapped[str] = mapped_column(sa.Text)
    scopes: Mapped[list[str]] = mapped_column(JsonText)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    expires_utc: Mapped[str | None] = mapped_column(sa.Text)
    revoked_utc: Mapped[str | None] = mapped_column(sa.Text)
    last_used_utc: Mapped[str | None] = mapped_column(sa.Text)


class LoginSession(Base):
    """A log-in of a person: the hash of the secret in its cookie, where it was made, and why it ended."""

    __tablename__ = "login_sessions"
    __table_args__ = (
        allow_only("ended_because", SESSION_ENDINGS),
        sa.Index("ix_login_sessions_user_id_ended_utc", "user_id", "ended_utc"),
        sa.Index("ix_login_sessions_ended_utc", "ended_utc"),
        STRICT,
    )
    sealing = Sealing(
        unsealed="moves with its use and is forgotten; what was done under it is sealed with its own record"
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    token_hash: Mapped[str] = mapped_column(sa.Text, unique=True)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    last_used_utc: Mapped[str] = mapped_column(sa.Text)  # to the minute: written once per maintenance round
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_because: Mapped[str | None] = mapped_column(sa.Text)
    address: Mapped[str] = mapped_column(sa.Text)
    user_agent: Mapped[str] = mapped_column(sa.Text)
    method: Mapped[str] = mapped_column(sa.Text, default="password", server_default="password")
    factor_kind: Mapped[str | None] = mapped_column(sa.Text)  # of the second factor that was given
    confirmed_utc: Mapped[str | None] = mapped_column(sa.Text)  # when the provider confirmed the person again


class ExternalIdentity(Base):
    """The person of an identity provider that an account is bound to, by issuer and subject and by no name."""

    __tablename__ = "external_identities"
    noun = "external identity"
    __table_args__ = (sa.UniqueConstraint("issuer", "subject"), STRICT)
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"), unique=True)
    issuer: Mapped[str] = mapped_column(sa.Text)
    subject: Mapped[str] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)


class SecondFactor(Base):
    """A second factor of a person: the encrypted secret of an authenticator app, or the public key of a security key."""

    __tablename__ = "second_factors"
    noun = "second factor"
    __table_args__ = (
        allow_only("kind", FACTOR_KINDS),
        allow_only("ended_because", FACTOR_ENDINGS),
        sa.Index("ix_second_factors_user_id", "user_id"),
        STRICT,
    )
    sealing = Sealing(
        fleeting={
            "last_used_utc": "moves with every use",
            "last_step": "moves with every use",
            "sign_count": "moves with every use",
        }
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    kind: Mapped[str] = mapped_column(sa.Text)
    label: Mapped[str] = mapped_column(TypedText)
    secret: Mapped[str] = mapped_column(sa.Text)  # encrypted; of a security key its public key
    credential_id: Mapped[str | None] = mapped_column(sa.Text, unique=True)  # of a security key, in base64url
    rp_id: Mapped[str | None] = mapped_column(sa.Text)  # the site that a security key was registered for
    created_utc: Mapped[str] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_because: Mapped[str | None] = mapped_column(sa.Text)
    last_used_utc: Mapped[str | None] = mapped_column(sa.Text)
    last_step: Mapped[int] = mapped_column(default=0)  # of the newest code that was taken: none is taken twice
    sign_count: Mapped[int] = mapped_column(sa.BigInteger().with_variant(sa.Integer, "sqlite"), default=0)


class RecoveryCode(Base):
    """A code that stands in for a lost second factor once, stored hashed."""

    __tablename__ = "recovery_codes"
    noun = "recovery code"
    __table_args__ = (
        allow_only("ended_because", CODE_ENDINGS),
        sa.Index("ix_recovery_codes_user_id", "user_id"),
        STRICT,
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    code_hash: Mapped[str] = mapped_column(sa.Text, unique=True)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    ended_because: Mapped[str | None] = mapped_column(sa.Text)


class FactorChallenge(Base):
    """What waits for a second factor: a log-in after its password, a signature, or an enrolment. Each is answered once."""

    __tablename__ = "factor_challenges"
    noun = "challenge"
    __table_args__ = (
        allow_only("purpose", CHALLENGE_PURPOSES),
        sa.Index("ix_factor_challenges_created_utc", "created_utc"),
        sa.Index("ix_factor_challenges_user_id", "user_id"),
        STRICT,
    )
    sealing = Sealing(unsealed="lasts minutes and is forgotten; what it led to is sealed with its own record")
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    purpose: Mapped[str] = mapped_column(sa.Text)
    token_hash: Mapped[str | None] = mapped_column(sa.Text, unique=True)  # of the cookie of a log-in that waits
    session_id: Mapped[int | None] = mapped_column(sa.ForeignKey("login_sessions.id"))  # of every other one
    method: Mapped[str | None] = mapped_column(sa.Text)  # of the log-in that waits
    challenge: Mapped[str] = mapped_column(sa.Text)  # random; of an authenticator app its secret, encrypted
    created_utc: Mapped[str] = mapped_column(sa.Text)
    ended_utc: Mapped[str | None] = mapped_column(sa.Text)
    failures: Mapped[int] = mapped_column(default=0)


class UserPreference(Base):
    """What a person prefers under a name that `preferences` knows; a row is there once it was chosen."""

    __tablename__ = "user_preferences"
    __table_args__ = (sa.UniqueConstraint("user_id", "name"), STRICT)
    sealing = Sealing(unsealed="moves as a person likes, and decides nothing but what that person is shown")
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    name: Mapped[str] = mapped_column(sa.Text)
    value: Mapped[Any] = mapped_column(JsonText)
