"""The log of runs: one line an event, in the order they happened.

Kinds: `state` for every change of state (the message begins with the new state's word), `log` for what the computation
says, `lost` for every attempt that died with its worker or its server. Writers are one at a time, so numbers ascend in
the order of commits and whoever follows the log from a number on misses nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store import journals
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import RunEvent

Line = tuple[int, int, str, str]  # run id, attempt, kind, message


def write_event(session: Session, run_id: int, attempt: int, kind: str, message: str) -> None:
    """Add a line to a run's log; `kind` is state, log or lost."""
    session.add(RunEvent(run_id=run_id, attempt=attempt, at_utc=utc_now(), kind=kind, message=message))
    session.flush()


def write_events(session: Session, lines: Sequence[Line]) -> None:
    """Add lines to the logs of runs in this order, however many in one statement."""
    now = utc_now()
    given = [dict(zip(("run_id", "attempt", "kind", "message"), line, strict=True)) | {"at_utc": now} for line in lines]
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
