"""Approvals: the inbox, and a request in the order in which it should be read.

First why the requester wants it, then what changes, the evidence, the warnings, who has signed, and only then the
signature: a decision, what it means, a comment and the password once more. A refused signature comes back in its place
with everything typed but the password. The buttons name their effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES, WIDE
from boresight.figures.evidence import marks
from boresight.figures.parameter_table import UNEXPECTED_TYPICAL_SIGMAS, ParameterRow, set_rows
from boresight.pages.attempts import Refusal, attempt
from boresight.pages.parameter_sets import bound_incumbent
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.services import approvals, parameter_sets, runs, sensors
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Signature

router = APIRouter(dependencies=[Depends(csrf)])

VIEWS = {"waiting": "Waiting for a signature", "submitted": "Submitted by me", "all": "All"}
EVIDENCE_FIGURES = ("radial", "rms", "arc-uncertainty", "shadow", "two-halves", "observability", "parameters")
MEANINGS = {
    "APPROVE": "I reviewed the evidence and approve this set for baseline",
    "REFUSE": "I reviewed the evidence and refuse this set",
}


@dataclass(frozen=True)
class Entry:
    """One row of the inbox: a request, its set, and why the reader may not sign it."""

    approval: Approval
    parameter_set: ParameterSet
    submitter: str
    blocked: str | None


@router.get("/approvals", response_class=HTMLResponse)
def approvals_page(
    request: Request, session: Reading, actor: Who, show: str = "waiting", before: str = ""
) -> HTMLResponse:
    """Show the inbox: what waits for a signature, what one submitted, or everything."""
    view = show if show in VIEWS else "waiting"
    found = approvals.list_approvals(
        session,
        state="OPEN" if view == "waiting" else None,
        before_id=int(before) if before.isdecimal() else None,
        limit=101,
    )
    names = read_names(session)
    shown = [known for known in found[:100] if view != "submitted" or known.submitted_by == actor.user_id]
    entries = [
        Entry(
            known,
            parameter_sets.get_parameter_set(session, known.parameter_set_id),
            names.person(known.submitted_by),
            approvals.why_not_sign(session, actor, known.id, policy=request.app.state.policy),
        )
        for known in shown
    ]
    return render(
        request,
        "approvals.html",
        entries=entries,
        names=names,
        views=VIEWS,
        view=view,
        next_before=found[99].id if len(found) > 100 else None,
    )


@router.get("/approvals/{approval_id:int}", response_class=HTMLResponse)
def approval_page(request: Request, session: Reading, actor: Who, approval_id: int) -> HTMLResponse:
    """Show a request."""
    return _page(request, session, actor, approval_id)


@dataclass(frozen=True)
class Words:
    """The signature as it was typed, without its password."""

    decision: str = ""
    meaning: str = ""
    comment: str = ""


def warnings_of(result: Mapping[str, Any] | None, rows: Sequence[ParameterRow], *, is_ground: bool) -> list[str]:
    """Gather what an approver should have read before signing."""
    said = [str(sentence) for sentence in (result or {}).get("advice") or ()]
    said += [
        f"{row.name} moves by {abs(row.delta_over_typical or 0.0):.1f} typical sigmas, more than"
        f" {UNEXPECTED_TYPICAL_SIGMAS:g}: look at the matches before believing it."
        for row in rows
        if row.unexpected and row.estimated
    ]
    if result is not None and not result.get("validation"):
        said.append("No validation set: nothing outside the fitted frames says that this is better.")
    if is_ground:
        said.append("This is a ground calibration: declared, not estimated from telemetry.")
    return said


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    approval_id: int,
    *,
    refusal: Refusal | None = None,
    typed: Words | None = None,
) -> HTMLResponse:
    """Render a request, with a refused signature's words in their place."""
    approval = approvals.get_approval(session, approval_id)
    row = parameter_sets.get_parameter_set(session, approval.parameter_set_id)
    sensor = sensors.get_sensor(session, row.sensor_id)
    incumbent = bound_incumbent(session, row, approval)
    result = runs.result(session, request.app.state.blobs, row.run_id) if row.run_id is not None else None
    rows = set_rows(row.document, incumbent.document if incumbent else None, sensor.document)
    return render(
        request,
        "approval.html",
        status_code=409 if refusal else 200,
        approval=approval,
        set=row,
        sensor=sensor,
        incumbent=incumbent,
        names=read_names(session),
        rows=rows,
        marks=marks(result) if result else [],
        warnings=warnings_of(result, rows, is_ground=row.run_id is None),
        figures=[FIGURES[name] for name in EVIDENCE_FIGURES if row.run_id is not None],
        wide=WIDE,
        signatures=approvals.signatures_of(session, approval_id),
        blocked=approvals.why_not_sign(session, actor, approval_id, policy=request.app.state.policy),
        decisions=_decisions(approval, row),
        meanings=MEANINGS.values(),
        refusal=refusal,
        typed=typed or Words(),
        may_promote="operator" in actor.roles,
    )


def _decisions(approval: Approval, row: ParameterSet) -> list[tuple[str, str]]:
    """Name the effect of each decision that the request's state still has."""
    refuse = ("REFUSE", f"Refuse {row.name}")
    return [("APPROVE", f"Approve {row.name} for baseline"), refuse] if approval.state == "OPEN" else [refuse]


@router.post("/approvals/{approval_id:int}/sign")
async def sign(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Sign a request: approve or refuse it."""
    form = {key: value for key, value in (await request.form()).items() if isinstance(value, str)}
    typed = Words(form.get("decision", ""), form.get("meaning", ""), form.get("comment", ""))

    def change(session: Session) -> Signature:
        if not form.get("version", "").isdecimal():
            raise RefusedInputError("The form does not say which version you saw; reload the page and do it again.")
        version = int(form["version"])
        meaning = typed.meaning.strip() or MEANINGS.get(typed.decision, "")
        words = (typed.decision, meaning, typed.comment, form.get("password", ""))
        return approvals.sign(session, actor, approval_id, *words, version, policy=request.app.state.policy)

    outcome = await attempt(request, change)
    if outcome.value is None:
        page = partial(_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    effect = {
        "APPROVE": "Approved: an operator can now promote the set to baseline.",
        "REFUSE": "Refused: the set cannot become baseline under this request.",
    }
    return redirect(f"/approvals/{approval_id}", flash=effect[outcome.value.decision])
