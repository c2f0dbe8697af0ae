"""How much work a run is, before it begins: arcs, seconds.

An exposure of N stars gives 2N-3 arcs, so S stars in X exposures give 2S - 3X. The time is that of the newest runs of
the same method, scaled by the number of stars: every estimator here is linear in it. Where no run has been made yet, a
careful guess is used, and its spread is as wide as machines differ. A replayed run lasts as long as its frames take to come
down; what it computes meanwhile is not seen, so its pace is used only where no other run has been made, less that wait.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median, quantiles
from typing import Any

from boresight.store.run_lists import recent_runs
from boresight.store.sessions import Session

FIRST_GUESS_S_PER_STAR = 5e-5
#: How many times slower or faster than the guess a machine and a method may be.
GUESS_SPREAD = 4.0
START_S = 0.02
#: The newest runs of a method that its pace is taken from.
RUNS_TIMED = 20


@dataclass(frozen=True)
class Pace:
    """How fast runs of a method are.

    Parameters
    ----------
    s_per_star
        Median, seconds a star.
    low, high
        Between which four of five of them lie.
    runs
        How many were looked at; 0 is a guess.
    """

    s_per_star: float
    low: float
    high: float
    runs: int


@dataclass(frozen=True)
class Timed:
    """What a finished run was and how long its computing took, without its wait for frames."""

    stars: int
    seconds: float


def timed_runs(session: Session, method: str) -> list[Timed]:
    """Return what the newest runs of a method took, newest first: of those that waited for no frames where there are any."""
    timed = [run for run in recent_runs(session, method, RUNS_TIMED) if run[1].get("seconds") and run[1].get("stars")]
    unthrottled = [run for run in timed if not _downlink_s(run[0], frames=1)]
    return [Timed(summary["stars"], _computed_s(settings, summary)) for settings, summary in unthrottled or timed]


def pace_of(session: Session, method: str) -> Pace:
    """Return the pace of the newest runs of a method; a careful guess before there is one."""
    paces = [run.seconds / run.stars for run in timed_runs(session, method)]
    if not paces:
        guess = FIRST_GUESS_S_PER_STAR
        return Pace(guess, guess / GUESS_SPREAD, guess * GUESS_SPREAD, 0)
    if len(paces) == 1:
        return Pace(paces[0], paces[0] / 2, paces[0] * 2, 1)
    tenths = quantiles(paces, n=10, method="inclusive")
    return Pace(median(paces), tenths[0], tenths[-1], len(paces))


def seconds_per_star(session: Session, method: str) -> float:
    """Return the median pace of the newest runs of a method."""
    return pace_of(session, method).s_per_star


def predicted_s(settings: Mapping[str, Any], frames: int, stars: int, pace_s_per_star: float) -> float:
    """Return how long a run will take, seconds."""
    return START_S + stars * pace_s_per_star + _downlink_s(settings, frames)


def _downlink_s(settings: Mapping[str, Any], frames: int) -> float:
    """Return how long a replay waits for its frames, seconds; 0 where nothing is replayed."""
    replay = float(settings.get("replay_frames_per_s") or 0.0)
    return frames / replay if replay > 0 else 0.0


def _computed_s(settings: Mapping[str, Any], summary: Mapping[str, Any]) -> float:
    """Return the seconds of a past run without its wait for frames, at least `START_S` where it waited."""
    waited = _downlink_s(settings, summary.get("frames") or 0)
    return max(float(summary["seconds"]) - waited, START_S) if waited else float(summary["seconds"])


def pairs_of(stars: int, exposures: int) -> int:
    """Return the number of arcs of `stars` spread over `exposures`."""
    return max(0, 2 * stars - 3 * exposures)
