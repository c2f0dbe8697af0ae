"""People, their keys, their log-ins and their preferences."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing, allow_only
from boresight.platform.db.documents import JsonText

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


class ApiKey(Base):
    """A scoped key for automation, stored hashed, shown once."""

    __tablename__ = "api_keys"
    noun = "API key"
    __table_args__ = (STRICT,)
    sealing = Sealing(fleeting={"last_used_utc": "moves with every use"})
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    label: Mapped[str] = mapped_column(sa.Text)
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


class UserPreference(Base):
    """What a person prefers under a name that `preferences` knows; a row is there once it was chosen."""

    __tablename__ = "user_preferences"
    __table_args__ = (sa.UniqueConstraint("user_id", "name"), STRICT)
    sealing = Sealing(unsealed="moves as a person likes, and decides nothing but what that person is shown")
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    name: Mapped[str] = mapped_column(sa.Text)
    value: Mapped[Any] = mapped_column(JsonText)
