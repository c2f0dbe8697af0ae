"""Approvals: the inbox, and signing: a decision, what it means, a comment and the password once more.

A second person may sign at another's console, with name and password.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, client_of, csrf
from boresight.api.passwords import Passwords
from boresight.pages.approval import MEANINGS, Words, request_page
from boresight.pages.attempts import Refusal, attempt
from boresight.pages.forms import read_texts, seen_version
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.pages.tables import Column, Table, all_of, csv_of, is_text, one_of, page_of, read_view
from boresight.services import approvals, gates, parameter_sets
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session, reading
from boresight.store.tables import Approval, ParameterSet, Signature

router = APIRouter(dependencies=[Depends(csrf)])

VIEWS = {
    "waiting": "Waiting for a signature",
    "mine": "Mine to sign",
    "submitted": "Submitted by me",
    "all": "All",
}
REQUESTS = Table(
    "approvals",
    "Requests for approval",
    (
        Column("request", "Request", "-request", "tight", head=True),
        Column("set", "Set, of sensor", "set", "named"),
        Column("gates", "Gates", "", "verdict-words"),
        Column("reason", "Reason", "", "words"),
        Column("by", "Submitted by", "by", "named"),
        Column("expires", "Signed, expires", "expires", "tight"),
        Column("asked", "Asked of", "", "named"),
        Column("part", "Your part", "", "act"),
    ),
    {"show": one_of(VIEWS), "q": is_text},
    "-request",
    kind="approvals",
    rows_a_page=100,
)
CSV_FIELDS = {
    "request": ("request", "kind", "state"),
    "set": ("set",),
    "gates": ("verdict",),
    "reason": ("reason",),
    "by": ("submitted_by", "submitted_utc"),
    "expires": ("signed", "needed", "expires_utc"),
}
EFFECTS = {
    "OPEN": "Signed: another person must sign too before the set is approved.",
    "APPROVED": "Approved: an operator can now promote the set to baseline.",
    "REJECTED": "Refused: the set cannot become baseline under this request.",
}


@dataclass(frozen=True)
class Entry:
    """One row of the inbox: a request, its set, its verdict, and why the reader may not sign it."""

    approval: Approval
    parameter_set: ParameterSet
    submitter: str
    verdict: str | None
    signed: int
    blocked: str | None


@router.get("/approvals", response_class=HTMLResponse)
def approvals_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the inbox: what waits for a signature, for one's own, what one submitted, or everything."""
    view = read_view(request, REQUESTS)
    show = view.where.get("show", "waiting")
    found = page_of(session, view, **_narrowed(show, actor))
    entries = _entries(request, session, actor, found.rows)
    return render(
        request,
        "approvals/approvals.html",
        view=view,
        entries=[entry for entry in entries if show != "mine" or entry.blocked is None],
        last=found.last,
        names=read_names(session, sensors_of=[entry.parameter_set for entry in entries]),
        views=VIEWS,
        show=show,
    )


@router.get("/approvals.csv")
def approvals_csv(request: Request, session: Reading, actor: Who) -> Response:
    """Give every request of a view as CSV."""
    view = read_view(request, REQUESTS)
    show = view.where.get("show", "waiting")
    entries = _entries(request, session, actor, list(all_of(session, view, **_narrowed(show, actor))))
    shown = (entry for entry in entries if show != "mine" or entry.blocked is None)
    return csv_of(view, CSV_FIELDS, (_csv_row(entry) for entry in shown))


def _narrowed(show: str, actor: Actor) -> dict[str, Any]:
    """Say what an inbox holds, as the list takes it; what one may sign is found among what waits."""
    return {
        "show": None,
        "state": "OPEN" if show in {"waiting", "mine"} else None,
        "submitted_by": actor.user_id if show == "submitted" else None,
    }


def _csv_row(entry: Entry) -> dict[str, Any]:
    """Lay out a request for a program."""
    known = entry.approval
    return {
        "request": known.id,
        "kind": known.kind,
        "state": known.state,
        "set": entry.parameter_set.name,
        "verdict": entry.verdict,
        "reason": known.reason,
        "submitted_by": entry.submitter,
        "submitted_utc": known.submitted_utc,
        "signed": entry.signed,
        "needed": known.needed,
        "expires_utc": known.expires_utc,
    }


def _entries(request: Request, session: Session, actor: Actor, found: Sequence[Approval]) -> list[Entry]:
    """Look up what the inbox says of each request."""
    names, policy = read_names(session), request.app.state.policy
    verdicts = gates.verdicts(session, {known.parameter_set_id for known in found})
    return [
        Entry(
            known,
            parameter_sets.get_parameter_set(session, known.parameter_set_id),
            names.person(known.submitted_by),
            verdicts.get(known.parameter_set_id),
            sum(one.decision == "APPROVE" for one in approvals.signatures_of(session, known.id)),
            approvals.why_not_sign(session, actor, known.id, policy=policy),
        )
        for known in found
    ]


@router.get("/approvals/{approval_id:int}", response_class=HTMLResponse)
def approval_page(request: Request, session: Reading, actor: Who, approval_id: int) -> HTMLResponse:
    """Show a request."""
    return request_page(request, session, actor, approval_id)


@router.post("/approvals/{approval_id:int}/sign")
async def sign(request: Request, actor: Who, approval_id: int) -> Response:
    """Sign a request: approve or refuse it."""
    return await _signed(request, actor, approval_id, "sign")


@router.post("/approvals/{approval_id:int}/sign-over-the-shoulder")
async def sign_over_the_shoulder(request: Request, actor: Who, approval_id: int) -> Response:
    """Let a second person sign at this console."""
    return await _signed(request, actor, approval_id, "shoulder")


async def _signed(request: Request, actor: Actor, approval_id: int, kind: str) -> Response:
    """Sign as the form says, and show the request, or why it was refused."""
    form = await read_texts(request)
    typed = Words(kind, *(form.get(name, "") for name in ("decision", "meaning", "comment", "name")))
    words = (typed.decision, typed.meaning.strip() or MEANINGS.get(typed.decision, ""), typed.comment)
    policy = request.app.state.policy
    checks: Passwords = request.app.state.passwords

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, *words, seen_version(form))

    async def prove() -> tuple[PasswordProof]:
        password, client = form.get("password", ""), client_of(request)
        if kind == "sign":
            return (await checks.check_own(actor, password, client),)
        return (await checks.check_beside(actor, typed.name, password, client, refuse),)

    def change(session: Session, proof: PasswordProof) -> tuple[Signature, str]:
        sign = approvals.sign if kind == "sign" else approvals.sign_over_the_shoulder
        made = sign(session, actor, approval_id, *words, proof, seen_version(form), policy=policy)
        return made, approvals.get_approval(session, approval_id).state

    outcome = await attempt(request, change, prove)
    if outcome.value is None:
        return await run_in_threadpool(_again, request, actor, approval_id, outcome.refusal, typed)
    return redirect(f"/approvals/{approval_id}", flash=EFFECTS[outcome.value[1]])


def _again(request: Request, actor: Actor, approval_id: int, refusal: Refusal | None, typed: Words) -> HTMLResponse:
    """Show a request with why it was not signed."""
    with reading(request.app.state.engine) as session:
        return request_page(request, session, actor, approval_id, refusal=refusal, typed=typed)
