"""How fast passwords may be tried, and how few audit records a crowd of wrong ones makes.

With f failures counted under a key and n of them free, an attempt begins no earlier than::

    d(f) = 0 for f < n,  min(2^(f - n), longest) [s] for f >= n

after the one before. It is counted under its name at its place, under its name at the console where another one is
logged in, and, unless the name logged in from that place before, under its name at all such places and under the place
alone. So strangers share some 50 tries an hour at an account and a known place has 50 of its own (OWASP ASVS 4.0,
2.2.1). Codes of second factors are counted apart, and a right password clears none of their failures.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass

from boresight.console.access import queries as rows
from boresight.errors import TooManyAttemptsError
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.audit.security_log import tell
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import comparison_key

LONGEST_OF_NAME_S, LONGEST_OF_ACCOUNT_S, LONGEST_OF_PLACE_S = 100.0, 120.0, 10.0
LONGEST_OF_CODE_S = 1800.0  # of six digits three in a million fit: 48 tries a day find one in 19 years on average
PLACES_A_NAME = 3  # times as many failures are free to strangers together at a name as to one of them
NAMES_A_PLACE = 6  # times as many failures are free to a place as to a name at it
HELD_S = 4.0  # a wait up to so long is waited out
FORGET_S = 3600.0
MOST_COUNTS = 20_000


def name_network(address: str) -> str:
    """Return the place that an address stands for: of IPv6 the network of 64 bits, which one customer has whole."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return address
    mapped = parsed.ipv4_mapped
    return str(mapped) if mapped else str(ipaddress.ip_network((parsed, 64), strict=False))


@dataclass(frozen=True)
class LoginAttempt:
    """What is tried: a name from a place."""

    name: str
    place: str
    known: bool = False
    console: str | None = None
    is_code: bool = False  # of a second factor: counted apart from the passwords of the name


@dataclass
class _Count:
    """The failures under one key."""

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
    """The counts of one server."""

    def __init__(self, free: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._free = free
        self._now_s = now_s
        self._counts: OrderedDict[Hashable, _Count] = OrderedDict()

    def admit(self, tried: LoginAttempt) -> float:
        """Admit an attempt and return after how many seconds it may begin; report its outcome to `ended`."""
        now_s = self._now_s()
        limits = self._limits(tried)
        begins_s = max(self._begins_s(key, now_s) for key in limits)
        if begins_s - now_s > HELD_S:
            wait_s = math.ceil(begins_s - now_s)
            what = "second factors" if tried.is_code else "passwords"
            tell("authn_login_lock", "failure", name=tried.name, wait_s=wait_s)
            raise TooManyAttemptsError(f"Too many failed attempts ({what}); wait {wait_s} s and try again.", wait_s)
        for key, (free, longest_s) in limits.items():
            count = self._counts.setdefault(key, _Count(free, longest_s))
            self._counts.move_to_end(key)
            count.began_s = count.touched_s = begins_s
            count.pending += 1
        while len(self._counts) > MOST_COUNTS:
            self._counts.popitem(last=False)
        return begins_s - now_s

    def record_outcome(self, tried: LoginAttempt, *, failed: bool | None) -> None:
        """Record the outcome of an attempt; `failed` is None where it was not made.

        A right password clears the failures of its name there. Counts without failures are not kept, so that only passwords that
        were really checked can push out older counts.
        """
        for key in self._limits(tried):
            count = self._counts.get(key)
            if count is None:
                continue
            count.pending = max(count.pending - 1, 0)
            count.failures += failed is True
            own = {(tried.name, tried.place), ("console", tried.name, tried.console), _code_key(tried)}
            if failed is False and key in own:
                count.failures = 0
            if not count.pending and not count.failures:
                del self._counts[key]

    def _limits(self, tried: LoginAttempt) -> dict[Hashable, tuple[float, float]]:
        """Return the keys under which an attempt is counted, each with its number of free failures and its longest wait."""
        if tried.is_code:
            return {_code_key(tried): (self._free, LONGEST_OF_CODE_S)}
        of_name = (self._free, LONGEST_OF_NAME_S)
        limits: dict[Hashable, tuple[float, float]] = {(tried.name, tried.place): of_name}
        if tried.console is not None:
            limits["console", tried.name, tried.console] = of_name
        if not tried.known:
            limits["name", tried.name, None] = (self._free * PLACES_A_NAME, LONGEST_OF_ACCOUNT_S)
            limits["place", tried.console or tried.place, None] = (self._free * NAMES_A_PLACE, LONGEST_OF_PLACE_S)
        return limits

    def _begins_s(self, key: Hashable, now_s: float) -> float:
        """Return when the next attempt under a key may begin, forgetting what is long ago."""
        count = self._counts.get(key)
        if count is not None and not count.pending and now_s - count.touched_s > FORGET_S:
            del self._counts[key]
            count = None
        return now_s if count is None else count.begins_s(now_s)


def _code_key(tried: LoginAttempt) -> Hashable:
    """Return the key under which codes are counted: those from strange places together, any other place by itself."""
    return ("code", tried.name, tried.place if tried.known else None)


MOST_RECORDS = 10
LONGEST_NAME = 64
REFUSED = "refused wrong passwords of"


@dataclass(frozen=True)
class FailedAttempt:
    """A name as it was typed, the address it came from, and the log-in under which it was typed, if any."""

    name: str
    address: str
    session_id: int | None = None

    @classmethod
    def of(cls, name: str, address: str, session_id: int | None = None) -> FailedAttempt:
        """Make one from the typed name, shortened and without control characters."""
        return cls("".join(letter for letter in name[:LONGEST_NAME] if letter.isprintable()), address, session_id)


@dataclass
class Failures:
    """How often an attempt failed, since when and until when."""

    count: int = 0
    since_utc: str = ""
    until_utc: str = ""

    def add(self) -> None:
        """Count one more."""
        self.until_utc = utc_now()
        self.since_utc = self.since_utc or self.until_utc
        self.count += 1


def record(session: Session, failed: Mapping[FailedAttempt, Failures]) -> None:
    """Put failed attempts into the audit log, the most frequent each by itself, the rest together."""
    ranked = sorted(failed.items(), key=lambda pair: -pair[1].count)
    for attempt, failures in ranked[:MOST_RECORDS]:
        user = rows.find_user(session, attempt.name.strip(), comparison_key(attempt.name))
        told = {"name": attempt.name, "address": attempt.address, "log_in": attempt.session_id}
        subject = "sessions" if user is None else f"users/{user.id}"
        audit.append(session, SYSTEM, REFUSED, subject, None, told | _describe_times([failures]))
    if rest := ranked[MOST_RECORDS:]:
        told = {"names": len({one.name for one, _ in rest}), "addresses": len({one.address for one, _ in rest})}
        audit.append(
            session, SYSTEM, REFUSED, "sessions", None, told | _describe_times([failures for _, failures in rest])
        )


def _describe_times(found: Sequence[Failures]) -> dict[str, int | str]:
    return {
        "count": sum(one.count for one in found),
        "since_utc": min(one.since_utc for one in found),
        "until_utc": max(one.until_utc for one in found),
    }
