"""Webhooks: who is told what happens, and every message that was sent. For administrators in person."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, Who, Writing
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import webhooks
from boresight.services.webhook_secrets import state_of
from boresight.store.secret_box import SecretBox

router = APIRouter(prefix="/webhooks", tags=["webhooks"])

OVERLAP_HOURS = 24.0


class WantedWebhook(BaseModel):
    """An address to be told what happens."""

    model_config = ConfigDict(extra="forbid")
    label: str = Field(description="Who listens there.", examples=["Mission chat"])
    url: str = Field(examples=["https://mission.example/hooks/boresight"])
    actions: Annotated[
        list[str],
        Field(
            description="Kinds of events, or a noun with a star. None: all.",
            examples=[["parameter-sets.promoted", "approvals.*"]],
        ),
    ] = []


class Renewal(BaseModel):
    """How long the former secret signs beside the new one."""

    model_config = ConfigDict(extra="forbid")
    overlap_hours: float = Field(
        OVERLAP_HOURS, ge=0.0, le=webhooks.LONGEST_OVERLAP_HOURS, description="0: it ends at once."
    )


def _judge(request: Request, wanted: WantedWebhook, actor: Who) -> None:
    """Look up where the address leads before the writing transaction: that takes time, and there is one writer."""
    webhooks.judge_address(actor, wanted.url, request.app.state.deliveries.targets)


def _box(request: Request) -> SecretBox:
    """Return what encrypts the secrets of this server's webhooks."""
    box: SecretBox = request.app.state.secret_box
    return box


Box = Annotated[SecretBox, Depends(_box)]
Judged = Annotated[None, Depends(_judge)]


def _shown(row: Any, box: SecretBox) -> schemas.Document:
    """Write a webhook without its secret."""
    names = ("id", "label", "url", "actions", "version", "created_utc", "created_by", "disabled_utc")
    former = {"former_secret_until_utc": row.previous_until_utc}
    return {**{name: getattr(row, name) for name in names}, "state": state_of(row, box), **former}


def _with_secret(row: Any, secret: str, box: SecretBox, status: int) -> Answer:
    """Show a secret this once."""
    shown = _shown(row, box)
    headers = {"Cache-Control": "no-store", "Location": f"/api/v1/webhooks/{row.id}"}
    return Answer({**shown, "secret": secret}, status, headers, kept={**shown, "secret": None})


def _answer(row: Any, box: SecretBox) -> Answer:
    return Answer(_shown(row, box))


def _delivery(row: Any, status: int = 200) -> Answer:
    return Answer(schemas.written(schemas.WebhookDelivery, row), status)


@router.get("", name="list_webhooks", summary="List webhooks", response_model=Page[schemas.Webhook])
def list_webhooks(actor: Who, session: Reading, page: Paged, box: Box) -> Response:
    """List webhooks, newest first."""
    found = webhooks.list_webhooks(session, actor)
    return json_response(page.cut_whole(found, lambda row: _shown(row, box)))


@router.post("", name="create_webhook", summary="Make a webhook", status_code=201, response_model=schemas.NewWebhook)
def create_webhook(
    wanted: WantedWebhook,
    actor: Who,
    once: Idempotent,
    judged: Judged,  # noqa: ARG001 - judged, or refused
    box: Box,
    session: Writing,
) -> Response:
    """Tell an address what happens from now on. `secret` is in this answer and nowhere else.

    The host is judged by every address that its name leads to, now and before each message.
    """

    def act() -> Answer:
        made = webhooks.create_webhook(session, actor, box, label=wanted.label, url=wanted.url, actions=wanted.actions)
        return _with_secret(*made, box, 201)

    return once.answer(session, actor, act)


@router.post(
    "/{webhook_id}:renew-secret",
    name="renew_webhook_secret",
    summary="Give it a new secret",
    response_model=schemas.NewWebhook,
    responses=refusals(404),
)
def renew_webhook_secret(
    webhook_id: Id, actor: Who, once: Idempotent, box: Box, session: Writing, renewal: Renewal | None = None
) -> Response:
    """Give a webhook a new secret; the former one signs beside it for some hours, so that the receiver can change over."""

    def act() -> Answer:
        hours = OVERLAP_HOURS if renewal is None else renewal.overlap_hours
        return _with_secret(*webhooks.renew_secret(session, actor, box, webhook_id, overlap_hours=hours), box, 200)

    return once.answer(session, actor, act)


@router.get(
    "/{webhook_id}",
    name="get_webhook",
    summary="Read a webhook",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def get_webhook(webhook_id: Id, actor: Who, session: Reading, box: Box) -> Response:
    """Read a webhook."""
    return _answer(webhooks.get_webhook(session, actor, webhook_id), box).response()


@router.post(
    "/{webhook_id}:disable",
    name="disable_webhook",
    summary="Tell it nothing more",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def disable_webhook(webhook_id: Id, actor: Who, once: Idempotent, box: Box, session: Writing) -> Response:
    """Tell an address nothing more; its log stays."""
    return once.answer(session, actor, lambda: _answer(webhooks.disable_webhook(session, actor, webhook_id), box))


@router.post(
    "/{webhook_id}:enable",
    name="enable_webhook",
    summary="Tell it again",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def enable_webhook(webhook_id: Id, actor: Who, once: Idempotent, box: Box, session: Writing) -> Response:
    """Tell an address again what happens from now on."""
    return once.answer(session, actor, lambda: _answer(webhooks.enable_webhook(session, actor, webhook_id), box))


@router.post(
    "/{webhook_id}:try",
    name="try_webhook",
    summary="Send a trial",
    status_code=202,
    response_model=schemas.WebhookDelivery,
    responses=refusals(404, 409),
)
def try_webhook(webhook_id: Id, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Queue a message that says nothing but that it came."""
    return once.answer(session, actor, lambda: _delivery(webhooks.try_webhook(session, actor, webhook_id), 202))


@router.get(
    "/{webhook_id}/deliveries",
    name="list_webhook_deliveries",
    summary="List messages",
    response_model=Page[schemas.WebhookDelivery],
    responses=refusals(404),
)
def list_webhook_deliveries(webhook_id: Id, actor: Who, session: Reading, page: Paged) -> Response:
    """List what was sent and what is to be sent, newest first."""
    found = webhooks.list_deliveries(session, actor, webhook_id, before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, lambda row: schemas.written(schemas.WebhookDelivery, row)))


@router.post(
    "/deliveries/{delivery_id}:redeliver",
    name="redeliver",
    summary="Send a message again",
    status_code=202,
    response_model=schemas.WebhookDelivery,
    responses=refusals(404, 409),
)
def redeliver(delivery_id: Id, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Queue a message once more; its id and its words stay."""
    return once.answer(session, actor, lambda: _delivery(webhooks.redeliver(session, actor, delivery_id), 202))
