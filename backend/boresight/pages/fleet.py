"""How the fleet stands, for the top bar of every page: as its worst sensor does, that sensor named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from boresight.pages.states import LEVELS
from boresight.services import alarms, approvals, sensors
from boresight.services.sensors import SensorTile
from boresight.store.sessions import Session

WORD_OF_LEVEL = {level: level.upper() for level in LEVELS} | {"off": "NO DATA"}


@dataclass(frozen=True)
class Standing:
    """A consolidated status: colour and shape, a word, and why."""

    level: str
    word: str
    sentence: str


def worst_standing(tiles: Sequence[SensorTile]) -> Standing:
    """Return how a fleet stands."""
    if not tiles:
        return Standing("off", "NO SENSORS", "No sensors yet: register one.")
    worst = max(tiles, key=lambda tile: LEVELS.index(tile.status))
    alike = sum(tile.status == worst.status for tile in tiles)
    more = f" {alike - 1} more alike." if alike > 1 else ""
    return Standing(worst.status, WORD_OF_LEVEL[worst.status], f"{worst.sensor.name}: {worst.sentence}{more}")


def fleet_standing(session: Session) -> tuple[Standing, int, int]:
    """Return how the fleet stands, how many requests wait for a signature, and how many alarms to be acknowledged."""
    waiting = len(approvals.list_approvals(session, state="OPEN"))
    return worst_standing(sensors.fleet_overview(session)), waiting, alarms.unacknowledged(session)
