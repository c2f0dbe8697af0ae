"""New telemetry: what was made of each file, one decision with its answer, and the policy of a sensor with its dry run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Protocol

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import (
    KNOWN,
    Reading,
    ServerPolicy,
    Who,
    csrf,
    depend_on_server,
    get_server,
)
from boresight.console.approvals.staleness import find_blocking_gates
from boresight.console.approvals.tables import Approval
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest import policies, service
from boresight.console.ingest import queries as rows
from boresight.console.ingest.rules import RULES
from boresight.console.ingest.tables import ANSWERS, DECISION_STATES, IngestDecision, IngestPolicy
from boresight.console.list_queries import list_newest
from boresight.console.mission_control import queries as link_rows
from boresight.console.mission_control.tables import FAILURES_TOLD
from boresight.console.operation import RowWithFields
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    make_change,
    read_texts,
    render,
    seen_version,
)
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    accept_one,
    is_number,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import presets
from boresight.console.runs.pages.list import RunNames, read_names
from boresight.console.runs.tables import Run
from boresight.console.telemetry import profiles
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import NotFoundError, RefusedInputError
from boresight.mission_control import systems
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.gates import GATES

router = PageRouter(dependencies=[Depends(csrf)])

DECISIONS = Table(
    "ingest-decisions",
    "Decisions on new telemetry",
    (
        TableColumn("state", "State", "state", "nowrap", csv=("state", "answer")),
        TableColumn("decision", "Decision", "-decision", "nowrap", head=True, csv=("decision",)),
        TableColumn("sensor", "Sensor", "sensor", "nowrap", csv=("sensor",)),
        TableColumn("file", "File", "file", "name", csv=("file_name", "file_sha256", "source")),
        TableColumn("sentence", "Why", "", "gist", csv=("sentence",)),
        TableColumn("received", "Received", "", "tight", csv=("received_utc", "decided_utc", "answered_utc")),
    ),
    {"state": accept_one(DECISION_STATES), "sensor": is_number, "sensor_name": is_text, "q": is_text},
    "-decision",
    kind="dense",
    path="/ingest",
)
RECENT = 12
TITLES = {
    "SUBMIT": "Submit the parameter set for approval",
    "WAIT": "Wait",
    "MORE DATA": "More data first",
    "RECALIBRATE": "Recalibrate with other settings",
}
DONE = {
    "SUBMIT": "Submitted: an approver signs next.",
    "WAIT": "Answered: no decision on the same change is requested until then.",
    "MORE DATA": "Answered: the next set will request a decision again.",
    "RECALIBRATE": "Answered: launch the calibration, and submit its result.",
}
STEPS = {
    "rehearse": "Rehearsed on past data; nothing else changed.",
    "enable": "The policy is in force.",
    "pause": "Paused: files are not ingested and stay where they are.",
    "resume": "Resumed: the limits apply again, counted from now.",
    "switch-off": "Switched off.",
}


class Watcher(Protocol):
    """What pages read of the watcher of this server."""

    @property
    def fault(self) -> str:
        """What is wrong with the watched folder or bucket."""

    @property
    def places(self) -> Sequence[str]:
        """Addresses of the watched folder and bucket."""

    def count_waiting(self, sensor: str) -> int:
        """Count the files of a sensor that were not taken yet."""

    def describe_work(self, sensor: str) -> str:
        """Say which file of a sensor is being read; empty where none is."""


ServerWatcher = Annotated[Watcher, depend_on_server("ingest_watcher")]


@dataclass(frozen=True)
class PolicyLine:
    """A policy in force as the page of all decisions shows it."""

    policy: IngestPolicy
    sensor: str
    waiting: int
    work: str
    asked: IngestDecision | None


@router.get("/ingest", response_class=HTMLResponse)
def ingest_page(request: Request, session: Reading, watcher: ServerWatcher) -> HTMLResponse:
    """Show the policies in force, and what was made of each file."""
    view = read_view(request, DECISIONS)
    found = read_page(session, view)
    in_force = rows.list_policies_in_force(session)
    sensor = parse_row_id(view.where.get("sensor", ""))
    names = read_names(session, sensors_of=[*found.rows, *in_force])
    lines = [
        PolicyLine(
            row,
            names.sensors[row.sensor_id],
            watcher.count_waiting(names.sensors[row.sensor_id]),
            watcher.describe_work(names.sensors[row.sensor_id]),
            rows.find_asked(session, row.sensor_id),
        )
        for row in in_force
    ]
    return render(
        request,
        "ingest/ingest.html",
        view=view,
        decisions=found.rows,
        last=found.last,
        lines=lines,
        places=watcher.places,
        fault=watcher.fault,
        sensor=sensor,
        choices=sensors.list_choices(session, keep=[sensor] if sensor else []),
        states=DECISION_STATES,
        names=names,
    )


@router.get("/ingest.csv", dependencies=[KNOWN])
def ingest_csv(request: Request, session: Reading) -> Response:
    """Give every decision of a view as CSV."""
    view, names = read_view(request, DECISIONS), read_names(session, sensors_of=None)
    return write_csv(view, (_csv_row(row, names) for row in read_all(session, view)))


def _csv_row(row: IngestDecision, names: RunNames) -> RowWithFields:
    return RowWithFields(row, decision=row.id, sensor=names.sensors[row.sensor_id])


@router.get("/ingest/{decision_id:int}", response_class=HTMLResponse)
def decision_page(request: Request, session: Reading, actor: Who, decision_id: int) -> HTMLResponse:
    """Show a decision: what was found, the alternatives, and the answer."""
    return _decision(request, actor, decision_id, {}, None, session)


def _decision(
    request: Request,
    actor: Actor,
    decision_id: int,
    typed: Mapping[str, str],
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    row = session.get_known(IngestDecision, decision_id)
    prepared = session.get(ParameterSet, row.parameter_set_id) if row.parameter_set_id else None
    return render(
        request,
        "ingest/decision.html",
        refused=refusal,
        decision=row,
        policy=session.get_known(IngestPolicy, row.policy_id),
        sensor=session.get_known(Sensor, row.sensor_id),
        data=session.get(TelemetrySet, row.telemetry_set_id) if row.telemetry_set_id else None,
        run=session.get(Run, row.run_id) if row.run_id else None,
        prepared=prepared,
        stopped=[] if prepared is None else find_blocking_gates(session, prepared),
        blocking=[GATES[name].title for name in row.evidence.get("gates", {}).get("blocking", ()) if name in GATES],
        approval=session.get(Approval, row.approval_id) if row.approval_id else None,
        titles=TITLES,
        why_not={one: service.explain_why_not_answer(session, actor, row, one) for one in ANSWERS},
        quiet_days=service.QUIET_DAYS,
        names=read_names(session),
        typed=typed,
        refusal=refusal,
    )


@router.post("/ingest/{decision_id:int}/answer", response_class=HTMLResponse)
async def answer_decision(request: Request, actor: Who, decision_id: int, policy: ServerPolicy) -> Response:
    """Answer a decision; SUBMIT leads to the request for approval."""
    typed = await read_texts(request)
    blobs: BlobStore = request.app.state.blobs
    given = typed.get("answer", "")
    change = partial(_answer, actor, blobs, decision_id, typed, policy)
    again = partial(_decision, request, actor, decision_id, typed)
    return await make_change(request, change, f"/ingest/{decision_id}", DONE.get(given, "Answered."), again=again)


def _answer(
    actor: Actor, blobs: BlobStore, decision_id: int, typed: Mapping[str, str], policy: Any, session: Session
) -> IngestDecision:
    days = typed.get("days", "").strip() or str(service.QUIET_DAYS)
    try:
        number = float(days)
    except ValueError as error:
        raise RefusedInputError(f"{days[:20]!r} is no number of days; give one, such as 7.") from error
    given = service.DecisionAnswer(typed.get("answer", ""), typed.get("reason", ""), number)
    return service.answer(session, actor, blobs, decision_id, given, seen_version(typed), policy=policy)


@router.get("/sensors/{sensor_id:int}/ingest", response_class=HTMLResponse)
def policy_page(
    request: Request, session: Reading, actor: Who, sensor_id: int, watcher: ServerWatcher, version: str = ""
) -> HTMLResponse:
    """Show the policy of a sensor, its dry run on the past, its versions and its latest decisions."""
    return _policy(request, actor, sensor_id, watcher, parse_row_id(version), {}, None, session)


def _policy(
    request: Request,
    actor: Actor,
    sensor_id: int,
    watcher: Watcher,
    number: int | None,
    typed: Mapping[str, str],
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    sensor = session.get_known(Sensor, sensor_id)
    versions = rows.list_policies(session, sensor_id)
    in_force = next((row for row in versions if row.state in rows.IN_FORCE), None)
    draft = next((row for row in versions if row.state == "DRAFT"), None)
    shown = next((row for row in versions if row.number == number), draft or in_force or next(iter(versions), None))
    return render(
        request,
        "ingest/policy.html",
        refused=refusal,
        sensor=sensor,
        policy=shown,
        in_force=in_force,
        versions=versions,
        rules=RULES,
        values=dict(shown.document if shown else {}) | dict(typed),
        profiles=profiles.list_offers(session),
        presets=presets.list_offers(session),
        decisions=list_newest(session, IngestDecision, sensor=sensor_id, limit=RECENT),
        places=watcher.places,
        waiting=watcher.count_waiting(sensor.name),
        archives=systems.TITLES,
        linked=request.app.state.mission_control.links,
        link=link_rows.find_link(session, sensor_id),
        failures_told=FAILURES_TOLD,
        may_write=policies.may_write(actor),
        steps=policies.list_open_steps(session, actor, shown) if shown else set(),
        why_not_enable=policies.explain_why_not_enable(session, shown) if shown else None,
        names=read_names(session),
        typed=typed,
        refusal=refusal,
    )


@router.post("/sensors/{sensor_id:int}/ingest", response_class=HTMLResponse)
async def draft_policy(request: Request, actor: Who, sensor_id: int, watcher: ServerWatcher) -> Response:
    """Draft the next version of a sensor's policy."""
    typed = await read_texts(request)
    rules = {name: text for name in RULES if (text := typed.get(name, "").strip()) or name in {"profile", "feed"}}

    def change(session: Session) -> IngestPolicy:
        return policies.draft(session, actor, sensor_id, rules, typed.get("reason", ""))

    again = partial(_policy, request, actor, sensor_id, watcher, None, typed)
    address = f"/sensors/{sensor_id}/ingest"
    return await make_change(request, change, address, "Drafted: next, rehearse it on past data.", again=again)


@router.post("/sensors/{sensor_id:int}/ingest/{step}", response_class=HTMLResponse)
async def move_policy(request: Request, actor: Who, sensor_id: int, step: str) -> Response:
    """Rehearse, enable, pause, resume or switch off a policy."""
    if step not in STEPS:
        raise NotFoundError(f"There is no step {step[:40]} of a policy; choose from {', '.join(STEPS)}.")
    typed = await read_texts(request)
    policy_id, seen, reason = (
        parse_row_id(typed.get("policy_id", "")) or 0,
        seen_version(typed),
        typed.get("reason", ""),
    )
    found = await run_in_threadpool(_rehearse, request, policy_id) if step == "rehearse" else {}
    changes: dict[str, Callable[[Session], IngestPolicy]] = {
        "rehearse": lambda session: policies.record_rehearsal(session, actor, policy_id, found, seen),
        "enable": lambda session: policies.enable(session, actor, policy_id, seen),
        "pause": lambda session: policies.pause_by_person(session, actor, policy_id, reason, seen),
        "resume": lambda session: policies.resume(session, actor, policy_id, reason, seen),
        "switch-off": lambda session: policies.switch_off(session, actor, policy_id, reason, seen),
    }
    return await make_change(request, changes[step], f"/sensors/{sensor_id}/ingest", STEPS[step])


def _rehearse(request: Request, policy_id: int) -> dict[str, Any]:
    """Walk over the past before the writing transaction."""
    with open_reading(get_server(request).engine) as session:
        return policies.compute_rehearsal(session, policy_id)
