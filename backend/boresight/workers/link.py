"""The thread between a computing run and the server: progress goes up, the wish to stop comes down.

Progress is an event on a topic of the scheduler, at most four a second, its histories thinned; the wish to stop is a
`distributed.Event` named after run and attempt, looked at twice a second at most, because a look is a round trip. A
run that is over within a second tells nothing on its way: nobody could see it.
"""

from __future__ import annotations

import time
from typing import Any

import orjson
from distributed import Event, get_worker

from boresight.calibration.calibrate import Progress
from boresight.errors import CancelledError
from boresight.workers.reports import Report

TOPIC = "boresight-progress"
REPORT_EVERY_S = 0.25
FIRST_REPORT_S = 1.0
LOOK_EVERY_S = 0.5
HISTORY_POINTS = 300


def cancel_event(run_id: int, attempt: int) -> str:
    """Name the event that asks an attempt to stop."""
    return f"boresight-cancel-{run_id}-{attempt}"


class Link:
    """One attempt's link; made where the attempt computes."""

    def __init__(self, run_id: int, attempt: int) -> None:
        self.run_id = run_id
        self.attempt = attempt
        self._stop = Event(cancel_event(run_id, attempt))
        self._begun_s = self._looked_s = time.monotonic()
        self._reported_s = self._begun_s + FIRST_REPORT_S - REPORT_EVERY_S
        self._stopped = False

    def report(self, progress: Progress) -> None:
        """Send a report on, unless the last one is younger than a quarter of a second."""
        now_s = time.monotonic()
        if now_s - self._reported_s < REPORT_EVERY_S:
            return
        self._reported_s = now_s
        partial = None if progress.partial is None else encoded(progress.partial)
        elapsed_s = round(now_s - self._begun_s, 3)
        report = Report(self.run_id, self.attempt, float(progress.fraction), progress.message, elapsed_s, partial)
        get_worker().log_event(TOPIC, {"report": vars(report)})  # the worker adds its own address beside it

    def cancelled(self) -> bool:
        """Say whether this attempt was asked to stop."""
        now_s = time.monotonic()
        if not self._stopped and now_s - self._looked_s >= LOOK_EVERY_S:
            self._looked_s = now_s
            self._stopped = bool(self._stop.is_set())
        return self._stopped

    def refuse_if_cancelled(self) -> None:
        """Look now, before the work begins: a run that waited in its group may have been cancelled meanwhile."""
        if self._stop.is_set():
            raise CancelledError("Stopped on request before it began.")


def encoded(partial: dict[str, Any]) -> bytes:
    """Write a calibration so far as JSON, its history thinned to what a chart can show."""
    history = partial.get("history")
    thin = {**partial, "history": thinned(history)} if isinstance(history, dict) else partial
    return orjson.dumps(thin, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)


def thinned(history: dict[str, Any], points: int = HISTORY_POINTS) -> dict[str, Any]:
    """Keep at most `points` of every column of a history, evenly spread, the last always among them."""
    length = len(history.get("frame") or ())
    if length <= points:
        return history
    kept = [round(i * (length - 1) / (points - 1)) for i in range(points)]
    return {
        name: [column[k] for k in kept] if column is not None and len(column) == length else column
        for name, column in history.items()
    }
