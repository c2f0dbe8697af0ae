"""Progress on its way from the workers to the rows and the listeners: only the newest report of an attempt counts."""

from __future__ import annotations

import threading
import time
from collections.abc import Set as AbstractSet
from typing import Any

from boresight.store.runs import Held

RECORD_EVERY_S = 0.5


class Reports:
    """A letter box that the cluster's thread fills and the engine's thread empties."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[Held, dict[str, Any]] = {}
        self._recorded_s: dict[Held, float] = {}

    def hear(self, report: dict[str, Any]) -> None:
        """Take a report; it replaces the one before of the same attempt."""
        with self._lock:
            self._newest[report["run_id"], report["attempt"]] = report

    def take(self, ours: AbstractSet[Held]) -> dict[Held, dict[str, Any]]:
        """Return what came since the last time, of our attempts only."""
        with self._lock:
            reports, self._newest = self._newest, {}
        return {held: report for held, report in reports.items() if held in ours}

    def due(self, reports: dict[Held, dict[str, Any]]) -> dict[Held, dict[str, Any]]:
        """Return those whose rows were not written in the last half second; they are taken as written now."""
        now_s = time.monotonic()
        self._recorded_s = {held: at_s for held, at_s in self._recorded_s.items() if now_s - at_s < RECORD_EVERY_S}
        due = {held: report for held, report in reports.items() if held not in self._recorded_s}
        self._recorded_s |= dict.fromkeys(due, now_s)
        return due
