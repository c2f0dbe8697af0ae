"""A person's addresses for messages: what goes to which, when not, a test, and what became of each message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Reading, SecretKeeper, Who, csrf
from boresight.console.access.preferences import get_time_style
from boresight.console.jobs.dependencies import ServerMessageSender
from boresight.console.messages import queries
from boresight.console.messages import service as messages
from boresight.console.messages.kinds import KINDS
from boresight.console.messages.service import AddressChoice, Outlets
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, make_change, read_again, redirect, render
from boresight.errors import BoresightError
from boresight.platform.actors import Actor
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import list_zones
from boresight.platform.web.paging import parse_row_id

router = PageRouter(prefix="/preferences/messages", dependencies=[Depends(csrf)])

ROWS_A_PAGE = 50
#: Of a new address, until its person chooses otherwise.
FIRST_KINDS = (
    "signature-waits",
    "alignment-waits",
    "request-decided",
    "mention",
    "alarm-assigned",
    "request-assigned",
    "alarm",
    "run-failed",
    "ingest-asks",
)


@dataclass(frozen=True)
class MessagesContext:
    """The state of the form for another address: its refusal and what was typed, but never the address."""

    refusal: RefusalContext | None = None
    typed: Mapping[str, str] = field(default_factory=dict)
    kinds: Sequence[str] = FIRST_KINDS


@router.get("", response_class=HTMLResponse)
def messages_page(
    request: Request, session: Reading, actor: Who, box: SecretKeeper, sender: ServerMessageSender
) -> HTMLResponse:
    """Show where a person gets messages, and the form for another address."""
    return _page(request, actor, box, sender.outlets, MessagesContext(), session)


def _page(
    request: Request, actor: Actor, box: SecretBox, outlets: Outlets, shown: MessagesContext, session: Session
) -> HTMLResponse:
    addresses = messages.list_addresses(session, actor)
    return render(
        request,
        "messages/messages.html",
        refused=shown.refusal,
        shown=shown,
        addresses=addresses,
        newest=queries.read_newest(session, [row.id for row in addresses]),
        state_of=partial(messages.get_state, box=box),
        services=[one for one in outlets.services if one != messages.MAIL or outlets.mail_server],
        mail=bool(outlets.mail_server) and messages.MAIL in outlets.services,
        kinds=KINDS,
        zone=get_time_style(session, actor.user_id).zone,
    )


@router.post("", response_class=HTMLResponse)
async def add(
    request: Request,
    actor: Who,
    box: SecretKeeper,
    sender: ServerMessageSender,
    address: Annotated[str, Form()] = "",
    label: Annotated[str, Form()] = "",
    kinds: Annotated[list[str] | None, Form()] = None,
) -> Response:
    """Add an address."""
    shown = partial(MessagesContext, typed={"label": label}, kinds=kinds or [])
    again = partial(_page, request, actor, box, sender.outlets)
    try:
        normal, checked = await run_in_threadpool(sender.judge_address, actor, address)
    except BoresightError as error:
        return await read_again(request, partial(again, shown(RefusalContext.of(error))))
    choice = AddressChoice(tuple(kinds or ()))
    change = partial(
        messages.add_address, actor=actor, box=box, label=label, address=normal, checked=checked, choice=choice
    )
    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        return await read_again(request, partial(again, shown(outcome.refusal)))
    said = f"{outcome.made.shown} is added. Send a test message to see whether it arrives."
    return redirect(f"/preferences/messages/{outcome.made.id}", flash=said)


@router.get("/{address_id:int}", response_class=HTMLResponse)
def address_page(
    request: Request, session: Reading, actor: Who, box: SecretKeeper, address_id: int, before: str = ""
) -> HTMLResponse:
    """Show an address with its choice and its messages, newest first."""
    row = messages.get_address(session, actor, address_id)
    before_id = parse_row_id(before)
    found = messages.list_messages(session, actor, address_id, before_id=before_id, limit=ROWS_A_PAGE + 1)
    return render(
        request,
        "messages/address.html",
        row=row,
        state=messages.get_state(row, box),
        kinds=KINDS,
        zones=list_zones(),
        zone=get_time_style(session, actor.user_id).zone,
        found=found[:ROWS_A_PAGE],
        next_before=found[ROWS_A_PAGE - 1].id if len(found) > ROWS_A_PAGE else None,
    )


@router.post("/{address_id:int}", response_class=HTMLResponse)
async def change(
    request: Request,
    actor: Who,
    address_id: int,
    kinds: Annotated[list[str] | None, Form()] = None,
    quiet_from: Annotated[str, Form()] = "",
    quiet_until: Annotated[str, Form()] = "",
    quiet_zone: Annotated[str, Form()] = "",
) -> Response:
    """Choose kinds and quiet hours."""
    choice = AddressChoice(tuple(kinds or ()), quiet_from.strip(), quiet_until.strip(), quiet_zone.strip())
    make = partial(messages.change_address, actor=actor, address_id=address_id, choice=choice)
    return await make_change(request, make, f"/preferences/messages/{address_id}", "Saved.")


@router.post("/{address_id:int}/try", response_class=HTMLResponse)
async def try_address(request: Request, actor: Who, address_id: int) -> Response:
    """Queue a test message."""
    make = partial(messages.try_address, actor=actor, address_id=address_id)
    said = "The test message is queued: reload to see its outcome."
    return await make_change(request, make, f"/preferences/messages/{address_id}", said)


@router.post("/{address_id:int}/remove", response_class=HTMLResponse)
async def remove(request: Request, actor: Who, address_id: int) -> Response:
    """Remove an address."""
    make = partial(messages.remove_address, actor=actor, address_id=address_id)
    return await make_change(request, make, "/preferences/messages", "The address was deleted.")
