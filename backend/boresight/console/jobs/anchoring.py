"""Anchoring: signs the head of the audit log when it is due, has it time-stamped, and knows when either is overdue.

A step of the maintenance, and only while the log verifies: a head of a broken chain is never signed. The time-stamp service is
asked outside any transaction, for the newest anchor alone, because that covers what the ones before it cover.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from boresight.errors import BoresightError
from boresight.platform.audit import queries as rows
from boresight.platform.audit.anchors import TrustedKeys, keep_time_stamp, make_anchor
from boresight.platform.audit.signing import SigningKey
from boresight.platform.audit.time_stamps import TimeStampService
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now
from boresight.platform.db.times import seconds_between

log = logging.getLogger(__name__)

LATE = 3.0  # intervals without an anchor or a time-stamp after which one is overdue
READ_EACH_ROUND = 100  # anchors that the maintenance verifies with the log; `boresight audit verify` reads all


@dataclass
class Anchoring:
    """The anchors of one server: its key, its time-stamp service, and how often a head is signed; 0 is never by itself."""

    database: Engine
    key: SigningKey
    service: TimeStampService | None
    every_s: float
    fault: str = ""

    def trust(self, newest: int | None = None) -> TrustedKeys | None:
        """Return what anchors are verified with; None where the key cannot be read, of which the alarm tells."""
        authorities = () if self.service is None else self.service.authorities
        try:
            return TrustedKeys(self.key.list_public_keys(), self.key.name, authorities, newest)
        except BoresightError:
            return None

    def anchor(self) -> None:
        """Sign the head when due, then have the newest anchor time-stamped; what goes wrong is kept for the alarm."""
        try:
            with open_reading(self.database) as session:
                due = self._is_due(session)
            if due:
                with open_writing(self.database) as session:
                    make_anchor(session, self.key, "Boresight")
            self.stamp()
        except BoresightError as error:
            if str(error) != self.fault:
                log.warning("%s", error)
            self.fault = str(error)
        else:
            self.fault = ""

    def _is_due(self, session: Session) -> bool:
        """Whether the newest anchor is old enough, and there are records after it."""
        newest = rows.find_newest_anchor(session)
        if not self.every_s or (newest is not None and seconds_between(newest.at_utc, utc_now()) < self.every_s):
            return False
        return rows.find_first_after(session, 0 if newest is None else newest.record_id) is not None

    def stamp(self) -> None:
        """Have the newest anchor time-stamped, where a service is set and has not yet."""
        if self.service is None:
            return
        with open_reading(self.database) as session:
            newest = rows.find_newest_anchor(session)
        if newest is None or newest.time_stamp is not None:
            return
        stamp = self.service.stamp(newest.signature.encode())
        with open_writing(self.database) as session:
            keep_time_stamp(session, newest.id, stamp)

    def find_overdue(self, session: Session) -> str:
        """Return a sentence on what is overdue, the same as long as it is; empty where nothing is."""
        if not self.every_s:
            return ""
        newest = rows.find_newest_anchor(session)
        first = rows.find_first_after(session, 0 if newest is None else newest.record_id)
        cause = self.fault or "The log does not verify, or no server ran: look at its other alarms."
        if first is not None and self._is_late(first.at_utc):
            return f"The audit log is not anchored from record {first.id} on, which was written {first.at_utc[:16]} UTC. {cause}"
        unstamped = None if self.service is None else rows.find_first_unstamped(session)
        if unstamped is not None and self._is_late(unstamped.at_utc):
            return f"Anchor {unstamped.id} of the audit log, signed {unstamped.at_utc[:16]} UTC, has no time-stamp. {cause}"
        return ""

    def _is_late(self, at_utc: str) -> bool:
        return seconds_between(at_utc, utc_now()) > LATE * self.every_s
