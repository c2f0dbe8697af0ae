"""The dask cluster as the engine uses it: submit, ask to stop, kill, notice its loss.

By default a scheduler in this process with worker processes of one thread each, which end when this process does,
however it ends; or an external scheduler by address. An external one should be started with
`DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=0`, as ours is: the engine counts the workers that a run has cost.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import dask
from distributed import Client, Event, Future, LocalCluster
from distributed.system import MEMORY_LIMIT

from boresight.settings import Settings
from boresight.store.runs import Held
from boresight.workers.link import TOPIC, cancel_event
from boresight.workers.tasks import Inputs, execute_group
from boresight.workers.warm import WarmUp

log = logging.getLogger(__name__)

CONNECT_S = 5
CLOSE_S = 5
CHATTY = ("distributed", "distributed.client")  # what they tell, the engine writes to the run it concerns
MEMORY_SHARE = 0.8  # of the machine, over all worker processes; the rest is the server's and the system's
CONFIGURATION = {
    "distributed.admin.low-level-log-length": 100,  # progress events the scheduler keeps; each may hold a history
    "distributed.diagnostics.nvml": False,
}


class Cluster:
    """An open connection to a scheduler, with the workers when they are ours."""

    def __init__(self, client: Any, local: Any | None) -> None:
        self._client = client
        self._local = local

    @classmethod
    def open(cls, settings: Settings, on_progress: Callable[[dict[str, Any]], None]) -> Cluster:
        """Start our own workers, or connect to the scheduler of the settings.

        Raises
        ------
        OSError
            When the scheduler cannot be reached.
        """
        for name in CHATTY:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with dask.config.set(CONFIGURATION):
            local = None if settings.scheduler else _local_cluster(settings)
            client = Client(
                settings.scheduler or local,
                timeout=CONNECT_S,
                set_as_default=False,
                heartbeat_interval="2s",
            )
        client.subscribe_topic(TOPIC, lambda event: on_progress(event[1]))
        client.register_plugin(WarmUp(str(settings.catalogue_folder), ours=local is not None))
        return cls(client, local)

    @property
    def connected(self) -> bool:
        """Whether the scheduler is still there."""
        return bool(self._client.status == "running")

    def threads(self) -> int:
        """Count the threads that can compute now."""
        return sum(self._client.nthreads().values())

    def submit(self, group: list[tuple[int, int, Inputs]], calculation: str, done: Callable[[], None]) -> Any:
        """Hand over a group of runs; `done` is called from another thread when the task ended."""
        key = "run-" + "-".join(str(number) for number in group[0][:2])
        future = self._client.submit(execute_group, group, calculation, key=key, pure=False)
        future.add_done_callback(lambda _: done())
        return future

    def ask_to_stop(self, held: Held) -> None:
        """Ask an attempt to stop; it looks five times a second."""
        Event(cancel_event(*held), client=self._client).set()

    def forget_stop(self, held: Held) -> None:
        """Drop the wish once the attempt has ended."""
        Event(cancel_event(*held), client=self._client).clear()

    def kill(self, future: Any) -> None:
        """End a task that does not answer, by ending its worker process; a new one takes its place."""
        workers = [address for address, keys in self._client.processing().items() if future.key in keys]
        future.cancel()
        threading.Thread(target=self._restart, args=(workers,), daemon=True, name="kill").start()

    def _restart(self, workers: list[str]) -> None:
        """Restart worker processes; takes seconds, so beside the loop."""
        try:
            self._client.restart_workers(workers, raise_for_error=False)
        except Exception:
            log.exception("Workers %s could not be restarted", workers)

    def close(self) -> None:
        """Let go of the scheduler, and end the workers that are ours."""
        for part in (self._client, self._local):
            if part is not None:
                with suppress(Exception):  # what is lost already cannot be closed in order
                    part.close(timeout=CLOSE_S)


def outcome_of(future: Any) -> Any:
    """Return a finished task's value, or the exception that ended it."""
    try:
        return future.result(timeout=30)
    except Exception as error:  # noqa: BLE001 - the exception is the answer
        return error


def is_finished(future: Any) -> bool:
    """Say whether a task ended in any way."""
    return isinstance(future, Future) and bool(future.done())


def _local_cluster(settings: Settings) -> Any:
    """Start a scheduler in this process and worker processes of one thread."""
    folder = os.environ.get("NUMBA_CACHE_DIR", str(settings.kernel_folder))
    return LocalCluster(
        n_workers=settings.workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
        memory_limit=int(MEMORY_SHARE * MEMORY_LIMIT / settings.workers),
        scheduler_kwargs={"allowed_failures": 0},
        local_directory=str(settings.data_folder / "scratch"),
        env={"NUMBA_CACHE_DIR": folder},
    )
