"""What the event feed tells, and the places in it.

What is told of runs and of the audit log are rows: `run_events` and `audit`, both numbered in the order of their
commits. Progress is not a row; its events are numbered as they pass, from the milliseconds of the server's start on, so
that a number of an earlier server lies below all of this one. A place in the feed is therefore three numbers, written
`<run event>.<audit record>.<progress>`, and is the id of every event; whoever comes back with a place is told all the
rows after it, and the progress after it as far as it is still kept.
"""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import orjson

from boresight.api.numbers import row_number
from boresight.store import audit, run_events
from boresight.store.sessions import Session
from boresight.store.tables import RunEvent

PAGE = 500
LINE_LENGTH = 400  # of a log line that is told; the log has it whole


@dataclass(frozen=True)
class Place:
    """How far somebody has been told: the newest run event, audit record and progress."""

    run_event: int
    record: int
    progress: int = 0

    def __str__(self) -> str:
        """Write the place as an event id."""
        return f"{self.run_event}.{self.record}.{self.progress}"

    def covers(self, other: Place) -> bool:
        """Whether everything before another place is before this one too."""
        return self.run_event >= other.run_event and self.record >= other.record and self.progress >= other.progress

    @classmethod
    def parse(cls, text: str) -> Place | None:
        """Read an event id; None when it is none of ours."""
        numbers = [number for part in text.split(".") if (number := row_number(part)) is not None]
        return cls(*numbers) if len(numbers) in {2, 3} and len(numbers) == text.count(".") + 1 else None

    @classmethod
    def now(cls, session: Session, progress: int = 0) -> Place:
        """Return the place after everything stored, and after this progress."""
        return cls(run_events.newest_event_id(session), audit.newest_id(session), progress)


PART_OF_KIND = {"run": "run_event", "log": "run_event", "audit": "record", "progress": "progress"}


@dataclass(frozen=True)
class Event:
    """One event.

    Parameters
    ----------
    kind
        `run` (a change of state), `log` (another line of a run's log), `progress` or `audit`.
    data
        What is told to everybody.
    number
        The row's, or that of the progress.
    history
        The new points of a running run's course: told only to who follows that run.
    """

    kind: str
    data: dict[str, Any]
    number: int
    history: dict[str, Any] | None = None

    def is_after(self, place: Place) -> bool:
        """Whether somebody at a place has not been told this yet."""
        told: int = getattr(place, PART_OF_KIND[self.kind])
        return self.number > told

    def move(self, place: Place) -> Place:
        """Return the place of somebody who has now been told this."""
        return replace(place, **{PART_OF_KIND[self.kind]: self.number})

    @cached_property
    def text(self) -> str:
        """The event as JSON, written once for all listeners."""
        return orjson.dumps(self.data).decode()

    @cached_property
    def text_with_history(self) -> str:
        """The same for those who follow the run."""
        return orjson.dumps(self.data | {"history": self.history}).decode()

    def wire(self, place: Place, *, with_history: bool = False) -> bytes:
        """Write it as a server-sent event, its id the place after it."""
        text = self.text_with_history if with_history and self.history is not None else self.text
        return f"event: {self.kind}\ndata: {text}\nid: {place}\n\n".encode()


class Ring:
    """The newest progress events, numbered.

    Parameters
    ----------
    length
        How many are kept.
    """

    def __init__(self, length: int) -> None:
        self._kept: deque[Event] = deque(maxlen=length)
        self.newest = int(1000 * time.time())

    def add(self, data: dict[str, Any], history: dict[str, Any] | None) -> Event:
        """Give a progress event its number, and keep it."""
        self.newest += 1
        self._kept.append(Event("progress", data, self.newest, history))
        return self._kept[-1]

    def after(self, number: int) -> list[Event] | None:
        """Return what came after a number; None when some of it is kept no more, or the number is another server's."""
        oldest = self._kept[0].number if self._kept else self.newest + 1
        if not oldest - 1 <= number <= self.newest:
            return None
        return [event for event in self._kept if event.number > number]


def events_after(session: Session, place: Place) -> list[Event]:
    """Return the rows after a place as events, those of either kind in their order, at most a page of each."""
    lines = [_line(row) for row in run_events.events_after(session, place.run_event, PAGE)]
    records = [_told(row) for row in audit.heads_after(session, place.record, PAGE)]
    return list(heapq.merge(lines, records, key=lambda event: str(event.data["at_utc"])))


def _line(row: RunEvent) -> Event:
    """Tell a line of a run's log: a change of state as such, any other as a line."""
    told = {"run_id": row.run_id, "attempt": row.attempt, "at_utc": row.at_utc, "message": row.message[:LINE_LENGTH]}
    if row.kind == "state":
        return Event("run", told | {"state": row.state}, row.id)
    return Event("log", told | {"kind": row.kind}, row.id)


def _told(row: Mapping[str, Any]) -> Event:
    """Tell an audit record as an event; what it changed is left to the log itself."""
    return Event("audit", dict(row), row["id"])
