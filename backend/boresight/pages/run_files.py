"""What a run gives to take along: its log as text, the sensor file as it was at launch."""

from __future__ import annotations

from fastapi import APIRouter, Depends
from fastapi.responses import JSONResponse, PlainTextResponse

from boresight.api.credentials import who_acts
from boresight.api.dependencies import Reading
from boresight.services import runs

router = APIRouter(dependencies=[Depends(who_acts)])


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"'}


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
