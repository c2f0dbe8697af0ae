"""What a server does beside its requests: it holds the store against its audit log, watches the fleet, tends keys and log-ins.

A page shows the light of the chain and must not wait for it, for a long chain takes seconds to walk. So a thread walks
it over and over, and a page reads what the last walk found. Between two walks it rests a minute, and at least `REST`
times as long as the walk took, so that a chain of any length costs a fixed small part of one processor.

After each look the alarms are brought in line with what is so now (`services.watch`); a round that finds nothing new writes
nothing.

Keys and log-ins are used more often than is worth writing: the newest time of each is kept in memory and written once a round.
A log-in that was not used for too long is refused at once, and its end is written in a round.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from boresight.api.rounds import Rounds
from boresight.services import api_keys, audit, sessions, watch
from boresight.services.conditions import chain_condition
from boresight.services.sessions import SessionLimits
from boresight.store.sessions import Engine, reading, utc_now, writing

log = logging.getLogger(__name__)

ROUND_S = 60.0
PATIENCE_S = (
    5.0  # for a look at a large fleet that is under way when the server stops; what it had not written is undone
)
REST = 20.0
LATE = 3.0  # rounds without a new finding, after which the last one is stale


@dataclass(frozen=True)
class Light:
    """What is known of the chain.

    Parameters
    ----------
    state
        `not yet`, `verified`, `broken` or `stale`.
    last_id
        The newest record that was found good.
    at_utc
        When it was looked at; None before the first walk.
    sentence
        The finding in words.
    """

    state: str
    last_id: int
    at_utc: str | None
    sentence: str


NOT_YET = Light("not yet", 0, None, "The audit log has not been verified since this server was started.")


class Upkeep:
    """The upkeep of one server.

    Parameters
    ----------
    database
        The store.
    limits
        How long log-ins last.
    """

    def __init__(self, database: Engine, limits: SessionLimits) -> None:
        self._database = database
        self._limits = limits
        self._used_utc: dict[str, str] = {}
        self._sessions_used_utc: dict[int, str] = {}
        self._unwritten: set[int] = set()
        self._guard = threading.Lock()
        self._found = NOT_YET
        self._looked_s = 0.0
        self._pause_s = ROUND_S
        self._rounds = Rounds(
            "upkeep", [self.write_uses, self.tidy_sessions, self._verify_when_due, self.watch], lambda: ROUND_S
        )

    def start(self) -> None:
        """Begin; the first walk is at once."""
        self._rounds.start()

    def close(self) -> None:
        """Stop, and write the last uses; safe to call twice."""
        self._rounds.close(PATIENCE_S)
        self._rounds.take(self.write_uses)

    def used(self, credential: str, *, active: bool = True) -> bool:  # noqa: ARG002 - a key is used by what only listens too
        """Remember that a key was used now, which is always allowed."""
        with self._guard:
            self._used_utc[credential.removeprefix("key:")] = utc_now()
        return True

    def session_used(self, session_id: int, last_used_utc: str, *, active: bool) -> bool:
        """Whether a log-in was not idle for too long; if not, and somebody did something, that is its last use.

        Parameters
        ----------
        last_used_utc
            As its row says; this server, or by way of the row another, may know of a later use.
        active
            Whether somebody did something; False where an open page only goes on listening.
        """
        with self._guard:
            last_used_utc = max(last_used_utc, self._sessions_used_utc.get(session_id, ""))
            if self._limits.is_idle(last_used_utc):
                return False
            if active:
                self._sessions_used_utc[session_id] = utc_now()
                self._unwritten.add(session_id)
        return True

    def write_uses(self) -> None:
        """Write the uses since the last round."""
        with self._guard:
            used_utc, self._used_utc = self._used_utc, {}
            sessions_used_utc = {one: self._sessions_used_utc[one] for one in self._unwritten}
            self._unwritten = set()
        if used_utc or sessions_used_utc:
            with writing(self._database) as session:
                api_keys.record_uses(session, used_utc)
                sessions.write_uses(session, sessions_used_utc)
        with self._guard:  # what was written stands in the rows
            for one in sessions_used_utc.keys() - self._unwritten:
                self._sessions_used_utc.pop(one, None)

    def tidy_sessions(self) -> None:
        """Write the end of log-ins that lapsed, and forget those that ended long ago."""
        with reading(self._database) as session:
            needed = sessions.need_tidying(session, self._limits, LATE * ROUND_S)
        if needed:
            with writing(self._database) as session:
                sessions.tidy(session, self._limits, LATE * ROUND_S)

    def verify(self) -> None:
        """Walk the chain and every row that it seals."""
        began_s = time.monotonic()
        with reading(self._database) as session:
            report = audit.verify(session)
        self._looked_s = time.monotonic()
        self._pause_s = max(ROUND_S, REST * (self._looked_s - began_s))
        state = "verified" if report.ok else "broken"
        if state != self._found.state and not report.ok:
            log.critical("The audit log does not hold: %s", report.sentence)
        self._found = Light(state, report.last_id, utc_now(), report.sentence)

    def watch(self) -> None:
        """Bring the alarms of the fleet and of the audit log in line with what is so now."""
        known = self._found.state in {"verified", "broken"}
        broken = chain_condition(self._found.state, self._found.sentence)
        with reading(self._database) as session:
            sensor_ids, chain = watch.changed_sensors(session), known and watch.chain_changed(session, broken)
        if not sensor_ids and not chain:
            return
        with writing(self._database) as session:
            watch.watch(session, sensor_ids)
            if chain:
                watch.watch_chain(session, broken)

    def light(self) -> Light:
        """Return what the last walk found, as stale when the next one is long overdue."""
        found = self._found
        if found.state == "verified" and time.monotonic() - self._looked_s > LATE * self._pause_s:
            return Light("stale", found.last_id, found.at_utc, f"{found.sentence} It was not verified again since.")
        return found

    def _verify_when_due(self) -> None:
        """Walk the chain at first, and again after the pause that the last walk earned."""
        if self._found is NOT_YET or time.monotonic() - self._looked_s >= self._pause_s:
            self.verify()
