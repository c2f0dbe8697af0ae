"""How fast passwords may be tried: after some failures each further attempt waits, longer each time, and nobody is locked out.

Failures are counted by the name and the place they come from together, so that nobody else's failures keep a person waiting; a
place is an address, or the session of somebody who is logged in already. One place that tries many names is slowed down too. With
f failures and n of them free, an attempt begins no earlier than::

    d(f) = 0 for f < n,  min(2^(f - n), longest) [s] for f >= n

after the one before; attempts that come at once are counted as if they had failed. A short wait is waited out, of a longer one
the person is told. So one place has about 100 tries an hour at a name (OWASP ASVS 4.0, 2.2.1). Counts are each server's own and
are forgotten `FORGET_S` after the last failure.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from boresight.errors import TooManyAttemptsError

LONGEST_OF_NAME_S, LONGEST_OF_PLACE_S = 45.0, 10.0
NAMES_A_PLACE = 6  # times as many failures are free to a place as to a name at it
HELD_S = 4.0  # a wait up to so long is waited out
FORGET_S = 900.0
MOST_COUNTS = 20_000


def place_of_address(address: str) -> str:
    """Return the place that an address stands for: of IPv6 the network of 64 bits, which one customer has whole."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return address
    mapped = parsed.ipv4_mapped
    return str(mapped) if mapped else str(ipaddress.ip_network((parsed, 64), strict=False))


@dataclass
class _Count:
    """The failures of one name at one place, or of one place."""

    free: float
    longest_s: float
    failures: int = 0
    pending: int = 0
    began_s: float = -math.inf
    touched_s: float = 0.0

    def begins_s(self, now_s: float) -> float:
        """Return when the next attempt may begin."""
        over = self.failures + self.pending - self.free
        return now_s if over < 0 else max(now_s, self.began_s + min(2.0 ** min(over, 30), self.longest_s))


class LoginLimiter:
    """The counts of one server.

    Parameters
    ----------
    free
        Failures of a name at a place before attempts wait.
    now_s
        The clock.
    """

    def __init__(self, free: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._free = free
        self._now_s = now_s
        self._counts: OrderedDict[Hashable, _Count] = OrderedDict()

    def admit(self, name: str, place: str) -> float:
        """Let an attempt in; returns after how many seconds it may begin. `ended` must be told how it went.

        Raises
        ------
        TooManyAttemptsError
            When that is more than `HELD_S`; the attempt is not counted.
        """
        now_s = self._now_s()
        counts = self._of(name, place, now_s)
        begins_s = max(count.begins_s(now_s) for count in counts)
        if begins_s - now_s > HELD_S:
            wait_s = math.ceil(begins_s - now_s)
            raise TooManyAttemptsError(
                f"Too many wrong passwords came from here; wait {wait_s} s and try again.", wait_s
            )
        for count in counts:
            count.began_s, count.touched_s = begins_s, begins_s
            count.pending += 1
        return begins_s - now_s

    def ended(self, name: str, place: str, *, failed: bool | None) -> None:
        """Note how an attempt went; None where it was not made. A right password makes up for the wrong ones of its name."""
        of_name, of_place = counts = self._of(name, place, self._now_s())
        for count in counts:
            count.pending = max(count.pending - 1, 0)
            count.failures += failed is True
        if failed is False:
            of_name.failures = 0
            of_place.began_s = -math.inf

    def _of(self, name: str, place: str, now_s: float) -> tuple[_Count, _Count]:
        """Return the counts of a name at a place and of the place, forgetting what is long ago."""
        found = (
            self._count((name, place), self._free, LONGEST_OF_NAME_S, now_s),
            self._count(place, self._free * NAMES_A_PLACE, LONGEST_OF_PLACE_S, now_s),
        )
        while len(self._counts) > MOST_COUNTS:
            self._counts.popitem(last=False)
        return found

    def _count(self, key: Hashable, free: float, longest_s: float, now_s: float) -> _Count:
        count = self._counts.get(key)
        if count is None or (not count.pending and now_s - count.touched_s > FORGET_S):
            count = self._counts[key] = _Count(free, longest_s, touched_s=now_s)
        self._counts.move_to_end(key)
        return count
