"""Webhooks: who is told what happens, and every message that was sent. For administrators in person."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, Who, Writing
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import webhooks

router = APIRouter(prefix="/webhooks", tags=["webhooks"])


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


def _answer(row: Any) -> Answer:
    return Answer(schemas.written(schemas.Webhook, row))


def _delivery(row: Any, status: int = 200) -> Answer:
    return Answer(schemas.written(schemas.WebhookDelivery, row), status)


@router.get("", name="list_webhooks", summary="List webhooks", response_model=Page[schemas.Webhook])
def list_webhooks(actor: Who, session: Reading, page: Paged) -> Response:
    """List webhooks, newest first."""
    found = webhooks.list_webhooks(session, actor)
    return json_response(page.cut_whole(found, lambda row: schemas.written(schemas.Webhook, row)))


@router.post("", name="create_webhook", summary="Make a webhook", status_code=201, response_model=schemas.NewWebhook)
def create_webhook(wanted: WantedWebhook, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Tell an address what happens from now on. `secret` is in this answer and nowhere else."""

    def act() -> Answer:
        row = webhooks.create_webhook(session, actor, label=wanted.label, url=wanted.url, actions=wanted.actions)
        shown = schemas.written(schemas.Webhook, row)
        headers = {"Cache-Control": "no-store", "Location": f"/api/v1/webhooks/{row.id}"}
        return Answer({**shown, "secret": row.secret}, 201, headers, kept={**shown, "secret": None})

    return once.answer(session, actor, act)


@router.get(
    "/{webhook_id}",
    name="get_webhook",
    summary="Read a webhook",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def get_webhook(webhook_id: Id, actor: Who, session: Reading) -> Response:
    """Read a webhook."""
    return _answer(webhooks.get_webhook(session, actor, webhook_id)).response()


@router.post(
    "/{webhook_id}:disable",
    name="disable_webhook",
    summary="Tell it nothing more",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def disable_webhook(webhook_id: Id, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Tell an address nothing more; its log stays."""
    return once.answer(session, actor, lambda: _answer(webhooks.disable_webhook(session, actor, webhook_id)))


@router.post(
    "/{webhook_id}:enable",
    name="enable_webhook",
    summary="Tell it again",
    response_model=schemas.Webhook,
    responses=refusals(404),
)
def enable_webhook(webhook_id: Id, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Tell an address again what happens from now on."""
    return once.answer(session, actor, lambda: _answer(webhooks.enable_webhook(session, actor, webhook_id)))


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
