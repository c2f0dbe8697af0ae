"""The log of a run on its page: every line with how grave it is, filtered by that in the address, and what follows a line.

A run that failed or was lost and an attempt that died are errors, a stop and an attempt that is computed again are warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading
from boresight.errors import RefusedInputError
from boresight.pages.rendering import render
from boresight.services import runs
from boresight.store.sessions import Session
from boresight.store.tables import Run, RunEvent

router = APIRouter()

LEVELS = {"info": "All lines", "warning": "Warnings and errors", "error": "Errors"}
SYMBOLS = {"info": "off", "warning": "caution", "error": "serious"}


def lines_of(rows: Sequence[RunEvent], level: str) -> list[RunEvent]:
    """Return the lines that are at least as grave as a level.

    Raises
    ------
    RefusedInputError
        When there is no such level.
    """
    if level not in LEVELS:
        raise RefusedInputError(f"A log has no level {level[:40]}; choose from {', '.join(LEVELS)}.")
    order = list(LEVELS)
    return [row for row in rows if order.index(row.level) >= order.index(level)]


def log_of(request: Request, session: Session, run: Run) -> dict[str, Any]:
    """Gather what `run_log.html` shows."""
    level = request.query_params.get("level", "info")
    rows = runs.log_lines(session, run.id)
    return {
        "lines": lines_of(rows, level),
        "symbols": SYMBOLS,
        "level": level,
        "filters": [(name, words, len(lines_of(rows, name))) for name, words in LEVELS.items()],
    }


@router.get("/runs/{run_id:int}/log/lines", response_class=HTMLResponse)
def log_lines(request: Request, session: Reading, run_id: int, after: int = 0, level: str = "info") -> HTMLResponse:
    """Give the lines after a line as list items, for a page that follows the log."""
    rows = runs.log_lines(session, run_id, after_id=after)
    return render(request, "runs/run_log_lines.html", lines=lines_of(rows, level), symbols=SYMBOLS)
