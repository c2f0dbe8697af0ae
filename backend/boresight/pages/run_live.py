"""The live part of the run page: what state the run is in, what that means, how far it is; and stopping it.

A filter comes to its fraction frame by frame, so its pace and what is left can be told from the time so far. A batch does
not: its iterations end when the estimate rests, and only the time so far is told.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import Response

from boresight.api.dependencies import Who, csrf
from boresight.calibration.options import CalibrationSettings
from boresight.pages.attempts import attempt
from boresight.pages.forms import read_texts
from boresight.pages.rendering import redirect, redirect_refused
from boresight.pages.run_states import heard_s, notices_of
from boresight.services import runs, telemetry_sets
from boresight.store.sessions import Session
from boresight.store.tables import Run
from boresight.verdicts.numbers import duration, fixed

router = APIRouter(dependencies=[Depends(csrf)])


def live_of(request: Request, session: Session, run: Run) -> dict[str, Any]:
    """Gather what `run_live.html` shows."""
    progress, log = run.progress or {}, runs.log_lines(session, run.id)
    workers = request.app.state.workers
    return {
        "notices": notices_of(session, run, log, workers.state() if workers else None),
        "fraction": float(progress.get("fraction") or 0.0),
        "message": progress.get("message") or "",
        "frames_to_come": frames_to_come(session, run),
        "pace": pace_of(session, run),
        "heard_s": heard_s(run, log),
    }


def frames_to_come(session: Session, run: Run) -> int | None:
    """Return how many frames a run takes in one after another; None where it takes them all at once."""
    if not CalibrationSettings.parse(run.settings).sequential:
        return None
    return telemetry_sets.get_telemetry_set(session, run.telemetry_set_id).frames


def pace_of(session: Session, run: Run) -> str:
    """Say how quick a computing run is, and how long it will still take."""
    fraction, elapsed_s = (float((run.progress or {}).get(name) or 0.0) for name in ("fraction", "elapsed_s"))
    if not elapsed_s:
        return ""
    frames = frames_to_come(session, run)
    if not frames or not fraction:
        return f"for {duration(elapsed_s)}"
    left = duration(elapsed_s * (1 - fraction) / fraction)
    return f"{fixed(fraction * frames / elapsed_s, 1)} frames/s, about {left} left"


@router.post("/runs/{run_id:int}/cancel")
async def cancel(request: Request, actor: Who, run_id: int) -> Response:
    """Ask a run to stop."""
    reason = (await read_texts(request)).get("reason", "")
    outcome = await attempt(request, partial(runs.cancel, actor=actor, run_id=run_id, reason=reason))
    if outcome.refusal:
        return redirect_refused(f"/runs/{run_id}", outcome.refusal)
    return redirect(f"/runs/{run_id}", flash=f"Run #{run_id} was asked to stop.")
