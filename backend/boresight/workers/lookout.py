"""The look at what finished runs found: whether it raises an alarm.

It is no part of writing an end, so no worker waits for it: the runs are noted, and looked at some at a time while others compute.
What is still noted when a server stops, its upkeep finds when it starts again.
"""

from __future__ import annotations

import logging
from collections.abc import Collection

from boresight.services.watch import changed_sensors, watch
from boresight.store.run_lists import sensors_of
from boresight.store.runs import End
from boresight.store.sessions import Engine as Database
from boresight.store.sessions import reading, writing

log = logging.getLogger(__name__)

RUNS = 16  # looked at together


class Lookout:
    """The runs of one engine that were not looked at yet."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._noted: list[int] = []

    def __bool__(self) -> bool:
        """Whether there is anything to look at."""
        return bool(self._noted)

    def note(self, ends: Collection[End]) -> None:
        """Remember the runs that succeeded."""
        self._noted += [end.run_id for end in ends if end.state == "SUCCEEDED"]

    def look(self) -> None:
        """Look at some of them, writing only where an alarm changes; what fails here, the server's upkeep does again."""
        some, self._noted = self._noted[:RUNS], self._noted[RUNS:]
        try:
            if some and (sensor_ids := self._changed(some)):
                with writing(self._database) as session:
                    watch(session, sensor_ids)
        except Exception:
            log.exception("The watch failed after a run; the server's upkeep looks again")

    def _changed(self, run_ids: Collection[int]) -> list[int]:
        """Return the sensors of these runs whose alarms are not as they should be."""
        with reading(self._database) as session:
            return changed_sensors(session, sensors_of(session, run_ids))
