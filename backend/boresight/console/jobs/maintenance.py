"""Maintenance of a server: verifies and anchors the audit chain, updates alarms, rereads files, records uses of keys and log-ins.

Between two walks of the chain it rests a minute, and at least `REST` times as long as the walk took. Files are read for
`READ_S` a round; what a reader found corrupt is looked at now. The newest use of each key and log-in is kept in memory
and written once a round.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from boresight.console.access import api_keys, sessions
from boresight.console.alarms import rules
from boresight.console.alarms.rules import (
    ANCHOR,
    BACKUP,
    CHAIN,
    FILES,
    HEAD,
    LINK,
    AlarmCause,
    check_anchors,
    check_backups,
    check_chain,
    check_events,
    check_files,
    check_head,
)
from boresight.console.backups import service as backups
from boresight.console.jobs.anchoring import READ_EACH_ROUND, Anchoring
from boresight.console.webhooks import service as webhooks
from boresight.errors import BoresightError
from boresight.platform.actors import SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.audit.external_head import ExternalHead, read_head, write_head
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker

log = logging.getLogger(__name__)

ROUND_S = 60.0
REST = 20.0
READ_S = 1.0
LATE = 3.0  # rounds without a new finding, after which the last one is stale


@dataclass(frozen=True)
class ExternalHeadFile:
    """The external file for the head of the audit log, None for no file, and how often the head is written and sent."""

    file: Path | None
    every_s: float


@dataclass(frozen=True)
class ChainStatus:
    """The result of the last verification of the chain."""

    state: str
    last_id: int
    at_utc: str | None
    sentence: str


NOT_YET = ChainStatus("not yet", 0, None, "The audit log has not been verified since this server was started.")


class Maintenance(PeriodicWorker):
    """The maintenance of one server."""

    patience_s = 5.0  # for a check of a large fleet; what that had not written is rolled back

    def __init__(
        self,
        database: Engine,
        limits: SessionLimits,
        blobs: BlobStore,
        kept: ExternalHeadFile | None = None,
        anchoring: Anchoring | None = None,
    ) -> None:
        self._database = database
        self._limits = limits
        self._blobs = blobs
        self._kept = kept or ExternalHeadFile(None, 0.0)
        self._anchoring = anchoring
        self._head_kept_s = float("-inf")
        self._head_fault = ""
        self._suspects: set[str] = set()
        self._read_to = ""
        self._used_utc: dict[str, str] = {}
        self._sessions_used_utc: dict[int, str] = {}
        self._unwritten: set[int] = set()
        self._guard = threading.Lock()
        self._found = NOT_YET
        self._looked_s = 0.0
        self._pause_s = ROUND_S
        self._thread = PeriodicThread(
            "maintenance",
            [
                self.write_uses,
                self.tidy_sessions,
                self._verify_when_due,
                self.keep_head,
                self.anchor,
                self.read_files,
                self.apply_alarm_rules,
            ],
            lambda: ROUND_S,
        )

    def close(self) -> None:
        """Stop, and write the last uses; safe to call twice."""
        super().close()
        self._thread.take(self.write_uses)

    def used(self, key_prefix: str, *, active: bool = True) -> bool:  # noqa: ARG002 - a key is used by what only listens too
        """Record the use of a key; keys have no idle limit, so this returns True."""
        with self._guard:
            self._used_utc[key_prefix] = utc_now()
        return True

    def session_used(self, session_id: int, last_used_utc: str, *, active: bool) -> bool:
        """Return whether a log-in was not idle for too long, and record its use if a person did something."""
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
            with open_writing(self._database) as session:
                api_keys.record_uses(session, used_utc)
                sessions.write_uses(session, sessions_used_utc)
        with self._guard:  # the rows now hold what was written
            for one in sessions_used_utc.keys() - self._unwritten:
                self._sessions_used_utc.pop(one, None)

    def tidy_sessions(self) -> None:
        """Write the end of log-ins that lapsed, and forget those that ended long ago."""
        with open_reading(self._database) as session:
            needed = sessions.need_tidying(session, self._limits, LATE * ROUND_S)
        if needed:
            with open_writing(self._database) as session:
                sessions.tidy(session, self._limits, LATE * ROUND_S)

    def verify(self) -> None:
        """Verify the chain and every row that it seals."""
        began_s = time.monotonic()
        with open_reading(self._database) as session:
            kept, file = self._read_head()
            trust = None if self._anchoring is None else self._anchoring.trust(READ_EACH_ROUND)
            report = audit.verify(session, kept=kept, head_file=file, trust=trust)
        self._looked_s = time.monotonic()
        self._pause_s = max(ROUND_S, REST * (self._looked_s - began_s))
        state = "verified" if report.ok else "broken"
        if state != self._found.state and not report.ok:
            log.critical("The audit log is broken: %s", report.sentence)
        self._found = ChainStatus(state, report.last_id, utc_now(), report.sentence)

    def anchor(self) -> None:
        """Sign the head of a log that verifies, when due."""
        if self._anchoring is not None and self._found.state == "verified":
            self._anchoring.anchor()

    def _read_head(self) -> tuple[ExternalHead | None, Path | None]:
        """Return the externally kept head and its file; an unreadable file is reported by an alarm."""
        file = self._kept.file
        try:
            return (None if file is None else read_head(file)), file
        except BoresightError as error:
            self._head_fault = str(error)
            return None, None

    def keep_head(self) -> None:
        """Write a new head to its external file when due, and send it to webhooks; never after a head that the chain has lost."""
        if self._found.state != "verified" or time.monotonic() - self._head_kept_s < self._kept.every_s:
            return
        with open_reading(self._database) as session:
            head = audit.find_newest_head(session)
            before, file = self._read_head()
            is_on_record = file is not None and audit.head_was_kept(session, file)
            if (is_on_record and before is None) or (before is not None and not audit.holds(session, before)):
                self.verify()  # records, or the file, were lost since the last walk
                return
            told = webhooks.is_head_told(session, head)
        if self._kept.file is not None and head is not None:
            try:
                if before != head:
                    write_head(self._kept.file, head)
                if file is not None and not is_on_record:
                    head = self._put_on_record(file) or head
                    write_head(file, head)
                self._head_fault = ""
            except BoresightError as error:
                self._head_fault = str(error)
                log.warning("%s", error)
        if head is not None and not told:
            with open_writing(self._database) as session:
                webhooks.tell_head(session, head)
        self._head_kept_s = time.monotonic()

    def _put_on_record(self, file: Path) -> ExternalHead | None:
        """Record in the audit log that heads are kept in a file, once one exists, and return the new head."""
        with open_writing(self._database) as session:
            audit.tell_head_kept(session, file)
        with open_reading(self._database) as session:
            return audit.find_newest_head(session)

    def suspect(self, sha256: str) -> None:
        """Check a stored file now that a reader found corrupt."""
        with self._guard:
            is_new = sha256 not in self._suspects
            self._suspects.add(sha256)
        if is_new:
            self.nudge()

    def read_files(self) -> None:
        """Reread stored files: the suspected ones, and some others from where the last round ended."""
        with open_reading(self._database) as session:
            suspected = self._suspects | set(rules.list_files_in_alarm(session))
            doubtful = files.list_sizes(session, sorted(suspected))
            others = files.list_registered(session, self._read_to) if self._blobs.kept_at is None else ()
        bad = {sha256 for sha256, size in doubtful if self._is_bad(sha256, size)}
        self._read_to, ends_s = "", time.monotonic() + READ_S
        for sha256, size in others:
            if self._is_bad(sha256, size):
                bad.add(sha256)
            if time.monotonic() > ends_s or sha256 == others[-1][0]:
                self._read_to = sha256
                break
        with self._guard:
            self._suspects = (self._suspects - suspected) | bad

    def _is_bad(self, sha256: str, size: int) -> bool:
        """Whether a file differs from its row; a store that does not answer does not count."""
        try:
            return files.wrong_with(self._blobs, sha256, size, again=True) is not None
        except BoresightError:
            return sha256 in self._suspects

    def apply_alarm_rules(self) -> None:
        """Update the alarms of the fleet, of the audit log and of the stored files."""
        with open_reading(self._database) as session:
            found = self._check_installation(session)
            sensor_ids, installation = (
                rules.find_changed_sensors(session),
                rules.has_installation_changed(session, found),
            )
        if not sensor_ids and not installation:
            return
        with open_writing(self._database) as session:
            rules.update_alarms(session, sensor_ids)
            if installation:
                rules.update_installation_alarms(session, found)

    def _check_installation(self, session: Session) -> dict[str, AlarmCause | None]:
        """Return the causes of installation alarms, by source."""
        named = files.list_sizes(session, sorted(self._suspects))
        wrong = [
            files.BadFile(sha256, what, files.list_users(session, sha256))
            for sha256, size in named
            if (what := files.wrong_with(self._blobs, sha256, size, again=False)) is not None
        ]
        found = {FILES: check_files(wrong), HEAD: check_head(self._head_fault), LINK: check_events(session)}
        found[BACKUP] = check_backups(backups.find_fault(session))
        if self._anchoring is not None:
            found[ANCHOR] = check_anchors(self._anchoring.find_overdue(session))
        if self._found.state in {"verified", "broken"}:
            found[CHAIN] = check_chain(self._found.state, self._found.sentence)
        return found

    def light(self) -> ChainStatus:
        """Return the result of the last verification, marked stale when the next one is long overdue."""
        found = self._found
        if found.state == "verified" and time.monotonic() - self._looked_s > LATE * self._pause_s:
            return ChainStatus("stale", found.last_id, found.at_utc, f"{found.sentence} Not verified since then.")
        return found

    @property
    def broken(self) -> str:
        """What the last verification found wrong with the log; empty for nothing."""
        return self._found.sentence if self._found.state == "broken" else ""

    def _verify_when_due(self) -> None:
        """Verify the chain at the start, and again after a pause in proportion to how long that took."""
        if self._found is NOT_YET or time.monotonic() - self._looked_s >= self._pause_s:
            self.verify()
