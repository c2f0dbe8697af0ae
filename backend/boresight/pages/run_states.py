"""What a run's state means for whoever looks at it now: what it waits for, what ended it, what to do next.

Nothing is said that the rows do not hold: who asked for a stop and when is a line of the log, when the worker was last
heard of is the time of its last report, and the workers of this server are what its engine saw at its last turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.pages.formats import seconds_since
from boresight.services import runs
from boresight.store.sessions import Session
from boresight.store.tables import Run, RunEvent
from boresight.verdicts.numbers import count, duration, percent

LAST_LINES = 5
SILENT_S = 30.0  # a worker reports four times a second, or at every frame of a slow replay
WHAT_TO_TRY = (
    "Read the telemetry's quality report, then clone this run and edit it: free fewer parameters, or use another set."
)
NO_WORKERS = (
    "This server computes nothing itself (no workers, no scheduler in its settings): it starts when another server on "
    "this database takes it, or when this one is started with workers."
)
NOT_THERE = "No worker is there yet: this server's are still starting, or its scheduler cannot be reached."


@dataclass(frozen=True)
class Notice:
    """A sentence above the verdict.

    Parameters
    ----------
    level
        How grave it is.
    sentence
        What is so.
    lines
        The end of the log that belongs to it.
    links
        (address, words) of what to do next; the first is a button.
    """

    level: str
    sentence: str
    lines: tuple[RunEvent, ...] = ()
    links: tuple[tuple[str, str], ...] = ()


def notices_of(
    session: Session, run: Run, log: Sequence[RunEvent], workers: Mapping[str, Any] | None = None
) -> list[Notice]:
    """Say what a run's state means.

    Parameters
    ----------
    log
        The run's log in order.
    workers
        What the engine of this server says of itself; None where there is none.
    """
    telling = {
        "QUEUED": lambda: [Notice("standby", _queue_sentence(session, run, workers)), *_of_attempts(log)],
        "RUNNING": lambda: [*_of_attempts(log), *_of_silence(run)],
        "CANCELLING": lambda: [Notice("caution", _stopping_sentence(run, log))],
        "FAILED": lambda: _of_failure(run, log),
        "LOST": lambda: [Notice("serious", _lost_sentence(run), links=_again(run)), *_of_partial(run)],
        "CANCELLED": lambda: [Notice("off", _reason(run) or "This run was cancelled."), *_of_partial(run)],
    }
    return telling.get(run.state, list)()


def heard_s(run: Run, log: Sequence[RunEvent]) -> float | None:
    """Return how long ago anything was heard of a run: a report of its worker, or a line of its log."""
    times = [line.at_utc for line in log[-1:]] + [str((run.progress or {}).get("at_utc") or "")]
    return seconds_since(max(times, default=""))


def _reason(run: Run) -> str:
    return (run.reason or "").strip()


def _again(run: Run) -> tuple[tuple[str, str], ...]:
    return ((f"/runs/new?clone={run.id}", "Run it again"), (f"/telemetry/{run.telemetry_set_id}", "Quality report"))


def _of_failure(run: Run, log: Sequence[RunEvent]) -> list[Notice]:
    """Say the cause, show the end of the log, and what to try."""
    cause = _reason(run) or "The run failed and gave no cause; its log has the last lines."
    lines = tuple(line for line in log if line.state != "FAILED")
    return [
        Notice("serious", cause, lines=lines[-LAST_LINES:]),
        Notice("off", WHAT_TO_TRY, links=_again(run)),
        *_of_partial(run),
    ]


def _of_partial(run: Run) -> list[Notice]:
    """Say how far a run had come whose estimate does not count."""
    fraction, message = ((run.progress or {}).get(name) for name in ("fraction", "message"))
    if not fraction:
        return []
    so_far = f"It had come to {percent(fraction, 0)}{f' ({message})' if message else ''}"
    return [Notice("off", f"PARTIAL: {so_far}. What it had estimated by then is void and shown nowhere as a result.")]


def _of_attempts(log: Sequence[RunEvent]) -> list[Notice]:
    """Say why there is more than one attempt."""
    again = [line for line in log if line.state == "QUEUED" and line.cause]
    if not again:
        return []
    told = f"Attempt {count(again[-1].attempt)} ended without a result: {again[-1].cause}."
    return [Notice("caution", f"{told} It is computed again from the start.")]


def _of_silence(run: Run) -> list[Notice]:
    """Say that a worker that should report does not."""
    silent_s = seconds_since((run.progress or {}).get("at_utc") or run.started_utc)
    if silent_s is None or silent_s < SILENT_S:
        return []
    then = "If its server does not renew its claim the run is queued again by itself."
    return [Notice("caution", f"The worker has not reported for {duration(silent_s)}. {then}")]


def _stopping_sentence(run: Run, log: Sequence[RunEvent]) -> str:
    """Say who asked for the stop and when."""
    asked = [line.at_utc for line in log if line.state == "CANCELLING"]
    since = f"Asked at {clock(asked[-1])}, {duration(seconds_since(asked[-1]))} ago. " if asked else ""
    return (
        f"Stopping: {_reason(run)} {since}The worker looks for this five times a second; one that does not answer is "
        "ended with its process after some seconds."
    )


def _lost_sentence(run: Run) -> str:
    """Say when the worker was last heard of, and that nothing of it counts."""
    heard = (run.progress or {}).get("at_utc") or run.lease_until_utc or run.ended_utc
    told = f"The worker stopped reporting at {clock(heard)}; no result is trusted."
    return " ".join(filter(None, [told, _reason(run), "Run it again to have one."]))


def clock(text: str | None) -> str:
    """Print a stored time to the second."""
    return text[:19].replace("T", " ") + "Z" if text else "an unknown time"


def _queue_sentence(session: Session, run: Run, workers: Mapping[str, Any] | None) -> str:
    """Say how many runs are in front, and what the first of them waits for."""
    before = runs.place_in_queue(session, run.id)
    place = f"Position {before + 1} in the queue." if before else "Next in the queue."
    return f"{place} {_waits_for(session, workers)}"


def _waits_for(session: Session, workers: Mapping[str, Any] | None) -> str:
    """Say what keeps the first of the queue from starting."""
    if not workers or not workers.get("turns"):
        return NO_WORKERS
    threads = workers.get("threads") or 0
    if not workers.get("connected") or not threads:
        return NOT_THERE
    busy = sorted(run.id for run in runs.list_runs(session, state=["RUNNING", "CANCELLING"]))
    if workers["tasks"] < threads:
        return "A worker is free: it starts at once."
    named = (
        f" with {', '.join(f'run #{number}' for number in busy[:6])}{' and others' * (len(busy) > 6)}" if busy else ""
    )
    which = "The only worker is" if threads == 1 else f"All {threads} workers are"
    return f"{which} busy{named}; it starts when one is free."
