"""The log of runs: one line an event, in the order they happened, a sentence for people with the same as fields beside it.

Kinds: `state` for every change of state, `log` for what the computation says, `lost` for every attempt that died with its
worker or its server. Writers are one at a time, so numbers ascend in the order of commits and whoever follows the log from a
number on misses nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import sqlalchemy as sa

from boresight.console.runs.tables import RunEvent
from boresight.platform.audit import seals as journals
from boresight.platform.db.sessions import Session, utc_now

LEVELS = ("info", "warning", "error")
LEVEL_OF_STATE = {"FAILED": "error", "LOST": "error", "CANCELLED": "warning", "CANCELLING": "warning"}


@dataclass(frozen=True)
class Line:
    """One line."""

    kind: str
    message: str
    state: str | None = None
    cause: str | None = None
    level: str = "info"
    numbers: Mapping[str, float] | None = None

    @classmethod
    def log(cls, message: str, numbers: Mapping[str, float] | None = None, *, level: str = "info") -> Line:
        """Say what a computation says."""
        return cls("log", message, level=level, numbers=numbers)

    @classmethod
    def moved(cls, state: str, cause: str | None = None) -> Line:
        """Say that a run is in another state."""
        message = f"{state}: {cause}" if cause else state
        return cls("state", message, state, cause or None, LEVEL_OF_STATE.get(state, "info"))

    @classmethod
    def begun(cls, attempt: int, owner: str) -> Line:
        """Say that an attempt computes."""
        return cls("state", f"RUNNING: attempt {attempt} on {owner}", "RUNNING")

    @classmethod
    def queued_again(cls, cause: str) -> Line:
        """Say that a run waits again, its attempt having ended without a result."""
        return cls("state", f"QUEUED: again, because {cause}", "QUEUED", cause, "warning")

    @classmethod
    def attempt_ended(cls, attempt: int, cause: str, *, is_lost: bool) -> Line:
        """Say why an attempt ended without a result, and whether that counts against its run."""
        kind, level = ("lost", "error") if is_lost else ("log", "warning")
        return cls(kind, f"Attempt {attempt}: {cause}", cause=cause, level=level)


def write_event(session: Session, run_id: int, attempt: int, line: Line) -> None:
    """Add a line to a run's log."""
    write_events(session, [(run_id, attempt, line)])


def write_events(session: Session, lines: Sequence[tuple[int, int, Line]]) -> None:
    """Add lines to the logs of runs and their attempts in this order, however many in one statement."""
    now = utc_now()
    given = [{"run_id": run_id, "attempt": attempt, "at_utc": now, **asdict(line)} for run_id, attempt, line in lines]
    if given:
        session.flush()  # what waits was said before
        session.execute(sa.insert(RunEvent), journals.chained(session, RunEvent, given))


def events_of_run(session: Session, run_id: int, after_id: int, limit: int | None) -> list[RunEvent]:
    """Return the log of one run in order, from the line after `after_id`; at most `limit` lines, None for all."""
    query = sa.select(RunEvent).where(RunEvent.run_id == run_id, RunEvent.id > after_id)
    return list(session.scalars(query.order_by(RunEvent.id).limit(limit)))


def newest_event_id(session: Session) -> int:
    """Return the number of the newest log line of any run; 0 where there is none."""
    return session.scalar(sa.select(sa.func.max(RunEvent.id))) or 0


def events_after(session: Session, after_id: int, limit: int) -> list[RunEvent]:
    """Return the log lines of all runs in order, from the line after `after_id`."""
    return list(session.scalars(sa.select(RunEvent).where(RunEvent.id > after_id).order_by(RunEvent.id).limit(limit)))
