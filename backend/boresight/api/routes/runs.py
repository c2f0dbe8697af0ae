"""Runs: launch, follow, stop; the calibration, its log and its report."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Query
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.dependencies import Blobs, Held, OnlyAsked, Reading, SeenTag, Sighted, Who, Writing
from boresight.api.keeping import SAME_FOR_ALL, whole_tag
from boresight.api.numbers import Id
from boresight.api.operation import Answer, json_response, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.figures.report import render_report
from boresight.services import runs
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES, Run, RunEvent

router = operations("/runs", tags=["runs"])


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
    settings: schemas.Settings = Field(default_factory=dict, description="Method, variant, free parameters and so on.")
    validation_set_id: Id | None = Field(None, description="A set that is held out and only judged with.")
    label: str = ""
    validate_only: bool = Field(
        default=False, description="Check everything, change nothing, and say what it would be."
    )


class Cancellation(BaseModel):
    """Why a run is stopped."""

    model_config = ConfigDict(extra="forbid")
    reason: str = ""


@router.get("", summary="List runs", response_model=Page[schemas.Run], dependencies=[SAME_FOR_ALL])
def list_runs(
    session: Reading,
    page: Paged,
    sensor_id: Id | None = None,
    telemetry_set_id: Id | None = None,
    method: str | None = None,
    state: Annotated[list[schemas.RunState] | None, Query(description="Repeat for several.")] = None,
) -> Listing[Run]:
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
    return page.cut(found)


@router.post(
    "",
    summary="Launch a run",
    status_code=202,
    response_model=schemas.Run,
    responses={200: {"model": schemas.DryRun, "description": "The dry run of `validate_only`."}},
)
def launch_run(order: Launch, actor: Who, session: Writing, asked: OnlyAsked, sight: Sighted) -> Run | Answer:
    """Queue a calibration; `Location` is where to follow it. With `validate_only` only say what it would be and would know."""
    made = runs.launch(
        session,
        actor,
        order.sensor_id,
        order.telemetry_set_id,
        order.settings,
        validation_set_id=order.validation_set_id,
        label=order.label,
        validate_only=asked or order.validate_only,
        sight=sight,
    )
    return Answer(made, shape=schemas.DryRun, is_trial=True) if isinstance(made, dict) else made


@router.get("/{run_id}", summary="Read a run", response_model=schemas.Run, dependencies=[SAME_FOR_ALL])
def get_run(run_id: Id, session: Reading, request: Request) -> Run:
    """Read a run: its state, its progress, and when it has ended its summary."""
    row = runs.get_run(session, run_id)
    whole_tag(request, holds=row.state in TERMINAL_RUN_STATES)  # while it runs its progress moves under one tag
    return row


@router.post("/{run_id}:cancel", summary="Stop a run", response_model=schemas.Run)
def cancel_run(
    run_id: Id, actor: Who, seen: SeenTag, session: Writing, cancellation: Cancellation | None = None
) -> Run:
    """Stop a run: one that waits ends at once, one that computes as soon as it notices. The ETag is that of the run."""
    seen.require(schemas.Run, runs.get_run(session, run_id), f"Run {run_id}")
    return runs.cancel(session, actor, run_id, cancellation.reason if cancellation else "")


@router.get("/{run_id}/result", summary="Read the calibration", response_model=schemas.Calibration)
def get_run_result(run_id: Id, session: Reading, blobs: Blobs) -> Response:
    """Read the calibration JSON; while the run computes, what there is so far with status `running`."""
    return json_response(result_so_far(session, blobs, run_id))


@router.get("/{run_id}/log", summary="Read the log", response_model=Page[schemas.LogLine], dependencies=[SAME_FOR_ALL])
def get_run_log(run_id: Id, session: Reading, page: Paged) -> Listing[RunEvent]:
    """Read a run's log in the order it happened."""
    return page.cut(runs.log_lines(session, run_id, after_id=page.last_id or 0, limit=page.limit + 1))


@router.get("/{run_id}/report", summary="Read the report", response_class=HTMLResponse)
def get_run_report(run_id: Id, session: Reading, blobs: Blobs, policy: Held) -> HTMLResponse:
    """Read the report of a run that has ended: one HTML file that needs nothing else, figures included."""
    report = render_report(runs.final_result(session, blobs, run_id), four_eyes=policy.four_eyes)
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
