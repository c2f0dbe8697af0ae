"""FileQueue: files of several sensors are taken in side by side, one of a sensor at a time, so that no sensor waits for another's.

`AT_ONCE` files are read at a time, and of those that wait the one whose sensor was served longest ago is next. A file that takes
longer than `SLOW_S` keeps its sensor, and its place is given away: it goes on beside `AT_ONCE` others, as long as fewer than `MOST`
are under way. A thread cannot be ended from outside, so one that hangs is said on the page until the server is restarted.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial

AT_ONCE, MOST = 2, 8
SLOW_S = 60.0
#: How long a round hands out files before it looks again for new ones, and how long an end of the server waits for those under way.
ROUND_BUDGET_S, PATIENCE_S = 20.0, 30.0


@dataclass(frozen=True)
class WaitingFile:
    """A file that waits: its sensor, its name, and what takes it in."""

    sensor: str
    name: str
    take: Callable[[], None]


@dataclass(frozen=True)
class FileUnderWay:
    """A file that is being taken in, and since when on the clock of the queue."""

    name: str
    since_s: float
    thread: threading.Thread


class FileQueue:
    """The files that one server takes in."""

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._name = name
        self._clock = clock
        self._ended = threading.Condition()
        self._under_way: dict[str, FileUnderWay] = {}
        self._served_s: dict[str, float] = {}

    def take_all(self, files: Sequence[WaitingFile], closing: Callable[[], bool]) -> bool:
        """Take files in, oldest of a sensor first, for at most `ROUND_BUDGET_S`; returns whether all were begun."""
        ends, waiting = self._clock() + ROUND_BUDGET_S, dict[str, deque[WaitingFile]]()
        for one in files:
            waiting.setdefault(one.sensor, deque()).append(one)
        with self._ended:
            while not closing() and self._clock() < ends:
                while (sensor := self._find_next(waiting)) is not None:
                    self._begin(waiting[sensor].popleft())
                    if not waiting[sensor]:
                        del waiting[sensor]
                if not waiting and not self._list_quick():
                    break
                if not self._list_quick() and all(sensor in self._under_way for sensor in waiting):
                    break  # what is left belongs to sensors that are busy with a slow file
                self._ended.wait(max(min(ends - self._clock(), 1.0), 0.01))
        return not waiting

    def _find_next(self, waiting: dict[str, deque[WaitingFile]]) -> str | None:
        """Return the sensor whose file may begin; None where there is no place."""
        if len(self._list_quick()) >= AT_ONCE or len(self._under_way) >= MOST:
            return None
        free = [sensor for sensor in waiting if sensor not in self._under_way]
        return min(free, key=lambda sensor: self._served_s.get(sensor, 0.0), default=None)

    def _list_quick(self) -> list[str]:
        """Sensors whose file has a place among those that are read at once."""
        now = self._clock()
        return [sensor for sensor, one in self._under_way.items() if now - one.since_s < SLOW_S]

    def _begin(self, one: WaitingFile) -> None:
        run = partial(copy_context().run, self._run, one)
        thread = threading.Thread(target=run, name=f"boresight-{self._name}-{one.sensor}", daemon=True)
        self._served_s[one.sensor] = now = self._clock()
        self._under_way[one.sensor] = FileUnderWay(one.name, now, thread)
        thread.start()

    def _run(self, one: WaitingFile) -> None:
        try:
            one.take()
        finally:
            with self._ended:
                del self._under_way[one.sensor]
                self._ended.notify_all()

    def describe(self, sensor: str) -> str:
        """Say what a sensor's file is doing; empty where none is under way."""
        one = self._under_way.get(sensor)
        if one is None:
            return ""
        seconds = self._clock() - one.since_s
        slow = "; other sensors are not affected" if seconds >= SLOW_S else ""
        return f"reading {one.name} for {seconds:.0f} s{slow}"

    @property
    def fault(self) -> str:
        """What is wrong: every place taken by files that do not end."""
        if len(self._under_way) < MOST or self._list_quick():
            return ""
        return (
            f"Reading {MOST} files does not finish, so no more files are accepted: remove them from the folder and restart the "
            "server."
        )

    def close(self) -> None:
        """Wait a while for what is under way."""
        ends = time.monotonic() + PATIENCE_S
        for one in list(self._under_way.values()):
            if one.thread is not threading.current_thread():
                one.thread.join(max(ends - time.monotonic(), 0.0))
