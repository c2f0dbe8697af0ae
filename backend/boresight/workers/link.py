"""The link between a computing run and the server: progress is sent up, and cancellation is received."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import orjson
from distributed import Event, get_worker

from boresight.calibration.calibrate import Progress
from boresight.calibration.calibration import Calibration, History, parse_calibration
from boresight.console.runs.queries import HeldRun, Line
from boresight.errors import CancelledError
from boresight.platform.jobs.worker_news import RunProgress

RECORD_EVERY_S = 0.5
LINE_EVERY_S = 2.0
LINES = 20
POINTS_AN_EVENT = 60
COLUMNS = ("parameters", "sigma", "tail_rms_rad", "aggregate_rms_rad")


@dataclass(frozen=True)
class Report:
    """How far an attempt is; `partial` is the calibration JSON so far as bytes, `elapsed_s` the time since it began."""

    run_id: int
    attempt: int
    fraction: float
    message: str
    elapsed_s: float
    partial: bytes | None = None

    @cached_property
    def calibration(self) -> dict[str, Any] | None:
        """The calibration so far."""
        return None if self.partial is None else orjson.loads(self.partial)

    @cached_property
    def history(self) -> History | None:
        """The history so far, of a filter."""
        return None if self.calibration is None else parse_calibration(self.calibration).history

    def to_event(self, history: dict[str, Any] | None) -> RunProgress:
        """Return the news that is broadcast, with the new points of its history."""
        return RunProgress(self.run_id, self.attempt, self.fraction, self.message, self.elapsed_s, history)

    def progress(self, at_utc: str) -> dict[str, Any]:
        """Return the report as the run's row stores it, with the time when it came."""
        said = {"fraction": self.fraction, "message": self.message, "elapsed_s": self.elapsed_s}
        return said | {"at_utc": at_utc, "partial": self.calibration}

    def line(self) -> Line:
        """Return its line for the log."""
        numbers = {"fraction": self.fraction, "elapsed_s": self.elapsed_s}
        return Line.log(f"{100 * self.fraction:.0f} %: {self.message}", numbers)


class ProgressInbox:
    """An inbox that the cluster's thread fills and the dispatcher's thread empties."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[HeldRun, Report] = {}
        self._recorded_s: dict[HeldRun, float] = {}
        self._told_frame: dict[HeldRun, int] = {}
        self._lines: dict[HeldRun, tuple[int, float]] = {}

    def hear(self, report: Report) -> None:
        """Store a report, which replaces the attempt's last one."""
        with self._lock:
            self._newest[report.run_id, report.attempt] = report

    def take(self, ours: AbstractSet[HeldRun]) -> dict[HeldRun, Report]:
        """Return the reports since the last call, of our attempts only."""
        with self._lock:
            reports, self._newest = self._newest, {}
        self._told_frame = {held: frame for held, frame in self._told_frame.items() if held in ours}
        self._lines = {held: line for held, line in self._lines.items() if held in ours}
        return {held: report for held, report in reports.items() if held in ours}

    def news(self, held: HeldRun, report: Report) -> RunProgress:
        """Return the news of a report with the new points of its history, and mark these as sent."""
        points = points_after(report.history, self._told_frame.get(held))
        if points is not None:
            self._told_frame[held] = points["frame"][-1]
        return report.to_event(points)

    def due(self, reports: dict[HeldRun, Report]) -> dict[HeldRun, Report]:
        """Return the reports of attempts whose rows were not written in the last half second, and mark them as written."""
        now_s = time.monotonic()
        self._recorded_s = {held: at_s for held, at_s in self._recorded_s.items() if now_s - at_s < RECORD_EVERY_S}
        due = {held: report for held, report in reports.items() if held not in self._recorded_s}
        self._recorded_s |= dict.fromkeys(due, now_s)
        return due

    def lines(self, reports: Mapping[HeldRun, Report]) -> dict[HeldRun, Line]:
        """Return a log line for each attempt that completed another twentieth, at most one in two seconds."""
        now_s = time.monotonic()
        lines = {}
        for held, report in reports.items():
            part = int(LINES * report.fraction)
            last, at_s = self._lines.get(held, (-1, -LINE_EVERY_S))
            if part > last and now_s - at_s >= LINE_EVERY_S:
                self._lines[held] = part, now_s
                lines[held] = report.line()
        return lines


def points_after(history: History | None, after: int | None) -> dict[str, Any] | None:
    """Return the points of a history after a frame, or None where there are none."""
    if history is None:
        return None
    frames = history.frame
    if after is not None and frames and frames[-1] < after:
        after = None
    first = 0 if after is None else bisect_right(frames, after)
    if first >= len(frames):
        return None
    kept = _pick_evenly(first, len(frames) - 1)
    columns = {name: getattr(history, name) for name in COLUMNS} | {"nis_per_dof": _nis_per_dof(history)}
    told = {name: [column[k] for k in kept] for name, column in columns.items() if column is not None}
    return {"after": after, "frame": [frames[k] for k in kept]} | told


def _pick_evenly(first: int, last: int) -> list[int]:
    """Return evenly spread indices, including the first and the last."""
    most = min(last - first + 1, POINTS_AN_EVENT)
    return [last] if most == 1 else [first + round(k * (last - first) / (most - 1)) for k in range(most)]


def _nis_per_dof(history: History) -> list[float | None] | None:
    """Average the normalised innovation squared over the points so far, per degree of freedom."""
    if not history.nis:
        return None
    nis, dof = accumulate(value or 0.0 for value in history.nis), accumulate(history.nis_dof)
    return [total / count if count else None for total, count in zip(nis, dof, strict=False)]


TOPIC = "boresight-progress"
REPORT_EVERY_S = 0.25
FIRST_REPORT_S = 1.0
LOOK_EVERY_S = 0.5
HISTORY_POINTS = 300


def cancel_event(run_id: int, attempt: int) -> str:
    """Name the event that asks an attempt to stop."""
    return f"boresight-cancel-{run_id}-{attempt}"


class Link:
    """The link of one attempt, created where it computes."""

    def __init__(self, run_id: int, attempt: int) -> None:
        self.run_id = run_id
        self.attempt = attempt
        self._stop = Event(cancel_event(run_id, attempt))
        self._worker = get_worker()  # now: reports come from threads that compile, too, which have none of their own
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
        self._worker.log_event(TOPIC, {"report": vars(report)})  # the worker adds its own address beside it

    def cancelled(self) -> bool:
        """Return whether this attempt was asked to stop."""
        now_s = time.monotonic()
        if not self._stopped and now_s - self._looked_s >= LOOK_EVERY_S:
            self._looked_s = now_s
            self._stopped = bool(self._stop.is_set())
        return self._stopped

    def refuse_if_cancelled(self) -> None:
        """Raise if the attempt was cancelled, before its work begins: it may have waited in its group."""
        if self._stop.is_set():
            raise CancelledError("Cancelled before it started.")


def encoded(partial: Calibration) -> bytes:
    """Write a partial calibration as JSON, its history thinned to what a chart can show."""
    thin = partial if partial.history is None else replace(partial, history=thinned(partial.history))
    return orjson.dumps(thin.to_dict(), option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)


def thinned(history: History) -> History:
    """Keep at most `HISTORY_POINTS` of every column of a history, evenly spread, the last always among them."""
    length = len(history.frame)
    if length <= HISTORY_POINTS:
        return history
    kept = [round(i * (length - 1) / (HISTORY_POINTS - 1)) for i in range(HISTORY_POINTS)]
    columns = {name: column for name, column in vars(history).items() if name != "between" and column is not None}
    thin: dict[str, Any] = {
        name: [column[k] for k in kept] for name, column in columns.items() if len(column) == length
    }
    return replace(history, **thin)
