"""Whether the machine's clock jumped: then no request expires before a person has seen it.

The wall clock is held against one that nobody can set. Where the two drift apart by more than `JUMP_S` since they were last
found to agree, the wall clock was set. Across a restart nothing runs on, so a server that finds itself more than `AWAY_S` after
it was last seen to run asks too: it was away for long, or the clock is wrong. Both raise an alarm of kind CLOCK, and
acknowledging it is to say that the clock is right now.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime

from boresight.services.conditions import Condition
from boresight.store import alarms as rows
from boresight.store.sessions import Session, utc_text

CLOCK = "clock/CLOCK"
JUMP_S = 60.0
AWAY_S = 86_400.0


def _steady_s() -> float:
    """Return seconds that nobody can set, and that go on while the machine sleeps where the system has such."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class Clock:
    """The wall clock beside one that nobody can set."""

    def __init__(self, wall_s: Callable[[], float] = time.time, steady_s: Callable[[], float] = _steady_s) -> None:
        self._wall_s = wall_s
        self._steady_s = steady_s
        self._agreed_s = wall_s() - steady_s()

    def now_s(self) -> float:
        """Return the wall clock's seconds."""
        return self._wall_s()

    def moved_s(self) -> float:
        """Return by how much the wall clock was set since it was last found right."""
        return self._wall_s() - self._steady_s() - self._agreed_s

    def has_jumped(self) -> bool:
        """Whether it was set by more than clocks are corrected by."""
        return abs(self.moved_s()) > JUMP_S

    def agree(self) -> None:
        """Take the wall clock for right."""
        self._agreed_s = self._wall_s() - self._steady_s()


OURS = Clock()


def is_held(session: Session) -> bool:
    """Whether nothing may expire: the clock jumped, and nobody has acknowledged it."""
    row = rows.open_alarms(session).get(CLOCK)
    return OURS.has_jumped() or (row is not None and bool(row.active) and not row.acknowledged)


def is_acknowledged(session: Session) -> bool:
    """Whether somebody has seen the jump whose alarm is up."""
    row = rows.open_alarms(session).get(CLOCK)
    return row is not None and bool(row.active) and bool(row.acknowledged)


def condition_now(seen_s: float | None) -> Condition | None:
    """Return that the clock jumped, or that this server was last seen long ago; None where neither is so."""
    now = _text(OURS.now_s())
    if OURS.has_jumped():
        moved_s = OURS.moved_s()
        way = "forward" if moved_s > 0 else "back"
        sentence = f"The clock was set {way} by {abs(moved_s):.0f} s, and says {now}: no request expires until you acknowledge it."
        return Condition(CLOCK, None, "CLOCK", "serious", sentence, {"moved_s": round(moved_s), "now_utc": now})
    if seen_s is not None and abs(OURS.now_s() - seen_s) > AWAY_S:
        seen = _text(seen_s)
        sentence = (
            f"The clock says {now}, and a server ran last at {seen}: no request expires until you acknowledge it."
        )
        return Condition(CLOCK, None, "CLOCK", "serious", sentence, {"seen_utc": seen, "now_utc": now})
    return None


def _text(seconds: float) -> str:
    return utc_text(datetime.fromtimestamp(seconds, UTC))
