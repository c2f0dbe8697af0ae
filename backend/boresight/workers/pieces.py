"""The pieces of one map over a large set: which wait, which are out, which are done.

Whoever computes takes a group of neighbouring pieces at a time. A group is to last about half a second, against the ten
milliseconds that it costs to hand it over, and never more than its share of half of what is left, so that all end together
(guided self-scheduling; Polychronopoulos and Kuck, IEEE Trans. Computers C-36, 1987). How long a piece lasts is measured on
the way. Results are kept by place: who computed a piece, when, and how often is nowhere to be seen in them.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

GROUP_S = 0.5
LEAST_S = 0.05

#: Places of the pieces of one group, ascending.
Group = tuple[int, ...]


@dataclass(frozen=True)
class Broken:
    """In the place of a result: what the piece raised."""

    error: Exception


class Pieces:
    """A ledger that several threads write.

    Parameters
    ----------
    count
        How many pieces there are.
    seconds
        How long one lasts as far as known; None when none was ever timed.
    """

    def __init__(self, count: int, seconds: float | None = None) -> None:
        self.count = count
        self.seconds = seconds
        self._lock = threading.Condition()
        self._news = threading.Event()
        self._fresh = deque(range(count))
        self._returned: deque[int] = deque()
        self._results: dict[int, Any] = {}
        self._end = count  # behind the first piece that broke nothing is computed
        self._closed = False

    def take(self, takers: int, *, returned: bool = False) -> Group:
        """Take the next group; empty when there is none.

        Parameters
        ----------
        takers
            How many share what is left.
        returned
            Whether those may be taken, and first, that somebody else has had already.
        """
        with self._lock:
            while returned and self._returned:
                place = self._returned.popleft()
                if place < self._end and place not in self._results:
                    return (place,)
            left = sum(place < self._end for place in self._fresh) if self._end < self.count else len(self._fresh)
            size = min(left, self._size(left, takers))
            return tuple(self._fresh.popleft() for _ in range(size))

    def _size(self, left: int, takers: int) -> int:
        """How many pieces make a group now."""
        if not self.seconds:
            return 1
        most, least = max(1, int(GROUP_S / self.seconds)), math.ceil(LEAST_S / self.seconds)
        return max(1, min(most, max(least, math.ceil(left / (2 * takers)))))

    def give_back(self, group: Group) -> None:
        """Return a group that was lost, or is overdue; it may still be settled by whoever had it."""
        with self._lock:
            self._returned.extend(place for place in group if place not in self._results)
            self._lock.notify_all()
        self._news.set()

    def settle(self, group: Group, results: Sequence[Any], seconds: float) -> None:
        """Write the results of a group, up to the first that is `Broken`; the first answer for a piece counts."""
        with self._lock:
            for place, result in zip(group, results, strict=False):
                self._results.setdefault(place, result)
                if isinstance(result, Broken):
                    self._end = min(self._end, place)
            self.seconds = seconds / max(1, len(results))
        self._news.set()

    def await_news(self, seconds: float) -> None:
        """Wait until there is news since the last time, so many seconds at most; for one thread, which gathers."""
        self._news.wait(seconds)
        self._news.clear()

    def tell_news(self) -> None:
        """Say that there is something to gather."""
        self._news.set()

    def rest(self, seconds: float) -> None:
        """Wait until something is given back or all is over, so many seconds at most."""
        with self._lock:
            self._lock.wait(seconds)

    def close(self) -> None:
        """Let nobody take any more."""
        with self._lock:
            self._closed = True
            self._fresh.clear()
            self._returned.clear()
            self._lock.notify_all()

    @property
    def closed(self) -> bool:
        """Whether all is over."""
        return self._closed

    @property
    def done(self) -> int:
        """How many pieces have a result."""
        return len(self._results)

    @property
    def complete(self) -> bool:
        """Whether every piece has its result, or every one before the first that broke."""
        with self._lock:
            return all(place in self._results for place in range(self._end)) if self.done >= self._end else False

    def results(self) -> list[Any]:
        """Return the results in order.

        Raises
        ------
        Exception
            What the first broken piece raised.
        """
        if self._end < self.count:
            error: Exception = self._results[self._end].error
            raise error
        return [self._results[place] for place in range(self.count)]
