"""The engine: a thread in the server process that hands waiting runs to the workers and writes how they end.

The row is the truth, the cluster only computes. Each turn: settle finished tasks, renew leases, write progress, pass on
wishes to stop, claim as many runs as there are free threads, tell the listeners what changed. The engine may die at any
point: what it had claimed lapses with the lease, what its workers had finished lies in the blob folder under its own
address, and a write-back of an attempt that no longer holds its run matches nothing.
"""

from __future__ import annotations

import logging
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from boresight.settings import Settings
from boresight.store.runs import Claimed, Held
from boresight.store.sessions import Engine as Database
from boresight.workers.cluster import Cluster, is_finished, outcome_of
from boresight.workers.reconcile import Reconciler
from boresight.workers.tasks import CALCULATION, Inputs

log = logging.getLogger(__name__)

BUSY_TURN_S = 0.1
IDLE_TURN_S = 0.25
PAUSE_AFTER_ERROR_S = 1.0
RECORD_EVERY_S = 0.5
CANCEL_GRACE_S = 5.0
JOIN_S = 30.0


@dataclass
class Flight:
    """A task on the cluster and the attempts it computes."""

    future: Any
    members: set[Held]
    asked_s: dict[Held, float] = field(default_factory=dict)  # when each was asked to stop
    killed: bool = False


class Engine:
    """Runs the runs of one database; several engines may share it.

    Parameters
    ----------
    database
        The store.
    settings
        Scheduler address or number of workers, lease, attempts, folders.
    broadcast
        Called with every event, `{"kind": "run" | "progress", "run_id", ...}`, from the engine's thread.
    calculation
        `module:function` that the workers call, with the signature of `calibrate`.
    cancel_grace_s
        A run that does not answer a wish to stop for so long is ended with its worker process.
    """

    def __init__(
        self,
        database: Database,
        settings: Settings,
        broadcast: Callable[[dict[str, Any]], None] | None = None,
        *,
        calculation: str = CALCULATION,
        cancel_grace_s: float = CANCEL_GRACE_S,
    ) -> None:
        self.owner = f"{socket.gethostname()}/{os.getpid()}/{secrets.token_hex(3)}"
        self._settings = settings
        self._rows = Reconciler(database, self.owner, settings.lease_s, settings.max_attempts)
        self._broadcast = broadcast or (lambda _event: None)
        self._calculation = calculation
        self._grace_s = cancel_grace_s
        self._cluster: Cluster | None = None
        self._flights: list[Flight] = []
        self._reports: dict[Held, dict[str, Any]] = {}
        self._reports_lock = threading.Lock()
        self._recorded_s: dict[Held, float] = {}
        self._renewed_s = 0.0
        self._told = 0
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="boresight-engine", daemon=True)

    def start(self) -> None:
        """Begin; returns at once, the workers start beside."""
        self._told = self._rows.newest_event()
        self._thread.start()

    def stop(self) -> None:
        """End in order: what is still computing is queued again for the next engine, the workers end."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(JOIN_S)

    def notify(self) -> None:
        """Look at the rows now: one was launched or cancelled."""
        self._wake.set()

    def state(self) -> dict[str, Any]:
        """Say for a health page who this is, whether its cluster is there, and how many tasks it has on it."""
        connected = self._cluster is not None and self._cluster.connected
        return {"owner": self.owner, "connected": connected, "tasks": len(self._flights)}

    @property
    def _computes(self) -> bool:
        """Whether this engine has workers at all; without, it only tells what other engines do."""
        return bool(self._settings.scheduler) or self._settings.workers > 0

    def _run(self) -> None:
        """Turn until asked to stop; an error is logged and the next turn tries again."""
        while not self._stopping.is_set():
            pause_s = BUSY_TURN_S if self._flights else IDLE_TURN_S
            try:
                self._turn()
            except Exception:
                log.exception("The engine's turn failed and is tried again")
                self._stopping.wait(PAUSE_AFTER_ERROR_S)
            self._wake.wait(pause_s)
            self._wake.clear()
        self._shut_down()

    def _turn(self) -> None:
        """Do each part of the loop once."""
        if self._computes and self._attach():
            self._settle()
            self._renew()
            self._tell_progress()
            self._pass_on_stops()
            self._launch()
        self._tell_states()

    def _attach(self) -> bool:
        """Have a cluster; after its loss queue what was on it and make a new connection."""
        if self._cluster is not None and not self._cluster.connected:
            self._detach("the scheduler was lost")
        if self._cluster is None:
            try:
                self._cluster = Cluster.open(self._settings, self._hear)
            except OSError as error:
                log.warning("No scheduler at %s, trying again: %s", self._settings.scheduler or "this machine", error)
        return self._cluster is not None

    def _detach(self, cause: str) -> None:
        """Let go of the cluster and queue again what was on it."""
        cluster, self._cluster = self._cluster, None
        self._rows.put_back(self._held(), cause)
        self._flights.clear()
        if cluster is not None:
            cluster.close()

    def _shut_down(self) -> None:
        """Write what is finished, queue the rest again, end the workers."""
        with suppress(Exception):
            self._settle()
        try:
            self._detach("its server was stopped")
            self._tell_states()
        except Exception:
            log.exception("The engine could not queue its runs again; their leases will lapse")

    def _held(self) -> set[Held]:
        """Return all attempts that are on the cluster for us."""
        return {held for flight in self._flights for held in flight.members}

    def _settle(self) -> None:
        """Write the ends of finished tasks."""
        finished = [flight for flight in self._flights if is_finished(flight.future)]
        for flight in finished:
            self._settle_flight(flight)
            self._flights.remove(flight)
            for held in flight.asked_s:
                self._on_cluster().forget_stop(held)

    def _settle_flight(self, flight: Flight) -> None:
        """Write one task's outcomes, or that it was lost."""
        if flight.killed:
            self._rows.put_back(flight.members, "a run that shared its worker had to be ended by force")
        elif flight.future.cancelled():
            self._rows.put_back(flight.members, "the scheduler was lost")
        elif isinstance(answer := outcome_of(flight.future), Exception):
            self._rows.give_up(flight.members, _cause(answer))
        else:
            self._rows.settle(answer)

    def _renew(self) -> None:
        """Renew our leases three times a lease; drop what is no longer ours."""
        if time.monotonic() - self._renewed_s < self._settings.lease_s / 3:
            return
        lost = self._rows.renew(self._held())
        self._renewed_s = time.monotonic()
        for flight in self._flights:
            for held in flight.members & lost:
                flight.members.discard(held)
                flight.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)

    def _hear(self, event: dict[str, Any]) -> None:
        """Take a report from the cluster's thread; the newest of an attempt replaces the one before."""
        with self._reports_lock:
            self._reports[event["run_id"], event["attempt"]] = event

    def _tell_progress(self) -> None:
        """Pass reports on, and write them to the rows at most twice a second."""
        with self._reports_lock:
            reports, self._reports = self._reports, {}
        ours, now_s = self._held(), time.monotonic()
        self._recorded_s = {held: at_s for held, at_s in self._recorded_s.items() if held in ours}
        due: dict[Held, dict[str, Any]] = {}
        for held, report in reports.items():
            if held not in ours:
                continue
            if now_s - self._recorded_s.get(held, 0.0) >= RECORD_EVERY_S:
                due[held] = report
                self._recorded_s[held] = now_s
            told = {name: report[name] for name in ("run_id", "attempt", "fraction", "message")}
            self._broadcast({"kind": "progress", **told})
        if due:
            self._rows.record(due)

    def _pass_on_stops(self) -> None:
        """Ask attempts to stop whose rows say so; end by force what did not answer in time."""
        for flight, held in self._to_stop():
            if held not in flight.asked_s:
                flight.asked_s[held] = time.monotonic()
                self._on_cluster().ask_to_stop(held)
            elif time.monotonic() - flight.asked_s[held] > self._grace_s and not flight.killed:
                flight.killed = True
                flight.members.discard(held)
                self._rows.end_cancelled(held)
                self._on_cluster().kill(flight.future)

    def _to_stop(self) -> list[tuple[Flight, Held]]:
        """Return the attempts that somebody asked to stop, each with its task."""
        if not self._flights:
            return []
        asked = self._rows.stops(self._held())
        return [(flight, held) for flight in self._flights for held in flight.members & asked]

    def _launch(self) -> None:
        """Claim as many tasks as there are free threads and hand them over."""
        free = self._on_cluster().threads() - len(self._flights)
        for group in self._rows.take(free) if free > 0 else ():
            work = [(run.run_id, run.attempt, self._inputs(run)) for run in group]
            members = {(run.run_id, run.attempt) for run in group}
            try:
                future = self._on_cluster().submit(work, self._calculation, self._wake.set)
            except Exception:
                self._rows.put_back(members, "it could not be handed to the scheduler")
                raise
            self._flights.append(Flight(future, members))

    def _inputs(self, run: Claimed) -> Inputs:
        """Gather what the workers need."""
        return Inputs(
            blob_folder=str(self._settings.blob_folder),
            catalogue_folder=str(self._settings.catalogue_folder),
            table_sha256=run.table_sha256,
            validation_sha256=run.validation_sha256,
            sensor_document=dict(run.sensor_document),
            settings=dict(run.settings),
        )

    def _tell_states(self) -> None:
        """Tell every change of state since the last turn, whoever made it."""
        self._told, news = self._rows.news(self._told)
        for event in news:
            self._broadcast(event)

    def _on_cluster(self) -> Cluster:
        """Return the cluster that the turn has attached."""
        if self._cluster is None:
            raise RuntimeError("Expected an attached cluster / Received none")
        return self._cluster


def _cause(error: Exception) -> str:
    """Say in a clause why a task was lost."""
    if type(error).__name__ == "KilledWorker":
        return "its worker process died while computing it (killed, or out of memory)"
    return f"its worker could not begin it, {type(error).__name__}: {error}"
