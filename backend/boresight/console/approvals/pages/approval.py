"""The inbox of requests, one request as a review beside the panel where it is signed, and the page that confirms a decision.

Requests for alignments stand in the inbox too, and are signed on the page of their alignment. A refused form comes back in its
place with everything typed but the password.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.calibration import Calibration
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import Reading, Who, check_own, csrf, get_client, get_needed, get_server
from boresight.console.access.password_checks import PasswordWorker
from boresight.console.access.passwords import PasswordProof
from boresight.console.alignments import approval as alignment_approval
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals import gates, review, staleness, threads
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.pages.gates import make_gates_panel
from boresight.console.approvals.review import Acknowledgement, Point
from boresight.console.approvals.tables import Approval, Remark, Signature, Thread
from boresight.console.approvals.threads import MENTION
from boresight.console.change_proposals import service as proposals
from boresight.console.fleet import queries as sensor_rows
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    attempt,
    make_change,
    read_texts,
    redirect,
    render,
    seen_version,
)
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    TableView,
    accept_one,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.parameter_sets.pages import find_bound_incumbent, read_set_and_incumbent
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.pages.list import read_names
from boresight.console.uplinks.stations import make_workflow
from boresight.errors import NotFoundError
from boresight.figures import FIGURES, Figure
from boresight.figures.tables import set_rows
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.answers import make_four_views
from boresight.verdicts.gates import GATES
from boresight.verdicts.gates.judgement import GateReport


@dataclass(frozen=True)
class SigningView:
    """A figure that is opened before signing: what the run answers in a sentence, and when this reader opened it."""

    point: Point
    figure: Figure
    answer: str


def make_views(points: Sequence[Point], result: Calibration | None) -> list[SigningView]:
    """Return the figures of a request, each with its answer."""
    said = {} if result is None else {view.figure: view.answer.sentence for view in make_four_views(result)}
    return [
        SigningView(point, FIGURES[point.name], said.get(point.name, "Open it to see the answer."))
        for point in points
        if point.kind == review.EVIDENCE
    ]


def list_further_evidence(row: ParameterSet, incumbent: ParameterSet | None) -> list[tuple[str, str]]:
    """Return title and address of what else there is to read about a set."""
    found = [
        (f"{row.name}: values, identity, lineage", f"/parameter-sets/{row.id}"),
        ("Gates: assess, waive", f"/parameter-sets/{row.id}/gates"),
    ]
    if row.run_id is not None:
        found.append((f"Run #{row.run_id}", f"/runs/{row.run_id}"))
        if incumbent is not None and incumbent.run_id is not None:
            found.append((f"Compare with {incumbent.name}", f"/compare?runs={incumbent.run_id},{row.run_id}"))
    return found


@dataclass(frozen=True)
class TypedText:
    """What was typed into a form of the page, without its password."""

    form: str = ""
    decision: str = ""
    meaning: str = ""
    comment: str = ""
    name: str = ""
    text: str = ""
    about: tuple[str, str] = ("", "")
    reasons: Mapping[tuple[str, str], str] = field(default_factory=dict)
    ticked: frozenset[tuple[str, str]] = frozenset()


def cut_at_mentions(remark: Remark) -> list[tuple[str, bool]]:
    """Cut a remark into pieces, those that mention a person marked."""
    pieces = MENTION.split(remark.text)
    return [(f"@{piece}" if i % 2 else piece, bool(i % 2)) for i, piece in enumerate(pieces) if piece]


def group_threads(found: Sequence[Thread]) -> dict[tuple[str, str], list[Thread]]:
    """Group threads by what they are about."""
    grouped: dict[tuple[str, str], list[Thread]] = {}
    for thread in found:
        grouped.setdefault((thread.kind, thread.name), []).append(thread)
    return grouped


def title_thread(kind: str, name: str) -> str:
    """Return what a thread is about, as the page calls it; a gate that is no more has its name alone."""
    titles = {"gate": {gate.name: gate.title for gate in GATES.values()}, "figure": review.VIEWS}
    return f"{kind} {titles.get(kind, {}).get(name, name)}"


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
    points = review.list_points(session, approval, actor.user_id)
    found = threads.list_threads(session, approval_id)
    changed = [one for one in rows if one.delta]
    blocked = approvals.explain_why_not_sign(session, actor, approval_id, policy=policy)
    panel = make_gates_panel(session, actor, row, report_sha256=approval.binding.gate_report_sha256)
    return render(
        request,
        "approvals/approval.html",
        refused=refusal,
        approval=approval,
        set=row,
        sensor=sensor,
        workflow=make_workflow(session, actor, policy, row),
        incumbent=incumbent,
        names=read_names(session),
        rows=rows,
        changed=changed if incumbent is not None else rows,
        staying=len(rows) - len(changed),
        panel=panel,
        points=points,
        threads=group_threads(found),
        title_thread=title_thread,
        open_threads=sum(thread.state == "OPEN" for thread in found),
        views=make_views(points, result),
        further=list_further_evidence(row, incumbent),
        cut_at_mentions=cut_at_mentions,
        read_points=review.read_points,
        longest_reason=review.LONGEST_REASON,
        remarks=approvals.list_remarks(session, approval_id),
        signatures=approval_queries.list_signatures(session, approval_id),
        pending=proposals.list_open_proposals(session, row.sensor_id) if approval.state in {"OPEN", "APPROVED"} else [],
        signers=approvals.list_request_signers(session, approval_id, policy=policy) if approval.state == "OPEN" else [],
        blocked=blocked or staleness.explain_outdated(session, approval, row),
        decisions=_decisions(approval, row),
        meanings=approvals.MEANINGS.values(),
        refusal=refusal,
        typed=typed or TypedText(),
        may_speak=bool(actor.roles - {"viewer"}),
        needed=get_needed(request, session, actor),
    )


def _decisions(approval: Approval, row: ParameterSet) -> list[tuple[str, str]]:
    refuse = ("REFUSE", f"Refuse {row.name}")
    return [("APPROVE", f"Approve {row.name} for baseline"), refuse] if approval.state == "OPEN" else [refuse]


router = PageRouter(dependencies=[Depends(csrf)])

VIEWS = {
    "waiting": "Waiting for a signature",
    "mine": "For me to sign",
    "submitted": "Submitted by me",
    "all": "All",
}
SHOWN_FIRST = "waiting"
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
        TableColumn("asked", "Assigned to", "", "named"),
        TableColumn("part", "Your action", "", "act"),
    ),
    {"show": accept_one(VIEWS), "q": is_text},
    "-request",
    kind="approvals",
    rows_a_page=100,
)


@dataclass(frozen=True)
class InboxRow:
    """One row of the inbox: a request, its set, its gates, and why the reader may not sign it."""

    approval: Approval
    parameter_set: ParameterSet
    submitter: str
    gates: GateReport | None
    signed: int
    blocked: str | None


@dataclass(frozen=True)
class AlignmentRow:
    """A request for an alignment in the inbox, and why the reader may not sign it."""

    asked: AlignmentRequest
    alignment: Alignment
    sensors: str
    blocked: str | None


def _list_alignments(
    request: Request, session: Session, actor: Actor, view: TableView, *, limit: int | None = None
) -> list[AlignmentRow]:
    """Return the requests for alignments of an inbox view, newest first; at most `limit`."""
    show = view.where.get("show", SHOWN_FIRST)
    where = {name: value for name, value in _narrowed(show, actor).items() if name != "show"}
    found = lists.list_newest(session, AlignmentRequest, limit=limit, q=view.where.get("q"), **where)
    policy, listed = get_server(request).policy, []
    for one in found:
        row = session.get_known(Alignment, one.alignment_id)
        names = sensor_rows.read_names(session, {row.sensor_a_id, row.sensor_b_id})
        blocked = alignment_approval.explain_why_not_sign(session, actor, one, policy)
        listed.append(AlignmentRow(one, row, f"{names[row.sensor_a_id]} to {names[row.sensor_b_id]}", blocked))
    return [one for one in listed if show != "mine" or one.blocked is None]


@router.get("/approvals", response_class=HTMLResponse)
def approvals_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the inbox: what waits for a signature, for one's own, what one submitted, or everything."""
    view = read_view(request, REQUESTS)
    show = view.where.get("show", SHOWN_FIRST)
    found = read_page(session, view, **_narrowed(show, actor))
    entries = _entries(request, session, actor, found.rows)
    alignments = [] if view.before else _list_alignments(request, session, actor, view, limit=REQUESTS.rows_a_page)
    return render(
        request,
        "approvals/approvals.html",
        view=view,
        alignments=alignments,
        entries=[entry for entry in entries if show != "mine" or entry.blocked is None],
        last=found.last,
        names=read_names(session, sensors_of=[entry.parameter_set for entry in entries]),
        views=VIEWS,
        show=show,
    )


@router.get("/approvals.csv")
def approvals_csv(request: Request, session: Reading, actor: Who) -> Response:
    """Give every request of a view as CSV, those for alignments first."""
    view = read_view(request, REQUESTS)
    show = view.where.get("show", SHOWN_FIRST)
    alignments = _list_alignments(request, session, actor, view)
    entries = _entries(request, session, actor, list(read_all(session, view, **_narrowed(show, actor))))
    shown = (entry for entry in entries if show != "mine" or entry.blocked is None)
    names = read_names(session)
    of_alignments = [_alignment_csv_row(one, names.person(one.asked.submitted_by)) for one in alignments]
    return write_csv(view, (*of_alignments, *map(_csv_row, shown)))


def _narrowed(show: str, actor: Actor) -> dict[str, Any]:
    """Return the filters of an inbox view; requests that the actor may sign are chosen among the open ones."""
    return {
        "show": None,
        "state": "OPEN" if show in {"waiting", "mine"} else None,
        "submitted_by": actor.user_id if show == "submitted" else None,
    }


def _csv_row(entry: InboxRow) -> RowWithFields:
    return RowWithFields(
        entry.approval,
        request=entry.approval.id,
        set=entry.parameter_set.name,
        verdict=None if entry.gates is None else entry.gates.words,
        submitted_by=entry.submitter,
        signed=entry.signed,
    )


def _alignment_csv_row(one: AlignmentRow, submitter: str) -> RowWithFields:
    """One row of the CSV file; requests for alignments have numbers of their own, which `kind` tells from the others'."""
    return RowWithFields(
        one.asked,
        request=one.asked.id,
        kind="ALIGNMENT",
        set=f"Alignment {one.alignment.id}: {one.sensors}",
        verdict=one.alignment.verdict,
        submitted_by=submitter,
        signed=int(one.asked.state == "APPROVED"),
        needed=1,
        expires_utc=None,
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
    typed = read_signing(kind, form)
    given = [Acknowledgement(*key, typed.reasons.get(key, "")) for key in sorted(typed.ticked)]
    says_itself = not typed.meaning.strip()
    decided = approvals.Decision(typed.decision, typed.meaning, typed.comment, given, says_itself=says_itself)
    policy = get_server(request).policy
    checks: PasswordWorker = get_server(request).passwords

    def refuse(session: Session) -> None:
        approvals.refuse_beside(session, actor, approval_id, decided, seen_version(form))

    async def prove() -> tuple[PasswordProof]:
        client = get_client(request)
        if kind == "sign":
            return (await check_own(request, actor, form.get("password", ""), form.get("factor", "")),)
        password, factor = form.get("their_password", ""), form.get("their_factor", "")
        return (await checks.check_beside(actor, typed.name, password, client, refuse, factor),)

    def change(session: Session, proof: PasswordProof) -> int:
        sign = approvals.sign if kind == "sign" else approvals.sign_over_the_shoulder
        return sign(session, actor, approval_id, decided, proof, seen_version(form), policy=policy).id

    outcome = await attempt(request, change, prove)
    if outcome.value is None:
        return await run_in_threadpool(_render_again, request, actor, approval_id, outcome.refusal, typed)
    return redirect(f"/approvals/{approval_id}/signatures/{outcome.value}")


def read_signing(kind: str, form: Mapping[str, str]) -> TypedText:
    """Read what was typed into the form of a signature; a tick is `tick:KIND:NAME`, its reason `reason:KIND:NAME`.

    `their:KIND:NAME` is what the person at the console opened and the second person did not; `their_reason` answers for all.
    """
    reasons: dict[tuple[str, str], str] = {}
    ticked: set[tuple[str, str]] = set()
    for key, value in form.items():
        what, _, point = key.partition(":")
        kind_of_point, _, point_name = point.partition(":")
        about = (kind_of_point, point_name)
        if what == "reason":
            reasons[about] = value
        if what == "tick":
            ticked.add(about)
        if what == "their" and kind != "sign" and form.get("their_reason", "").strip():
            ticked.add(about)
            reasons[about] = form["their_reason"]
    decision, meaning, comment, name = (form.get(key, "") for key in ("decision", "meaning", "comment", "name"))
    return TypedText(kind, decision, meaning, comment, name, reasons=reasons, ticked=frozenset(ticked))


@router.get("/approvals/{approval_id:int}/signatures/{signature_id:int}", response_class=HTMLResponse)
def signature_page(request: Request, session: Reading, actor: Who, approval_id: int, signature_id: int) -> HTMLResponse:
    """Confirm a decision: what was decided and by whom, its audit record, what happens next and who has it."""
    approval = session.get_known(Approval, approval_id)
    signature = next((one for one in approval.signatures if one.id == signature_id), None)
    if signature is None:
        raise NotFoundError(f"Request {approval_id} has no signature {signature_id}; read its list of signatures.")
    row = session.get_known(ParameterSet, approval.parameter_set_id)
    return render(
        request,
        "approvals/signature.html",
        approval=approval,
        signature=signature,
        points=review.read_points(signature.points),
        set=row,
        sensor=session.get_known(Sensor, row.sensor_id),
        record=find_record(session, approval, signature),
        workflow=make_workflow(session, actor, get_server(request).policy, row),
    )


def find_record(session: Session, approval: Approval, signature: Signature) -> AuditRecord | None:
    """Return the audit record of a signature."""
    action = {"APPROVE": "approved", "REFUSE": "refused"}[signature.decision]
    records = audit.list_records(session, subject=f"approvals/{approval.id}")
    return next((one for one in records if (one.actor_id, one.action) == (signature.user_id, action)), None)


def _render_again(
    request: Request, actor: Actor, approval_id: int, refusal: RefusalContext | None, typed: TypedText
) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        return request_page(request, session, actor, approval_id, refusal=refusal, typed=typed)


@router.post("/approvals/{approval_id:int}/threads")
async def comment(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Comment on a gate, a parameter or a figure, in a thread that is there or a new one."""
    form = await read_texts(request)
    about, text = (form.get("kind", ""), form.get("name", "")), form.get("text", "")
    thread_id = parse_row_id(form.get("thread", ""))

    def change(session: Session) -> Remark | Thread:
        if thread_id is None:
            return threads.open_thread(session, actor, approval_id, *about, text)
        return threads.add_remark(session, actor, approval_id, text, thread_id)

    outcome = await attempt(request, change)
    if outcome.value is None:
        typed = TypedText("thread", text=text, about=about)
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#thread-{about[0]}-{about[1]}", flash="Your comment is added.")


@router.post("/approvals/{approval_id:int}/threads/{thread_id:int}/{action}")
async def resolve(request: Request, actor: Who, approval_id: int, thread_id: int, action: str) -> Response:
    """Resolve a thread, or reopen it."""
    if action not in threads.RESOLVED:
        raise NotFoundError(f"A thread cannot be {action!r}; choose resolved or reopened.")
    form = await read_texts(request)

    def change(session: Session) -> Thread:
        return threads.set_resolved(session, actor, approval_id, thread_id, action, seen_version(form))

    return await make_change(request, change, f"/approvals/{approval_id}#threads", f"The thread is {action}.")


@router.post("/approvals/{approval_id:int}/remarks")
async def remark(
    request: Request, session: Reading, actor: Who, approval_id: int, text: Annotated[str, Form()] = ""
) -> Response:
    """Say something about a request."""
    outcome = await attempt(request, partial(threads.add_remark, actor=actor, approval_id=approval_id, text=text))
    if outcome.value is None:
        typed = TypedText("remark", text=text)
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#discussion", flash="Your comment was added.")


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
    return redirect(f"/approvals/{approval_id}#discussion", flash="The assignment is saved.")
