"""Webhooks: the list, a trial message, and the log of every message with its outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Reading, SecretKeeper, Who, csrf
from boresight.console.jobs.dependencies import ServerWebhookSender
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, make_change, read_again, redirect_refused, render
from boresight.console.webhooks import service as webhooks
from boresight.console.webhooks.secrets import get_state
from boresight.errors import BoresightError
from boresight.platform.actors import Actor
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id

router = PageRouter(dependencies=[Depends(csrf)])

ROWS_A_PAGE = 50


@dataclass(frozen=True)
class WebhooksContext:
    """The state of a form: its refusal, what was typed, a secret that is shown once."""

    refusal: RefusalContext | None = None
    typed: Mapping[str, str] = field(default_factory=dict)
    secret: str = ""


@router.get("/webhooks", response_class=HTMLResponse)
def webhooks_page(request: Request, session: Reading, actor: Who, box: SecretKeeper) -> HTMLResponse:
    """Show every webhook, and the form for another."""
    return _page(request, actor, box, WebhooksContext(), session)


def _page(request: Request, actor: Actor, box: SecretBox, shown: WebhooksContext, session: Session) -> HTMLResponse:
    may = "administrator" in actor.roles
    return render(
        request,
        "webhooks/webhooks.html",
        refused=shown.refusal,
        may=may,
        hooks=webhooks.list_webhooks(session, actor) if may else [],
        state_of=partial(get_state, box=box),
        shown=shown,
    )


@router.post("/webhooks", response_class=HTMLResponse)
async def create(
    request: Request,
    actor: Who,
    box: SecretKeeper,
    sender: ServerWebhookSender,
    label: Annotated[str, Form()] = "",
    url: Annotated[str, Form()] = "",
    actions: Annotated[str, Form()] = "",
) -> Response:
    """Make a webhook and show its secret, this once."""
    wanted = actions.replace(",", " ").split()
    typed = {"label": label, "url": url, "actions": actions}
    try:
        await run_in_threadpool(webhooks.judge_address, actor, url, sender.targets)
    except BoresightError as error:
        return await read_again(
            request, partial(_page, request, actor, box, WebhooksContext(RefusalContext.of(error), typed))
        )
    change = partial(webhooks.create_webhook, actor=actor, box=box, label=label, url=url, actions=wanted)
    outcome = await attempt(request, change)
    shown = (
        WebhooksContext(outcome.refusal, typed) if outcome.value is None else WebhooksContext(secret=outcome.value[1])
    )
    return await read_again(request, partial(_page, request, actor, box, shown))


@router.get("/webhooks/{webhook_id:int}", response_class=HTMLResponse)
def webhook_page(
    request: Request, session: Reading, actor: Who, box: SecretKeeper, webhook_id: int, before: str = ""
) -> HTMLResponse:
    """Show a webhook with its messages, newest first."""
    return _webhook_page(request, actor, box, webhook_id, session, before)


def _webhook_page(
    request: Request,
    actor: Actor,
    box: SecretBox,
    webhook_id: int,
    session: Session,
    before: str = "",
    secret: str = "",
) -> HTMLResponse:
    before_id = parse_row_id(before)
    hook = webhooks.get_webhook(session, actor, webhook_id)
    found = webhooks.list_deliveries(session, actor, webhook_id, before_id=before_id, limit=ROWS_A_PAGE + 1)
    return render(
        request,
        "webhooks/webhook.html",
        hook=hook,
        state=get_state(hook, box),
        secret=secret,
        deliveries=found[:ROWS_A_PAGE],
        next_before=found[ROWS_A_PAGE - 1].id if len(found) > ROWS_A_PAGE else None,
    )


@router.post("/webhooks/{webhook_id:int}/try", response_class=HTMLResponse)
async def try_webhook(request: Request, actor: Who, webhook_id: int) -> Response:
    """Queue a trial."""
    change = partial(webhooks.try_webhook, actor=actor, webhook_id=webhook_id)
    return await make_change(
        request, change, f"/webhooks/{webhook_id}", "The test message is queued: reload to see its outcome."
    )


@router.post("/webhooks/{webhook_id:int}/renew-secret", response_class=HTMLResponse)
async def renew_secret(
    request: Request, actor: Who, box: SecretKeeper, webhook_id: int, overlap_hours: Annotated[str, Form()] = "24"
) -> Response:
    """Give a webhook a new secret and show it, this once."""
    hours = 0.0 if overlap_hours == "0" else 24.0
    change = partial(webhooks.renew_secret, actor=actor, box=box, webhook_id=webhook_id, overlap_hours=hours)
    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        return redirect_refused(f"/webhooks/{webhook_id}", outcome.refusal)
    secret = outcome.made[1]
    return await read_again(request, partial(_webhook_page, request, actor, box, webhook_id, secret=secret))


@router.post("/webhooks/{webhook_id:int}/disable", response_class=HTMLResponse)
async def disable(request: Request, actor: Who, webhook_id: int) -> Response:
    """Disable a webhook."""
    change = partial(webhooks.disable_webhook, actor=actor, webhook_id=webhook_id)
    return await make_change(request, change, f"/webhooks/{webhook_id}", "Disabled: it receives no more events.")


@router.post("/webhooks/{webhook_id:int}/enable", response_class=HTMLResponse)
async def enable(request: Request, actor: Who, webhook_id: int) -> Response:
    """Enable a webhook."""
    change = partial(webhooks.enable_webhook, actor=actor, webhook_id=webhook_id)
    return await make_change(request, change, f"/webhooks/{webhook_id}", "Enabled: it receives events from now on.")


@router.post("/webhooks/{webhook_id:int}/deliveries/{delivery_id:int}/redeliver", response_class=HTMLResponse)
async def redeliver(request: Request, actor: Who, webhook_id: int, delivery_id: int) -> Response:
    """Queue a message once more."""
    change = partial(webhooks.redeliver, actor=actor, delivery_id=delivery_id)
    return await make_change(request, change, f"/webhooks/{webhook_id}", "The message is queued again.")
