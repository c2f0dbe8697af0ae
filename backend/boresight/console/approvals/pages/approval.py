"""The inbox of requests, and one request on one page, in the order in which it should be read, the signature last.

A refused form comes back in its place with everything typed but the password.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.calibration import Calibration
from boresight.cameras.model import FAR_TYPICAL_SIGMAS
from boresight.console.access.dependencies import Reading, Who, csrf, get_client, get_server
from boresight.console.access.password_checks import PasswordWorker
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.pages.gates import make_gates_panel
from boresight.console.approvals.tables import Approval, Opening, Signature
from boresight.console.change_proposals import service as proposals
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import Beside
from boresight.console.pages.rendering import RefusalContext, attempt, read_texts, redirect, render, seen_version
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    accept_one,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.pages import find_bound_incumbent, read_set_and_incumbent
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.pages.list import read_names
from boresight.errors import NotFoundError
from boresight.figures import FIGURES, WIDE
from boresight.figures.tables import ParameterRow, set_rows
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.verdict import make_verdict_marks

CHANGE_FIGURE = "radial"
EVIDENCE_FIGURES = ("rms", "arc-uncertainty", "shadow", "two-halves", "observability", "parameters")
MEANINGS = {
    "APPROVE": "I reviewed the evidence and approve this set for baseline",
    "REFUSE": "I reviewed the evidence and refuse this set",
}


@dataclass(frozen=True)
class EvidenceItem:
    """A piece of evidence: its name in the store, its title, its address, and who first opened it when."""

    name: str
    title: str
    address: str
    opened: Sequence[Opening]


def list_evidence(
    session: Session, approval: Approval, row: ParameterSet, incumbent: ParameterSet | None
) -> list[EvidenceItem]:
    """Return the evidence that an approver can open, with who has opened it."""
    opened = approvals.list_openings(session, approval.id)
    return [
        EvidenceItem(name, title, address, [one for one in opened if one.evidence == name])
        for name, (title, address) in list_evidence_addresses(row, incumbent).items()
    ]


def list_evidence_addresses(row: ParameterSet, incumbent: ParameterSet | None) -> dict[str, tuple[str, str]]:
    """Return where each piece of evidence of a set is to be seen."""
    own = {
        "set": (f"{row.name}: values, identity, lineage", f"/parameter-sets/{row.id}"),
        "gate-report": ("Gates: every answer with its reason", f"/parameter-sets/{row.id}/gates"),
    }
    if row.run_id is None:
        return own
    run = {
        "run": (f"Run #{row.run_id}: convergence, RMS, observability", f"/runs/{row.run_id}"),
        "trust": ("Trust: two halves, efficiency, suspect stars", f"/runs/{row.run_id}?part=trust"),
        "matching": ("Matching: what was matched and lost", f"/runs/{row.run_id}?part=matching"),
    }
    if incumbent is not None and incumbent.run_id is not None:
        run["compare"] = (f"Beside {incumbent.name}", f"/compare?runs={incumbent.run_id},{row.run_id}")
    return run | own


@dataclass(frozen=True)
class TypedText:
    """What was typed into a form of the page, without its password."""

    form: str = ""
    decision: str = ""
    meaning: str = ""
    comment: str = ""
    name: str = ""
    text: str = ""


def list_warnings(result: Calibration | None, rows: Sequence[ParameterRow], *, is_ground: bool) -> list[str]:
    """List the warnings that an approver should read before signing."""
    said = [*result.advice] if result else []
    said += [
        f"{row.name} moves by {abs(row.delta_over_typical or 0.0):.1f} typical sigmas, more than"
        f" {FAR_TYPICAL_SIGMAS:g}: look at the matches before believing it."
        for row in rows
        if row.unexpected and row.estimated
    ]
    if result is not None and result.validation is None:
        said.append("No validation set: nothing outside the fitted frames says that this is better.")
    if is_ground:
        said.append("This is a ground calibration: declared, not estimated from telemetry.")
    return said


def request_page(
    request: Request,
    session: Session,
    actor: Actor,
    approval_id: int,
    *,
    refusal: RefusalContext | None = None,
    typed: TypedText | None = None,
) -> HTMLResponse:
    """Render a request, with a refused form's words in their place."""
    approval = session.get_known(Approval, approval_id)
    row = session.get_known(ParameterSet, approval.parameter_set_id)
    sensor = session.get_known(Sensor, row.sensor_id)
    incumbent = find_bound_incumbent(session, row, approval)
    result = runs.find_calibration(session, get_server(request).blobs, row.run_id) if row.run_id is not None else None
    rows = set_rows(*read_set_and_incumbent(row, incumbent), sensor.document["typical_sigma"])
    policy = get_server(request).policy
    has_figures = row.run_id is not None
    return render(
        request,
        "approvals/approval.html",
        refused=refusal,
        approval=approval,
        set=row,
        sensor=sensor,
        incumbent=incumbent,
        names=read_names(session),
        rows=rows,
        change_figure=FIGURES[CHANGE_FIGURE] if has_figures else None,
        panel=make_gates_panel(session, actor, row, report_sha256=approval.bound.get("gate_report_sha256")),
        marks=make_verdict_marks(result) if result else [],
        warnings=list_warnings(result, rows, is_ground=row.run_id is None),
        evidence=list_evidence(session, approval, row, incumbent),
        figures=[FIGURES[name] for name in EVIDENCE_FIGURES if has_figures],
        wide=WIDE,
        remarks=approvals.list_remarks(session, approval_id),
        signatures=approval_queries.list_signatures(session, approval_id),
        pending=proposals.list_open_proposals(session, row.sensor_id) if approval.state in {"OPEN", "APPROVED"} else [],
        signers=approvals.list_signers_of(session, approval_id, policy=policy) if approval.state == "OPEN" else [],
        blocked=approvals.explain_why_not_sign(session, actor, approval_id, policy=policy),
        decisions=_decisions(approval, row),
        meanings=MEANINGS.values(),
        refusal=refusal,
        typed=typed or TypedText(),
        may_speak=bool(actor.roles - {"viewer"}),
        may_promote="operator" in actor.roles,
        policy=policy,
    )


def _decisions(approval: Approval, row: ParameterSet) -> list[tuple[str, str]]:
    refuse = ("REFUSE", f"Refuse {row.name}")
    return [("APPROVE", f"Approve {row.name} for baseline"), refuse] if approval.state == "OPEN" else [refuse]


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
        TableColumn("request", "Request", "-request", "tight", head=True, csv=("request", "kind", "state")),
        TableColumn("set", "Set, of sensor", "set", "named", csv=("set",)),
        TableColumn("gates", "Gates", "", "verdict-words", csv=("verdict",)),
        TableColumn("reason", "Reason", "", "words", csv=("reason",)),
        TableColumn("by", "Submitted by", "by", "named", csv=("submitted_by", "submitted_utc")),
        TableColumn("expires", "Signed, expires", "expires", "tight", csv=("signed", "needed", "expires_utc")),
        TableColumn("asked", "Asked of", "", "named"),
        TableColumn("part", "Your part", "", "act"),
    ),
    {"show": accept_one(VIEWS), "q": is_text},
    "-request",
    kind="approvals",
    rows_a_page=100,
)
EFFECTS = {
    "OPEN": "Signed: another person must sign too before the set is approved.",
    "APPROVED": "Approved: an operator can now promote the set to baseline.",
    "REJECTED": "Refused: the set cannot become baseline under this request.",
}


@dataclass(frozen=True)
class InboxRow:
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
    found = read_page(session, view, **_narrowed(show, actor))
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
    entries = _entries(request, session, actor, list(read_all(session, view, **_narrowed(show, actor))))
    shown = (entry for entry in entries if show != "mine" or entry.blocked is None)
    return write_csv(view, (_csv_row(entry) for entry in shown))


def _narrowed(show: str, actor: Actor) -> dict[str, Any]:
    """Return the filters of an inbox view; requests that the actor may sign are chosen among the open ones."""
    return {
        "show": None,
        "state": "OPEN" if show in {"waiting", "mine"} else None,
        "submitted_by": actor.user_id if show == "submitted" else None,
    }


def _csv_row(entry: InboxRow) -> Beside:
    return Beside(
        entry.approval,
        request=entry.approval.id,
        set=entry.parameter_set.name,
        verdict=entry.verdict,
        submitted_by=entry.submitter,
        signed=entry.signed,
    )


def _entries(request: Request, session: Session, actor: Actor, found: Sequence[Approval]) -> list[InboxRow]:
    names, policy = read_names(session), get_server(request).policy
    verdicts = gates.read_verdicts(session, {known.parameter_set_id for known in found})
    return [
        InboxRow(
            known,
            session.get_known(ParameterSet, known.parameter_set_id),
            names.person(known.submitted_by),
            verdicts.get(known.parameter_set_id),
            sum(one.decision == "APPROVE" for one in approval_queries.list_signatures(session, known.id)),
            approvals.explain_why_not_sign(session, actor, known.id, policy=policy),
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
    typed = TypedText(kind, *(form.get(name, "") for name in ("decision", "meaning", "comment", "name")))
    meaning = typed.meaning.strip() or MEANINGS.get(typed.decision, "")
    decided = approvals.Decision(typed.decision, meaning, typed.comment)
    policy = get_server(request).policy
    checks: PasswordWorker = get_server(request).passwords

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, decided, seen_version(form))

    async def prove() -> tuple[PasswordProof]:
        password, client = form.get("password", ""), get_client(request)
        if kind == "sign":
            return (await checks.check_own(actor, password, client),)
        return (await checks.check_beside(actor, typed.name, password, client, refuse),)

    def change(session: Session, proof: PasswordProof) -> tuple[Signature, str]:
        sign = approvals.sign if kind == "sign" else approvals.sign_over_the_shoulder
        made = sign(session, actor, approval_id, decided, proof, seen_version(form), policy=policy)
        return made, session.get_known(Approval, approval_id).state

    outcome = await attempt(request, change, prove)
    if outcome.value is None:
        return await run_in_threadpool(_again, request, actor, approval_id, outcome.refusal, typed)
    return redirect(f"/approvals/{approval_id}", flash=EFFECTS[outcome.value[1]])


def _again(
    request: Request, actor: Actor, approval_id: int, refusal: RefusalContext | None, typed: TypedText
) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        return request_page(request, session, actor, approval_id, refusal=refusal, typed=typed)


@router.post("/approvals/{approval_id:int}/open")
async def open_evidence(
    request: Request, actor: Who, approval_id: int, evidence: Annotated[str, Form()] = ""
) -> Response:
    """Keep that a piece of evidence was opened, and go there."""
    with open_reading(get_server(request).engine) as session:
        row = session.get_known(ParameterSet, session.get_known(Approval, approval_id).parameter_set_id)
        incumbent = set_queries.find_baseline(session, row.sensor_id)
    known = list_evidence_addresses(row, incumbent)
    if evidence not in known:
        raise NotFoundError(f"There is no evidence {evidence!r} for this request; choose one of its list.")
    opening = partial(approvals.record_opening, actor=actor, approval_id=approval_id, evidence=evidence)
    outcome = await attempt(request, opening)
    if outcome.refusal is not None and outcome.refusal.is_ours:
        raise outcome.refusal.error  # an opening that was not stored would not count
    return redirect(known[evidence][1])


@router.post("/approvals/{approval_id:int}/remarks")
async def remark(
    request: Request, session: Reading, actor: Who, approval_id: int, text: Annotated[str, Form()] = ""
) -> Response:
    """Say something about a request."""
    outcome = await attempt(request, partial(approvals.add_remark, actor=actor, approval_id=approval_id, text=text))
    if outcome.value is None:
        typed = TypedText("remark", text=text)
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#discussion", flash="Your remark is kept.")


@router.post("/approvals/{approval_id:int}/assign")
async def assign(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Ask a person to decide on a request."""
    form = await read_texts(request)

    def change(session: Session) -> Approval:
        user_id = parse_row_id(form.get("person", ""))
        policy = get_server(request).policy
        return approvals.assign(session, actor, approval_id, user_id, seen_version(form), policy=policy)

    outcome = await attempt(request, change)
    if outcome.value is None:
        typed = TypedText("assign")
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#discussion", flash="The request shows whom it is asked of.")
