"""Trials of a study in processes of their own: how many, and which ends first, changes no result."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def run_all(
    run: Callable[[T, Path | None], R], trials: Sequence[T], catalogue_folder: Path | None, processes: int
) -> Iterator[tuple[T, R]]:
    """Yield trials with their results as they end.

    Parameters
    ----------
    run
        Of one trial, a module's own function so that another process finds it.
    trials
        What to run.
    catalogue_folder
        Where the trimmed star catalogue is cached, or None.
    processes
        Trials at a time; 1 runs them in this process.
    """
    if processes == 1:
        for trial in trials:
            yield trial, run(trial, catalogue_folder)
        return
    # a forked child would inherit the locks of our threads
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(trials)), mp_context=context) as pool:
        waiting = {pool.submit(run, trial, catalogue_folder): trial for trial in trials}
        for done in as_completed(waiting):
            yield waiting[done], done.result()
