"""The dispatcher: a thread in the server process that hands waiting runs to the workers and writes how they end.

The row is the truth, the cluster only computes. Each turn: settle finished tasks, give runs to the threads, and only then, while
they compute, renew leases, write progress, pass on wishes to stop, and look whether what was found raises an alarm. A task is
pinned to its worker and a thread computes one task at a time, so when a worker dies it is known which run may have been guilty.
It may die at any point: what it had claimed lapses with the lease, what its workers had finished lies in the blob
folder under its own address, and a write-back of an attempt that no longer holds its run matches nothing.

Everything it writes to the database is one short transaction each. What we hold we renew three times a lease; what lapses belonged
to a server that is gone and is queued again, or ended when it has lost too many attempts. Every write is fenced by attempt and
state (see `boresight.console.runs.queries`), so two servers on one database cannot both end a run, and a result that comes too late
writes nothing.
"""

from __future__ import annotations

import logging
import math
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from statistics import median

from distributed.comm import CommClosedError

from boresight.console.alarms.rules import find_changed_sensors, update_alarms
from boresight.console.fleet.queries import list_camera_models
from boresight.console.runs import queries as runs
from boresight.console.runs.dry_runs import TimedRun, estimate_seconds_per_star, list_timed_runs, predict_duration_s
from boresight.console.runs.queries import (
    ClaimedRun,
    HeldRun,
    Line,
    RunEnd,
    WaitingRun,
    list_sensors,
    list_waiting_runs,
    write_event,
)
from boresight.platform.db.data_version import DataVersionReader, VersionedCache
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import Engine as Database
from boresight.platform.db.sessions import Session, open_reading, open_writing, utc_now
from boresight.platform.jobs.worker_news import RunMoved, RunProgress, WorkerState
from boresight.platform.observability.traces import NO_SPAN, Span, get_traces, to_ns
from boresight.settings import Settings
from boresight.telemetry.sensors import read_described_camera
from boresight.workers.cluster import Cluster, LostTaskError
from boresight.workers.dispatched_tasks import DispatchedTask, DispatchedTasks
from boresight.workers.link import ProgressInbox, Report
from boresight.workers.tasks import CALCULATION, gather_inputs

FRESH_S = 3.0
ALIKE = 1.5  # runs with up to so many times more or fewer stars count as alike


@dataclass
class _MethodDuration:
    """The recent durations of a method."""

    timed: list[TimedRun]
    s_per_star: float
    read_s: float


@dataclass
class DurationModel:
    """A model of run durations, from the newest runs of each method."""

    _known: dict[str, _MethodDuration] = field(default_factory=dict)

    def refresh(self, session: Session, methods: set[str]) -> None:
        """Reread the newest runs of these methods, unless that was done just now."""
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
        waits = run.settings.replay_frames_per_s
        return foreseen_s if waits or not alike else run.stars * median(alike)


# To hand over a task, fetch its answer and write it costs tens of milliseconds, so short runs share one: two seconds' worth where
# few wait; of a long queue a share of what waits for each thread, for who queued a thousand runs waits for the last (ADR 39).
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
    if waiting[0].stands_alone or total_s > GROUP_S:
        return RunGroup([waiting[0].run_id], total_s, short=False)
    chosen = [waiting[0].run_id]
    for run in waiting[1:most]:
        seconds = seconds_of(run)
        if run.stands_alone or seconds > GROUP_S or total_s + seconds > longest_s:
            break
        chosen.append(run.run_id)
        total_s += seconds
    return RunGroup(chosen, total_s, short=True)


log = logging.getLogger(__name__)


def _recordable(end: RunEnd) -> RunEnd:
    """Return an end that a row can hold, because one that cannot be written would block the ends of all other runs."""
    try:
        canonical([end.summary, [line.numbers for line in end.log]])
    except (TypeError, ValueError) as error:
        log.exception("Run %d: the end of attempt %d is not JSON", end.run_id, end.attempt)
        reason = f"The result could not be recorded, {type(error).__name__}: {error}"
        return RunEnd(end.run_id, end.attempt, "FAILED", reason)
    return end


@dataclass(frozen=True)
class Reconciler:
    """The dispatcher's transactions on the rows of runs."""

    database: Database
    owner: str
    lease_s: float
    max_attempts: int
    durations: DurationModel = field(default_factory=DurationModel)

    @cached_property
    def _data_versions(self) -> DataVersionReader:
        """Reads the data version, so that queries of every turn run only after a commit."""
        return DataVersionReader(self.database)

    @cached_property
    def _waiting(self) -> VersionedCache[list[WaitingRun]]:
        return VersionedCache(self._data_versions)

    @cached_property
    def _stops(self) -> VersionedCache[set[HeldRun]]:
        return VersionedCache(self._data_versions)

    def close(self) -> None:
        """Close the connection to the store."""
        self._data_versions.close()

    def list_cameras(self) -> list[str]:
        """List the camera models of the registered sensors, for which workers are warmed."""
        with open_reading(self.database) as session:
            return list_camera_models(session)

    def settle(self, ends: Sequence[RunEnd]) -> list[RunEnd]:
        """Write how attempts ended, unless they no longer hold their runs; return those that were written."""
        with open_writing(self.database) as session:
            written = runs.finish_all(session, [_recordable(end) for end in ends])
        for (run_id, attempt), state in written.items():
            log.info(
                "Run %d: attempt %d ended %s",
                run_id,
                attempt,
                state,
                extra={"told": {"run_id": run_id, "attempt": attempt}},
            )
        for held in {(end.run_id, end.attempt) for end in ends} - written.keys():
            log.info("Run %d: a late end of attempt %d writes nothing", *held)
        kept = [end for end in ends if (end.run_id, end.attempt) in written]
        return [replace(end, state=written[end.run_id, end.attempt]) for end in kept]

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
        """Queue attempts again whose worker is gone without a task being blamed.

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
        """Return the attempts that were asked to stop."""
        return self._stops.answer(frozenset(members), lambda: self._asked_to_stop(members))

    def _asked_to_stop(self, members: Collection[HeldRun]) -> set[HeldRun]:
        """Read the states of attempts."""
        with open_reading(self.database) as session:
            states = runs.read_states(session, [run_id for run_id, _ in members])
        return {held for held in members if states.get(held) == "CANCELLING"}

    def record(self, reports: Mapping[HeldRun, Report], lines: Mapping[HeldRun, Line]) -> None:
        """Write the progress of attempts with its time, the data for live pages, and lines for their logs."""
        with open_writing(self.database) as session:
            for held, report in reports.items():
                if runs.record_progress(session, *held, report.progress(utc_now())) and held in lines:
                    write_event(session, *held, lines[held])

    def waiting(self, limit: int) -> list[WaitingRun]:
        """Return the oldest waiting runs."""
        return self._waiting.answer(limit, lambda: self._oldest(limit))

    def _oldest(self, limit: int) -> list[WaitingRun]:
        with open_reading(self.database) as session:
            return list_waiting_runs(session, limit)

    def take(
        self, waiting: Sequence[WaitingRun], free: int, followed: int, threads: int
    ) -> list[tuple[RunGroup, list[ClaimedRun]]]:
        """Claim the oldest waiting runs for free threads and for threads that soon will be, grouped into tasks."""
        with open_writing(self.database) as session:
            self.durations.refresh(session, {run.method for run in waiting})
            groups = planned(waiting, free, followed, threads, self.durations.seconds)
            run_ids = [run_id for group in groups for run_id in group.run_ids]
            claimed = runs.claim(session, self.owner, self.lease_s, len(run_ids), run_ids) if run_ids else []
        ours = {run.run_id: run for run in claimed}
        kept = [(group, [ours[run_id] for run_id in group.run_ids if run_id in ours]) for group in groups]
        return [(group, members) for group, members in kept if members]


RUNS = 16  # checked together


class AlarmCheck:
    """The succeeded runs whose alarms are still to be checked."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._noted: list[int] = []

    def __bool__(self) -> bool:
        """Whether there is anything to check."""
        return bool(self._noted)

    def note(self, ends: Collection[RunEnd]) -> None:
        """Remember the runs that succeeded."""
        self._noted += [end.run_id for end in ends if end.state == "SUCCEEDED"]

    def look(self) -> None:
        """Check some of them, writing only where an alarm changes; after a failure the server's maintenance checks again."""
        some, self._noted = self._noted[:RUNS], self._noted[RUNS:]
        try:
            if some and (sensor_ids := self._changed(some)):
                with open_writing(self._database) as session:
                    update_alarms(session, sensor_ids)
        except Exception:
            log.exception("The alarm check failed after a run; the server's maintenance checks again")

    def _changed(self, run_ids: Collection[int]) -> list[int]:
        """Return the sensors of these runs whose alarms have to change."""
        with open_reading(self._database) as session:
            return find_changed_sensors(session, list_sensors(session, run_ids))


TURN_S = 0.25  # pause without events; an end, a launch or a cancellation on this server wakes the dispatcher at once
LOOK_EVERY_S = 0.5  # pause between checks of the workers
PAUSE_AFTER_ERROR_S = 1.0
CANCEL_GRACE_S, GONE_S = 5.0, 1.0
GONE = "its worker was lost before the task reached it, or before its result was fetched"
KILL_AGAIN_S, OVERDUE_S = 20.0, 30.0
LOOK_AHEAD = 64  # runs per thread
JOIN_S = 30.0


class RunDispatcher:
    """Runs the runs of one database; several dispatchers may share it."""

    def __init__(
        self,
        database: Database,
        settings: Settings,
        broadcast: Callable[[RunMoved | RunProgress], None] | None = None,
        *,
        suspect: Callable[[str], None] | None = None,
        observe: Callable[[str, float | None], None] | None = None,
        calculation: str = CALCULATION,
        cancel_grace_s: float = CANCEL_GRACE_S,
    ) -> None:
        self.owner = f"{socket.gethostname()}/{os.getpid()}/{secrets.token_hex(3)}"
        self._settings = settings
        self._rows = Reconciler(database, self.owner, settings.lease_s, settings.max_attempts)
        self._broadcast = broadcast or (lambda _event: None)
        self._suspect = suspect or (lambda _sha256: None)
        self._observe = observe or (lambda _state, _seconds: None)
        self._calculation = calculation
        self._grace_s = cancel_grace_s
        self._cluster: Cluster | None = None
        self._tasks = DispatchedTasks()
        self._threads: dict[str, int] = {}
        self._joined = False  # whether any worker has ever joined
        self._alarm_check = AlarmCheck(database)
        self._reports = ProgressInbox()
        self._traces = get_traces(settings.otlp_endpoint, "boresight")
        self._spans: dict[HeldRun, Span] = {}
        self._renewed_s = self._looked_s = 0.0
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._draining = False
        self._thread = threading.Thread(target=self._run, name="boresight-dispatcher", daemon=True)

    def start(self) -> None:
        """Start the thread if the settings have any workers; returns at once while the workers start."""
        if self._settings.scheduler or self._settings.workers > 0:
            self._thread.start()

    def drain(self) -> None:
        """Claim no more runs; those under way go on, and waiting ones are left to other servers."""
        self._draining = True

    def stop(self) -> None:
        """Stop in order: running attempts are queued again for the next dispatcher, and the workers end."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def notify(self) -> None:
        """Read the rows now, after a launch or cancellation."""
        self._wake.set()

    def state(self) -> WorkerState:
        """Return how it and its workers are."""
        connected = self._cluster is not None and self._cluster.connected
        turns, threads = self._thread.is_alive(), sum(self._threads.values())
        return WorkerState(self.owner, turns, connected, self._joined, threads, len(self._tasks))

    def _run(self) -> None:
        """Run turns until asked to stop; after an error, which is logged, the next turn tries again."""
        while not self._stopping.is_set():
            try:
                self._turn()
            except CommClosedError:  # the next turn notices and connects to another
                log.warning("The scheduler was lost during a request")
                self._stopping.wait(TURN_S)
            except Exception:
                log.exception("The dispatcher's turn failed and is tried again")
                self._stopping.wait(PAUSE_AFTER_ERROR_S)
            self._wake.wait(TURN_S)
            self._wake.clear()
        self._shut_down()

    def _turn(self) -> None:
        if self._attach():
            self._settle()
            if not self._draining:
                self._launch()
            self._renew()
            self._tell_progress()
            self._pass_on_stops()
            self._alarm_check.look()

    def _attach(self) -> bool:
        """Make sure that there is a cluster; after a loss queue its attempts again and reconnect."""
        if self._cluster is not None and not self._cluster.connected:
            self._detach("the scheduler was lost")
        if self._cluster is None:
            try:
                cameras = self._rows.list_cameras()
                self._cluster = Cluster.open(self._settings, self._reports.hear, cameras)
            except OSError as error:
                log.warning("No scheduler at %s, trying again: %s", self._settings.scheduler or "this machine", error)
        return self._cluster is not None

    def _detach(self, cause: str) -> None:
        """Disconnect from the cluster and queue its attempts again."""
        cluster, self._cluster = self._cluster, None
        held = self._tasks.held()
        self._tasks.clear()
        try:
            self._rows.put_back(held, cause)
            self._tell_moved(held)
        finally:
            if cluster is not None:
                cluster.close(held)

    def _shut_down(self) -> None:
        """Write the finished ends, queue the rest again, and end the workers."""
        try:
            if self._cluster is not None:
                self._settle()
        except Exception:
            log.exception("The dispatcher could not write all that had ended; it is computed again")
        try:
            self._detach("its server was stopped")
        except Exception:
            log.exception("The dispatcher could not queue its runs again; their leases will lapse")
        self._rows.close()

    def _settle(self) -> None:
        """Write the ends of finished and of lost tasks."""
        is_due = time.monotonic() - self._looked_s > LOOK_EVERY_S and (self._tasks or not self._threads)
        if is_due or self._tasks.any_done():
            self._threads, self._looked_s = self._on_cluster().workers(), time.monotonic()
        self._joined = self._joined or bool(self._threads)
        self._tasks.advance(self._threads)
        self._recall()
        for task in self._tasks:
            if self._is_settled(task, alive=task.worker in self._threads):
                self._tasks.remove(task)
                self._tell_moved(task.members)
                for held in task.asked_s:
                    self._on_cluster().forget_stop(held)

    def _is_settled(self, task: DispatchedTask, *, alive: bool) -> bool:
        """Write how one task ended, if it did."""
        if task.killed_s is not None:  # its thread is free only when its worker is gone
            if alive and time.monotonic() - task.killed_s > KILL_AGAIN_S:
                self._kill(task)
            return not alive
        if task.future.cancelled():
            self._rows.put_back(task.members, "the scheduler dropped it")
            return True
        answer = self._on_cluster().fetch_ends(task.future, task.worker)
        if answer is None and alive:
            return False
        if answer is None:  # the report of the end may not have arrived yet
            task.gone_s = task.gone_s or time.monotonic()
            if time.monotonic() - task.gone_s < GONE_S:
                return False
            task.future.cancel()
            self._rows.put_back_or_give_up(task.members, GONE)
            return True
        if isinstance(answer, LostTaskError):
            self._rows.give_up(task.members, str(answer), begun=not task.behind)
        else:
            for end in self._rows.settle(answer):
                self._observe(end.state, (end.summary or {}).get("seconds"))
            self._end_spans(answer)
            self._alarm_check.note(answer)
            for sha256 in {end.corrupt_sha256 for end in answer} - {None}:
                self._suspect(str(sha256))
        return True

    def _renew(self) -> None:
        """Renew our leases three times per lease; drop attempts that are no longer ours."""
        if time.monotonic() - self._renewed_s < self._settings.lease_s / 3:
            return
        lost = self._rows.renew(self._tasks.held())
        self._renewed_s = time.monotonic()
        for task in self._tasks:
            for held in task.members & lost:
                task.members.discard(held)
                task.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)

    def _tell_progress(self) -> None:
        """Broadcast reports, and write them to the rows at most twice a second."""
        reports = self._reports.take(self._tasks.held())
        for held, report in reports.items():
            self._broadcast(self._reports.news(held, report))
        if due := self._reports.due(reports):
            self._rows.record(due, self._reports.lines(due))

    def _pass_on_stops(self) -> None:
        """Ask attempts of cancelled runs to stop; kill those that did not answer in time."""
        asked = self._rows.stops(self._tasks.held()) if self._tasks else set()
        for held in asked:
            task = self._tasks.find_task(held)
            if held not in task.asked_s:
                task.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)
            elif not task.behind and task.unanswered_s(held) > self._grace_s:
                self._end_by_force(task, held)
                break  # the others of its task are not in flight any more

    def _end_by_force(self, task: DispatchedTask, held: HeldRun) -> None:
        """Kill an attempt that does not answer with its worker; the others of its task are queued again."""
        self._rows.end_cancelled(held)
        self._rows.put_back(task.members - {held}, "a run that shared its worker had to be ended by force")
        self._tell_moved(task.members)
        task.members.clear()
        self._kill(task)

    def _kill(self, task: DispatchedTask) -> None:
        """End a task's worker process; a new one takes its place."""
        task.killed_s = time.monotonic()
        self._on_cluster().kill(task.future, task.worker)

    def _launch(self) -> None:
        """Give waiting runs to free threads, and further ones to threads that will soon be free."""
        if self._tasks and not (self._tasks.free(self._threads) or self._tasks.followed(self._threads)):
            return
        threads = sum(self._threads.values())
        waiting = self._rows.waiting(LOOK_AHEAD * max(1, threads))
        if waiting and not self._tasks:
            self._threads = self._on_cluster().workers()
            threads = sum(self._threads.values())
        free = self._tasks.free(self._threads) if waiting else []
        followed = self._tasks.followed(self._threads) if len(waiting) > threads else []
        claimed = self._rows.take(waiting, len(free), len(followed), threads) if free or followed else []
        try:
            for place, (worker, (group, runs)) in enumerate(zip(free + followed, claimed, strict=False)):
                self._hand_over(worker, group, runs, behind=place >= len(free))
        except Exception:
            taken = {(run.run_id, run.attempt) for _, runs in claimed for run in runs}
            self._rows.put_back(taken - self._tasks.held(), "it could not be handed to the scheduler")
            raise

    def _hand_over(self, worker: str, group: RunGroup, runs: list[ClaimedRun], *, behind: bool) -> None:
        members = {(run.run_id, run.attempt) for run in runs}
        work = [(run.run_id, run.attempt, gather_inputs(self._settings, run, self._begin_span(run))) for run in runs]
        future = self._on_cluster().submit(worker, work, self._calculation, self._wake.set)
        self._tasks.add(DispatchedTask(future, worker, members, group.short, group.seconds, behind))
        self._tell_moved(members)

    def _begin_span(self, run: ClaimedRun) -> str | None:
        """Tell how long a run waited, begin the span of its attempt, and return its place for the worker."""
        if not self._traces.on:
            return None
        told: dict[str, str | int] = {"boresight.run_id": run.run_id, "boresight.attempt": run.attempt}
        told |= {
            "boresight.sensor_id": run.sensor_id,
            "boresight.sensor": read_described_camera(run.sensor_document).name,
        }
        self._traces.tell_past("queue", run.traceparent, to_ns(run.launched_utc), time.time_ns(), told)
        span = self._traces.begin("run", run.traceparent, told, kind="PRODUCER")
        self._spans[run.run_id, run.attempt] = span
        return span.traceparent

    def _end_spans(self, ends: Sequence[RunEnd]) -> None:
        for end in ends:
            span = self._spans.pop((end.run_id, end.attempt), NO_SPAN)
            span.tell({"boresight.state": end.state, "boresight.result_sha256": end.result_sha256})
            if end.state == "FAILED":
                span.fail(end.reason or end.state)
            span.end()

    def _recall(self) -> None:
        """Queue tasks again that wait behind one slower than predicted; another thread may be free sooner."""
        for task in self._tasks.overdue(OVERDUE_S):
            task.future.cancel()
            self._rows.put_back(task.members, "earlier runs took longer than predicted")
            self._tasks.remove(task)
            self._tell_moved(task.members)

    def _tell_moved(self, members: Collection[HeldRun]) -> None:
        """Announce that the states of runs have changed; the span of an attempt that is over without an end ends too."""
        for held in self._spans.keys() & set(members) - self._tasks.held():
            self._spans.pop(held).end()
        for run_id, attempt in sorted(members):
            self._broadcast(RunMoved(run_id, attempt))

    def _on_cluster(self) -> Cluster:
        if self._cluster is None:
            raise RuntimeError("Expected an attached cluster / Received none")
        return self._cluster
