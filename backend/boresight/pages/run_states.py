"""What a run's state means for whoever looks at it now, in a sentence each: what it waits for, what ended it, what to do."""

from __future__ import annotations

from boresight.services import runs
from boresight.store.sessions import Session
from boresight.store.tables import Run

LONGEST_QUEUE = 500
WHAT_TO_TRY = (
    "Read the telemetry's quality report, then clone this run and edit it: free fewer parameters, or use another set."
)


def notices_of(session: Session, run: Run) -> list[tuple[str, str]]:
    """Say in a sentence each what a state means for whoever looks at the run now."""
    why = (run.reason or "").strip()
    telling = {
        "QUEUED": [("standby", _queue_sentence(session, run))],
        "CANCELLING": [("caution", f"Stopping: {why} The worker is asked five times a second.")],
        "FAILED": [
            ("serious", why or "The run failed and gave no cause; its log has the last lines."),
            ("off", WHAT_TO_TRY),
        ],
        "LOST": [("serious", _lost_sentence(run, why))],
        "CANCELLED": [("off", why or "This run was cancelled.")],
    }
    return telling.get(run.state, [])


def _lost_sentence(run: Run, why: str) -> str:
    since = _clock(run.lease_until_utc or run.ended_utc)
    return f"The worker stopped reporting at {since}; no result is trusted. {why} Clone this run to compute it again."


def _clock(text: str | None) -> str:
    return text[:19].replace("T", " ") + "Z" if text else "an unknown time"


def _queue_sentence(session: Session, run: Run) -> str:
    """Say how many runs are in front."""
    waiting = runs.list_runs(session, state="QUEUED", before_id=run.id, limit=LONGEST_QUEUE)
    if not waiting:
        return "Next in the queue: it starts when a worker is free."
    more = "at least " if len(waiting) == LONGEST_QUEUE else ""
    return f"Position {more}{len(waiting) + 1} in the queue."
