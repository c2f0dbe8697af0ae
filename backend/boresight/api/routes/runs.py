"""Runs: launch, follow, stop; the calibration, its log and its report."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import OnlyAsked, Reading, SeenTag, Sighted, Who, Writing, require_tag, tag_of, weak
from boresight.api.keeping import Known, whole_tag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.figures.report import render_report
from boresight.services import runs
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES

router = APIRouter(prefix="/runs", tags=["runs"])


class Launch(BaseModel):
    """A calibration to be made."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"sensor_id": 1, "telemetry_set_id": 1, "settings": {"method": "batch"}, "label": "first look"}
            ]
        },
    )
    sensor_id: Id
    telemetry_set_id: Id
    settings: schemas.Document = Field(default_factory=dict, description="Method, variant, free parameters and so on.")
    validation_set_id: Id | None = Field(None, description="A set that is held out and only judged with.")
    label: str = ""
    validate_only: bool = Field(
        default=False, description="Check everything, change nothing, and say what it would be."
    )


class Cancellation(BaseModel):
    """Why a run is stopped."""

    model_config = ConfigDict(extra="forbid")
    reason: str = ""


def _tagged(row: Any, status: int = 200, **headers: str) -> Answer:
    """Answer with a run; its tag changes with its state and attempt, not with its progress, and so is weak."""
    return Answer(_shown(row), status, {"ETag": weak(_tag(row)), **headers})


def _tag(row: Any) -> str:
    return tag_of(row.id, row.state, row.attempt)


def _shown(row: Any) -> schemas.Document:
    return schemas.written(schemas.Run, row)


@router.get("", name="list_runs", summary="List runs", response_model=Page[schemas.Run])
def list_runs(
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    telemetry_set_id: Id | None = None,
    method: str | None = None,
    state: Annotated[list[schemas.RunState] | None, Query(description="Repeat for several.")] = None,
) -> Response:
    """List runs, newest first."""
    found = runs.list_runs(
        session,
        sensor_id=sensor_id,
        telemetry_set_id=telemetry_set_id,
        method=method,
        state=state,
        before_id=page.last_id,
        limit=page.limit + 1,
    )
    return json_response(page.cut(found, _shown))


@router.post(
    "",
    name="launch_run",
    summary="Launch a run",
    status_code=202,
    response_model=schemas.Run,
    responses={**refusals(404, 409), 200: {"model": schemas.DryRun, "description": "The dry run of `validate_only`."}},
)
def launch_run(
    order: Launch, actor: Who, once: Idempotent, session: Writing, asked: OnlyAsked, sight: Sighted
) -> Response:
    """Queue a calibration; `Location` is where to follow it. With `validate_only` only say what it would be and would know."""
    dry = asked or order.validate_only

    def act() -> Answer:
        made = runs.launch(
            session,
            actor,
            order.sensor_id,
            order.telemetry_set_id,
            order.settings,
            validation_set_id=order.validation_set_id,
            label=order.label,
            validate_only=dry,
            sight=sight,
        )
        if isinstance(made, dict):
            return Answer(made)
        return _tagged(made, 202, Location=f"/api/v1/runs/{made.id}")

    once.tried = dry
    return once.answer(session, actor, act)


@router.get("/{run_id}", name="get_run", summary="Read a run", response_model=schemas.Run, responses=refusals(404))
def get_run(run_id: Id, known: Known, session: Reading, request: Request) -> Response:  # noqa: ARG001 - asked for what it refuses
    """Read a run: its state, its progress, and when it has ended its summary."""
    row = runs.get_run(session, run_id)
    whole_tag(request, holds=row.state in TERMINAL_RUN_STATES)  # while it runs its progress moves under one tag
    return _tagged(row).response()


@router.post(
    "/{run_id}:cancel",
    name="cancel_run",
    summary="Stop a run",
    response_model=schemas.Run,
    responses=refusals(404, 409, 412, 428),
)
def cancel_run(
    run_id: Id, actor: Who, seen: SeenTag, once: Idempotent, session: Writing, cancellation: Cancellation | None = None
) -> Response:
    """Stop a run: one that waits ends at once, one that computes as soon as it notices. The ETag is that of the run."""
    reason = cancellation.reason if cancellation else ""

    def act() -> Answer:
        require_tag(seen, _tag(runs.get_run(session, run_id)), f"Run {run_id}")
        return _tagged(runs.cancel(session, actor, run_id, reason))

    return once.answer(session, actor, act)


@router.get(
    "/{run_id}/result",
    name="get_run_result",
    summary="Read the calibration",
    response_model=schemas.Calibration,
    responses=refusals(404, 409),
)
def get_run_result(
    run_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> Response:
    """Read the calibration JSON; while the run computes, what there is so far with status `running`."""
    return json_response(result_so_far(session, request.app.state.blobs, run_id))


@router.get(
    "/{run_id}/log",
    name="get_run_log",
    summary="Read the log",
    response_model=Page[schemas.LogLine],
    responses=refusals(404),
)
def get_run_log(
    run_id: Id,
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
    page: Paged,
) -> Response:
    """Read a run's log in the order it happened."""
    lines = runs.log_lines(session, run_id, after_id=page.last_id or 0, limit=page.limit + 1)
    return json_response(page.cut(lines, lambda line: schemas.written(schemas.LogLine, line)))


@router.get(
    "/{run_id}/report",
    name="get_run_report",
    summary="Read the report",
    response_class=HTMLResponse,
    responses=refusals(404, 409),
)
def get_run_report(
    run_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> HTMLResponse:
    """Read the report of a run that has ended: one HTML file that needs nothing else, figures included."""
    state = request.app.state
    report = render_report(runs.final_result(session, state.blobs, run_id), four_eyes=state.policy.four_eyes)
    headers = {"Content-Disposition": f'attachment; filename="run-{run_id}-report.html"'}
    return HTMLResponse(report, headers=headers)


def result_so_far(session: Session, blobs: BlobStore, run_id: Id) -> dict[str, Any]:
    """Return a run's calibration, complete or so far; with nothing yet, one that only says that it runs."""
    found = runs.result(session, blobs, run_id)
    return found if found is not None else _nothing_yet(runs.get_run(session, run_id).state)


def _nothing_yet(state: str) -> dict[str, Any]:
    """Say as a calibration that there is none."""
    status: Literal["running", "none"] = "running" if state in {"QUEUED", "RUNNING", "CANCELLING"} else "none"
    return {"schema": "boresight.calibration/1", "status": status, "run_state": state}
