"""Webhooks and their deliveries."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from boresight.console.schemas import Row


class Webhook(Row):
    """An address that is told what happens, without its secret."""

    location = "/webhooks/{row.id}"

    id: int
    label: str
    url: str
    actions: list[str] = Field(description="Kinds of events that are sent; empty: all.")
    version: int
    created_utc: str
    created_by: int | None
    disabled_utc: str | None
    state: Literal["ENABLED", "DISABLED", "PAUSED"] = Field(
        description="PAUSED: its secret cannot be decrypted with this server's key, so its messages wait; renew the secret."
    )
    former_secret_until_utc: str | None = Field(description="Until then the former secret also signs.")


class NewWebhook(Webhook):
    """A webhook just made."""

    secret: str | None = Field(description="Signs each message. Shown only once; null when the answer is replayed.")


class WebhookDelivery(Row):
    """One message to a webhook, and what came of its last attempt."""

    id: int
    webhook_id: int
    audit_id: int | None = Field(description="The audit record that is sent; null for a test message.")
    body: str = Field(description="The bytes that are sent.")
    state: Literal["PENDING", "DELIVERED", "FAILED"]
    attempts: int
    due_utc: str
    attempted_utc: str | None
    status: int | None = Field(description="HTTP status of the answer; null when there was none.")
    outcome: str | None
    created_utc: str
