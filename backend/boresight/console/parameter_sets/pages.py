"""The list of parameter sets; one set with its two states, its values against the baseline, its lineage and other camera models.

The ground state and the on-board state are two symbols side by side and never one word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.conversion import try_conversion
from boresight.calibration.parameter_set import ParameterSetDocument, parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import Reading, Who, csrf, get_needed, get_server, same_for_roles
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import gates, review
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals import service as approvals
from boresight.console.approvals.dependencies import assess_before_submission
from boresight.console.approvals.pages.gates import make_gates_panel
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.pages.sensors import list_sensor_choices
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    attempt,
    proof_of_own,
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
    is_number,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import GROUND_STATES, ONBOARD_STATES, ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.pages.list import RunNames, read_names
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.uplinks.queries import find_c_sd_record
from boresight.console.uplinks.stations import make_workflow
from boresight.console.uplinks.tables import Uplink
from boresight.errors import RefusedInputError
from boresight.figures.tables import set_rows
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.telemetry.sensors import Sensor as SensorDescription
from boresight.telemetry.sensors import parse_sensor
from boresight.verdicts.gates.judgement import GateReport

READ_AT_ONCE = 500
TURNING = ("APPROVED", "BASELINE")  # about to be loaded, or loaded: the turn of the attitude stands above everything
SETS = Table(
    "parameter-sets",
    "Parameter sets",
    (
        TableColumn("set", "Set, of sensor", "-set", "named", head=True, csv=("number", "set", "sensor")),
        TableColumn("ground", "Ground", "ground", csv=("ground_state",)),
        TableColumn("board", "On board", "board", csv=("onboard_state",)),
        TableColumn("gates", "Gates", "", "verdict-words", csv=("verdict",)),
        TableColumn("run", "From run", "-run", csv=("run",)),
        TableColumn("hash", "SHA-256", csv=("sha256",)),
        TableColumn("by", "Created by", "by", "named", csv=("created_by", "created_utc")),
        TableColumn("baseline", "Baseline since", "-baseline", csv=("baseline_from_utc", "baseline_to_utc")),
    ),
    {
        "sensor": is_number,
        "sensor_name": is_text,
        "state": accept_one(GROUND_STATES),
        "board": accept_one(ONBOARD_STATES),
        "q": is_text,
    },
    "-set",
    kind="sets",
)

router = PageRouter()


@router.get("/parameter-sets", response_class=HTMLResponse, dependencies=[Depends(same_for_roles)])
def parameter_sets_page(request: Request, session: Reading) -> HTMLResponse:
    """Show a page of sets."""
    view = read_view(request, SETS)
    found = read_page(session, view)
    return render(
        request,
        "parameter_sets/parameter_sets.html",
        view=view,
        sets=found.rows,
        last=found.last,
        names=read_names(session, sensors_of=found.rows),
        choices=list_sensor_choices(session, view),
        states=GROUND_STATES,
        on_board=ONBOARD_STATES,
        verdicts=gates.read_verdicts(session, {row.id for row in found.rows}),
    )


@router.get("/parameter-sets.csv")
def parameter_sets_csv(request: Request, session: Reading) -> Response:
    """Give every set of a view as CSV."""
    view = read_view(request, SETS)
    return write_csv(view, _csv_rows(session, view, read_names(session, sensors_of=None)))


def _csv_rows(session: Session, view: TableView, names: RunNames) -> Iterator[RowWithFields]:
    """Yield the rows of a view for the CSV file; verdicts are read for many sets at once."""
    rows = iter(read_all(session, view))
    while some := list(islice(rows, READ_AT_ONCE)):
        verdicts = gates.read_verdicts(session, {row.id for row in some})
        yield from (_csv_row(row, names, verdicts.get(row.id)) for row in some)


def _csv_row(row: ParameterSet, names: RunNames, judged: GateReport | None) -> RowWithFields:
    sensor, by = names.sensors[row.sensor_id], names.person(row.created_by)
    return RowWithFields(
        row, number=row.id, set=row.name, sensor=sensor, run=row.run_id, created_by=by, verdict=judged and judged.words
    )


@dataclass(frozen=True)
class ConvertedSet:
    """A set in another model: how far that differs and may, and its document or why there is none."""

    model: str
    misfit_px: float | None
    allowed_px: float | None
    document: dict[str, Any] | None
    refusal: str | None


def list_conversions(session: Session, row: ParameterSet) -> list[ConvertedSet]:
    """Try every other camera model on a set."""
    sensor = parse_sensor(session.get_known(Sensor, row.sensor_id).document)
    return [_try(row, sensor, model) for model in sorted(CAMERA_MODELS) if model != row.document["camera_model"]]


def _try(row: ParameterSet, sensor: SensorDescription, model: str) -> ConvertedSet:
    try:
        tried = try_conversion(row.document, sensor, row.name, model)
    except RefusedInputError as error:
        return ConvertedSet(model, None, None, None, str(error))
    if isinstance(tried.outcome, RefusedInputError):
        return ConvertedSet(model, tried.misfit_px, tried.allowed_px, None, str(tried.outcome))
    return ConvertedSet(model, tried.misfit_px, tried.allowed_px, tried.outcome, None)


parameter_set_router = PageRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class SetAction:
    """A transition: whether the set's state has it, and why this person cannot make it."""

    offered: bool
    blocked: str | None


def list_set_actions(
    row: ParameterSet, actor: Actor, request: Approval | None, why_not_promote: str | None
) -> dict[str, SetAction]:
    """List the transitions of a set's state, each with why the actor may not make it."""
    submitter = request is not None and request.submitted_by == actor.user_id
    submitted = row.ground_state in {"SUBMITTED", "APPROVED"}
    submittable, was_baseline = row.ground_state in approvals.SUBMITTABLE, row.baseline_from_utc is not None
    return {
        "roll_back": SetAction(
            submittable and was_baseline,
            None
            if actor.roles.intersection({"analyst", "operator"})
            else "Only an analyst or an operator may request a roll-back; ask an administrator for the role.",
        ),
        "submit": SetAction(
            submittable and not was_baseline,
            None
            if "analyst" in actor.roles
            else "Only an analyst may submit a set; ask an administrator for the role.",
        ),
        "withdraw": SetAction(
            submitted,
            None
            if submitter or "administrator" in actor.roles
            else "Only the submitter or an administrator may withdraw it.",
        ),
        "promote": SetAction(
            submitted,
            why_not_promote,
        ),
    }


@dataclass(frozen=True)
class LineageNode:
    """One station of a set's lineage."""

    kind: str
    name: str
    address: str | None = None
    state: str | None = None


def _say_more(sets: int) -> str:
    """Say how many further sets there are."""
    return f" and {sets} more" if sets else ""


def list_lineage(session: Session, row: ParameterSet, requests: Sequence[Approval]) -> list[LineageNode]:
    """Return the lineage of a set from telemetry to the spacecraft, as far as it has come."""
    nodes = []
    if row.run_id is not None:
        run = runs.get_run(session, row.run_id)
        data = session.get_known(TelemetrySet, run.telemetry_set_id)
        nodes = [
            LineageNode("Telemetry", f"{data.name}{_say_more(len(run.joint_set_ids))}", f"/telemetry/{data.id}"),
            LineageNode("Run", f"#{run.id} {run.own_label}".rstrip(), f"/runs/{run.id}", run.state),
        ]
    else:
        nodes = [LineageNode("Ground calibration", "declared at registration", f"/sensors/{row.sensor_id}")]
    nodes.append(LineageNode("Set", row.name, None, row.ground_state))
    nodes += [
        LineageNode("Approval", f"request {known.id}", f"/approvals/{known.id}", known.state)
        for known in reversed(requests)
    ]
    nodes.append(
        LineageNode(
            "On board", "no uplink recorded" if row.onboard_state == "NOT SENT" else "recorded", None, row.onboard_state
        )
    )
    return nodes


def find_incumbent(session: Session, row: ParameterSet, requests: Sequence[Approval]) -> ParameterSet | None:
    """Return the set to compare with: the current baseline, or for a promoted set the one that it replaced."""
    if row.baseline_from_utc is None:
        return set_queries.find_baseline(session, row.sensor_id)
    return find_bound_incumbent(session, row, next((known for known in requests if known.state == "APPROVED"), None))


def find_bound_incumbent(session: Session, row: ParameterSet, request: Approval | None) -> ParameterSet | None:
    """Return the set that was baseline when a request was made; None where the request names none."""
    sha256 = request.binding.incumbent_sha256 if request is not None else None
    return None if sha256 is None else set_queries.find_other_with_document(session, row, sha256)


def read_set_and_incumbent(
    row: ParameterSet, incumbent: ParameterSet | None
) -> tuple[ParameterSetDocument, ParameterSetDocument | None]:
    """Read the documents of a set and of the one it would replace."""
    return parse_parameter_set(row.document), None if incumbent is None else parse_parameter_set(incumbent.document)


@parameter_set_router.get("/parameter-sets/{set_id:int}", response_class=HTMLResponse)
def parameter_set_page(request: Request, session: Reading, actor: Who, set_id: int) -> HTMLResponse:
    """Show a set."""
    return _page(request, session, actor, set_id)


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    set_id: int,
    *,
    refusal: RefusalContext | None = None,
    reason: str = "",
    act: str = "",
) -> HTMLResponse:
    row = session.get_known(ParameterSet, set_id)
    requests = lists.list_newest(session, Approval, set=set_id)
    sensor = session.get_known(Sensor, row.sensor_id)
    incumbent, baseline = find_incumbent(session, row, requests), set_queries.find_baseline(session, row.sensor_id)
    policy, warnings = get_server(request).policy, review.warn_of_set(session, row, incumbent)
    panel = make_gates_panel(session, actor, row)
    return render(
        request,
        "parameter_sets/parameter_set.html",
        refused=refusal,
        set=row,
        sensor=sensor,
        names=read_names(session),
        workflow=make_workflow(session, actor, policy, row),
        incumbent=incumbent,
        rows=set_rows(*read_set_and_incumbent(row, incumbent), sensor.document["typical_sigma"]),
        requests=requests,
        signatures=[
            signature for known in requests for signature in approval_queries.list_signatures(session, known.id)
        ],
        uplinks=lists.list_newest(session, Uplink, set=set_id),
        conversions=list_conversions(session, row),
        panel=panel,
        advice=[
            said for name, said in warnings.items() if name != "attitude-turn"
        ],  # the line of the alignment says it
        warnings=[*panel.warnings, *warnings.values()],
        turning=TURNING,
        c_sd=find_c_sd_record(session, row),
        turn=warnings.get("attitude-turn"),
        needed=get_needed(request, session, actor),
        policy=policy,
        baseline=baseline,
        act_rows=set_rows(*read_set_and_incumbent(row, baseline), sensor.document["typical_sigma"]),
        lineage=list_lineage(session, row, requests),
        actions=list_set_actions(
            row,
            actor,
            requests[0] if requests else None,
            approvals.explain_why_not_promote(session, actor, set_id, policy=policy),
        ),
        refusal=refusal,
        reason=reason,
        act=act,
    )


@parameter_set_router.post("/parameter-sets/{set_id:int}/submit")
async def submit(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Ask that a set become baseline."""
    return await _asked(request, session, actor, set_id, "submit", approvals.submit)


@parameter_set_router.post("/parameter-sets/{set_id:int}/roll-back")
async def roll_back(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Ask that a former baseline become baseline again."""
    return await _asked(request, session, actor, set_id, "roll-back", approvals.roll_back)


async def _asked(
    request: Request, session: Session, actor: Actor, set_id: int, act: str, ask: Callable[..., Approval]
) -> Response:
    """Open a request and redirect to it, or show why it was refused."""
    form = await read_texts(request)
    reason, state = form.get("reason", ""), get_server(request)
    assessed = await run_in_threadpool(assess_before_submission, actor, set_id, state.forecast_sources, state.engine)

    def change(session: Session) -> Approval:
        asked = (state.blobs, set_id, reason, seen_version(form), assessed)
        return ask(session, actor, *asked, policy=state.policy)

    outcome = await attempt(request, change)
    if outcome.value is None:
        page = partial(_page, request, session, actor, set_id, refusal=outcome.refusal, reason=reason, act=act)
        return await run_in_threadpool(page)
    return redirect(
        f"/approvals/{outcome.value.id}", flash="Submitted: another person with the role approver must sign."
    )


@parameter_set_router.post("/parameter-sets/{set_id:int}/withdraw")
async def withdraw(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Take a request back."""
    form = await read_texts(request)
    reason = form.get("reason", "")

    def change(session: Session) -> ParameterSet:
        return approvals.withdraw(session, actor, set_id, seen_version(form), reason)

    outcome = await attempt(request, change)
    if outcome.value is None:
        page = partial(_page, request, session, actor, set_id, refusal=outcome.refusal, reason=reason, act="withdraw")
        return await run_in_threadpool(page)
    return redirect(f"/parameter-sets/{set_id}", flash=f"{outcome.value.name} is withdrawn.")


@parameter_set_router.post("/parameter-sets/{set_id:int}/promote")
async def promote(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Make an approved set the baseline."""
    form = await read_texts(request)
    policy, reason = get_server(request).policy, form.get("reason", "")

    def change(session: Session, proof: PasswordProof) -> ParameterSet:
        asked, signed = replace(policy, promotion_reason=True), proof if policy.promotion_password else None
        seen = seen_version(form)
        return approvals.promote(session, actor, set_id, seen, reason, signed, policy=asked, factor=proof.given)

    prove = proof_of_own(request, actor, form, with_password=policy.promotion_password)
    outcome = await attempt(request, change, prove)
    if outcome.value is None:
        page = partial(_page, request, session, actor, set_id, refusal=outcome.refusal, reason=reason, act="promote")
        return await run_in_threadpool(page)
    words = f"{outcome.value.name} is now the baseline; nothing on board has changed."
    return redirect(f"/parameter-sets/{set_id}", flash=words)
