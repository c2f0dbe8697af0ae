"""The live part of the run page: its state with an explanation, its progress, its log, cancelling it, and files to download.

A filter comes to its fraction frame by frame, so what is left can be told; of a batch only the time so far is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response

from boresight.console.access.dependencies import Reading, Who, csrf, get_server
from boresight.console.pages.formats import seconds_since
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import make_change, read_texts, redirect, render
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.tables import Run, RunEvent, parse_progress
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.platform.jobs.worker_news import WorkerState
from boresight.platform.web.media import CameraFile
from boresight.verdicts.numbers import count, duration, fixed, percent

LAST_LINES = 5
SILENT_S = 30.0  # a worker reports four times a second, or at every frame of a slow replay
WHAT_TO_TRY = (
    "Read the telemetry's quality report, then clone this run and edit it: free fewer parameters, or use another set."
)
UPLOAD_WITH_TIMES = "Every attempt on this set fails: upload it again with its times."
NO_WORKERS = (
    "This server has no workers and no scheduler in its settings: the run starts when another server on "
    "this database takes it, or when this one is restarted with workers."
)
NOT_THERE = "No worker is connected yet: the server's workers are still starting, or its scheduler cannot be reached."


@dataclass(frozen=True)
class StateNotice:
    """A sentence above the verdict; `code`: which one, for scripts."""

    level: str
    sentence: str
    code: str = ""
    lines: tuple[RunEvent, ...] = ()
    links: tuple[tuple[str, str], ...] = ()


def list_notices(
    session: Session, run: Run, log: Sequence[RunEvent], workers: WorkerState | None = None
) -> list[StateNotice]:
    """Return the notices that explain a run's state."""
    notices_by_state = {
        "QUEUED": lambda: [_explain_queue(session, run, workers), *_explain_attempts(log)],
        "RUNNING": lambda: [*_explain_attempts(log), *_explain_silence(run)],
        "CANCELLING": lambda: [StateNotice("caution", _stopping_sentence(run, log), "stopping")],
        "FAILED": lambda: _explain_failure(session, run, log),
        "LOST": lambda: [
            StateNotice("serious", _lost_sentence(run), "lost", links=_list_repeats(run)),
            *_explain_partial(run),
        ],
        "CANCELLED": lambda: [
            StateNotice("off", _reason(run) or "This run was cancelled.", "cancelled"),
            *_explain_partial(run),
        ],
    }
    return notices_by_state.get(run.state, list)()


def heard_s(run: Run, log: Sequence[RunEvent]) -> float | None:
    """Return the seconds since the last sign of a run: a report of its worker, or a line of its log."""
    times = [line.at_utc for line in log[-1:]] + [parse_progress(run.progress).at_utc or ""]
    return seconds_since(max(times, default=""))


def _reason(run: Run) -> str:
    return (run.reason or "").strip()


def _list_repeats(run: Run) -> tuple[tuple[str, str], ...]:
    return ((f"/runs/new?clone={run.id}", "Run it again"), (f"/telemetry/{run.telemetry_set_id}", "Quality report"))


def _explain_failure(session: Session, run: Run, log: Sequence[RunEvent]) -> list[StateNotice]:
    """Explain a failure: its cause, the end of the log, and what to try."""
    cause = _reason(run) or "The run failed and no cause was recorded; see the last lines of its log."
    lines = tuple(line for line in log if line.state != "FAILED")
    told, links, code = WHAT_TO_TRY, _list_repeats(run), "to-try"
    if runs.lacks_times(session, run):
        upload = (f"/telemetry?sensor={run.sensor_id}#upload-title", "Upload a set with times")
        told, links, code = UPLOAD_WITH_TIMES, (upload, links[-1]), "upload-with-times"
    return [
        StateNotice("serious", cause, "failed", lines=lines[-LAST_LINES:]),
        StateNotice("off", told, code, links=links),
        *_explain_partial(run),
    ]


def _explain_partial(run: Run) -> list[StateNotice]:
    told = parse_progress(run.progress)
    if not told.fraction:
        return []
    so_far = f"It had reached {percent(told.fraction, 0)}{f' ({told.message})' if told.message else ''}"
    return [
        StateNotice("off", f"PARTIAL: {so_far}. The estimate at that point is not valid and is not shown.", "partial")
    ]


def _explain_attempts(log: Sequence[RunEvent]) -> list[StateNotice]:
    again = [line for line in log if line.state == "QUEUED" and line.cause]
    if not again:
        return []
    told = f"Attempt {count(again[-1].attempt)} ended without a result: {again[-1].cause}."
    return [StateNotice("caution", f"{told} It is being computed again from the start.", "again")]


def _explain_silence(run: Run) -> list[StateNotice]:
    """Explain that a worker has stopped reporting."""
    silent_s = seconds_since(parse_progress(run.progress).at_utc or run.started_utc)
    if silent_s is None or silent_s < SILENT_S:
        return []
    then = "If the server does not renew its lease, the run is queued again automatically."
    return [StateNotice("caution", f"No report from the worker for {duration(silent_s)}. {then}", "silent")]


def _stopping_sentence(run: Run, log: Sequence[RunEvent]) -> str:
    asked = [line.at_utc for line in log if line.state == "CANCELLING"]
    since = f"Requested at {asked[-1]}, {duration(seconds_since(asked[-1]))} ago. " if asked else ""
    return (
        f"Stopping: {_reason(run)} {since}The worker checks five times per second; if it does not respond, its "
        "process is stopped after a few seconds."
    )


def _lost_sentence(run: Run) -> str:
    """Describe when the worker was last heard of, and that its partial result is void."""
    heard = parse_progress(run.progress).at_utc or run.lease_until_utc or run.ended_utc
    told = f"The worker stopped reporting at {heard or 'an unknown time'}; there is no valid result."
    return " ".join(filter(None, [told, _reason(run), "Run it again to get one."]))


def _explain_queue(session: Session, run: Run, workers: WorkerState | None) -> StateNotice:
    """Describe how many runs are ahead, and what the first of them waits for."""
    before = run_queries.count_queued_before(session, run.id)
    place = f"Position {before + 1} in the queue." if before else "Next in the queue."
    code, waits_for = _waits_for(session, workers)
    return StateNotice("standby", f"{place} {waits_for}", code)


def _waits_for(session: Session, workers: WorkerState | None) -> tuple[str, str]:
    if not workers or not workers.turns:
        return "no-workers", NO_WORKERS
    threads = workers.threads
    if not workers.connected or not threads:
        return "no-worker-connected", NOT_THERE
    busy = sorted(run.id for run in runs.list_runs(session, state=["RUNNING", "CANCELLING"]))
    if workers.tasks < threads:
        return "worker-free", "A worker is free: the run starts at once."
    named = (
        f" with {', '.join(f'run #{number}' for number in busy[:6])}{' and others' * (len(busy) > 6)}" if busy else ""
    )
    which = "The only worker is" if threads == 1 else f"All {threads} workers are"
    return "workers-busy", f"{which} busy{named}; the run starts when one is free."


router = PageRouter(dependencies=[Depends(csrf)])


def make_live_part(request: Request, session: Session, run: Run) -> dict[str, Any]:
    """Gather what the head of `runs/run.html` shows."""
    progress, log = parse_progress(run.progress), runs.list_log_lines(session, run.id)
    workers = get_server(request).workers
    return {
        "notices": list_notices(session, run, log, workers.state() if workers else None),
        "lacks_times": runs.lacks_times(session, run),
        "fraction": progress.fraction or 0.0,
        "message": progress.message or "",
        "frames_to_come": runs.frames_to_come(session, run),
        "pace": describe_progress(session, run),
        "heard_s": heard_s(run, log),
    }


def describe_progress(session: Session, run: Run) -> str:
    """Describe the speed of a computing run, and its remaining time."""
    told = parse_progress(run.progress)
    fraction, elapsed_s = told.fraction or 0.0, told.elapsed_s or 0.0
    if not elapsed_s:
        return ""
    frames = runs.frames_to_come(session, run)
    if not frames or not fraction:
        return f"for {duration(elapsed_s)}"
    left = duration(elapsed_s * (1 - fraction) / fraction)
    return f"{fixed(fraction * frames / elapsed_s, 1)} frames/s, about {left} left"


@router.post("/runs/{run_id:int}/cancel")
async def cancel(request: Request, actor: Who, run_id: int) -> Response:
    """Ask a run to stop."""
    reason = (await read_texts(request)).get("reason", "")
    change = partial(runs.cancel, actor=actor, run_id=run_id, reason=reason)
    return await make_change(request, change, f"/runs/{run_id}", f"Cancelling of run #{run_id} was requested.")


run_log_router = PageRouter()

LEVELS = {"info": "All lines", "warning": "Warnings and errors", "error": "Errors"}
SYMBOLS = {"info": "off", "warning": "caution", "error": "serious"}


def filter_lines(rows: Sequence[RunEvent], level: str) -> list[RunEvent]:
    """Return the lines that are at least as grave as a level."""
    if level not in LEVELS:
        raise RefusedInputError(f"There is no log level {level[:40]}; choose from {', '.join(LEVELS)}.")
    order = list(LEVELS)
    return [row for row in rows if order.index(row.level) >= order.index(level)]


def make_log_part(request: Request, session: Session, run: Run) -> dict[str, Any]:
    """Gather what the part `log` of `runs/run.html` shows."""
    level = request.query_params.get("level", "info")
    rows = runs.list_log_lines(session, run.id)
    return {
        "lines": filter_lines(rows, level),
        "symbols": SYMBOLS,
        "level": level,
        "filters": [(name, words, len(filter_lines(rows, name))) for name, words in LEVELS.items()],
    }


@run_log_router.get("/runs/{run_id:int}/log/lines", response_class=HTMLResponse)
def log_lines(request: Request, session: Reading, run_id: int, after: int = 0, level: str = "info") -> HTMLResponse:
    """Give the lines after a line as list items, for a page that follows the log."""
    rows = runs.list_log_lines(session, run_id, after_id=after)
    return render(request, "runs/log_lines.html", lines=filter_lines(rows, level), symbols=SYMBOLS)


run_file_router = PageRouter()


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"'}


@run_file_router.get("/runs/{run_id:int}/log")
def log(session: Reading, run_id: int) -> PlainTextResponse:
    """Give every line of a run's log as text: time, attempt, kind, message."""
    lines = [
        f"{line.at_utc} {line.attempt} {line.kind} {line.message}" for line in runs.list_log_lines(session, run_id)
    ]
    return PlainTextResponse("".join(f"{line}\n" for line in lines), headers=_attachment(f"run-{run_id}.log"))


@run_file_router.get("/runs/{run_id:int}/sensor.json")
def sensor_file(session: Reading, run_id: int) -> JSONResponse:
    """Give the sensor file that the run was made with, whatever has been edited since."""
    run = runs.get_run(session, run_id)
    return JSONResponse(run.sensor_document, headers=_attachment(f"run-{run_id}.sensor.json"))


@run_file_router.get("/runs/{run_id:int}/camera-file")
def camera_file(request: Request, session: Reading, run_id: int, to: str) -> Response:
    """Give the camera as a file of another program, or go back to the run's page and say why not."""
    try:
        content, name = runs.export_run(session, get_server(request).blobs, run_id, to)
    except RefusedInputError as refusal:
        return redirect(f"/runs/{run_id}", flash=str(refusal), level="serious")
    return CameraFile(content, name)
