"""The page of one's own second factors: enrol, name, remove, and recovery codes, each confirmed by the person first."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import segno
from fastapi import Depends, Form, Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import confirmations, second_factors
from boresight.console.access.dependencies import (
    Reading,
    ServerFactorRules,
    Who,
    csrf,
    get_factor_rules,
    get_needed,
    get_site,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.access.second_factors import FactorOffer
from boresight.console.access.tables import SecondFactor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    attempt,
    proof_of_own,
    read_again,
    read_texts,
    redirect,
    render,
)
from boresight.errors import BoresightError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id

router = PageRouter(prefix="/second-factor", dependencies=[Depends(csrf)])

KINDS = {"totp": "Authenticator app", "webauthn": "Security key"}


@dataclass(frozen=True)
class SecondFactorContext:
    """What a form left behind on the page: its refusal, an enrolment that was begun, codes that are shown once."""

    form: str = ""
    refusal: RefusalContext | None = None
    offer: FactorOffer | None = None
    codes: Sequence[str] = field(default=(), repr=False)
    label: str = ""


def _page(request: Request, actor: Actor, shown: SecondFactorContext, session: Session) -> HTMLResponse:
    rules = get_factor_rules(request)
    return render(
        request,
        "access/second_factor.html",
        refused=shown.refusal,
        shown=shown,
        rules=rules,
        kinds=KINDS,
        demanded=rules.demand(actor.roles),
        factors=second_factors.list_factors(session, actor),
        codes_left=second_factors.count_recovery_codes(session, actor),
        needed=get_needed(request, session, actor),
        qr=segno.make(shown.offer.uri, error="m").svg_data_uri(scale=5, border=3, dark="#000", light="#fff")
        if shown.offer and shown.offer.uri
        else "",
    )


@router.get("", response_class=HTMLResponse)
def second_factor_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show one's second factors."""
    return _page(request, actor, SecondFactorContext(), session)


async def _confirmed(
    request: Request,
    actor: Actor,
    change: Callable[[Session], Any],
    shown: Callable[[Any], SecondFactorContext | str],
    form: str,
) -> Response:
    """Make a change that the person confirms, and show what came of it: on the page, or a line after a redirect."""
    texts = await read_texts(request)

    def confirm_and_change(session: Session, proof: PasswordProof) -> Any:
        confirmations.require(session, actor, proof)
        return change(session)

    prepare: Callable[[], Awaitable[Sequence[object]]] = proof_of_own(request, actor, texts)
    outcome = await attempt(request, confirm_and_change, prepare)
    result = SecondFactorContext(form, outcome.refusal) if outcome.value is None else shown(outcome.value)
    if isinstance(result, str):
        return redirect("/second-factor", flash=result)
    return await read_again(request, partial(_page, request, actor, result))


@router.post("/begin", response_class=HTMLResponse)
async def begin(
    request: Request, actor: Who, rules: ServerFactorRules, kind: Annotated[str, Form()] = "totp"
) -> Response:
    """Begin to enrol a second factor: show the QR code of an app, or what a security key is asked."""
    change = partial(second_factors.offer, actor=actor, kind=kind, rules=rules, site=get_site(request))
    return await _confirmed(request, actor, change, lambda offer: SecondFactorContext(offer=offer), kind)


@router.post("/enrol", response_class=HTMLResponse)
async def enrol(
    request: Request,
    actor: Who,
    rules: ServerFactorRules,
    challenge: Annotated[str, Form()] = "",
    label: Annotated[str, Form()] = "",
    factor: Annotated[str, Form()] = "",
) -> Response:
    """Enrol what was begun, and show the recovery codes that come with the first one."""
    number, site = parse_row_id(challenge) or 0, get_site(request)

    def change(session: Session) -> tuple[SecondFactor, list[str] | None]:
        return second_factors.enrol(session, actor, number, label, factor, rules, site)

    outcome = await attempt(request, change)
    if outcome.value is not None:
        made, codes = outcome.value
        if codes is None:
            return redirect("/second-factor", flash=f"{made.label} is enrolled. Every other log-in of yours has ended.")
        return await read_again(request, partial(_page, request, actor, SecondFactorContext(codes=codes)))

    def render_again(session: Session) -> HTMLResponse:
        try:
            offer = second_factors.find_offer(session, actor, number, rules, site)
        except BoresightError:  # it is over, as the refusal says
            offer = None
        return _page(request, actor, SecondFactorContext("enrol", outcome.refusal, offer, label=label), session)

    return await read_again(request, render_again)


@router.post("/recovery-codes", response_class=HTMLResponse)
async def renew_recovery_codes(request: Request, actor: Who) -> Response:
    """Make new recovery codes, and show them this once."""
    change = partial(second_factors.renew_recovery_codes, actor=actor)
    return await _confirmed(request, actor, change, lambda codes: SecondFactorContext(codes=codes), "codes")


@router.post("/{factor_id:int}/remove", response_class=HTMLResponse)
async def remove(request: Request, actor: Who, rules: ServerFactorRules, factor_id: int) -> Response:
    """Remove a second factor."""
    change = partial(second_factors.remove, actor=actor, factor_id=factor_id, rules=rules)
    return await _confirmed(request, actor, change, lambda gone: f"{gone.label} is removed.", "remove")
