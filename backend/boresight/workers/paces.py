"""How long waiting runs will take: as long as the newest runs of their method and size took.

Time is not in proportion to the number of stars: judging a small run takes longer than fitting it. So runs of about the same
size are asked first, and all of the method only where there are none. What the newest runs took is read anew every few seconds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from statistics import median

from boresight.services.run_estimates import Timed, predicted_s, seconds_per_star, timed_runs
from boresight.store.queued_runs import Waiting
from boresight.store.sessions import Session

FRESH_S = 3.0
ALIKE = 1.5  # times as many stars at most, or as few


@dataclass
class _Pace:
    """What is known of a method."""

    timed: list[Timed]
    s_per_star: float
    read_s: float


@dataclass
class Paces:
    """What the newest runs of each method took."""

    _known: dict[str, _Pace] = field(default_factory=dict)

    def refresh(self, session: Session, methods: set[str]) -> None:
        """Read what the newest runs of these methods took, where that was not done just now."""
        now_s = time.monotonic()
        for method in methods:
            if method not in self._known or now_s - self._known[method].read_s > FRESH_S:
                timed, pace = timed_runs(session, method), seconds_per_star(session, method)
                self._known[method] = _Pace(timed, pace, now_s)

    def seconds(self, run: Waiting) -> float:
        """Predict the time of a waiting run, seconds."""
        pace = self._known[run.method]
        alike = [one.seconds / one.stars for one in pace.timed if 1 / ALIKE <= run.stars / one.stars <= ALIKE]
        foreseen_s = predicted_s(run.settings, run.frames, run.stars, pace.s_per_star)
        waits = run.settings.get("replay_frames_per_s")
        return foreseen_s if waits or not alike else run.stars * median(alike)
