"""The live part of the run page: what state the run is in, what that means, how far it is; and stopping it."""

from __future__ import annotations

from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import Response

from boresight.api.dependencies import Who, csrf
from boresight.pages.attempts import attempt
from boresight.pages.rendering import redirect
from boresight.pages.run_states import notices_of
from boresight.services import runs
from boresight.store.sessions import Session
from boresight.store.tables import Run

router = APIRouter(dependencies=[Depends(csrf)])


def live_of(request: Request, session: Session, run: Run) -> dict[str, Any]:  # noqa: ARG001 - the workers' state is asked of it
    """Gather what `run_live.html` shows."""
    progress = run.progress or {}
    return {
        "notices": notices_of(session, run),
        "fraction": float(progress.get("fraction") or 0.0),
        "message": progress.get("message") or "",
    }


@router.post("/runs/{run_id:int}/cancel")
async def cancel(request: Request, actor: Who, run_id: int) -> Response:
    """Ask a run to stop."""
    outcome = await attempt(request, partial(runs.cancel, actor=actor, run_id=run_id))
    if outcome.refusal:
        return redirect(f"/runs/{run_id}", flash=outcome.refusal.sentence, level="serious")
    return redirect(f"/runs/{run_id}", flash=f"Run #{run_id} was asked to stop.")
