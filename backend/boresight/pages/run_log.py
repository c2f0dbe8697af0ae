"""The log of a run on its page."""

from __future__ import annotations

from typing import Any

from fastapi import Request

from boresight.services import runs
from boresight.store.sessions import Session
from boresight.store.tables import Run


def log_of(request: Request, session: Session, run: Run) -> dict[str, Any]:  # noqa: ARG001 - its query filters
    """Gather what `run_log.html` shows."""
    return {"log": runs.log_lines(session, run.id)}
