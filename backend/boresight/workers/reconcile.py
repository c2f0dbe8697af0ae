"""Keeping the run rows true: everything the engine writes to the database, one short transaction each.

Leases: what we hold we renew three times a lease; what lapses belonged to a server that is gone and is queued again,
or ended when it has lost too many attempts. Every write is fenced by attempt and state (see `boresight.console.runs.queries`), so
two servers on one database cannot both end a run, and a result that comes too late writes nothing.

The duration model: predicts how long waiting runs take from the newest runs of their method.

Time is not in proportion to the number of stars: judging a small run takes longer than fitting it. So runs of about the same
size are asked first, and all of the method only where there are none. What the newest runs took is read anew every few seconds.

Checking finished runs for alarms.

It is no part of writing an end, so no worker waits for it: the runs are noted, and looked at some at a time while others compute.
What is still noted when a server stops, its upkeep finds when it starts again.

Which waiting runs go to the workers next, and which of them share a task.

To hand over a task, fetch its answer and write it costs tens of milliseconds, so short runs are computed several in one task: two
seconds' worth where few wait, and of a long queue up to a quarter of what waits for each thread, eight seconds at most, for who
queued a thousand runs waits for the last and not for the next. A run that takes over two seconds, or that was tried before (its
neighbours shall not die with it), goes alone. A free thread gets a task; a thread that computes short runs may get a second group
to go on with, but only while more runs wait than there are threads. So the few runs of a person are spread over the threads and
really run when they are RUNNING, and other servers that share the database find the rest still QUEUED.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from statistics import median

from boresight.console.alarms.rules import find_changed_sensors, update_alarms
from boresight.console.runs import queries as runs
from boresight.console.runs.dry_runs import TimedRun, estimate_seconds_per_star, list_timed_runs, predict_duration_s
from boresight.console.runs.queries import (
    ClaimedRun,
    HeldRun,
    Line,
    RunEnd,
    WaitingRun,
    list_sensors,
    waiting_runs,
    write_event,
)
from boresight.platform.db.data_version import DataVersionReader, VersionedCache
from boresight.platform.db.sessions import Engine as Database
from boresight.platform.db.sessions import Session, open_reading, open_writing, utc_now
from boresight.workers.link import Report

FRESH_S = 3.0
ALIKE = 1.5  # times as many stars at most, or as few


@dataclass
class _MethodDuration:
    """What is known of a method."""

    timed: list[TimedRun]
    s_per_star: float
    read_s: float


@dataclass
class DurationModel:
    """What the newest runs of each method took."""

    _known: dict[str, _MethodDuration] = field(default_factory=dict)

    def refresh(self, session: Session, methods: set[str]) -> None:
        """Read what the newest runs of these methods took, where that was not done just now."""
        now_s = time.monotonic()
        for method in methods:
            if method not in self._known or now_s - self._known[method].read_s > FRESH_S:
                timed, pace = list_timed_runs(session, method), estimate_seconds_per_star(session, method)
                self._known[method] = _MethodDuration(timed, pace, now_s)

    def seconds(self, run: WaitingRun) -> float:
        """Predict the time of a waiting run, seconds."""
        pace = self._known[run.method]
        alike = [one.seconds / one.stars for one in pace.timed if 1 / ALIKE <= run.stars / one.stars <= ALIKE]
        foreseen_s = predict_duration_s(run.settings, run.frames, run.stars, pace.s_per_star)
        waits = run.settings.get("replay_frames_per_s")
        return foreseen_s if waits or not alike else run.stars * median(alike)


GROUP_S = 2.0
LONG_GROUP_S, QUEUE_SHARE = 8.0, 0.25
GROUP_RUNS = 64


@dataclass(frozen=True)
class RunGroup:
    """Runs that share a task."""

    run_ids: list[int]
    seconds: float
    short: bool


def planned(
    waiting: Sequence[WaitingRun], free: int, followed: int, threads: int, seconds_of: Callable[[WaitingRun], float]
) -> list[RunGroup]:
    """Divide the oldest waiting runs over the threads."""
    slots = free + followed
    most = min(GROUP_RUNS, math.ceil(len(waiting) / max(1, slots)))
    share_s = QUEUE_SHARE * sum(map(seconds_of, waiting)) / max(1, threads)
    longest_s = min(LONG_GROUP_S, max(GROUP_S, share_s))
    groups: list[RunGroup] = []
    rest = list(waiting)
    while rest and len(groups) < slots:
        group = _first_group(rest, most, longest_s, seconds_of)
        if len(groups) >= free and not group.short:
            break
        groups.append(group)
        rest = rest[len(group.run_ids) :]
    return groups


def _first_group(
    waiting: Sequence[WaitingRun], most: int, longest_s: float, seconds_of: Callable[[WaitingRun], float]
) -> RunGroup:
    """Return the oldest runs that may share a task."""
    total_s = seconds_of(waiting[0])
    if waiting[0].attempt or total_s > GROUP_S:
        return RunGroup([waiting[0].run_id], total_s, short=False)
    chosen = [waiting[0].run_id]
    for run in waiting[1:most]:
        seconds = seconds_of(run)
        if run.attempt or seconds > GROUP_S or total_s + seconds > longest_s:
            break
        chosen.append(run.run_id)
        total_s += seconds
    return RunGroup(chosen, total_s, short=True)


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reconciler:
    """The database as one owner of runs sees it."""

    database: Database
    owner: str
    lease_s: float
    max_attempts: int
    paces: DurationModel = field(default_factory=DurationModel)

    @cached_property
    def _marks(self) -> DataVersionReader:
        """Tells whether anything was committed: what is asked every turn is read only then."""
        return DataVersionReader(self.database)

    @cached_property
    def _waiting(self) -> VersionedCache[list[WaitingRun]]:
        return VersionedCache(self._marks)

    @cached_property
    def _stops(self) -> VersionedCache[set[HeldRun]]:
        return VersionedCache(self._marks)

    def close(self) -> None:
        """Let go of the store."""
        self._marks.close()

    def settle(self, ends: Sequence[RunEnd]) -> None:
        """Write how attempts ended, unless they no longer hold their runs."""
        with open_writing(self.database) as session:
            written = runs.finish_all(session, ends)
        for held in {(end.run_id, end.attempt) for end in ends} - written.keys():
            log.info("Run %d: a late end of attempt %d writes nothing", *held)

    def give_up(self, members: Collection[HeldRun], cause: str, *, begun: bool = True) -> None:
        """Write that a task was lost with its worker.

        A run that was alone in it is charged with the loss. Of several nobody knows which one was guilty, and of a task that had
        not begun none was: they go back unharmed, and alone the next time.
        """
        with open_writing(self.database) as session:
            for held in members:
                if begun and len(members) == 1:
                    runs.give_up_attempt(session, *held, cause, self.max_attempts)
                else:
                    runs.put_back(session, *held, cause)

    def put_back(self, members: Collection[HeldRun], cause: str) -> None:
        """Queue attempts again that ended through no fault of their own."""
        if members:
            with open_writing(self.database) as session:
                for held in members:
                    runs.put_back(session, *held, cause)

    def put_back_or_give_up(self, members: Collection[HeldRun], cause: str) -> None:
        """Queue attempts again whose worker was gone though the scheduler charged nobody with its end.

        They are not to blame, unless it goes on so: a scheduler that allows failures never says which task ended a
        worker, and a run that ends every worker must come to an end itself.
        """
        again = {held for held in members if held[1] <= 2 * self.max_attempts}
        self.put_back(again, cause)
        self.give_up(set(members) - again, cause)

    def end_cancelled(self, held: HeldRun) -> None:
        """Write that an attempt which did not answer was ended by force."""
        with open_writing(self.database) as session:
            runs.finish(session, *held, "CANCELLED")

    def renew(self, members: Collection[HeldRun]) -> set[HeldRun]:
        """Renew our leases and give up lapsed ones of others; return those of `members` that are no longer ours."""
        with open_writing(self.database) as session:
            ours = runs.renew(session, self.owner, self.lease_s, [run_id for run_id, _ in members])
            runs.give_up_expired(session, self.max_attempts)
        return {held for held in members if held not in ours}

    def stops(self, members: Collection[HeldRun]) -> set[HeldRun]:
        """Return those attempts that somebody asked to stop."""
        return self._stops.answer(frozenset(members), lambda: self._asked_to_stop(members))

    def _asked_to_stop(self, members: Collection[HeldRun]) -> set[HeldRun]:
        """Read the states of attempts."""
        with open_reading(self.database) as session:
            states = runs.read_states(session, [run_id for run_id, _ in members])
        return {held for held in members if states.get(held) == "CANCELLING"}

    def record(self, reports: Mapping[HeldRun, Report], lines: Mapping[HeldRun, Line]) -> None:
        """Write how far attempts are and when they said so, with what a live page draws, and lines for their logs."""
        with open_writing(self.database) as session:
            for held, report in reports.items():
                if runs.record_progress(session, *held, report.progress(utc_now())) and held in lines:
                    write_event(session, *held, lines[held])

    def waiting(self, limit: int) -> list[WaitingRun]:
        """Return the oldest runs that wait."""
        return self._waiting.answer(limit, lambda: self._oldest(limit))

    def _oldest(self, limit: int) -> list[WaitingRun]:
        """Read the oldest runs that wait."""
        with open_reading(self.database) as session:
            return waiting_runs(session, limit)

    def take(
        self, waiting: Sequence[WaitingRun], free: int, followed: int, threads: int
    ) -> list[tuple[RunGroup, list[ClaimedRun]]]:
        """Claim the oldest of the waiting runs for free threads and for those to be followed, grouped into tasks."""
        with open_writing(self.database) as session:
            self.paces.refresh(session, {run.method for run in waiting})
            groups = planned(waiting, free, followed, threads, self.paces.seconds)
            run_ids = [run_id for group in groups for run_id in group.run_ids]
            claimed = runs.claim(session, self.owner, self.lease_s, len(run_ids), run_ids) if run_ids else []
        ours = {run.run_id: run for run in claimed}
        kept = [(group, [ours[run_id] for run_id in group.run_ids if run_id in ours]) for group in groups]
        return [(group, members) for group, members in kept if members]


RUNS = 16  # looked at together


class AlarmCheck:
    """The runs of one engine that were not looked at yet."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._noted: list[int] = []

    def __bool__(self) -> bool:
        """Whether there is anything to look at."""
        return bool(self._noted)

    def note(self, ends: Collection[RunEnd]) -> None:
        """Remember the runs that succeeded."""
        self._noted += [end.run_id for end in ends if end.state == "SUCCEEDED"]

    def look(self) -> None:
        """Look at some of them, writing only where an alarm changes; what fails here, the server's upkeep does again."""
        some, self._noted = self._noted[:RUNS], self._noted[RUNS:]
        try:
            if some and (sensor_ids := self._changed(some)):
                with open_writing(self._database) as session:
                    update_alarms(session, sensor_ids)
        except Exception:
            log.exception("The watch failed after a run; the server's upkeep looks again")

    def _changed(self, run_ids: Collection[int]) -> list[int]:
        """Return the sensors of these runs whose alarms are not as they should be."""
        with open_reading(self._database) as session:
            return find_changed_sensors(session, list_sensors(session, run_ids))
