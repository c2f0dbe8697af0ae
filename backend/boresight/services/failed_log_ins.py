"""Wrong passwords in the audit log: one record for each name and address a minute, however many there were, and few records in all.

Whoever knows no password must not be able to make the log grow: what is more than `MOST_RECORDS` names and addresses in a minute
is told in one record, by its numbers. The name stands as it was typed, cut and cleaned of what cannot be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from boresight.services import audit
from boresight.services.actors import SYSTEM
from boresight.services.words import comparison_key
from boresight.store import users as rows
from boresight.store.sessions import Session, utc_now

MOST_RECORDS = 10
LONGEST_NAME = 64
REFUSED = "refused wrong passwords of"


@dataclass(frozen=True)
class Attempt:
    """A name as it was typed, the address it came from, and the log-in under which it was typed, if any."""

    name: str
    address: str
    session_id: int | None = None

    @classmethod
    def of(cls, name: str, address: str, session_id: int | None = None) -> Attempt:
        """Take what came, cut and cleaned."""
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


def record(session: Session, failed: Mapping[Attempt, Failures]) -> None:
    """Put failed attempts into the audit log, the most frequent each by itself, the rest together."""
    ranked = sorted(failed.items(), key=lambda pair: -pair[1].count)
    for attempt, failures in ranked[:MOST_RECORDS]:
        user = rows.user_named(session, attempt.name.strip(), comparison_key(attempt.name))
        told = {"name": attempt.name, "address": attempt.address, "log_in": attempt.session_id}
        subject = "sessions" if user is None else f"users/{user.id}"
        audit.append(session, SYSTEM, REFUSED, subject, None, told | _times([failures]))
    if rest := ranked[MOST_RECORDS:]:
        told = {"names": len({one.name for one, _ in rest}), "addresses": len({one.address for one, _ in rest})}
        audit.append(session, SYSTEM, REFUSED, "sessions", None, told | _times([failures for _, failures in rest]))


def _times(found: Sequence[Failures]) -> dict[str, int | str]:
    return {
        "count": sum(one.count for one in found),
        "since_utc": min(one.since_utc for one in found),
        "until_utc": max(one.until_utc for one in found),
    }
