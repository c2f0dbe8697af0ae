"""Addresses for messages, and messages, as the API shows them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Row


class MessageAddress(Row):
    """Where a person gets messages, without the address itself."""

    location = "/message-addresses/{row.id}"

    id: int
    label: str
    service: str = Field(description="Scheme of apprise; mailto: by this server's mail server.")
    shown: str = Field(description="What is shown of the address.")
    kinds: list[str]
    quiet_from: str | None = Field(description="Nothing is sent from this time of the day on.")
    quiet_until: str | None
    quiet_zone: str = Field(description="Time zone of both; empty: UTC.")
    created_utc: str
    state: Literal["ENABLED", "PAUSED"] = Field(
        description="PAUSED: it cannot be decrypted with this server's key; remove it and enter it again."
    )


class Message(Row):
    """One message, and what came of its last attempt."""

    id: int
    address_id: int
    audit_id: int | None = Field(description="The audit record that it tells of; null for a test message.")
    kind: str
    subject: str
    text: str
    path: str
    state: Literal["PENDING", "DELIVERED", "FAILED", "DROPPED"]
    attempts: int
    due_utc: str
    attempted_utc: str | None
    outcome: str | None
    created_utc: str
