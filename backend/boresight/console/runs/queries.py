"""Runs: every change of a run's row, which is the only source of truth.

A run is held by one owner at a time, for the time of a lease, under an attempt number that only grows::

    QUEUED --claim--> RUNNING --finish--> SUCCEEDED | FAILED
      |  ^               |
      |  +---put back----+            (its worker or server was lost, or its server stops)
      v                  v
    CANCELLED       CANCELLING --finish--> CANCELLED

Whoever computes writes back `WHERE id AND attempt AND state IN (RUNNING, CANCELLING)`, so a late result of an old
attempt matches no row, and a terminal state is written once, with its audit record. The log has one line an event:
`state`, `log`, `lost` for every attempt that died; their numbers ascend in the order of commits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.orm.attributes import set_committed_value

from boresight.calibration.options import CalibrationSettings
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import (
    CALIBRATIONS,
    CHOICE,
    TERMINAL_RUN_STATES,
    ArchivedRun,
    JointSet,
    Preset,
    Run,
    RunEvent,
    parse_settings,
)
from boresight.console.telemetry.tables import TelemetrySet, find_quality
from boresight.errors import RefusedInputError
from boresight.platform.audit import chain, seals
from boresight.platform.audit import seals as journals
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.observability.traces import get_traceparent
from boresight.verdicts.verdict import RunSummary, parse_run_summary

LEVELS = ("info", "warning", "error")
LEVEL_OF_STATE = {"FAILED": "error", "LOST": "error", "CANCELLED": "warning", "CANCELLING": "warning"}


@dataclass(frozen=True)
class Line:
    """A line for a run's log."""

    kind: str
    message: str
    state: str | None = None
    cause: str | None = None
    level: str = "info"
    numbers: Mapping[str, float] | None = None

    @classmethod
    def log(cls, message: str, numbers: Mapping[str, float] | None = None, *, level: str = "info") -> Line:
        """Make the line of a message from a computation."""
        return cls("log", message, level=level, numbers=numbers)

    @classmethod
    def moved(cls, state: str, cause: str | None = None) -> Line:
        """Make the line of a change of state."""
        message = f"{state}: {cause}" if cause else state
        return cls("state", message, state, cause or None, LEVEL_OF_STATE.get(state, "info"))

    @classmethod
    def begun(cls, attempt: int, owner: str) -> Line:
        """Make the line of an attempt that has begun."""
        return cls("state", f"RUNNING: attempt {attempt} on {owner}", "RUNNING")

    @classmethod
    def queued_again(cls, cause: str) -> Line:
        """Make the line of a run that is queued again after an attempt without a result."""
        return cls("state", f"QUEUED again: {cause}", "QUEUED", cause, "warning")

    @classmethod
    def attempt_ended(cls, attempt: int, cause: str, *, is_lost: bool) -> Line:
        """Make the line of an attempt that ended without a result: why, and whether it counts as lost."""
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
        session.flush()  # flush earlier lines, to keep the order
        session.execute(sa.insert(RunEvent), journals.chained(session, RunEvent, given))


def list_events(session: Session, run_id: int, after_id: int, limit: int | None) -> list[RunEvent]:
    """Return the log of one run in order, from the line after `after_id`; at most `limit` lines, None for all."""
    query = sa.select(RunEvent).where(RunEvent.run_id == run_id, RunEvent.id > after_id)
    return list(session.scalars(query.order_by(RunEvent.id).limit(limit)))


def read_newest_event_id(session: Session) -> int:
    """Return the number of the newest log line of any run; 0 where there is none."""
    return session.scalar(sa.select(sa.func.max(RunEvent.id))) or 0


def list_events_after(session: Session, after_id: int, limit: int) -> list[RunEvent]:
    """Return the log lines of all runs in order, from the line after `after_id`."""
    return list(session.scalars(sa.select(RunEvent).where(RunEvent.id > after_id).order_by(RunEvent.id).limit(limit)))


@dataclass(frozen=True)
class WaitingRun:
    """A queued run with what determines its duration."""

    run_id: int
    attempt: int
    method: str
    settings: CalibrationSettings
    frames: int
    stars: int

    @property
    def stands_alone(self) -> bool:
        """Whether it shares no task: it was tried before, or is a choice, which takes seconds."""
        return self.attempt > 0 or self.method == CHOICE


@dataclass(frozen=True)
class ClaimedSet:
    """A telemetry set of a claimed run: its name, its file as it was uploaded, and its stored table."""

    name: str
    original_sha256: str
    table_sha256: str


@dataclass(frozen=True)
class ClaimedPrior:
    """The calibration that a claimed run starts from: its name, its result, the files that it holds, and its last star's time."""

    name: str
    result_sha256: str
    held_sha256s: Sequence[str]
    ended_utc: str | None


@dataclass(frozen=True)
class ClaimedRun:
    """A run that this server has claimed, with everything that its computation needs."""

    run_id: int
    attempt: int
    settings: Mapping[str, Any]
    sensor_document: Mapping[str, Any]
    sets: Sequence[ClaimedSet]
    validation: ClaimedSet | None
    choice_of: int | None
    prior: ClaimedPrior | None
    sensor_id: int = 0
    launched_utc: str = ""
    traceparent: str | None = None


def list_waiting_runs(session: Session, limit: int) -> list[WaitingRun]:
    """Return the QUEUED runs, oldest first."""
    more = (
        sa.select(
            JointSet.run_id,
            sa.func.sum(TelemetrySet.frames).label("frames"),
            sa.func.sum(TelemetrySet.stars).label("stars"),
        )
        .join(TelemetrySet, TelemetrySet.id == JointSet.telemetry_set_id)
        .join(Run, Run.id == JointSet.run_id)
        .where(Run.state == "QUEUED")
        .group_by(JointSet.run_id)
        .subquery()
    )
    query = (
        sa.select(
            Run.id,
            Run.attempt,
            Run.method,
            Run.settings,
            TelemetrySet.frames + sa.func.coalesce(more.c.frames, 0),
            TelemetrySet.stars + sa.func.coalesce(more.c.stars, 0),
        )
        .join(TelemetrySet, TelemetrySet.id == Run.telemetry_set_id)
        .outerjoin(more, more.c.run_id == Run.id)
        .where(Run.state == "QUEUED")
        .order_by(Run.id)
        .limit(limit)
    )
    return [
        WaitingRun(run_id, attempt, method, _settings_to_plan_by(settings), frames, stars)
        for run_id, attempt, method, settings, frames, stars in session.execute(query)
    ]


def _settings_to_plan_by(document: Mapping[str, Any]) -> CalibrationSettings:
    """Read a run's settings; the usual ones where they are damaged, for one run must not keep others waiting."""
    try:
        return parse_settings(document)
    except RefusedInputError:
        return CalibrationSettings()


def list_claimed_runs(session: Session, run_ids: Sequence[int]) -> list[ClaimedRun]:
    """Read what the computation of claimed runs needs, in the order of their ids."""
    of = sa.select(Run).where(Run.id.in_(run_ids)).order_by(Run.id).execution_options(populate_existing=True)
    runs = session.scalars(of).all()
    wanted = {
        number for run in runs for number in (run.telemetry_set_id, *run.joint_set_ids, run.validation_set_id) if number
    }
    query = sa.select(
        TelemetrySet.id, TelemetrySet.name, TelemetrySet.original_sha256, TelemetrySet.table_sha256
    ).where(TelemetrySet.id.in_(wanted))
    sets = {number: ClaimedSet(*rest) for number, *rest in session.execute(query)}
    return [
        ClaimedRun(
            run_id=run.id,
            attempt=run.attempt,
            settings=run.settings,
            sensor_document=run.sensor_document,
            sets=[sets[number] for number in (run.telemetry_set_id, *run.joint_set_ids)],
            validation=None if run.validation_set_id is None else sets[run.validation_set_id],
            choice_of=run.choice_of,
            prior=_claim_prior(session, run),
            sensor_id=run.sensor_id,
            launched_utc=run.launched_utc,
            traceparent=run.traceparent,
        )
        for run in runs
    ]


def _claim_prior(session: Session, run: Run) -> ClaimedPrior | None:
    """Read the calibration that a run starts from."""
    if run.prior_run_id is None:
        return None
    before = session.get_one(Run, run.prior_run_id)
    held = [session.get_one(TelemetrySet, number) for number in sorted(list_held_sets(session, before))]
    own = {before.telemetry_set_id, *before.joint_set_ids}
    times = [time.end_utc for one in held if one.id in own and (time := find_quality(one.quality).time) is not None]
    named = None if run.prior_set_id is None else session.get_one(ParameterSet, run.prior_set_id)
    return ClaimedPrior(
        name=f"run {before.id}" if named is None else named.name,
        result_sha256=str(before.result_sha256),
        held_sha256s=[one.original_sha256 for one in held],
        ended_utc=max(times) if len(times) == len(own) else None,
    )


def list_held_sets(session: Session, run: Run) -> set[int]:
    """Return every telemetry set that a run's estimate rests on: its own, and those of what it started from."""
    held: set[int] = set()
    of: Run | None = run
    while of is not None:
        held |= {of.telemetry_set_id, *of.joint_set_ids}
        of = None if of.prior_run_id is None else session.get_one(Run, of.prior_run_id)
    return held


def list_further_sets(session: Session, run: Run) -> list[TelemetrySet]:
    """Return the sets that a run takes with its first, in their order."""
    query = (
        sa.select(TelemetrySet)
        .join(JointSet, JointSet.telemetry_set_id == TelemetrySet.id)
        .where(JointSet.run_id == run.id)
        .order_by(JointSet.id)
    )
    return list(session.scalars(query))


HOLDING_STATES = ("RUNNING", "CANCELLING")
HeldRun = tuple[int, int]  # (run id, attempt)


def add_run(session: Session, *, joint_set_ids: Sequence[int] = (), **values: Any) -> Run:
    """Insert a run as QUEUED, with the sets that it takes with its first, and return its row."""
    told = {"launched_utc": utc_now(), "traceparent": get_traceparent()}
    run = Run(state="QUEUED", attempt=0, cancel_requested=0, **told, **values)
    session.put(run)
    further = [JointSet(run_id=run.id, telemetry_set_id=number) for number in joint_set_ids]
    session.add_all(further)
    set_committed_value(run, "further", further)
    session.flush()
    write_event(session, run.id, 0, Line.moved("QUEUED"))
    return run


def find_run(session: Session, run_id: int) -> Run | None:
    """Return the run's row, or None."""
    return session.get(Run, run_id, populate_existing=True)


def request_cancels(session: Session, chosen: sa.ColumnElement[bool], reason: str) -> list[tuple[int, str]]:
    """Cancel runs: QUEUED ones end at once, RUNNING ones become CANCELLING; return the changed ones with their new states."""
    stopped = session.execute(
        sa.update(Run)
        .where(chosen, Run.state.in_(("QUEUED", "RUNNING")))
        .values(
            cancel_requested=1,
            reason=reason,
            ended_utc=sa.case((Run.state == "QUEUED", utc_now()), else_=None),
            state=sa.case((Run.state == "QUEUED", "CANCELLED"), else_="CANCELLING"),
        )
        .returning(Run.id, Run.attempt, Run.state)
        .execution_options(synchronize_session=False, **seals.BULK)
    ).all()
    write_events(session, [(run_id, attempt, Line.moved(state, reason)) for run_id, attempt, state in stopped])
    for run_id, _, state in stopped:
        if state in TERMINAL_RUN_STATES:
            seals.note(session, Run, run_id)
    return [(run_id, state) for run_id, _, state in stopped]


def request_cancel(session: Session, run_id: int, reason: str) -> Run | None:
    """Cancel a run that has not ended; return the row."""
    request_cancels(session, Run.id == run_id, reason)
    return find_run(session, run_id)


def claim(
    session: Session, owner: str, lease_s: float, limit: int, run_ids: Collection[int] | None = None
) -> list[ClaimedRun]:
    """Claim up to `limit` QUEUED runs, of all or of `run_ids`, oldest first, each under its next attempt number."""
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
    held = sorted((run_id, attempt) for run_id, attempt in taken)
    write_events(session, [(*one, Line.begun(one[1], owner)) for one in held])
    return list_claimed_runs(session, [run_id for run_id, _ in held])


def _fenced(held: HeldRun) -> sa.Update:
    """Return an UPDATE that matches only while this attempt still holds the run."""
    run_id, attempt = held
    return (
        sa.update(Run)
        .where(Run.id == run_id, Run.attempt == attempt, Run.state.in_(HOLDING_STATES))
        .execution_options(synchronize_session=False, **seals.BULK)
    )


def renew(session: Session, owner: str, lease_s: float, run_ids: Collection[int]) -> dict[HeldRun, str]:
    """Renew the leases of our runs; return the state of each that is still ours, by id and attempt."""
    rows = session.execute(
        sa.update(Run)
        .where(Run.id.in_(run_ids), Run.owner == owner, Run.state.in_(HOLDING_STATES))
        .values(lease_until_utc=utc_after(lease_s))
        .returning(Run.id, Run.attempt, Run.state)
        .execution_options(synchronize_session=False, **seals.BULK)
    )
    return {(run_id, attempt): state for run_id, attempt, state in rows}


def read_states(session: Session, run_ids: Collection[int]) -> dict[HeldRun, str]:
    """Return the state of runs by id and attempt."""
    rows = session.execute(sa.select(Run.id, Run.attempt, Run.state).where(Run.id.in_(run_ids)))
    return {(run_id, attempt): state for run_id, attempt, state in rows}


def record_progress(session: Session, run_id: int, attempt: int, progress: Mapping[str, Any]) -> bool:
    """Write the progress of a run; False when this attempt no longer holds it."""
    return _has_matched(session, _fenced((run_id, attempt)).values(progress=dict(progress)))


@dataclass(frozen=True)
class RunEnd:
    """How an attempt ended: state, reason, result, lines for the log; and the address of a stored file that it found corrupt."""

    run_id: int
    attempt: int
    state: str
    reason: str | None = None
    result_sha256: str | None = None
    summary: Mapping[str, Any] | None = None
    result_bytes: int = 0
    log: Sequence[Line] = ()
    corrupt_sha256: str | None = None


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
    """Write one run's end, once; see `finish_all`."""
    end = RunEnd(run_id, attempt, state, reason, result_sha256, summary, result_bytes)
    return finish_all(session, [end]).get((run_id, attempt))


def finish_all(session: Session, ends: Sequence[RunEnd]) -> dict[HeldRun, str]:
    """Write how runs ended, each once, however many in a few statements."""
    if strange := {end.state for end in ends}.difference(TERMINAL_RUN_STATES):
        raise ValueError(f"Expected some of {TERMINAL_RUN_STATES} / Received {strange}")
    now, held = utc_now(), _read_held(session, [end.run_id for end in ends])
    written = [_as_asked(end, held[end.run_id, end.attempt]) for end in ends if (end.run_id, end.attempt) in held]
    _register_results(session, written, now)
    _write_ends(session, [end for end in written if end.result_sha256 is None], now)
    _write_ends(session, [end for end in written if end.result_sha256 is not None], now, progress=None)
    write_events(
        session,
        [(end.run_id, end.attempt, line) for end in written for line in (*end.log, Line.moved(end.state, end.reason))],
    )
    for end in written:
        seals.note(session, Run, end.run_id)
        after = {"state": end.state, "result_sha256": end.result_sha256}
        chain.append_own(session, AuditAction.ENDED, f"runs/{end.run_id}", after=after, reason=end.reason)
    return {(end.run_id, end.attempt): end.state for end in written}


def _read_held(session: Session, run_ids: Collection[int]) -> dict[HeldRun, tuple[str, str | None]]:
    """Return state and reason of the runs that these attempts still hold, which cannot change before the commit."""
    query = sa.select(Run.id, Run.attempt, Run.state, Run.reason).where(
        Run.id.in_(run_ids), Run.state.in_(HOLDING_STATES)
    )
    return {(run_id, attempt): (state, reason) for run_id, attempt, state, reason in session.execute(query)}


def _as_asked(end: RunEnd, found: tuple[str, str | None]) -> RunEnd:
    """Return the end, as CANCELLED where its run was asked to stop."""
    state, reason = found
    return RunEnd(end.run_id, end.attempt, "CANCELLED", reason, log=end.log) if state == "CANCELLING" else end


def _write_ends(session: Session, ends: Sequence[RunEnd], now: str, **also: Any) -> None:
    """Write ends into their rows, fenced; progress is kept where there is no result."""
    if not ends:
        return
    runs, names = cast("sa.Table", Run.__table__), ("state", "reason", "result_sha256", "summary")
    is_held = sa.or_(*(runs.c.state == state for state in HOLDING_STATES))  # IN does not work with many rows at once
    fenced = (runs.c.id == sa.bindparam("held"), runs.c.attempt == sa.bindparam("under"), is_held)
    fixed = {"ended_utc": now, "lease_until_utc": None} | also
    write = sa.update(runs).where(*fenced).values({**fixed, **{name: sa.bindparam(f"new_{name}") for name in names}})
    rows = [
        {"held": end.run_id, "under": end.attempt, **{f"new_{name}": getattr(end, name) for name in names}}
        for end in ends
    ]
    if session.connection().execute(write, rows).rowcount != len(rows):
        raise RuntimeError(f"Expected {len(rows)} runs to end / Received another number")


def _register_results(session: Session, ends: Sequence[RunEnd], now: str) -> None:
    """Register the results' blobs, which the workers have stored already, possibly on another machine."""
    sizes = {end.result_sha256: end.result_bytes for end in ends if end.result_sha256 is not None}
    known = set(session.scalars(sa.select(Blob.sha256).where(Blob.sha256.in_(sizes))))
    rows = [
        {"sha256": sha256, "size_bytes": size, "media_type": "application/json", "created_utc": now}
        for sha256, size in sizes.items()
        if sha256 not in known
    ]
    if rows:
        session.execute(sa.insert(Blob), rows)


def put_back(session: Session, run_id: int, attempt: int, cause: str) -> bool:
    """Queue a run again whose attempt ended through no fault of its own; it does not count against the run."""
    return _put_back(session, (run_id, attempt), cause, is_lost=False)


def give_up_attempt(
    session: Session, run_id: int, attempt: int, cause: str, max_attempts: int, *, end_state: str = "FAILED"
) -> str | None:
    """Count a lost attempt: queue the run again, or end it when it lost too many."""
    lost = session.scalar(
        sa.select(sa.func.count()).where(RunEvent.run_id == run_id, RunEvent.kind == "lost"),
    )
    times = 1 + (lost or 0)
    if times >= max_attempts:
        reason = f"Ended after {times} lost attempt{'s' * (times > 1)}; last cause: {cause}."
        written = finish(session, run_id, attempt, end_state, reason)
        if written is not None:
            write_event(session, run_id, attempt, Line.attempt_ended(attempt, cause, is_lost=True))
        return written
    return "QUEUED" if _put_back(session, (run_id, attempt), cause, is_lost=True) else None


def _put_back(session: Session, held: HeldRun, cause: str, *, is_lost: bool) -> bool:
    """Queue a run again under a line of its log; one that was asked to stop ends instead."""
    if read_states(session, [held[0]]).get(held) == "CANCELLING":
        return finish(session, *held, "CANCELLED") is not None
    write = _fenced(held).values(state="QUEUED", owner=None, lease_until_utc=None, progress=sa.null())
    if not _has_matched(session, write):
        return False
    lines = (Line.attempt_ended(held[1], cause, is_lost=is_lost), Line.queued_again(cause))
    write_events(session, [(*held, line) for line in lines])
    return True


def give_up_expired(session: Session, max_attempts: int) -> list[HeldRun]:
    """Give up every attempt whose lease has lapsed because its server is gone, and return them."""
    query = sa.select(Run.id, Run.attempt, Run.owner).where(
        Run.state.in_(HOLDING_STATES), Run.lease_until_utc < utc_now()
    )
    lapsed = session.execute(query.with_for_update(skip_locked=True)).all()
    for run_id, attempt, owner in lapsed:
        cause = f"its server {owner} stopped reporting"
        give_up_attempt(session, run_id, attempt, cause, max_attempts, end_state="LOST")
    return [(run_id, attempt) for run_id, attempt, _ in lapsed]


def _has_matched(session: Session, statement: sa.Update) -> bool:
    return session.execute(statement.returning(Run.id)).first() is not None


def list_runs_of_set(session: Session, telemetry_set_id: int, limit: int) -> tuple[list[Run], int]:
    """Return the newest runs that fitted or validated with a telemetry set, and how many there are."""
    with_others = sa.select(JointSet.run_id).where(JointSet.telemetry_set_id == telemetry_set_id)
    uses = sa.or_(
        Run.telemetry_set_id == telemetry_set_id, Run.validation_set_id == telemetry_set_id, Run.id.in_(with_others)
    )
    uses = sa.and_(uses, CALIBRATIONS)
    newest = list(session.scalars(sa.select(Run).where(uses).order_by(Run.id.desc()).limit(limit)))
    return newest, session.scalar(sa.select(sa.func.count()).select_from(Run).where(uses)) or 0


def iterate_newest_finished(session: Session, sensor_id: int) -> Iterator[Run]:
    """Yield a sensor's runs that succeeded, the newest first, those with a validation set before all others; a read a run."""
    finished = (
        sa.select(Run)
        .where(Run.sensor_id == sensor_id, Run.state == "SUCCEEDED", CALIBRATIONS)
        .order_by(Run.id.desc())
        .limit(1)
    )
    for which in (Run.validation_set_id.is_not(None), Run.validation_set_id.is_(None)):
        run = session.scalar(finished.where(which))
        while run is not None:
            yield run
            run = session.scalar(finished.where(which, Run.id < run.id))


def find_choice(session: Session, run_id: int) -> Run | None:
    """Return the newest run that chooses a camera for a run's data, or None."""
    return session.scalar(sa.select(Run).where(Run.choice_of == run_id).order_by(Run.id.desc()).limit(1))


def count_queued_before(session: Session, run_id: int) -> int:
    """Count the runs that wait longer than one."""
    query = sa.select(sa.func.count()).select_from(Run).where(Run.state == "QUEUED", Run.id < run_id)
    return session.scalar(query) or 0


def read_neighbours(session: Session, run_id: int) -> tuple[int | None, int | None]:
    """Return the numbers of the calibrations before and after one, None at an end."""
    before = session.scalar(sa.select(sa.func.max(Run.id)).where(Run.id < run_id, CALIBRATIONS))
    return before, session.scalar(sa.select(sa.func.min(Run.id)).where(Run.id > run_id, CALIBRATIONS))


def count_by_state(session: Session) -> dict[str, int]:
    """Count the runs of each state that has any."""
    rows = session.execute(sa.select(Run.state, sa.func.count()).group_by(Run.state))
    return {row[0]: row[1] for row in rows}


def list_recent_runs(session: Session, method: str, limit: int) -> list[tuple[CalibrationSettings, RunSummary]]:
    """Return settings and summary of the newest runs of a method that succeeded."""
    query = sa.select(Run.settings, Run.summary).where(Run.state == "SUCCEEDED", Run.method == method)
    newest = session.execute(query.where(Run.summary.is_not(None)).order_by(Run.id.desc()).limit(limit))
    return [(_settings_to_plan_by(settings), parse_run_summary(summary)) for settings, summary in newest if summary]


def list_sensors(session: Session, run_ids: Collection[int]) -> list[int]:
    """Return the sensors that some runs are of, each once."""
    return list(session.scalars(sa.select(Run.sensor_id).where(Run.id.in_(run_ids)).distinct().order_by(Run.sensor_id)))


def find_newest_preset(session: Session, name: str) -> Preset | None:
    """Return the newest version of a name, archived or not."""
    return session.scalar(sa.select(Preset).where(Preset.name == name).order_by(Preset.number.desc()).limit(1))


def list_presets_in_use(session: Session) -> Sequence[Preset]:
    """Return the newest version of every name that is not archived, by name."""
    newest = sa.select(sa.func.max(Preset.id)).where(Preset.archived_utc.is_(None)).group_by(Preset.name)
    return session.scalars(sa.select(Preset).where(Preset.id.in_(newest)).order_by(Preset.name)).all()


def find_archived(session: Session, run_id: int) -> ArchivedRun | None:
    """Return the row that archives a run."""
    return session.scalar(sa.select(ArchivedRun).where(ArchivedRun.run_id == run_id))


def list_archived(session: Session, run_ids: Collection[int]) -> frozenset[int]:
    """Return which of these runs are archived."""
    return frozenset(session.scalars(sa.select(ArchivedRun.run_id).where(ArchivedRun.run_id.in_(run_ids))))
