"""What a server does beside its requests: it holds the store against its audit log, watches the fleet, writes when keys were used.

A page shows the light of the chain and must not wait for it, for a long chain takes seconds to walk. So a thread walks
it over and over, and a page reads what the last walk found. Between two walks it rests a minute, and at least `REST`
times as long as the walk took, so that a chain of any length costs a fixed small part of one processor.

After each look the alarms are brought in line with what is so now (`services.watch`); a round that finds nothing new writes
nothing.

A key is used more often than is worth writing: the newest time of each is kept in memory and written once a round.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from boresight.api.rounds import Rounds
from boresight.services import api_keys, audit, watch
from boresight.services.conditions import chain_condition
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
    """

    def __init__(self, database: Engine) -> None:
        self._database = database
        self._used_utc: dict[str, str] = {}
        self._guard = threading.Lock()
        self._found = NOT_YET
        self._looked_s = 0.0
        self._pause_s = ROUND_S
        self._rounds = Rounds("upkeep", [self.write_uses, self._verify_when_due, self.watch], lambda: ROUND_S)

    def start(self) -> None:
        """Begin; the first walk is at once."""
        self._rounds.start()

    def close(self) -> None:
        """Stop, and write the last uses of keys; safe to call twice."""
        self._rounds.close(PATIENCE_S)
        self._rounds.take(self.write_uses)

    def used(self, credential: str) -> bool:
        """Remember that a key was used now, which is always allowed."""
        with self._guard:
            self._used_utc[credential.removeprefix("key:")] = utc_now()
        return True

    def write_uses(self) -> None:
        """Write the uses since the last round."""
        with self._guard:
            used_utc, self._used_utc = self._used_utc, {}
        if used_utc:
            with writing(self._database) as session:
                api_keys.record_uses(session, used_utc)

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
