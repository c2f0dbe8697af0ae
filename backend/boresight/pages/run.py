"""The run page, the review desk: head and verdict always, below them one of its parts.

While a run computes the page shows what there is so far, marked PARTIAL, and follows the event stream. It never shows a
parameter without its sigma, and a result that is not to be trusted says so above everything else. A tab loads only what it
shows; the whole view is in the address.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response
from markupsafe import Markup

from boresight.api.dependencies import Reading, Who, csrf
from boresight.calibration.options import title_of
from boresight.errors import NotFoundError
from boresight.figures import WIDE
from boresight.pages.attempts import attempt
from boresight.pages.formats import short_hash, utc, words
from boresight.pages.rendering import redirect, redirect_refused, render
from boresight.pages.run_live import live_of
from boresight.pages.run_parts import Desk, marks_of, part_of_page
from boresight.pages.run_tabs import FORMER, TITLES, tabs_of
from boresight.pages.runs import read_names, seconds_of
from boresight.services import gates, notes, parameter_sets, runs, sensors, telemetry_sets
from boresight.services.actors import Actor
from boresight.services.neighbours import neighbours
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES, ParameterSet, Run, TelemetrySet
from boresight.verdicts.gates.table import gate_rows
from boresight.verdicts.numbers import MISSING, count, duration
from boresight.verdicts.verdict import verdict

router = APIRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class Action:
    """A button: whether it belongs on the page, and why it cannot be pressed."""

    offered: bool
    blocked: str | None = None


def actions_of(run: Run, actor: Actor) -> dict[str, Action]:
    """Say what may be done with a run, and by whom."""
    lacking = None if "analyst" in actor.roles else "Only an analyst may {}; ask an administrator for the role."
    create = lacking.format("create parameter sets") if lacking else _why_no_set(run)
    return {
        "cancel": Action(run.state in {"QUEUED", "RUNNING"}, lacking and lacking.format("cancel runs")),
        "create": Action(run.state == "SUCCEEDED", create),
    }


def _why_no_set(run: Run) -> str | None:
    """Say why no parameter set can be made of a run that ended, or None where one can."""
    status = (run.summary or {}).get("status")
    if status is None or status in parameter_sets.USABLE_STATUSES:
        return None
    return f"No parameter set is made of a result that ended as {words(status)}."


def header_of(run: Run, by: str, data: TelemetrySet, validation: TelemetrySet | None) -> list[tuple[str, Any]]:
    """Lay out who ran what on which data, and when."""
    return [
        ("Data", _set_link(data)),
        ("Validation", _set_link(validation) if validation else "none"),
        ("Launched by", by),
        ("Launched", utc(run.launched_utc)),
        ("Started", utc(run.started_utc)),
        ("Ended", utc(run.ended_utc)),
        ("Duration", duration(seconds_of(run))),
        ("Attempt", count(run.attempt) if run.attempt else MISSING),
    ]


def _set_link(data: TelemetrySet) -> Markup:
    link = Markup('<a href="/telemetry/{}">{}</a> ').format(data.id, data.name)
    return link + short_hash(data.original_sha256)


@router.get("/runs/{run_id:int}", response_class=HTMLResponse)
def run_page(request: Request, session: Reading, actor: Who, run_id: int, part: str = "summary") -> HTMLResponse:
    """Show a run: its head and verdict, and one of its parts."""
    part = FORMER.get(part, part)
    if part not in TITLES:
        raise NotFoundError(f"A run has no part {part[:40]}; choose from {', '.join(TITLES)}.")
    desk = desk_of(request, session, actor, run_id)
    run, result = desk.run, desk.result
    return render(
        request,
        "runs/run.html",
        run=run,
        terminal=run.state in TERMINAL_RUN_STATES,
        sensor=desk.sensor,
        method=title_of(run.method),
        **head_of(desk),
        **live_of(request, session, run),
        result=result,
        partial=run.result_sha256 is None,
        marks=marks_of(result),
        judged=verdict(result) if marks_of(result) and result else None,
        part=part,
        tabs=tabs_of(run_id, part, result, len(notes.list_notes(session, actor, "runs", run_id))),
        advice=list((result or {}).get("advice") or ()),
        no_result=desk.why_nothing,
        wide=WIDE,
        **part_of_page(desk, part),
    )


def desk_of(request: Request, session: Session, actor: Actor, run_id: int) -> Desk:
    """Fetch a run with its sensor, its data and what it has found so far."""
    run = runs.get_run(session, run_id)
    is_void = run.state in TERMINAL_RUN_STATES and run.result_sha256 is None  # what was computed does not count
    return Desk(
        request=request,
        session=session,
        actor=actor,
        run=run,
        sensor=sensors.get_sensor(session, run.sensor_id),
        data=telemetry_sets.get_telemetry_set(session, run.telemetry_set_id),
        validation=_validation_of(session, run),
        result=None if is_void else runs.result(session, request.app.state.blobs, run_id),
    )


def _validation_of(session: Session, run: Run) -> TelemetrySet | None:
    number = run.validation_set_id
    return None if number is None else telemetry_sets.get_telemetry_set(session, number)


def head_of(desk: Desk) -> dict[str, Any]:
    """Gather what stands above the tabs: who ran what, what may be done with it, and the runs beside it."""
    actions, made = actions_of(desk.run, desk.actor), parameter_set_of(desk.session, desk.run)
    by = read_names(desk.session).person(desk.run.launched_by)
    return {
        "actions": actions,
        "blocked": sorted({action.blocked for action in actions.values() if action.offered and action.blocked}),
        "parameter_set": made,
        "gates": gates_of(desk.session, made),
        "header": header_of(desk.run, by, desk.data, desk.validation),
        "neighbours": neighbours(desk.session, desk.run.id),
    }


def gates_of(session: Session, made: ParameterSet | None) -> dict[str, Any] | None:
    """Read the newest gate report of a run's set, a row a gate; None where the run has no set, no rows before it is assessed."""
    if made is None:
        return None
    report = gates.newest_report(session, made.id)
    if report is None:
        return {"words": "", "rows": []}
    document = gates.with_waivers(session, report)
    return {"words": document["words"], "rows": gate_rows(document)}


def parameter_set_of(session: Session, run: Run) -> ParameterSet | None:
    """Return the set that was made from a run, if one was."""
    return parameter_sets.set_of_run(session, run.id)


@router.post("/runs/{run_id:int}/parameter-set")
async def create_parameter_set(request: Request, actor: Who, run_id: int) -> Response:
    """Make a candidate set from a run's result."""
    blobs = request.app.state.blobs
    outcome = await attempt(request, partial(parameter_sets.create_from_run, actor=actor, blobs=blobs, run_id=run_id))
    if outcome.refusal is not None:
        return redirect_refused(f"/runs/{run_id}", outcome.refusal)
    return redirect(f"/parameter-sets/{outcome.made.id}", flash=f"{outcome.made.name} is a candidate.")
