"""Progress reports of a calibration, with the partial result, at a limited rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.calibration import result
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import Problem

#: Seconds between two progress reports with a partial result.
REPORT_EVERY_S = 0.25
#: Most of the time that may go into reports, for on a long set each costs many passes over it.
REPORT_SHARE = 0.2


@dataclass(frozen=True)
class Progress:
    """How far a calibration is."""

    fraction: float
    message: str
    partial: dict[str, Any] | None


class ProgressReporter:
    """Turns estimates on their way into progress reports with a partial result, as often as is worth it."""

    def __init__(
        self,
        problem: Problem,
        parameters: Parameters,
        settings: CalibrationSettings,
        sha256s: Mapping[str, str],
        report: Callable[[Progress], None] | None,
        begins: float = 0.0,
    ) -> None:
        self._of = (problem, parameters, settings)
        self._sha256s = sha256s
        self._report = report
        self._begins = begins  # share of the progress that is made before the estimator begins
        self._due = time.perf_counter() + REPORT_EVERY_S  # what is over sooner is not waited for

    def __call__(self, estimate: Estimate, fraction: float, message: str) -> None:
        """Report one estimate when it is time to."""
        began = time.perf_counter()
        if self._report is None or began < self._due:
            return
        partial = result.document(*self._of, estimate, self._sha256s) | {"frames_done": self._frames_done(estimate)}
        self._report(Progress(self._begins + (1 - self._begins) * fraction, message, partial))
        ended = time.perf_counter()
        self._due = ended + max(REPORT_EVERY_S, (ended - began) / REPORT_SHARE)

    def _frames_done(self, estimate: Estimate) -> int | None:
        """Count the frames of the set up to the last that a filter took in; its first update may be of several."""
        if not estimate.history:
            return None
        last = estimate.history.taken(np.array([len(estimate.history) - 1]))["frame"]
        return int(self._of[0].find_place(last + 1)[0])
