"""Webhooks, and every message that was sent. For administrators in person."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field

from boresight.console.access.dependencies import Reading, SecretKeeper, Who, Writing
from boresight.console.jobs.dependencies import ServerWebhookSender
from boresight.console.operation import OperationResponse, RowWithFields, operations
from boresight.console.schemas import Row, Shape
from boresight.console.webhooks import service as webhooks
from boresight.console.webhooks import tables
from boresight.console.webhooks.secrets import get_state
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.web.paging import Id, Listing, Page, Paged


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
    former_secret_until_utc: str | None = Field(description="Until then the previous secret also signs.")


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


router = operations("/webhooks", tags=["webhooks"])

OVERLAP_HOURS = 24.0


class WantedWebhook(BaseModel):
    """An address to be told what happens."""

    model_config = ConfigDict(extra="forbid")
    label: str = Field(description="The receiver.", examples=["Mission chat"])
    url: str = Field(examples=["https://mission.example/hooks/boresight"])
    actions: Annotated[
        list[str],
        Field(
            description="Kinds of events, or a noun with a star. Empty: all.",
            examples=[["parameter-sets.promoted", "approvals.*"]],
        ),
    ] = []


class Renewal(Shape):
    """How long the previous secret signs beside the new one."""

    overlap_hours: float = Field(
        OVERLAP_HOURS, ge=0.0, le=webhooks.LONGEST_OVERLAP_HOURS, description="0: it ends at once."
    )


def _judge(wanted: WantedWebhook, actor: Who, sender: ServerWebhookSender) -> None:
    """Resolve and check the address before the writing transaction, because that takes time and there is one writer."""
    webhooks.judge_address(actor, wanted.url, sender.targets)


def make_row(row: tables.Webhook, box: SecretBox, **more: str) -> RowWithFields:
    """Return a webhook with its state."""
    return RowWithFields(row, state=get_state(row, box), former_secret_until_utc=row.previous_until_utc, **more)


def _with_secret(row: tables.Webhook, secret: str, box: SecretBox) -> OperationResponse:
    headers = {"Cache-Control": "no-store", "Location": f"/api/v1/webhooks/{row.id}"}
    return OperationResponse(make_row(row, box, secret=secret), headers=headers, shown_once=("secret",))


@router.get("", summary="List webhooks", response_model=Page[Webhook])
def list_webhooks(actor: Who, session: Reading, page: Paged, box: SecretKeeper) -> Listing[RowWithFields]:
    """List webhooks, newest first."""
    return page.cut_whole(webhooks.list_webhooks(session, actor), lambda row: make_row(row, box))


@router.post(
    "",
    summary="Create a webhook",
    status_code=201,
    response_model=NewWebhook,
    dependencies=[Depends(_judge)],
)
def create_webhook(wanted: WantedWebhook, actor: Who, box: SecretKeeper, session: Writing) -> OperationResponse:
    """Send events to an address from now on. `secret` is in this answer and nowhere else.

    Every address that the host name resolves to is checked, now and before each message.
    """
    row, secret = webhooks.create_webhook(session, actor, box, **dict(wanted))
    return _with_secret(row, secret, box)


@router.post("/{webhook_id}:renew-secret", summary="Give it a new secret", response_model=NewWebhook)
def renew_webhook_secret(
    webhook_id: Id, actor: Who, box: SecretKeeper, session: Writing, renewal: Renewal | None = None
) -> OperationResponse:
    """Give a webhook a new secret; the previous one also signs for some hours, so that the receiver can change over."""
    hours = OVERLAP_HOURS if renewal is None else renewal.overlap_hours
    row, secret = webhooks.renew_secret(session, actor, box, webhook_id, overlap_hours=hours)
    return _with_secret(row, secret, box)


@router.get("/{webhook_id}", summary="Read a webhook", response_model=Webhook)
def get_webhook(webhook_id: Id, actor: Who, session: Reading, box: SecretKeeper) -> RowWithFields:
    """Read a webhook."""
    return make_row(webhooks.get_webhook(session, actor, webhook_id), box)


@router.post("/{webhook_id}:disable", summary="Disable a webhook", response_model=Webhook)
def disable_webhook(webhook_id: Id, actor: Who, box: SecretKeeper, session: Writing) -> RowWithFields:
    """Send nothing more to an address; its log stays."""
    return make_row(webhooks.disable_webhook(session, actor, webhook_id), box)


@router.post("/{webhook_id}:enable", summary="Enable a webhook", response_model=Webhook)
def enable_webhook(webhook_id: Id, actor: Who, box: SecretKeeper, session: Writing) -> RowWithFields:
    """Send events to an address again from now on."""
    return make_row(webhooks.enable_webhook(session, actor, webhook_id), box)


@router.post("/{webhook_id}:try", summary="Send a test message", status_code=202, response_model=WebhookDelivery)
def try_webhook(webhook_id: Id, actor: Who, session: Writing) -> tables.WebhookDelivery:
    """Queue a message without an event."""
    return webhooks.try_webhook(session, actor, webhook_id)


@router.get("/{webhook_id}/deliveries", summary="List messages", response_model=Page[WebhookDelivery])
def list_webhook_deliveries(
    webhook_id: Id, actor: Who, session: Reading, page: Paged
) -> Listing[tables.WebhookDelivery]:
    """List what was sent and what is to be sent, newest first."""
    return page.cut(webhooks.list_deliveries(session, actor, webhook_id, **page.rows))


@router.post(
    "/deliveries/{delivery_id}:redeliver",
    summary="Send a message again",
    status_code=202,
    response_model=WebhookDelivery,
)
def redeliver(delivery_id: Id, actor: Who, session: Writing) -> tables.WebhookDelivery:
    """Queue a message again with the same id and body."""
    return webhooks.redeliver(session, actor, delivery_id)
