"""Dispatched tasks: which worker computes which attempts, which threads are free, and whether a worker is compatible."""

from __future__ import annotations

import logging
import socket
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from distributed.diagnostics.plugin import WorkerPlugin

import boresight
from boresight.console.runs.queries import HeldRun


@dataclass(eq=False)
class DispatchedTask:
    """A task on one worker and the attempts it computes."""

    future: Any
    worker: str
    members: set[HeldRun]
    short: bool = False  # a group of short runs, none of them tried before
    expected_s: float = 0.0
    behind: bool = False  # waits for the task before it on its thread
    since_s: float = field(default_factory=time.monotonic)  # when it was given to the worker, or began on its thread
    asked_s: dict[HeldRun, float] = field(default_factory=dict)  # when each was asked to stop
    killed_s: float | None = None  # when its worker was ended by force
    gone_s: float | None = None  # when its worker was first missed

    def unanswered_s(self, held: HeldRun) -> float:
        """Return the seconds since an attempt that computes was asked to stop without answering."""
        return time.monotonic() - max(self.asked_s[held], self.since_s) - (self.expected_s if self.short else 0.0)


class DispatchedTasks:
    """All tasks that were given to workers, oldest first."""

    def __init__(self) -> None:
        self._all: list[DispatchedTask] = []

    def __len__(self) -> int:
        """Count the tasks."""
        return len(self._all)

    def __iter__(self) -> Iterator[DispatchedTask]:
        """Go through the tasks as they are now, oldest first; any may be removed meanwhile."""
        return iter(list(self._all))

    def add(self, task: DispatchedTask) -> None:
        """Note a task that a worker was given."""
        self._all.append(task)

    def remove(self, task: DispatchedTask) -> None:
        """Forget a task that has ended."""
        self._all.remove(task)

    def clear(self) -> None:
        """Forget all."""
        self._all.clear()

    def held(self) -> set[HeldRun]:
        """Return all attempts on the cluster for this server."""
        return {held for task in self._all for held in task.members}

    def find_task(self, held: HeldRun) -> DispatchedTask:
        """Return the task of an attempt."""
        return next(task for task in self._all if held in task.members)

    def any_done(self) -> bool:
        """Whether any task has ended, well or not."""
        return any(task.future.done() for task in self._all)

    def advance(self, threads: Mapping[str, int]) -> None:
        """Assign waiting tasks to threads that have become free; `threads` are those of the connected workers."""
        free = Counter(threads)
        free.subtract(task.worker for task in self._all if not task.behind)
        for task in self._all:
            if task.behind and free[task.worker] > 0:
                task.behind, task.since_s = False, time.monotonic()
                free[task.worker] -= 1

    def free(self, threads: Mapping[str, int]) -> list[str]:
        """Return the address of a worker for each of its threads that has no task."""
        busy = Counter(task.worker for task in self._all)
        return [worker for worker, count in threads.items() for _ in range(count - busy[worker])]

    def followed(self, threads: Mapping[str, int]) -> list[str]:
        """Return the address of a worker for each of its threads that computes short runs with nothing behind them."""
        short = Counter(task.worker for task in self._all if task.short and not task.behind)
        short.subtract(task.worker for task in self._all if task.behind)
        return [worker for worker in threads for _ in range(short[worker])]

    def overdue(self, patience_s: float) -> list[DispatchedTask]:
        """Return the tasks that have waited longer than the tasks before them should have taken."""
        now_s = time.monotonic()
        return [task for task in self._all if task.behind and now_s - task.since_s > patience_s]


log = logging.getLogger(__name__)

UNFIT_TOPIC = "boresight-unfit"
LEAVE_AFTER_S = 0.5  # its sentence goes first


class WorkerCheck(WorkerPlugin):  # type: ignore[misc]  # distributed ships no types
    """A plugin that checks on every worker whether it may compute for this server."""

    name = "boresight-worker-check"

    def __init__(self, version: str, folder: str) -> None:
        self.version = version
        self.folder = folder

    def setup(self, worker: Any) -> None:
        """Check a worker; an incompatible one logs why and closes."""
        fault = find_worker_fault(self.version, self.folder, boresight.__version__)
        if fault is None:
            return
        log.error(fault)
        worker.log_event(UNFIT_TOPIC, {"fault": fault})
        worker.loop.call_later(LEAVE_AFTER_S, worker.close, reason="boresight-unfit")


def find_worker_fault(server_version: str, folder: str, worker_version: str) -> str | None:
    """Return why a worker may not compute for a server; None when it may."""
    here = socket.gethostname()
    if worker_version != server_version:
        return (
            f"The worker on {here} runs Boresight {worker_version}, but the server runs {server_version}: "
            "install the same version on both; until then this worker gets no runs."
        )
    if folder and not Path(folder).is_dir():
        return (
            f"The worker on {here} does not see the server's folder {folder}: mount it there under the same path; "
            "until then this worker gets no runs."
        )
    return None
