"""Alignments: the list, the form that starts one, and one with its verdict, approval, rotations, gates, figure and history.

A request that an alignment goes on board is signed on the page of the alignment, and the inbox of approvals leads there.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.alignment.align import AlignmentOptions
from boresight.calibration.alignment.result import AXES
from boresight.calibration.alignment.result import Alignment as AlignmentResult
from boresight.console.access.dependencies import Reading, Who, csrf, get_needed, get_server
from boresight.console.access.passwords import PasswordProof
from boresight.console.alignments import approval, queries, service
from boresight.console.alignments.tables import (
    ALIGNMENT_STATES,
    Alignment,
    AlignmentRequest,
    AlignmentSummary,
    parse_summary,
)
from boresight.console.approvals.service import Decision
from boresight.console.fleet import queries as sensor_rows
from boresight.console.fleet import service as sensors
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    attempt,
    proof_of_own,
    read_again,
    read_number,
    read_texts,
    read_whole_number,
    redirect,
    render,
    seen_version,
)
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    accept_one,
    is_number,
    read_page,
    read_view,
)
from boresight.console.runs import queries as run_rows
from boresight.console.runs.pages.list import read_names
from boresight.console.runs.tables import Run
from boresight.console.telemetry import queries as telemetry_rows
from boresight.errors import ConflictError, RefusedInputError
from boresight.estimation.alignment import log_rotation
from boresight.estimation.attitude import to_matrix
from boresight.figures import alignment as chart
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.gates.judgement import gate_rows
from boresight.verdicts.numbers import fixed, number

router = PageRouter(dependencies=[Depends(csrf)])

ALIGNMENTS = Table(
    "alignments",
    "Alignments of two sensors",
    (
        TableColumn("state", "State", "state", "nowrap"),
        TableColumn("alignment", "Alignment", "-alignment", "nowrap", head=True),
        TableColumn("a", "From A", "a", "nowrap"),
        TableColumn("b", "To B", "b", "nowrap"),
        TableColumn("verdict", "Gates", "", "nowrap"),
        TableColumn("load", "3 σ to load", "", "num", "Uncertainty of the rotation about x, y, z of B", "arcsec"),
        TableColumn("sentence", "Result", "", "gist"),
        TableColumn("by", "By", "by", "tight"),
    ),
    {"state": accept_one(ALIGNMENT_STATES), "sensor": is_number},
    "-alignment",
    kind="dense",
)
#: Runs of a sensor that the form offers beside those that a link names.
MOST_OFFERED = 10
BETWEEN = (
    "The rotation between the two trackers as mounted. It is valid whichever parameters are on board, and includes the errors of "
    "both cameras, which more pairs do not reduce."
)
MEANINGS = {
    "APPROVE": "I approve this alignment for upload",
    "REFUSE": "I refuse this alignment",
}
LOADED = (
    "The rotation between the attitudes that the trackers report with the parameters of these two runs: load it only together "
    "with these parameters."
)


@dataclass(frozen=True)
class RotationView:
    """A rotation as it is printed: what it is, its quaternion, and about x, y, z of B its vector and 3 sigma."""

    name: str
    title: str
    sentence: str
    quaternion: str
    lines: Sequence[tuple[str, str, str]]


@dataclass(frozen=True)
class OfferedRun:
    """A run that may be aligned, under its sensor."""

    run: Run
    sensor: str
    data: str


@dataclass(frozen=True)
class RefusedForm:
    """A form of the page that was refused: which dialog it is of, why, and what was typed, without its password."""

    act: str = ""
    refusal: RefusalContext | None = None
    typed: Mapping[str, str] = field(default_factory=dict)


def _view_rotation(name: str, title: str, sentence: str, q: Sequence[float], sigma: Sequence[float]) -> RotationView:
    turn = np.degrees(log_rotation(to_matrix(np.array([q], np.float64)))[0])
    lines = [(axis, fixed(float(v), 5), number(3 * s, 3)) for axis, v, s in zip(AXES, turn, sigma, strict=True)]
    return RotationView(name, title, sentence, ", ".join(f"{one:.9f}" for one in q), lines)


def _rotations(found: AlignmentSummary) -> list[RotationView]:
    return [
        _view_rotation("to-load", "To load", LOADED, found.load_quaternion, found.load_sigma_arcsec),
        _view_rotation("between", "Between the trackers", BETWEEN, found.quaternion, found.sigma_arcsec),
    ]


@router.get("/alignments", response_class=HTMLResponse)
def alignments_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the alignments of all sensors, or of one."""
    view = read_view(request, ALIGNMENTS)
    found = read_page(session, view)
    sensor = parse_row_id(view.where.get("sensor", ""))
    return render(
        request,
        "alignments/alignments.html",
        view=view,
        rows=found.rows,
        last=found.last,
        summaries={row.id: parse_summary(row.summary) for row in found.rows if row.summary},
        sensor=sensor,
        choices=sensors.list_choices(session, keep=[sensor] if sensor else []),
        states=ALIGNMENT_STATES,
        may_start=service.may_align(actor),
        sensors=_sensor_names(session, found.rows),
        names=read_names(session),
    )


def _sensor_names(session: Session, rows: Sequence[Alignment]) -> Mapping[int, str]:
    ids = {number for row in rows for number in (row.sensor_a_id, row.sensor_b_id)}
    return sensor_rows.read_names(session, ids) if ids else {}


@router.get("/alignments/new", response_class=HTMLResponse)
def new_alignment_page(request: Request, session: Reading, actor: Who, a: str = "", b: str = "") -> HTMLResponse:
    """Show the form that starts an alignment; a link may name its runs."""
    return _form(request, actor, {"run_a_id": a, "run_b_id": b}, None, session)


def _form(
    request: Request, actor: Actor, typed: Mapping[str, str], refusal: RefusalContext | None, session: Session
) -> HTMLResponse:
    return render(
        request,
        "alignments/new_alignment.html",
        refused=refusal,
        offers=_list_offers(session, [parse_row_id(typed.get(name, "")) for name in ("run_a_id", "run_b_id")]),
        typed=typed,
        usual=AlignmentOptions(),
        may_start=service.may_align(actor),
        refusal=refusal,
    )


def _list_offers(session: Session, kept: Sequence[int | None]) -> Mapping[str, list[OfferedRun]]:
    """Return the runs that may be aligned, newest first, by the names of their sensors."""
    found = {run.id: run for run in queries.list_usable_runs(session, MOST_OFFERED)}
    found |= {run.id: run for one in kept if one and (run := run_rows.find_run(session, one)) is not None}
    names = sensor_rows.read_names(session, {run.sensor_id for run in found.values()}) if found else {}
    sets = telemetry_rows.read_names(session, {run.telemetry_set_id for run in found.values()}) if found else {}
    offers: dict[str, list[OfferedRun]] = {name: [] for name in sorted(names.values())}
    for _, run in sorted(found.items(), reverse=True):
        offers[names[run.sensor_id]].append(OfferedRun(run, names[run.sensor_id], sets[run.telemetry_set_id]))
    return offers


@router.post("/alignments/new", response_class=HTMLResponse)
async def start_alignment(request: Request, actor: Who) -> Response:
    """Queue an alignment and lead to its page."""
    typed = await read_texts(request)
    outcome = await attempt(request, partial(_start, actor, typed))
    if outcome.refusal is not None:
        return await read_again(request, partial(_form, request, actor, typed, outcome.refusal))
    return redirect(f"/alignments/{outcome.made}", flash="Queued: this page follows it.")


def _start(actor: Actor, typed: Mapping[str, str], session: Session) -> int:
    runs = [parse_row_id(typed.get(name, "")) for name in ("run_a_id", "run_b_id")]
    if runs[0] is None or runs[1] is None:
        raise RefusedInputError("Two runs are aligned: choose one for A and one for B.")
    return service.request_alignment(session, actor, runs[0], runs[1], _read_options(typed)).id


def _read_options(typed: Mapping[str, str]) -> dict[str, Any]:
    """Read the options that were typed; what is left empty is as usual."""
    given: dict[str, Any] = {}
    for name in ("tolerance_s", "longest_gap_s"):
        if text := typed.get(name, "").strip():
            given[name] = read_number(name, text)
    if text := typed.get("temperature", "").strip():
        given["temperature"] = read_whole_number("temperature", text)
    if text := typed.get("drift", "").strip():
        given["drift"] = text == "yes"
    return given


@router.get("/alignments/{alignment_id:int}", response_class=HTMLResponse)
def alignment_page(request: Request, session: Reading, actor: Who, alignment_id: int) -> HTMLResponse:
    """Show an alignment: its verdict, approval, both rotations, gates, figure, and how former ones of the pair differ from it."""
    return _page(request, actor, alignment_id, RefusedForm(), session)


def _page(request: Request, actor: Actor, alignment_id: int, refused: RefusedForm, session: Session) -> HTMLResponse:
    row = session.get_known(Alignment, alignment_id)
    found: AlignmentResult | None = None
    gates, damage, blocking = [], "", ""
    if row.state == "SUCCEEDED":
        try:
            found, report = service.read_result(session, get_server(request).blobs, alignment_id)
            gates = gate_rows(report.gates, report.blocking)
            blocking = ", ".join(one.title for one in gates if one.name in report.blocking)
        except ConflictError as error:
            damage = str(error)
    names, policy = _sensor_names(session, [row]), get_server(request).policy
    summary = parse_summary(row.summary) if row.summary else None
    requests = queries.list_requests(session, row.id)
    asked = next((one for one in requests if one.state == "OPEN"), None)
    return render(
        request,
        "alignments/alignment.html",
        refused=refused.refusal,
        alignment=row,
        found=found,
        damage=damage,
        summary=summary,
        rotations=_rotations(summary) if summary else [],
        gates=gates,
        blocking=blocking,
        a=names[row.sensor_a_id],
        b=names[row.sensor_b_id],
        history=service.list_history(session, row),
        requests=requests,
        asked=asked,
        blocked=asked and approval.explain_why_not_sign(session, actor, asked, policy),
        may_withdraw=asked is not None and approval.may_withdraw(actor, asked),
        may_align=service.may_align(actor),
        is_in_force=any(one.state in {"OPEN", "APPROVED"} for one in requests),
        form=refused,
        meanings=MEANINGS,
        needed=get_needed(request, session, actor),
        chart=chart,
        axes=AXES,
        names=read_names(session),
    )


@router.post("/alignments/{alignment_id:int}/submit", response_class=HTMLResponse)
async def submit_alignment(request: Request, actor: Who, alignment_id: int) -> Response:
    """Ask that an alignment go on board with the parameters of its runs."""
    typed, blobs = await read_texts(request), get_server(request).blobs

    def change(session: Session) -> AlignmentRequest:
        return approval.submit(session, actor, blobs, alignment_id, typed.get("reason", ""))

    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        refused = RefusedForm("submit", outcome.refusal, typed)
        return await read_again(request, partial(_page, request, actor, alignment_id, refused))
    return redirect(f"/alignments/{alignment_id}", flash=f"Request {outcome.made.id} is waiting for an approver.")


@router.get("/alignment-requests/{request_id:int}")
def alignment_request_page(session: Reading, request_id: int) -> Response:
    """Lead to the alignment of a request, where it is signed."""
    return redirect(f"/alignments/{session.get_known(AlignmentRequest, request_id).alignment_id}")


@router.post("/alignment-requests/{request_id:int}/sign", response_class=HTMLResponse)
async def sign_alignment(request: Request, actor: Who, request_id: int) -> Response:
    """Approve a request, or refuse it, as a second person."""
    typed = await read_texts(request)
    decision, policy = typed.get("decision", ""), get_server(request).policy
    decided = Decision(
        decision, typed.get("meaning", "").strip() or MEANINGS.get(decision, ""), typed.get("comment", "")
    )

    def change(session: Session, proof: PasswordProof) -> AlignmentRequest:
        return approval.sign(session, actor, request_id, decided, proof, seen_version(typed), policy=policy)

    prove = proof_of_own(request, actor, typed)
    return await _closed(request, actor, request_id, change, prove, RefusedForm(decision.lower(), None, typed))


@router.post("/alignment-requests/{request_id:int}/withdraw", response_class=HTMLResponse)
async def withdraw_alignment(request: Request, actor: Who, request_id: int) -> Response:
    """Take an open request back."""
    typed = await read_texts(request)

    def change(session: Session) -> AlignmentRequest:
        return approval.withdraw(session, actor, request_id, typed.get("reason", ""), seen_version(typed))

    return await _closed(request, actor, request_id, change, None, RefusedForm("withdraw", None, typed))


async def _closed(
    request: Request,
    actor: Actor,
    request_id: int,
    change: Callable[..., AlignmentRequest],
    prove: Callable[[], Awaitable[Sequence[object]]] | None,
    form: RefusedForm,
) -> Response:
    """Close a request as a form says, and lead to its alignment, or show the form again with its refusal."""
    outcome = await attempt(request, change, prove)
    if outcome.refusal is None:
        said = f"Request {request_id} is {outcome.made.state}."
        return redirect(f"/alignments/{outcome.made.alignment_id}", flash=said)

    def render_again(session: Session) -> HTMLResponse:
        number = session.get_known(AlignmentRequest, request_id).alignment_id
        return _page(request, actor, number, replace(form, refusal=outcome.refusal), session)

    return await read_again(request, render_again)
