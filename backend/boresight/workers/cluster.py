"""The dask cluster as the dispatcher uses it: submitting tasks to workers, stopping and killing them, noticing losses."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Any

import dask
import distributed
from distributed import Client, Event, KilledWorker, SpecCluster
from distributed.gc import enable_gc_diagnosis
from distributed.system import MEMORY_LIMIT

import boresight
from boresight.console.runs.queries import HeldRun, RunEnd
from boresight.settings import Settings
from boresight.workers.cluster_executor import LENT_TOPIC
from boresight.workers.dispatched_tasks import UNFIT_TOPIC, WorkerCheck
from boresight.workers.link import TOPIC, Report, cancel_event
from boresight.workers.security import PROTOCOL, make_security, own_security
from boresight.workers.tasks import WarmUp, Work, execute_group

#: Of a machine, over its worker processes; the rest is the server's and the system's.
MEMORY_SHARE = 0.8
#: Much of what distributed does beside tasks is for its own pages, which nobody opens here; it goes on whether anything is
#: computed or not, in the server's process for the scheduler and for the nanny of each worker.
CONFIGURATION = {
    "distributed.admin.low-level-log-length": 100,  # progress events the scheduler keeps; each may hold a history
    "distributed.admin.system-monitor.disk": False,  # of the whole machine
    "distributed.admin.system-monitor.gil.enabled": False,  # a thread that asks for the interpreter every millisecond
    "distributed.admin.system-monitor.interval": "5s",  # of 0.5 s; memory limits have a look of their own
    "distributed.admin.tick.interval": "1s",  # of 20 ms: whether the event loop is late, told from 3 s on
    "distributed.diagnostics.nvml": False,
    # gives every freed array back to the system at once, and each new one comes in pages that fault: a third of a short run's time
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.scheduler.active-memory-manager.start": False,  # drops copies of results; ours are fetched once
    "distributed.scheduler.work-stealing": False,  # every task names its worker
    "distributed.worker.memory.monitor-interval": "500ms",  # of 100 ms, by each worker and by its nanny
    "distributed.worker.profile.enabled": False,  # looks at the computing thread a hundred times a second
}
# A scheduler enables it as it starts; in the middle of a collection by another thread, its callback fails. From here on it stays.
enable_gc_diagnosis()


END_S = 2.0  # a stuck thread, as in a DNS query, is abandoned


class SchedulerClient(Client):  # type: ignore[misc] # dask is not typed
    """A connection to a scheduler, as `distributed.Client`."""

    _is_over = False

    def start(self, **options: Any) -> None:
        """Connect as the constructor does; after a failure the thread is ended."""
        try:
            super().start(**options)
        except BaseException:
            with suppress(Exception):
                self.close()
            raise

    def close(self, *arguments: Any, **options: Any) -> None:
        """Disconnect and end the thread, which dask's client does only while connected; safe to call twice."""
        if self._is_over:
            return
        self._is_over = True
        try:
            super().close(*arguments, **options)
        finally:
            with suppress(Exception):
                self._loop_runner.stop(timeout=END_S)


class Scheduler(distributed.Scheduler):  # type: ignore[misc]  # distributed ships no types
    """A scheduler without an HTTP server."""

    def start_http_server(self, *_arguments: Any, **_options: Any) -> None:
        """Open no port."""


class Worker(distributed.Worker):  # type: ignore[misc]  # distributed ships no types
    """A worker without an HTTP server."""

    def start_http_server(self, *_arguments: Any, **_options: Any) -> None:
        """Open no port."""


class Nanny(distributed.Nanny):  # type: ignore[misc]  # distributed ships no types
    """A nanny of such workers, without an HTTP server itself."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, worker_class=Worker, **options)


log = logging.getLogger(__name__)

CONNECT_S = 5
CLOSE_S = 5
FETCH_S = 2
CHATTY = ("distributed", "distributed.client")  # the dispatcher writes what they report to the run's log
DIED = "its worker process died while computing it (killed, or out of memory)"
LENT_S = 5.0  # for so long after pieces were on a worker, its death may be their fault
NEVER = "3650 days"


class LostTaskError(Exception):
    """A task was lost without an outcome; the message is a clause that says why."""


class Cluster:
    """An open connection to a scheduler, with the workers when they are ours."""

    def __init__(self, client: Any, local: Any | None) -> None:
        self._client = client
        self._local = local
        self._lent_until_s: dict[str, float] = {}
        client.subscribe_topic(LENT_TOPIC, lambda event: self._note_loan(event[1]))
        client.subscribe_topic(UNFIT_TOPIC, lambda event: log.error(event[1]["fault"]))

    @classmethod
    def open(cls, settings: Settings, on_progress: Callable[[Report], None], cameras: Sequence[str] = ()) -> Cluster:
        """Start our own workers, or connect to the scheduler of the settings; they are warmed for these cameras."""
        for name in CHATTY:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with dask.config.set(CONFIGURATION):
            local = None if settings.scheduler else _local_cluster(settings)
            try:
                client = SchedulerClient(
                    settings.scheduler or local,
                    timeout=CONNECT_S,
                    security=make_security(settings) if settings.scheduler else None,
                    set_as_default=False,
                    heartbeat_interval="2s",
                )
            except Exception:
                _close(local)  # or the next attempt's workers come beside these
                raise
        opened = cls(client, local)
        try:
            client.subscribe_topic(TOPIC, lambda event: on_progress(Report(**event[1]["report"])))
            if settings.scheduler:
                client.register_plugin(WorkerCheck(boresight.__version__, _shared_folder(settings)))
            warm_up = WarmUp(
                str(settings.catalogue_folder), ours=local is not None, cameras=cameras, log_format=settings.log_format
            )
            client.register_plugin(warm_up)
        except Exception:
            opened.close(())
            raise
        return opened

    @property
    def connected(self) -> bool:
        """Whether the scheduler is connected."""
        return bool(self._client.status == "running")

    def workers(self) -> dict[str, int]:
        """Return the addresses of the connected workers, with their numbers of threads."""
        return dict(self._client.nthreads())

    def submit(self, worker: str, group: list[Work], calculation: str, done: Callable[[], None]) -> Any:
        """Give a group of runs to one worker; `done` is called from another thread when the task ended."""
        run_id, attempt, _ = group[0]
        key = f"run-{run_id}-{attempt}"
        future = self._client.submit(execute_group, group, calculation, key=key, pure=False, workers=[worker])
        future.add_done_callback(lambda _: done())
        return future

    def fetch_ends(self, future: Any, worker: str) -> list[RunEnd] | LostTaskError | None:
        """Return the ends of a task's attempts or that it was lost; None when it has not ended or must be computed again."""
        if not future.done():
            return None
        try:
            ends: list[RunEnd] = future.result(timeout=FETCH_S)
        except (TimeoutError, CancelledError):  # its worker died after the task ended and before its result was fetched
            return None
        except KilledWorker:
            lent = time.monotonic() < self._lent_until_s.get(worker, 0.0)
            return None if lent else LostTaskError(DIED)
        except Exception as error:  # noqa: BLE001 - whatever kept the worker from even beginning
            return LostTaskError(f"its worker could not start it, {type(error).__name__}: {error}")
        return ends

    def _note_loan(self, event: dict[str, Any]) -> None:
        """Record that a worker has, or just had, pieces of another run."""
        now_s = time.monotonic()
        self._lent_until_s = {name: until_s for name, until_s in self._lent_until_s.items() if until_s > now_s}
        self._lent_until_s[event["worker"]] = now_s + event["for_s"] + LENT_S

    def ask_to_stop(self, held: HeldRun) -> None:
        """Ask an attempt to stop; it checks twice a second."""
        Event(cancel_event(*held), client=self._client).set()

    def forget_stop(self, held: HeldRun) -> None:
        """Withdraw the request to stop once the attempt has ended."""
        Event(cancel_event(*held), client=self._client).clear()

    def kill(self, future: Any, worker: str) -> None:
        """Kill the worker process of a task that does not answer; a new one takes its place."""
        future.cancel()
        threading.Thread(target=self._restart, args=(worker,), daemon=True, name="boresight-kill").start()

    def _restart(self, worker: str) -> None:
        """Restart a worker process in a thread, because that takes seconds."""
        try:
            self._client.restart_workers([worker], raise_for_error=False)
        except Exception:
            log.exception("Worker %s could not be restarted", worker)

    def close(self, unfinished: Collection[HeldRun]) -> None:
        """Ask running tasks to stop, disconnect, and end our own workers."""
        with suppress(Exception):  # a lost connection cannot be closed in order
            for held in unfinished if self.connected and self._local is None else ():
                self.ask_to_stop(held)
        _close(self._client)
        _close(self._local)


def _close(part: Any | None) -> None:
    """Close a client or workers if present, ignoring errors."""
    if part is not None:
        with suppress(Exception):
            part.close(timeout=CLOSE_S)


def _shared_folder(settings: Settings) -> str:
    """Return the folder that every worker must see, created at the first start; empty for an object store."""
    place = settings.blob_location
    if not place.is_folder:
        return ""
    Path(place.address).mkdir(parents=True, exist_ok=True)
    return place.address


def _local_cluster(settings: Settings) -> Any:
    """Start a scheduler in this process and worker processes of one thread."""
    # The cluster looks once more for a lost worker after this time, and ends its nanny, and so the next run on it, if it
    # finds that worker just then restarting for another reason. Our nannies restart their workers themselves.
    dask.config.set({"distributed.deploy.lost-worker-timeout": NEVER})
    link = {"host": "127.0.0.1", "protocol": PROTOCOL, "security": own_security()}
    nanny = {
        **link,
        "nthreads": 1,
        "silence_logs": logging.CRITICAL,
        "memory_limit": int(MEMORY_SHARE * MEMORY_LIMIT / settings.workers),
        "local_directory": str(settings.data_folder / "scratch"),
        "env": {"NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(settings.kernel_folder))},
    }
    return SpecCluster(
        scheduler={"cls": Scheduler, "options": {**link, "dashboard": False, "allowed_failures": 0}},
        workers={number: {"cls": Nanny, "options": nanny} for number in range(settings.workers)},
        security=link["security"],
        silence_logs=logging.CRITICAL,
    )
