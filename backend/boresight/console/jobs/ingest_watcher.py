"""The ingest watcher: takes files from the watched folder, and decides on what was calibrated; see `console.ingest.service`.

Reading, checking and judging happen outside transactions, each write is one. Every step may be repeated: what was received is known
by its bytes, a decision is written only while it is CALIBRATING, and several servers may watch the same folder.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from boresight.console.approvals import gates
from boresight.console.fleet import queries as sensor_rows
from boresight.console.ingest import policies, service
from boresight.console.ingest import queries as rows
from boresight.console.ingest.folder import DONE, REFUSED, Arrival, TakenFile, WatchedFolder
from boresight.console.ingest.service import SentFile
from boresight.console.ingest.tables import IngestPolicy
from boresight.console.jobs.intake import Intake
from boresight.errors import BoresightError, ConflictError, UnavailableError
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.periodic_thread import PeriodicThread
from boresight.settings import Settings

log = logging.getLogger(__name__)

ROUND_S = 2.0


class IngestWatcher:
    """The watcher of one server; without a folder it only decides on what was calibrated."""

    def __init__(
        self, database: Engine, sources: ForecastSources, settings: Settings, tell: Callable[[], None]
    ) -> None:
        self._database = database
        self._sources = sources
        self._intake = Intake(database, sources, settings)
        self._settings = settings
        self._tell = tell
        watched = settings.watched_folder
        self._folder = None if watched is None else WatchedFolder(watched, settings.watch_settle_s)
        self.fault = ""  # what is wrong with the watched folder
        self._thread = PeriodicThread("ingest", [self.look, self.decide], lambda: ROUND_S)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop; safe to call twice."""
        self._thread.close()

    @property
    def folder(self) -> str | None:
        """Address of the watched folder; None where none is watched."""
        return None if self._folder is None else str(self._folder.folder)

    def count_waiting(self, sensor: str) -> int:
        """Count the files that lie in a sensor's sub-folder."""
        return 0 if self._folder is None else self._folder.count_waiting(sensor)

    def look(self) -> None:
        """Take in the files that are complete, of sensors whose policy is active."""
        if self._folder is None or not (complete := self._list_complete(self._folder)):
            return
        with open_reading(self._database) as session:
            active = {row.sensor_id for row in rows.list_policies_in_force(session) if row.state == "ACTIVE"}
            sensors = (
                {name: number for number, name in sensor_rows.read_names(session, active).items()} if active else {}
            )
        for arrival in complete:
            if self._thread.closing:
                return
            if arrival.sensor in sensors:
                self._thread.take(partial(self._take, self._folder, arrival, sensors[arrival.sensor]))

    def _list_complete(self, folder: WatchedFolder) -> list[Arrival]:
        """Look into the folder; what is wrong with it is logged once and shown on the page until it is mended."""
        try:
            complete = folder.list_complete()
        except UnavailableError as error:
            if str(error) != self.fault:
                log.warning("%s", error)
            self.fault = str(error)
            return []
        self.fault = ""
        return complete

    def _take(self, folder: WatchedFolder, arrival: Arrival, sensor_id: int) -> None:
        """Take one file in; what stops the policy leaves the file where it is."""
        with open_reading(self._database) as session:
            try:
                policy = service.get_active_policy(session, sensor_id)
            except ConflictError:
                return  # it was paused since, or the clock is in doubt
            flood = service.explain_flood(session, policy)
        if flood is not None:
            self._pause(policy, "TOO MANY SETS", flood)
            return
        uploads = self._settings.data_folder / "uploads"
        uploads.mkdir(exist_ok=True)
        sent = SentFile("FOLDER", arrival.name, None, arrival.size_bytes)
        try:
            with tempfile.TemporaryDirectory(dir=uploads) as place:
                most_bytes = int(self._settings.upload_limit_mb * 1e6)
                taken = folder.take(arrival, Path(place) / "file", most_bytes)
                if taken is None:
                    return  # it is still written
                sent = SentFile("FOLDER", arrival.name, taken.sha256, taken.size_bytes)
                to, reason = self._read(policy, taken, sent)
        except FileNotFoundError:
            return  # another server took it
        except (UnavailableError, ConflictError):
            raise  # it is tried again, and the file is where it was
        except BoresightError as error:
            to, reason = REFUSED, f"Decision {self._intake.refuse(policy, sent, error).id}: {error}"
        self._settle(folder, arrival, policy, to, reason)
        self._tell()

    def _read(self, policy: IngestPolicy, taken: TakenFile, sent: SentFile) -> tuple[str, str]:
        """Read, check and receive a file; returns where it goes, and why."""
        row, came_before = self._intake.receive(policy, taken, sent)
        to = REFUSED if row.state == "REFUSED" else DONE
        if came_before:
            return to, f"These bytes came before, decision {row.id}: {row.sentence}"
        return to, f"Decision {row.id}: {row.sentence}" if to == REFUSED else ""

    def _settle(self, folder: WatchedFolder, arrival: Arrival, policy: IngestPolicy, to: str, reason: str) -> None:
        try:
            folder.settle(arrival, to, reason)
        except FileNotFoundError:
            return  # another server moved it
        except OSError as error:
            said = (
                f"{arrival.name} cannot be moved to {to} ({error.strerror}): give the server the right to write there."
            )
            self._pause(policy, "FOLDER", said)

    def _pause(self, policy: IngestPolicy, code: str, reason: str) -> None:
        log.warning("Ingest of sensor %d is paused: %s", policy.sensor_id, reason)
        with open_writing(self._database) as session:
            policies.pause(session, session.get_known(IngestPolicy, policy.id), code, reason)
        self._tell()

    def decide(self) -> None:
        """Judge what was calibrated, and close questions whose baseline moved."""
        with open_reading(self._database) as session:
            due, overtaken = service.list_due(session), service.list_overtaken(session)
        for decision_id in overtaken:
            with open_writing(self._database) as session:
                service.supersede_overtaken(session, decision_id)
        for decision_id in due:
            if self._thread.closing:
                return
            self._thread.take(partial(self._decide, decision_id))
        if due or overtaken:
            self._tell()

    def _decide(self, decision_id: int) -> None:
        with open_reading(self._database) as session:
            found = service.examine(session, decision_id)
        assessment = None
        if found.judgement.state == "ASKED":
            with open_writing(self._database) as session:
                number = service.prepare_set(session, self._sources.blobs, decision_id).id
            with open_reading(self._database) as session:
                inputs = gates.read_gate_inputs(session, number)
            assessment = gates.examine(
                inputs, self._sources.blobs, self._sources.catalogue(), self._sources.catalogue_folder
            )
        with open_writing(self._database) as session:
            service.conclude(session, found, assessment)
