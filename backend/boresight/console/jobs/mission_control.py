"""The links of one server to mission control systems: telemetry is pulled by the policies in force, and events are told.

`console.mission_control.service` says what is taken. The network is asked outside transactions; each outcome is one. Several
servers may do this on one database.
"""

from __future__ import annotations

import hashlib
import logging
import tempfile
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from boresight.console.fleet import queries as sensor_rows
from boresight.console.ingest import policies
from boresight.console.ingest import queries as policy_rows
from boresight.console.ingest import service as ingest
from boresight.console.ingest.folder import TakenFile
from boresight.console.ingest.service import SentFile
from boresight.console.ingest.tables import IngestPolicy
from boresight.console.jobs.intake import Intake
from boresight.console.mission_control import queries as rows
from boresight.console.mission_control import service as links
from boresight.console.mission_control.service import Range
from boresight.errors import BoresightError, ConflictError, NotFoundError, UnavailableError
from boresight.mission_control.archive import Archive, ArchiveRows, count_us, write_time
from boresight.mission_control.connection import TooMuchError
from boresight.mission_control.systems import TITLES, Link
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_now
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker
from boresight.settings import Settings
from boresight.telemetry.imports.profile import Profile

log = logging.getLogger(__name__)

ROUND_S = 5.0
SHORTEST_US = 60_000_000  # of a range that is asked for in smaller pieces


class MissionControl(PeriodicWorker):
    """What one server does over its links."""

    def __init__(
        self,
        database: Engine,
        sources: ForecastSources,
        settings: Settings,
        tell: Callable[[], None],
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._database = database
        self._intake = Intake(database, sources, settings)
        self._settings = settings
        self._tell = tell
        self._now = now
        self.links: Mapping[str, Link] = settings.mission_control
        self._thread = PeriodicThread("mission-control", [self.pull, self.tell_events], lambda: ROUND_S)

    def pull(self) -> None:
        """Pull what is due, by every policy in force that names an archive."""
        with open_reading(self._database) as session:
            due = []
            for policy in policy_rows.list_policies_in_force(session):
                if policy.state == "ACTIVE" and policies.read_rules(policy).feed:
                    link = rows.find_link(session, policy.sensor_id)
                    if link is None or link.due_utc <= utc_now():
                        due.append(policy.id)
        for policy_id in due:
            if self._thread.closing:
                return
            self._thread.take(partial(self._pull, policy_id))

    def _pull(self, policy_id: int) -> None:
        now_us = count_us(self._now())
        with open_writing(self._database) as session:
            policy = session.get_known(IngestPolicy, policy_id)
            rules = policies.read_rules(policy)
            row = links.open_link(session, rules.feed, policy.sensor_id, policy.enabled_utc or utc_now())
            asked = links.plan_range(row, rules, now_us)
        with open_reading(self._database) as session:
            try:
                policy = ingest.get_active_policy(session, policy.sensor_id)
            except ConflictError:
                return  # it was paused since, or the clock is in doubt
            flood = ingest.explain_flood(session, policy)
            intake = ingest.read_intake(session, policy.sensor_id)
            sensor = sensor_rows.read_names(session, {policy.sensor_id})[policy.sensor_id]
        if flood is not None:
            with open_writing(self._database) as session:
                policies.pause(session, session.get_known(IngestPolicy, policy.id), "TOO MANY SETS", flood)
            self._tell()
            return
        try:
            if intake.wanted is None or intake.wanted.profile is None:
                raise NotFoundError("The policy has no mapping profile; write a version with one.")
            found, asked = self._export(rules.feed, intake.wanted.profile, asked)
        except BoresightError as error:
            self._fail(asked.link_id, error)
            return
        new = links.choose_new(found, asked, rules, now_us)
        if new is None:
            with open_writing(self._database) as session:
                links.note_waiting(session, asked, rules)
        elif not new.lines:
            with open_writing(self._database) as session:
                links.note_taken(session, asked, new, rules)
        else:
            self._take(policy, rules.feed, sensor, asked, new)

    def _export(self, system: str, profile: Profile, asked: Range) -> tuple[ArchiveRows, Range]:
        """Return the archive's rows of a range, or of the first part of it that has new ones where the whole is too much."""
        link = self.links.get(system)
        if link is None:
            raise NotFoundError(f"{TITLES[system]} is not set here: give the server BORESIGHT_{system.upper()}_URL.")
        with closing(link.open()) as archive:
            return _export_part(archive, profile, asked)

    def _take(self, policy: IngestPolicy, system: str, sensor: str, asked: Range, new: ArchiveRows) -> None:
        """Take rows in as one set, and put the range on record in the same transaction."""
        content = new.to_bytes()
        first, last = (write_time(int(at))[:19].replace(":", "") for at in (new.times_us[0], new.times_us[-1]))
        name = f"{system}-{sensor}-{first}-{last}.{'tsv' if system == 'yamcs' else 'csv'}"
        sent = SentFile("ARCHIVE", name, hashlib.sha256(content).hexdigest(), len(content))
        uploads = self._settings.data_folder / "uploads"
        uploads.mkdir(exist_ok=True)
        rules = policies.read_rules(policy)
        beside = partial(links.note_taken, asked=asked, new=new, rules=rules)
        try:
            with tempfile.TemporaryDirectory(dir=uploads) as place:
                path = Path(place) / "file"
                path.write_bytes(content)
                taken = TakenFile(path, name, sent.sha256 or "", sent.size_bytes)
                self._intake.receive(policy, taken, sent, beside)
        except (UnavailableError, ConflictError) as error:
            log.warning("What %s exported is asked for again: %s", TITLES[system], error)
        except BoresightError as error:
            self._intake.refuse(policy, sent, error, beside)
        self._tell()

    def _fail(self, link_id: int, error: BoresightError) -> None:
        with open_writing(self._database) as session:
            row = links.note_failure(session, link_id, str(error))
        log.warning("%s (failure %d in a row, next try %s)", error, row.failures, row.due_utc)

    def tell_events(self) -> None:
        """Tell Yamcs what happened since it was told last, in order; what is sent again is the same event there."""
        link = self.links.get("yamcs")
        if link is None or not self._settings.yamcs_events:
            return
        with open_reading(self._database) as session:
            row = rows.find_event_link(session, "yamcs")
            if row is not None and row.due_utc > utc_now():
                return
            events, newest = ([], 0) if row is None else links.list_new_events(session, row)
        if row is None:
            with open_writing(self._database) as session:
                links.open_link(session, "yamcs", None, utc_now())
            return
        if newest == row.told_audit_id and not row.failures:
            return
        try:
            with closing(link.open_events()) as yamcs:
                for event in events:
                    yamcs.post_event(event)
        except BoresightError as error:
            self._fail(row.id, error)
            return
        with open_writing(self._database) as session:
            links.note_told(session, row.id, newest)


def _export_part(archive: Archive, profile: Profile, asked: Range) -> tuple[ArchiveRows, Range]:
    """Return what one request may bring, and the range that it is of."""
    try:
        return archive.export(profile, asked.start_us, asked.stop_us), asked
    except TooMuchError:
        middle_us = (asked.start_us + asked.stop_us) // 2
        if middle_us - asked.start_us < SHORTEST_US:
            raise
        found, first = _export_part(archive, profile, replace(asked, stop_us=middle_us))
        if found.without(asked.taken_us).lines:
            return found, first
        return _export_part(archive, profile, replace(asked, start_us=first.stop_us))
