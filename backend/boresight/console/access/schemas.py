"""People, their keys and their log-ins."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from boresight.console.access.tables import FACTOR_KINDS, SESSION_ENDINGS
from boresight.console.schemas import Row


class User(Row):
    """A person."""

    versioned_by = ("id", "roles", "disabled_utc", "session_epoch", "must_change_password")
    location = "/users/{row.id}"

    id: int
    name: str
    printed_name: str
    roles: list[str]
    created_utc: str
    disabled_utc: str | None
    must_change_password: bool = Field(description="Somebody else set the password; set your own before anything else.")


class ApiKey(Row):
    """A key, without its secret."""

    versioned_by = ("id", "revoked_utc")

    id: int
    user_id: int
    label: str
    prefix: str
    scopes: list[str]
    created_utc: str
    expires_utc: str | None
    revoked_utc: str | None
    last_used_utc: str | None = Field(description="To the minute.")


class NewApiKey(ApiKey):
    """A key just made."""

    secret: str | None = Field(description="Shown this once; null when the answer is replayed.")


class LoginSession(Row):
    """A log-in of a person."""

    id: int
    user_id: int
    created_utc: str
    last_used_utc: str = Field(description="To the minute.")
    ended_utc: str | None
    ended_because: Literal[SESSION_ENDINGS] | None  # type: ignore[valid-type]  # the words of the table
    address: str = Field(description="Address from which it was started.")
    user_agent: str = Field(description="User agent of the program, cut to 200 characters.")
    ends_utc: str = Field(description="When it ends at the latest.")
    current: bool = Field(description="Whether it is the one of this request.")
    method: str = Field(description="password, or single sign-on.")
    factor_kind: str | None = Field(description="The second factor that was given: totp, webauthn or recovery.")


class SecondFactor(Row):
    """A second factor, without its secret."""

    id: int
    kind: Literal[FACTOR_KINDS]  # type: ignore[valid-type]  # the words of the table
    label: str
    created_utc: str
    ended_utc: str | None
    last_used_utc: str | None


class NewSecondFactor(SecondFactor):
    """A second factor just enrolled."""

    recovery_codes: list[str] | None = Field(
        description="Ten, with the first second factor, shown this once; null otherwise, and when the answer is replayed."
    )


class FactorOffer(Row):
    """What is needed to enrol a second factor; `:enrol` names it by `challenge_id`."""

    challenge_id: int
    kind: Literal[FACTOR_KINDS]  # type: ignore[valid-type]  # the words of the table
    secret: str | None = Field(description="Secret of an authenticator app, in base32; shown only this once.")
    uri: str | None = Field(description="The otpauth:// address, as encoded in the QR code.")
    options: dict[str, Any] | None = Field(
        description="For `navigator.credentials.create`, in the JSON form of WebAuthn."
    )


class KeyChallenge(BaseModel):
    """What a security key is asked."""

    options: dict[str, Any] = Field(description="For `navigator.credentials.get`, in the JSON form of WebAuthn.")


class RecoveryCodes(BaseModel):
    """Codes that stand in for a second factor, each once."""

    recovery_codes: list[str] | None = Field(description="Shown this once; null when the answer is replayed.")


class EndedSessions(BaseModel):
    """How many log-ins were ended."""

    ended: int


class Session(BaseModel):
    """Who is acting, and the token that unsafe requests repeat."""

    user_id: int | None
    name: str
    printed_name: str
    roles: list[str]
    credential: str
    scopes: list[str] | None = Field(description="Scopes of an API key; null for a person.")
    must_change_password: bool = Field(description="Set your own password before anything else.")
    csrf_token: str | None = Field(description="For `X-CSRF-Token`; null with an API key.")
