"""What was used last, within a number of bytes: the oldest goes first, and nothing larger than a quarter is kept at all."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")

LARGEST_SHARE = 4  # of the limit, so that one large thing does not push everything else out


class Recent(Generic[Value]):
    """Values by key; many threads may ask at once, and two that ask for the same at once both make it.

    Parameters
    ----------
    limit_bytes
        How much is kept, counted as the callers count it.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self.held_bytes = 0
        self._kept: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], tuple[Value, int]]) -> Value:
        """Return what stands under a key; make it, as value and size in bytes, where nothing does."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][0]
        value, size = make()
        if size * LARGEST_SHARE <= self.limit_bytes:
            self._keep(key, value, size)
        return value

    def _keep(self, key: Hashable, value: Value, size: int) -> None:
        """Keep a value, and let the oldest go until the limit holds."""
        with self._lock:
            if key in self._kept:
                self.held_bytes -= self._kept.pop(key)[1]
            self._kept[key] = (value, size)
            self.held_bytes += size
            while self.held_bytes > self.limit_bytes:
                self.held_bytes -= self._kept.popitem(last=False)[1][1]
