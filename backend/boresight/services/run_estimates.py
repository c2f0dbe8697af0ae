"""How much work a run is, before it begins: arcs, seconds.

An exposure of N stars gives 2N-3 arcs, so S stars in X exposures give 2S - 3X. The time is that of the newest runs of
the same method, scaled by the number of stars: every estimator here is linear in it. Where no run has been made yet, a
careful guess is used. A replayed run lasts as long as its frames take to come down.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from typing import Any

from boresight.store.run_lists import recent_summaries
from boresight.store.sessions import Session

FIRST_GUESS_S_PER_STAR = 5e-5
START_S = 0.02


def seconds_per_star(session: Session, method: str) -> float:
    """Return the pace of the newest runs of a method; a careful guess before there is one."""
    paces = [
        summary["seconds"] / summary["stars"]
        for summary in recent_summaries(session, method)
        if summary.get("seconds") and summary.get("stars")
    ]
    return median(paces) if paces else FIRST_GUESS_S_PER_STAR


def predicted_s(settings: Mapping[str, Any], frames: int, stars: int, pace_s_per_star: float) -> float:
    """Return how long a run will take, seconds."""
    replay = float(settings.get("replay_frames_per_s") or 0.0)
    return START_S + stars * pace_s_per_star + (frames / replay if replay > 0 else 0.0)


def pairs_of(stars: int, exposures: int) -> int:
    """Return the number of arcs of `stars` spread over `exposures`."""
    return max(0, 2 * stars - 3 * exposures)
