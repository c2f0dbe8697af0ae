"""The engine: a thread in the server process that hands waiting runs to the workers and writes how they end.

The row is the truth, the cluster only computes. Each turn: settle finished tasks, give runs to the threads, and only then, while
they compute, renew leases, write progress, pass on wishes to stop, and look whether what was found raises an alarm. A task is
pinned to its worker and a thread computes one task at a time, so when a worker dies it is known which run may have been guilty.
The engine itself may die at any point: what it had claimed lapses with the lease, what its workers had finished lies in the blob
folder under its own address, and a write-back of an attempt that no longer holds its run matches nothing.
"""

from __future__ import annotations

import logging
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Collection
from typing import Any

from distributed.comm import CommClosedError

from boresight.console.runs.queries import ClaimedRun, HeldRun
from boresight.platform.db.sessions import Engine as Database
from boresight.settings import Settings
from boresight.workers.cluster import Cluster, LostTaskError
from boresight.workers.dispatched_tasks import DispatchedTask, DispatchedTasks
from boresight.workers.link import ProgressInbox
from boresight.workers.reconcile import AlarmCheck, Reconciler, RunGroup
from boresight.workers.tasks import CALCULATION, gather_inputs

log = logging.getLogger(__name__)

TURN_S = 0.25  # while nothing is told: an end, a launch and a wish to stop here wake the engine at once
LOOK_EVERY_S = 0.5  # at the workers, while no task has ended or none is there
PAUSE_AFTER_ERROR_S = 1.0
CANCEL_GRACE_S, GONE_S = 5.0, 1.0
GONE = "its worker was gone before the task reached it, or before its result was fetched"
KILL_AGAIN_S, OVERDUE_S = 20.0, 30.0
LOOK_AHEAD = 64  # runs a thread
JOIN_S = 30.0


class RunDispatcher:
    """Runs the runs of one database; several engines may share it."""

    def __init__(
        self,
        database: Database,
        settings: Settings,
        broadcast: Callable[[dict[str, Any]], None] | None = None,
        *,
        suspect: Callable[[str], None] | None = None,
        calculation: str = CALCULATION,
        cancel_grace_s: float = CANCEL_GRACE_S,
    ) -> None:
        self.owner = f"{socket.gethostname()}/{os.getpid()}/{secrets.token_hex(3)}"
        self._settings = settings
        self._rows = Reconciler(database, self.owner, settings.lease_s, settings.max_attempts)
        self._broadcast = broadcast or (lambda _event: None)
        self._suspect = suspect or (lambda _sha256: None)
        self._calculation = calculation
        self._grace_s = cancel_grace_s
        self._cluster: Cluster | None = None
        self._flights = DispatchedTasks()
        self._threads: dict[str, int] = {}
        self._joined = False  # whether any worker ever was there
        self._lookout = AlarmCheck(database)
        self._reports = ProgressInbox()
        self._renewed_s = self._looked_s = 0.0
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="boresight-engine", daemon=True)

    def start(self) -> None:
        """Begin, where the settings give any workers; returns at once, the workers start beside."""
        if self._settings.scheduler or self._settings.workers > 0:
            self._thread.start()

    def stop(self) -> None:
        """End in order: what is still computing is queued again for the next engine, the workers end."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def notify(self) -> None:
        """Look at the rows now: one was launched or cancelled."""
        self._wake.set()

    def state(self) -> dict[str, Any]:
        """Say who this is, whether it turns, its cluster is there and ever had a worker; its threads at last, and tasks."""
        connected = self._cluster is not None and self._cluster.connected
        counts = {"joined": self._joined, "threads": sum(self._threads.values()), "tasks": len(self._flights)}
        return {"owner": self.owner, "turns": self._thread.is_alive(), "connected": connected, **counts}

    def _run(self) -> None:
        """Turn until asked to stop; an error is logged and the next turn tries again."""
        while not self._stopping.is_set():
            try:
                self._turn()
            except CommClosedError:  # the next turn sees that, and attaches to another
                log.warning("The scheduler was lost while it was asked something")
                self._stopping.wait(TURN_S)
            except Exception:
                log.exception("The engine's turn failed and is tried again")
                self._stopping.wait(PAUSE_AFTER_ERROR_S)
            self._wake.wait(TURN_S)
            self._wake.clear()
        self._shut_down()

    def _turn(self) -> None:
        """Do each part of the loop once."""
        if self._attach():
            self._settle()
            self._launch()
            self._renew()
            self._tell_progress()
            self._pass_on_stops()
            self._lookout.look()

    def _attach(self) -> bool:
        """Have a cluster; after its loss queue what was on it and make a new connection."""
        if self._cluster is not None and not self._cluster.connected:
            self._detach("the scheduler was lost")
        if self._cluster is None:
            try:
                self._cluster = Cluster.open(self._settings, self._reports.hear)
            except OSError as error:
                log.warning("No scheduler at %s, trying again: %s", self._settings.scheduler or "this machine", error)
        return self._cluster is not None

    def _detach(self, cause: str) -> None:
        """Let go of the cluster and queue again what was on it."""
        cluster, self._cluster = self._cluster, None
        held = self._flights.held()
        self._flights.clear()
        try:
            self._rows.put_back(held, cause)
            self._tell_moved(held)
        finally:
            if cluster is not None:
                cluster.close(held)

    def _shut_down(self) -> None:
        """Write what is finished, queue the rest again, end the workers."""
        try:
            if self._cluster is not None:
                self._settle()
        except Exception:
            log.exception("The engine could not write all that had ended; it is computed again")
        try:
            self._detach("its server was stopped")
        except Exception:
            log.exception("The engine could not queue its runs again; their leases will lapse")
        self._rows.close()

    def _settle(self) -> None:
        """Write the ends of finished and of lost tasks."""
        is_due = time.monotonic() - self._looked_s > LOOK_EVERY_S and (self._flights or not self._threads)
        if is_due or self._flights.any_done():
            self._threads, self._looked_s = self._on_cluster().workers(), time.monotonic()
        self._joined = self._joined or bool(self._threads)
        self._flights.advance(self._threads)
        self._recall()
        for task in self._flights:
            if self._is_settled(task, alive=task.worker in self._threads):
                self._flights.remove(task)
                self._tell_moved(task.members)
                for held in task.asked_s:
                    self._on_cluster().forget_stop(held)

    def _is_settled(self, task: DispatchedTask, *, alive: bool) -> bool:
        """Write how one task ended, if it did."""
        if task.killed_s is not None:  # its thread is not free before its worker is gone
            if alive and time.monotonic() - task.killed_s > KILL_AGAIN_S:
                self._kill(task)
            return not alive
        if task.future.cancelled():
            self._rows.put_back(task.members, "the scheduler dropped it")
            return True
        answer = self._on_cluster().ends_of(task.future, task.worker)
        if answer is None and alive:
            return False
        if answer is None:  # the news of the end may still be on its way
            task.gone_s = task.gone_s or time.monotonic()
            if time.monotonic() - task.gone_s < GONE_S:
                return False
            task.future.cancel()
            self._rows.put_back_or_give_up(task.members, GONE)
            return True
        if isinstance(answer, LostTaskError):
            self._rows.give_up(task.members, str(answer), begun=not task.behind)
        else:
            self._rows.settle(answer)
            self._lookout.note(answer)
            for sha256 in {end.corrupt_sha256 for end in answer} - {None}:
                self._suspect(str(sha256))
        return True

    def _renew(self) -> None:
        """Renew our leases three times a lease; drop what is no longer ours."""
        if time.monotonic() - self._renewed_s < self._settings.lease_s / 3:
            return
        lost = self._rows.renew(self._flights.held())
        self._renewed_s = time.monotonic()
        for task in self._flights:
            for held in task.members & lost:
                task.members.discard(held)
                task.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)

    def _tell_progress(self) -> None:
        """Pass reports on, and write them to the rows at most twice a second."""
        reports = self._reports.take(self._flights.held())
        for held, report in reports.items():
            self._broadcast({"kind": "progress", **self._reports.news(held, report)})
        if due := self._reports.due(reports):
            self._rows.record(due, self._reports.lines(due))

    def _pass_on_stops(self) -> None:
        """Ask attempts to stop whose rows say so; end by force what did not answer in time."""
        asked = self._rows.stops(self._flights.held()) if self._flights else set()
        for held in asked:
            task = self._flights.of(held)
            if held not in task.asked_s:
                task.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)
            elif not task.behind and task.unanswered_s(held) > self._grace_s:
                self._end_by_force(task, held)
                break  # what shared its task is in flight no more

    def _end_by_force(self, task: DispatchedTask, held: HeldRun) -> None:
        """End an attempt that does not answer, with its worker; what shared its task is queued again."""
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
        """Give waiting runs to the free threads, and more to those that will soon be free."""
        if self._flights and not (self._flights.free(self._threads) or self._flights.followed(self._threads)):
            return
        threads = sum(self._threads.values())
        waiting = self._rows.waiting(LOOK_AHEAD * max(1, threads))
        if waiting and not self._flights:
            self._threads = self._on_cluster().workers()
            threads = sum(self._threads.values())
        free = self._flights.free(self._threads) if waiting else []
        followed = self._flights.followed(self._threads) if len(waiting) > threads else []
        claimed = self._rows.take(waiting, len(free), len(followed), threads) if free or followed else []
        try:
            for place, (worker, (group, runs)) in enumerate(zip(free + followed, claimed, strict=False)):
                self._hand_over(worker, group, runs, behind=place >= len(free))
        except Exception:
            taken = {(run.run_id, run.attempt) for _, runs in claimed for run in runs}
            self._rows.put_back(taken - self._flights.held(), "it could not be handed to the scheduler")
            raise

    def _hand_over(self, worker: str, group: RunGroup, runs: list[ClaimedRun], *, behind: bool) -> None:
        """Give one task to one worker."""
        members = {(run.run_id, run.attempt) for run in runs}
        work = [(run.run_id, run.attempt, gather_inputs(self._settings, run)) for run in runs]
        future = self._on_cluster().submit(worker, work, self._calculation, self._wake.set)
        self._flights.add(DispatchedTask(future, worker, members, group.short, group.seconds, behind))
        self._tell_moved(members)

    def _recall(self) -> None:
        """Queue again what waits behind a task that takes longer than was foreseen; another thread may be free sooner."""
        for task in self._flights.overdue(OVERDUE_S):
            task.future.cancel()
            self._rows.put_back(task.members, "the runs before it took longer than foreseen")
            self._flights.remove(task)
            self._tell_moved(task.members)

    def _tell_moved(self, members: Collection[HeldRun]) -> None:
        """Tell that the states of runs have changed; what to is in their rows."""
        for run_id, attempt in sorted(members):
            self._broadcast({"kind": "run", "run_id": run_id, "attempt": attempt})

    def _on_cluster(self) -> Cluster:
        """Return the cluster that the turn has attached."""
        if self._cluster is None:
            raise RuntimeError("Expected an attached cluster / Received none")
        return self._cluster
