"""The fastest of several repeats: what the work costs when nothing else is in its way."""

from __future__ import annotations

import time
from collections.abc import Callable


def fastest(run: Callable[[], object], repeats: int = 5) -> float:
    """Seconds of the fastest of several repeats."""
    return fastest_of_each(run, repeats=repeats)[0]


def fastest_of_each(*runs: Callable[[], object], repeats: int = 5) -> list[float]:
    """Seconds of the fastest repeat of each of several works, taken in turn so that a drift of the machine meets them all."""
    return [min(times) for times in zip(*([_seconds(run) for run in runs] for _ in range(repeats)), strict=True)]


def _seconds(run: Callable[[], object]) -> float:
    """Seconds that a work takes."""
    began = time.perf_counter()
    run()
    return time.perf_counter() - began
