"""What a run gives to take along: its report as one HTML file, its log as text, the sensor file as it was at launch."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse

from boresight.api.dependencies import Reading, current_actor
from boresight.errors import ConflictError
from boresight.figures.report import render_report
from boresight.services import runs

router = APIRouter(dependencies=[Depends(current_actor)])


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"'}


@router.get("/runs/{run_id:int}/report")
def report(request: Request, session: Reading, run_id: int) -> HTMLResponse:
    """Give the report of a run that has a result.

    Raises
    ------
    ConflictError
        When there is no result yet, or none was reached.
    """
    run = runs.get_run(session, run_id)
    result = runs.result(session, request.app.state.blobs, run_id)
    if run.result_sha256 is None or result is None:
        raise ConflictError(f"Run {run_id} is {run.state} and has no result; there is nothing to report.")
    return HTMLResponse(render_report(result), headers=_attachment(f"run-{run_id}-report.html"))


@router.get("/runs/{run_id:int}/log")
def log(session: Reading, run_id: int) -> PlainTextResponse:
    """Give every line of a run's log as text: time, attempt, kind, message."""
    lines = [f"{line.at_utc} {line.attempt} {line.kind} {line.message}" for line in runs.log_lines(session, run_id)]
    return PlainTextResponse("".join(f"{line}\n" for line in lines), headers=_attachment(f"run-{run_id}.log"))


@router.get("/runs/{run_id:int}/sensor.json")
def sensor_file(session: Reading, run_id: int) -> JSONResponse:
    """Give the sensor file that the run was made with, whatever has been edited since."""
    run = runs.get_run(session, run_id)
    return JSONResponse(run.sensor_document, headers=_attachment(f"run-{run_id}.sensor.json"))
