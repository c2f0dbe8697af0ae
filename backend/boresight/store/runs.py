"""Runs: the row is the truth, and this is every way it changes.

A run is held by one owner at a time, for the time of a lease, under an attempt number that only grows::

    QUEUED --claim--> RUNNING --finish--> SUCCEEDED | FAILED
      |  ^               |
      |  +---put back----+            (its worker or server was lost, or its server stops)
      v                  v
    CANCELLED       CANCELLING --finish--> CANCELLED

Fencing: whoever computes writes back `WHERE id AND attempt AND state IN (RUNNING, CANCELLING)`, and claiming adds one
to `attempt`. So a late result of an old attempt matches no row, and a terminal state is written once. A run that was
asked to stop never ends as anything but CANCELLED. An event of kind `lost` is written for every attempt that died; as
many of them as allowed end the run: FAILED when its worker processes died, LOST when only its servers were seen to go.
The end is put on record in the transaction that writes it; what passes before it is not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import aliased

from boresight.store import chain, seals
from boresight.store.run_events import write_event
from boresight.store.sessions import Session, utc_after, utc_now
from boresight.store.tables import TERMINAL_RUN_STATES, Blob, Run, RunEvent, TelemetrySet

HELD = ("RUNNING", "CANCELLING")
Held = tuple[int, int]  # (run id, attempt)


@dataclass(frozen=True)
class Waiting:
    """A run that nobody holds, with what decides how long it will take."""

    run_id: int
    attempt: int
    method: str
    settings: Mapping[str, Any]
    frames: int
    stars: int


@dataclass(frozen=True)
class Claimed:
    """A run that is now ours: all that its computation needs."""

    run_id: int
    attempt: int
    settings: Mapping[str, Any]
    sensor_document: Mapping[str, Any]
    table_sha256: str
    validation_sha256: str | None


def add_run(session: Session, **values: Any) -> Run:
    """Insert a run as QUEUED and return its row."""
    run = Run(state="QUEUED", attempt=0, cancel_requested=0, launched_utc=utc_now(), **values)
    session.add(run)
    session.flush()
    write_event(session, run.id, 0, "state", "QUEUED")
    return run


def find_run(session: Session, run_id: int) -> Run | None:
    """Return the run's row, or None."""
    return session.get(Run, run_id, populate_existing=True)


def request_cancel(session: Session, run_id: int, reason: str) -> Run | None:
    """Stop a run: QUEUED ends at once, RUNNING becomes CANCELLING; any other state stays. Return the row."""
    row = session.execute(
        sa.update(Run)
        .where(Run.id == run_id, Run.state.in_(("QUEUED", "RUNNING")))
        .values(
            cancel_requested=1,
            reason=reason,
            ended_utc=sa.case((Run.state == "QUEUED", utc_now()), else_=None),
            state=sa.case((Run.state == "QUEUED", "CANCELLED"), else_="CANCELLING"),
        )
        .returning(Run.attempt, Run.state)
        .execution_options(synchronize_session=False, **seals.BULK)
    ).first()
    if row is not None:
        write_event(session, run_id, row.attempt, "state", f"{row.state}: {reason}")
        if row.state in TERMINAL_RUN_STATES:
            seals.note(session, Run, run_id)
    return find_run(session, run_id)


def waiting_runs(session: Session, limit: int) -> list[Waiting]:
    """Return the QUEUED runs, oldest first."""
    query = (
        sa.select(Run.id, Run.attempt, Run.method, Run.settings, TelemetrySet.frames, TelemetrySet.stars)
        .join(TelemetrySet, TelemetrySet.id == Run.telemetry_set_id)
        .where(Run.state == "QUEUED")
        .order_by(Run.id)
        .limit(limit)
    )
    return [Waiting(*row) for row in session.execute(query)]


def claim(
    session: Session, owner: str, lease_s: float, limit: int, run_ids: Collection[int] | None = None
) -> list[Claimed]:
    """Take up to `limit` QUEUED runs, oldest first, each under its next attempt number.

    With `run_ids` only of these; those that are not QUEUED any more are somebody else's.
    """
    free = sa.select(Run.id).where(Run.state == "QUEUED").order_by(Run.id).limit(limit)
    if run_ids is not None:
        free = free.where(Run.id.in_(run_ids))
    free = free.with_for_update(skip_locked=True)
    taken = session.execute(
        sa.update(Run)
        .where(Run.id.in_(free.scalar_subquery()))
        .values(
            state="RUNNING",
            attempt=Run.attempt + 1,
            owner=owner,
            lease_until_utc=utc_after(lease_s),
            started_utc=utc_now(),
            progress=sa.null(),
        )
        .returning(Run.id, Run.attempt)
        .execution_options(synchronize_session=False, **seals.BULK)
    ).all()
    for run_id, attempt in taken:
        write_event(session, run_id, attempt, "state", f"RUNNING: attempt {attempt} on {owner}")
    return _claimed(session, [run_id for run_id, _ in taken])


def _claimed(session: Session, run_ids: Sequence[int]) -> list[Claimed]:
    """Read what the computation of claimed runs needs, in the order of their ids."""
    validation = aliased(TelemetrySet)
    query = (
        sa.select(
            Run.id,
            Run.attempt,
            Run.settings,
            Run.sensor_document,
            TelemetrySet.table_sha256,
            validation.table_sha256,
        )
        .join(TelemetrySet, TelemetrySet.id == Run.telemetry_set_id)
        .outerjoin(validation, validation.id == Run.validation_set_id)
        .where(Run.id.in_(run_ids))
        .order_by(Run.id)
    )
    return [Claimed(*row) for row in session.execute(query)]


def _fenced(held: Held) -> sa.Update:
    """Begin a write-back that matches only while this attempt still holds the run."""
    run_id, attempt = held
    return (
        sa.update(Run)
        .where(Run.id == run_id, Run.attempt == attempt, Run.state.in_(HELD))
        .execution_options(synchronize_session=False, **seals.BULK)
    )


def renew(session: Session, owner: str, lease_s: float, run_ids: Collection[int]) -> dict[Held, str]:
    """Renew the leases of our runs; return the state of each that is still ours, by id and attempt."""
    rows = session.execute(
        sa.update(Run)
        .where(Run.id.in_(run_ids), Run.owner == owner, Run.state.in_(HELD))
        .values(lease_until_utc=utc_after(lease_s))
        .returning(Run.id, Run.attempt, Run.state)
        .execution_options(synchronize_session=False, **seals.BULK)
    )
    return {(run_id, attempt): state for run_id, attempt, state in rows}


def states_of(session: Session, run_ids: Collection[int]) -> dict[Held, str]:
    """Return the state of runs by id and attempt."""
    rows = session.execute(sa.select(Run.id, Run.attempt, Run.state).where(Run.id.in_(run_ids)))
    return {(run_id, attempt): state for run_id, attempt, state in rows}


def record_progress(session: Session, run_id: int, attempt: int, progress: Mapping[str, Any]) -> bool:
    """Write how far a run is; False when this attempt no longer holds it."""
    return _matched(session, _fenced((run_id, attempt)).values(progress=dict(progress)))


def finish(
    session: Session,
    run_id: int,
    attempt: int,
    state: str,
    reason: str | None = None,
    result_sha256: str | None = None,
    summary: Mapping[str, Any] | None = None,
    result_bytes: int = 0,
) -> str | None:
    """Write a run's end, once.

    Returns
    -------
    str or None
        The terminal state written: `state`, or CANCELLED when the run had been asked to stop; None when this attempt
        no longer held the run and nothing was written.
    """
    if state not in TERMINAL_RUN_STATES:
        raise ValueError(f"Expected one of {TERMINAL_RUN_STATES} / Received {state!r}")
    cancelling = session.scalar(
        sa.select(Run.reason).where(Run.id == run_id, Run.attempt == attempt, Run.state == "CANCELLING")
    )
    if cancelling is not None:
        state, reason, result_sha256, summary = "CANCELLED", cancelling, None, None
    if result_sha256 is not None:
        _register_result(session, result_sha256, result_bytes)
    write = _fenced((run_id, attempt)).values(
        state=state,
        reason=reason,
        result_sha256=result_sha256,
        summary=sa.null() if summary is None else dict(summary),
        progress=Run.progress if result_sha256 is None else sa.null(),  # what there was is kept where no result is
        ended_utc=utc_now(),
        lease_until_utc=None,
    )
    if not _matched(session, write):
        return None
    write_event(session, run_id, attempt, "state", f"{state}: {reason}" if reason else state)
    seals.note(session, Run, run_id)
    after = {"state": state, "result_sha256": result_sha256}
    chain.append_own(session, "ended", f"runs/{run_id}", after=after, reason=reason)
    return state


def _register_result(session: Session, sha256: str, size_bytes: int) -> None:
    """Name the result's bytes, which the worker has put already; the worker may be on another machine."""
    if session.get(Blob, sha256) is None:
        session.add(
            Blob(sha256=sha256, size_bytes=size_bytes, media_type="application/json", created_utc=utc_now()),
        )
        session.flush()


def put_back(session: Session, run_id: int, attempt: int, cause: str) -> bool:
    """Queue a run again whose attempt ended through no fault of its own; it does not count against the run."""
    return _put_back(session, (run_id, attempt), "log", cause)


def give_up_attempt(
    session: Session, run_id: int, attempt: int, cause: str, max_attempts: int, *, end_state: str = "FAILED"
) -> str | None:
    """Count a lost attempt: queue the run again, or end it when it lost too many.

    Returns
    -------
    str or None
        The state the run is in now, None when this attempt no longer held it.
    """
    lost = session.scalar(
        sa.select(sa.func.count()).where(RunEvent.run_id == run_id, RunEvent.kind == "lost"),
    )
    times = 1 + (lost or 0)
    if times >= max_attempts:
        reason = f"Given up after {times} lost attempt{'s' * (times > 1)}, the last because {cause}."
        written = finish(session, run_id, attempt, end_state, reason)
        if written is not None:
            write_event(session, run_id, attempt, "lost", f"Attempt {attempt}: {cause}")
        return written
    return "QUEUED" if _put_back(session, (run_id, attempt), "lost", cause) else None


def _put_back(session: Session, held: Held, kind: str, cause: str) -> bool:
    """Queue a run again under a line of its log; one that was asked to stop ends instead."""
    if states_of(session, [held[0]]).get(held) == "CANCELLING":
        return finish(session, *held, "CANCELLED") is not None
    write = _fenced(held).values(state="QUEUED", owner=None, lease_until_utc=None, progress=sa.null())
    if not _matched(session, write):
        return False
    write_event(session, *held, kind, f"Attempt {held[1]}: {cause}")
    write_event(session, *held, "state", f"QUEUED: again, because {cause}")
    return True


def give_up_expired(session: Session, max_attempts: int) -> list[Held]:
    """Give up every attempt whose lease has lapsed: its server is gone. Return them."""
    query = sa.select(Run.id, Run.attempt, Run.owner).where(Run.state.in_(HELD), Run.lease_until_utc < utc_now())
    lapsed = session.execute(query.with_for_update(skip_locked=True)).all()
    for run_id, attempt, owner in lapsed:
        cause = f"its server {owner} was not heard of any more"
        give_up_attempt(session, run_id, attempt, cause, max_attempts, end_state="LOST")
    return [(run_id, attempt) for run_id, attempt, _ in lapsed]


def _matched(session: Session, statement: sa.Update) -> bool:
    """Say whether an update changed a row."""
    return session.execute(statement.returning(Run.id)).first() is not None
