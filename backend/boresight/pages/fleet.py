"""How the fleet stands, for the top bar of every page: as its worst sensor does, that sensor named.

It takes a look at every sensor, so it is remembered while nothing is committed (`store.marks`), and no longer than `HELD_S`, for
baselines age by the clock; who asked before the look began is given it too, whatever was committed since. Of a fleet of more than
`LARGE` sensors it is remembered `REST` times as long as the look took, whatever is committed: so the top bar of thousands of
sensors takes a fixed share of one processor, and most pages wait for none of it. One page looks for all that ask meanwhile.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from boresight.pages.states import LEVELS
from boresight.services import alarms, fleet, lists, sensors
from boresight.store.marks import Mark, Marks
from boresight.store.sessions import Engine, Session, reading

HELD_S = 30.0
LARGE, REST = 200, 5.0

WORD_OF_LEVEL = {level: level.upper() for level in LEVELS} | {"off": "NO DATA"}


@dataclass(frozen=True)
class Standing:
    """A consolidated status: colour and shape, a word, and why."""

    level: str
    word: str
    sentence: str


def worst_standing(standings: Sequence[fleet.Standing]) -> Standing:
    """Return how a fleet stands."""
    if not standings:
        return Standing("off", "NO SENSORS", "No sensors yet: register one.")
    worst = max(standings, key=lambda one: LEVELS.index(one.status))
    alike = sum(one.status == worst.status for one in standings)
    more = f" {alike - 1} more alike." if alike > 1 else ""
    return Standing(worst.status, WORD_OF_LEVEL[worst.status], f"{worst.name}: {worst.sentence}{more}")


def fleet_standing(session: Session) -> tuple[Standing, int, int]:
    """Return how the fleet stands, how many requests wait for a signature, and how many alarms to be acknowledged."""
    waiting = lists.count(session, "approvals", {"state": "OPEN"})
    return worst_standing(fleet.standings(session)), waiting, alarms.unacknowledged(session)


@dataclass(frozen=True)
class Look:
    """What `fleet_standing` found, and whether that was before the newest commit."""

    found: tuple[Standing, int, int]
    is_older: bool = False


class FleetMemory:
    """What the top bar says, read anew only after a commit, and of a large fleet less often; by one thread for all that ask.

    Parameters
    ----------
    engine
        The store.
    marks
        Tells whether anything was committed.
    """

    def __init__(self, engine: Engine, marks: Marks) -> None:
        self._engine, self._marks = engine, marks
        self._looking = threading.Lock()
        self._known: tuple[Mark, float, float, tuple[Standing, int, int]] | None = None  # when its look began and ended
        self._resting_until_s = 0.0

    def known_now(self, asked_s: float) -> Look | None:
        """Return what `standing` would without a look at the fleet; None where it takes one, or to tell takes a thread."""
        return self._remembered(self._marks.look(), asked_s) if self._marks.at_once else None

    def _remembered(self, mark: Mark | None, asked_s: float) -> Look | None:
        """Return what the last look found, where that holds for who asked at a time of the monotonic clock."""
        now_s = time.monotonic()
        if self._known is None:
            return None
        of_mark, began_s, ended_s, found = self._known
        if now_s - ended_s >= HELD_S:
            return None
        if mark == of_mark or now_s < self._resting_until_s:
            return Look(found)
        return Look(found, is_older=True) if began_s > asked_s else None

    def standing(self, asked_s: float) -> Look:
        """Return what `fleet_standing` does, from a look that began after it was asked for or that no commit came after.

        Of a large fleet the look may be older.
        """
        with self._looking:
            now_s = time.monotonic()
            mark = self._marks.look()
            if (remembered := self._remembered(mark, asked_s)) is not None:
                return remembered
            with reading(self._engine) as session:
                found = fleet_standing(session)
                is_large = sensors.count(session) > LARGE
            ended_s = time.monotonic()
            took_s = ended_s - now_s
            self._known = None if mark is None else (mark, now_s, ended_s, found)
            self._resting_until_s = ended_s + min(HELD_S, REST * took_s) if is_large else 0.0
            return Look(found)
