"""Trials of a study in processes of their own: how many, and which ends first, changes no result."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
#: Told what a study does, and the share of it that is done.
Report = Callable[[str, float], None]


def run_all(
    run: Callable[[T, Path | None], R],
    trials: Sequence[T],
    catalogue_folder: Path | None,
    processes: int,
    report: Callable[[T, float], None] | None = None,
) -> list[R]:
    """Run trials; returns their results in order. `report` is called with each that ends and the share that has ended."""
    found: dict[T, R] = {}
    for trial, result in _ended(run, trials, catalogue_folder, processes):
        found[trial] = result
        if report is not None:
            report(trial, len(found) / len(trials))
    return [found[trial] for trial in trials]


def _ended(
    run: Callable[[T, Path | None], R], trials: Sequence[T], catalogue_folder: Path | None, processes: int
) -> Iterator[tuple[T, R]]:
    """Yield trials with their results as they end."""
    if processes == 1 or len(trials) < 2:
        for trial in trials:
            yield trial, run(trial, catalogue_folder)
        return
    # a forked child would inherit the locks of our threads
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(trials)), mp_context=context) as pool:
        waiting = {pool.submit(run, trial, catalogue_folder): trial for trial in trials}
        for done in as_completed(waiting):
            yield waiting[done], done.result()


#: What tells linear algebra libraries how many threads to start; they read it when they are loaded.
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def run_on_one_thread(run: Callable[[Path | None], R], catalogue_folder: Path | None) -> R:
    """Run what reads the clock in a process whose linear algebra keeps to one thread.

    Threads that wait for a core that something else keeps busy make a product of matrices last tens of times longer, and the
    larger the matrix the more, so that ratios would tell of the machine's load.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ |= dict.fromkeys(THREADS, "1")
    try:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            return pool.submit(run, catalogue_folder).result()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
