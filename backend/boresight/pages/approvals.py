"""Approvals: the inbox, and signing: a decision, what it means, a comment and the password once more.

A second person may sign at another's console, with name and password.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.pages.approval import MEANINGS, Words, request_page
from boresight.pages.attempts import attempt
from boresight.pages.forms import read_texts, seen_version
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.services import approvals, gates, parameter_sets
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Signature

router = APIRouter(dependencies=[Depends(csrf)])

VIEWS = {
    "waiting": "Waiting for a signature",
    "mine": "Mine to sign",
    "submitted": "Submitted by me",
    "all": "All",
}
ROWS_A_PAGE = 100
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
def approvals_page(
    request: Request, session: Reading, actor: Who, show: str = "waiting", before: str = ""
) -> HTMLResponse:
    """Show the inbox: what waits for a signature, for one's own, what one submitted, or everything."""
    view = show if show in VIEWS else "waiting"
    found = approvals.list_approvals(
        session,
        state="OPEN" if view in {"waiting", "mine"} else None,
        before_id=int(before) if before.isdecimal() else None,
        limit=ROWS_A_PAGE + 1,
    )
    entries = _entries(request, session, actor, found[:ROWS_A_PAGE])
    if view == "mine":
        entries = [entry for entry in entries if entry.blocked is None]
    if view == "submitted":
        entries = [entry for entry in entries if entry.approval.submitted_by == actor.user_id]
    return render(
        request,
        "approvals.html",
        entries=entries,
        names=read_names(session),
        views=VIEWS,
        view=view,
        next_before=found[ROWS_A_PAGE - 1].id if len(found) > ROWS_A_PAGE else None,
    )


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
async def sign(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Sign a request: approve or refuse it."""
    return await _signed(request, session, actor, approval_id, "sign")


@router.post("/approvals/{approval_id:int}/sign-over-the-shoulder")
async def sign_over_the_shoulder(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Let a second person sign at this console."""
    return await _signed(request, session, actor, approval_id, "shoulder")


async def _signed(request: Request, session: Session, actor: Actor, approval_id: int, kind: str) -> Response:
    """Sign as the form says, and show the request, or why it was refused."""
    form = await read_texts(request)
    typed = Words(kind, *(form.get(name, "") for name in ("decision", "meaning", "comment", "name")))
    policy = request.app.state.policy

    def change(session: Session) -> tuple[Signature, str]:
        words = (typed.decision, typed.meaning.strip() or MEANINGS.get(typed.decision, ""), typed.comment)
        seen, password = seen_version(form), form.get("password", "")
        if kind == "sign":
            made = approvals.sign(session, actor, approval_id, *words, password, seen, policy=policy)
        else:
            named = (typed.name, password, seen)
            made = approvals.sign_over_the_shoulder(session, actor, approval_id, *words, *named, policy=policy)
        return made, approvals.get_approval(session, approval_id).state

    outcome = await attempt(request, change)
    if outcome.value is None:
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}", flash=EFFECTS[outcome.value[1]])
