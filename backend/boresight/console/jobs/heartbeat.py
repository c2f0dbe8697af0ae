"""The heartbeat: handles what becomes due by time alone, such as expiry and overdue alarms; writes only when something is due."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from boresight.console.alarms import rules as alarm_rules
from boresight.console.approvals import staleness
from boresight.console.change_proposals import service as proposals
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker

BEAT_S = 5.0


class Heartbeat(PeriodicWorker):
    """The heartbeat of one server."""

    def __init__(self, database: Engine, tell: Callable[[], None], seen_file: Path | None = None) -> None:
        self._database = database
        self._tell = tell
        self._seen_file = seen_file
        self._looked_back = False
        self._thread = PeriodicThread("heartbeat", [self.beat], lambda: BEAT_S)

    def look_at_clock(self) -> None:
        """Raise an alarm when the clock jumped, and return it to normal once somebody has acknowledged it."""
        seen_s = None if self._looked_back else self._seen_s()
        with open_reading(self._database) as session:
            held, acknowledged = (
                alarm_rules.find_active(session, alarm_rules.CLOCK) is not None,
                alarm_rules.is_acknowledged(session),
            )
        found = None if held else alarm_rules.check_clock(seen_s)
        if found is not None or acknowledged:
            with open_writing(self._database) as session:
                alarm_rules.update_installation_alarms(session, {alarm_rules.CLOCK: found})
            self._tell()
        if found is not None or held:
            alarm_rules.OURS.agree()  # while the alarm is active nothing expires
        self._looked_back = True
        if self._seen_file is not None:
            with suppress(OSError):
                self._seen_file.write_text(str(alarm_rules.OURS.now_s()), encoding="ascii")

    def _seen_s(self) -> float | None:
        """Return the time at which a server of this installation last ran."""
        try:
            return None if self._seen_file is None else float(self._seen_file.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return None

    def beat(self) -> None:
        """Expire everything whose time is over, unless the clock jumped."""
        self.look_at_clock()
        with open_reading(self._database) as session:
            if alarm_rules.is_held(session):
                return
            waiting = staleness.is_any_request_due(session) or proposals.is_any_due(session)
        if waiting:
            with open_writing(self._database) as session:
                staleness.expire_due_requests(session)
                proposals.expire_due(session)
            self._tell()
