"""The run page, the review desk: verdict first, then one of its parts: the estimate, its trust, its matching.

While a run computes the page shows what there is so far, marked PARTIAL, and follows the event stream. It never shows a
parameter without its sigma, and a result that is not to be trusted says so above everything else.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response
from markupsafe import Markup

from boresight.api.dependencies import Reading, Who, csrf
from boresight.errors import NotFoundError
from boresight.figures import CHAPTERS, WIDE
from boresight.figures.command_line import calibrate_command
from boresight.figures.numbers import MISSING, count
from boresight.figures.parameter_table import parameter_rows
from boresight.pages.attempts import attempt
from boresight.pages.formats import duration, short_hash, utc, words
from boresight.pages.methods import title_of
from boresight.pages.rendering import redirect, render
from boresight.pages.run_live import live_of
from boresight.pages.run_log import log_of
from boresight.pages.run_parts import TITLES, marks_of, matching_of, tabs_of, trust_of
from boresight.pages.runs import read_names, seconds_of
from boresight.services import gates, parameter_sets, runs, sensors, telemetry_sets
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES, ParameterSet, Run, TelemetrySet

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


def provenance_of(run: Run, result: Mapping[str, Any] | None) -> list[tuple[str, Any]]:
    """Lay out the addresses and versions that make the run again what it was."""
    inputs = (result or {}).get("inputs") or {}
    hashes = [(f"{name} SHA-256", _hash(value)) for name, value in _flat(inputs.get("sha256s") or {})]
    versions = ", ".join(f"{name} {value}" for name, value in (inputs.get("versions") or {}).items())
    timing = ", ".join(f"{name.replace('_', ' ')} {duration(value)}" for name, value in _timing(result))
    left_out = ", ".join(
        f"{count(part['count'])} {part['what']}: {part['reason']}" for part in (result or {}).get("left_out") or ()
    )
    return [
        *hashes,
        ("Left out", left_out or MISSING),
        ("Result SHA-256", short_hash(run.result_sha256) if run.result_sha256 else MISSING),
        ("Versions", versions or MISSING),
        ("Time spent", timing or MISSING),
    ]


def _timing(result: Mapping[str, Any] | None) -> list[tuple[str, float]]:
    return [(name, value) for name, value in ((result or {}).get("timing_s") or {}).items() if value is not None]


def _flat(hashes: Mapping[str, Any] | Sequence[str]) -> list[tuple[str, Any]]:
    return list(hashes.items()) if isinstance(hashes, Mapping) else [("input", value) for value in hashes]


def _hash(value: Any) -> Markup | str:
    return short_hash(str(value)) if value else MISSING


def command_of(run: Run, data: TelemetrySet, validation: TelemetrySet | None) -> str:
    """Write the command line that computes this run again from the files that the page offers."""
    files = data.name, f"run-{run.id}.sensor.json"
    words = calibrate_command(*files, run.settings, validation.name if validation else None, f"run-{run.id}.json")
    return " \\\n  ".join(words)


@router.get("/runs/{run_id:int}", response_class=HTMLResponse)
def run_page(request: Request, session: Reading, actor: Who, run_id: int, part: str = "estimate") -> HTMLResponse:
    """Show a run: its head and verdict, and one of its parts."""
    if part not in TITLES:
        raise NotFoundError(f"A run has no part {part[:40]}; choose from {', '.join(TITLES)}.")
    run = runs.get_run(session, run_id)
    sensor = sensors.get_sensor(session, run.sensor_id)
    data = telemetry_sets.get_telemetry_set(session, run.telemetry_set_id)
    validation = run.validation_set_id and telemetry_sets.get_telemetry_set(session, run.validation_set_id)
    is_void = run.state in TERMINAL_RUN_STATES and run.result_sha256 is None  # what was computed does not count
    result = None if is_void else runs.result(session, request.app.state.blobs, run_id)
    actions = actions_of(run, actor)
    made = parameter_set_of(session, run)
    has_estimate = bool(result and result.get("parameters"))
    return render(
        request,
        "run.html",
        run=run,
        terminal=run.state in TERMINAL_RUN_STATES,
        sensor=sensor,
        method=title_of(run.method),
        actions=actions,
        blocked=sorted({action.blocked for action in actions.values() if action.offered and action.blocked}),
        parameter_set=made,
        gates=gates.verdicts(session, [made.id]).get(made.id) if made else None,
        **live_of(request, session, run),
        header=header_of(run, read_names(session).person(run.launched_by), data, validation or None),
        result=result,
        partial=run.result_sha256 is None,
        marks=marks_of(result),
        part=part,
        tabs=tabs_of(run_id, part, result),
        trust=trust_of(result, _why_nothing(run)) if part == "trust" else None,
        matching=matching_of(result, _why_nothing(run)) if part == "matching" else None,
        advice=list((result or {}).get("advice") or ()),
        rows=parameter_rows(_with_truth(result, sensor.truth)) if result and has_estimate else [],
        no_result=_why_nothing(run),
        figures=[] if is_void else list(CHAPTERS["estimate"]),
        wide=WIDE,
        **log_of(request, session, run),
        provenance=provenance_of(run, result),
        validation=validation or None,
        data=data,
        command=command_of(run, data, validation or None),
        settings_json=json.dumps(run.settings, indent=2, sort_keys=True),
    )


def _with_truth(result: Mapping[str, Any], truth: Mapping[str, Any] | None) -> dict[str, Any]:
    """Put the simulated sensor's true values beside a result that does not carry them."""
    return {**result, "truth": result.get("truth") or truth}


def _why_nothing(run: Run) -> str:
    """Say why there is no result, to follow `No verdict: `."""
    return {
        "QUEUED": "the run has not started.",
        "RUNNING": "the first frames are being read.",
    }.get(run.state, f"the run ended as {run.state} before it had a result.")


def parameter_set_of(session: Session, run: Run) -> ParameterSet | None:
    """Return the set that was made from a run, if one was."""
    made = parameter_sets.list_parameter_sets(session, sensor_id=run.sensor_id)
    return next((known for known in made if known.run_id == run.id), None)


@router.post("/runs/{run_id:int}/parameter-set")
async def create_parameter_set(request: Request, actor: Who, run_id: int) -> Response:
    """Make a candidate set from a run's result."""
    blobs = request.app.state.blobs
    outcome = await attempt(request, partial(parameter_sets.create_from_run, actor=actor, blobs=blobs, run_id=run_id))
    if outcome.value is None:
        sentence = outcome.refusal.sentence if outcome.refusal else "The set was not made."
        return redirect(f"/runs/{run_id}", flash=sentence, level="serious")
    return redirect(f"/parameter-sets/{outcome.value.id}", flash=f"{outcome.value.name} is a candidate.")
