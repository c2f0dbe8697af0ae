"""A parameter set with its two states, its values against the baseline, its lineage and what may be done.

The ground state and the on-board state are two symbols side by side and never one word: a set that is baseline on the
ground says nothing about what the sensor uses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.api.measured import measured
from boresight.figures.parameter_table import set_rows
from boresight.pages.attempts import Refusal, attempt
from boresight.pages.conversions import conversions_of
from boresight.pages.forms import read_texts, seen_version
from boresight.pages.gates_panel import panel_of
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.services import approvals, parameter_sets, runs, sensors, telemetry_sets, uplinks
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet

router = APIRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class Action:
    """A transition: whether the set's state has it, and why this person cannot make it."""

    offered: bool
    blocked: str | None


def actions_of(row: ParameterSet, actor: Actor, request: Approval | None) -> dict[str, Action]:
    """Say which transitions a set's state has, and why the actor may not make one."""
    submitter = request is not None and request.submitted_by == actor.user_id
    submitted = row.ground_state in {"SUBMITTED", "APPROVED"}
    submittable, was_baseline = row.ground_state in parameter_sets.SUBMITTABLE, row.baseline_from_utc is not None
    return {
        "roll_back": Action(
            submittable and was_baseline,
            None
            if actor.roles.intersection({"analyst", "operator"})
            else "Only an analyst or an operator may ask for a roll-back; ask an administrator for the role.",
        ),
        "submit": Action(
            submittable and not was_baseline,
            None
            if "analyst" in actor.roles
            else "Only an analyst may submit a set; ask an administrator for the role.",
        ),
        "withdraw": Action(
            submitted,
            None
            if submitter or "administrator" in actor.roles
            else "Only who submitted the set, or an administrator, may withdraw it.",
        ),
        "promote": Action(
            submitted,
            _why_not_promote(row, actor),
        ),
    }


def _why_not_promote(row: ParameterSet, actor: Actor) -> str | None:
    """Say why a submitted set is not promoted by this person now."""
    if row.ground_state == "SUBMITTED":
        return "An approver must sign first; then an operator promotes."
    if "operator" not in actor.roles:
        return "Only an operator may promote an approved set; ask an administrator for the role."
    return None


@dataclass(frozen=True)
class Node:
    """One station of a set's lineage."""

    kind: str
    name: str
    address: str | None = None
    state: str | None = None


def lineage_of(session: Session, row: ParameterSet, requests: Sequence[Approval]) -> list[Node]:
    """Return the way of a set from telemetry to the spacecraft, as far as it has come."""
    nodes = []
    if row.run_id is not None:
        run = runs.get_run(session, row.run_id)
        data = telemetry_sets.get_telemetry_set(session, run.telemetry_set_id)
        nodes = [
            Node("Telemetry", data.name, f"/telemetry/{data.id}"),
            Node("Run", f"#{run.id} {run.label}".rstrip(), f"/runs/{run.id}", run.state),
        ]
    else:
        nodes = [Node("Ground calibration", "declared with the sensor", f"/sensors/{row.sensor_id}")]
    nodes.append(Node("Set", row.name, None, row.ground_state))
    nodes += [
        Node("Approval", f"request {known.id}", f"/approvals/{known.id}", known.state) for known in reversed(requests)
    ]
    nodes.append(
        Node(
            "On board", "no uplink recorded" if row.onboard_state == "NOT SENT" else "recorded", None, row.onboard_state
        )
    )
    return nodes


def incumbent_of(session: Session, row: ParameterSet, requests: Sequence[Approval]) -> ParameterSet | None:
    """Return what a set is measured against: the baseline of now, or for a promoted set the one that it replaced."""
    if row.baseline_from_utc is None:
        return parameter_sets.baseline_of(session, row.sensor_id)
    return bound_incumbent(session, row, next((known for known in requests if known.state == "APPROVED"), None))


def bound_incumbent(session: Session, row: ParameterSet, request: Approval | None) -> ParameterSet | None:
    """Return the set that was baseline when a request was made; None where the request names none."""
    sha256 = request.bound.get("incumbent_sha256") if request is not None else None
    return None if sha256 is None else parameter_sets.other_with_document(session, row, sha256)


@router.get("/parameter-sets/{set_id:int}", response_class=HTMLResponse)
def parameter_set_page(request: Request, session: Reading, actor: Who, set_id: int) -> HTMLResponse:
    """Show a set."""
    return _page(request, session, actor, set_id)


def _page(
    request: Request, session: Session, actor: Actor, set_id: int, *, refusal: Refusal | None = None, reason: str = ""
) -> HTMLResponse:
    """Render a set, with the refusal of a transition and the reason that was typed."""
    row = parameter_sets.get_parameter_set(session, set_id)
    requests = approvals.list_approvals(session, parameter_set_id=set_id)
    sensor = sensors.get_sensor(session, row.sensor_id)
    incumbent = incumbent_of(session, row, requests)
    return render(
        request,
        "parameter_sets/parameter_set.html",
        refused=refusal,
        set=row,
        sensor=sensor,
        names=read_names(session),
        incumbent=incumbent,
        rows=set_rows(row.document, incumbent.document if incumbent else None, sensor.document),
        requests=requests,
        signatures=[signature for known in requests for signature in approvals.signatures_of(session, known.id)],
        uplinks=uplinks.list_uplinks(session, parameter_set_id=set_id),
        conversions=conversions_of(session, row),
        panel=panel_of(session, actor, row),
        lineage=lineage_of(session, row, requests),
        actions=actions_of(row, actor, requests[0] if requests else None),
        refusal=refusal,
        reason=reason,
    )


@router.post("/parameter-sets/{set_id:int}/submit")
async def submit(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Ask that a set become baseline."""
    return await _asked(request, session, actor, set_id, parameter_sets.submit)


@router.post("/parameter-sets/{set_id:int}/roll-back")
async def roll_back(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Ask that a former baseline become baseline again."""
    return await _asked(request, session, actor, set_id, parameter_sets.roll_back)


async def _asked(
    request: Request, session: Session, actor: Actor, set_id: int, ask: Callable[..., Approval]
) -> Response:
    """Open a request, and show it or why it was refused."""
    form = await read_texts(request)
    reason, state = form.get("reason", ""), request.app.state
    assessed = await run_in_threadpool(measured, actor, set_id, state.sight, state.engine)

    def change(session: Session) -> Approval:
        asked = (state.blobs, set_id, reason, seen_version(form), assessed)
        return ask(session, actor, *asked, policy=state.policy)

    outcome = await attempt(request, change)
    if outcome.value is None:
        page = partial(_page, request, session, actor, set_id, refusal=outcome.refusal, reason=reason)
        return await run_in_threadpool(page)
    return redirect(
        f"/approvals/{outcome.value.id}", flash="Submitted: another person with the role approver must sign."
    )


@router.post("/parameter-sets/{set_id:int}/withdraw")
async def withdraw(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Take a request back."""
    form = await read_texts(request)

    def change(session: Session) -> ParameterSet:
        return parameter_sets.withdraw(session, actor, set_id, seen_version(form), form.get("reason", ""))

    return await _changed(request, session, actor, set_id, change, "{} is withdrawn.")


@router.post("/parameter-sets/{set_id:int}/promote")
async def promote(request: Request, session: Reading, actor: Who, set_id: int) -> Response:
    """Make an approved set the baseline."""
    form = await read_texts(request)

    def change(session: Session) -> ParameterSet:
        return parameter_sets.promote(session, actor, set_id, seen_version(form), policy=request.app.state.policy)

    return await _changed(
        request, session, actor, set_id, change, "{} is the baseline now; nothing on board has changed."
    )


async def _changed(request: Request, session: Session, actor: Actor, set_id: int, change: Any, words: str) -> Response:
    """Make a transition and show the set, or show why it was refused."""
    outcome = await attempt(request, change)
    if outcome.value is None:
        return await run_in_threadpool(partial(_page, request, session, actor, set_id, refusal=outcome.refusal))
    return redirect(f"/parameter-sets/{set_id}", flash=words.format(outcome.value.name))
