"""The ingest watcher: takes files from the watched folder and bucket, and decides on what was calibrated.

`console.ingest.service` says what a file goes through. Reading, checking and judging happen outside transactions, and each write is
one. Files of several sensors are taken at a time (`file_queue`), and what was calibrated is judged beside that. Every step may be
repeated: what was received is known by its bytes, a decision is written only while it is CALIBRATING, and several servers may watch
the same places.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from boresight.console.approvals import gates
from boresight.console.fleet import queries as sensor_rows
from boresight.console.ingest import policies, service
from boresight.console.ingest import queries as rows
from boresight.console.ingest.folder import DONE, REFUSED, Arrival, TakenFile, WatchedFolder
from boresight.console.ingest.service import SentFile
from boresight.console.ingest.tables import IngestPolicy
from boresight.console.jobs.file_queue import FileQueue, WaitingFile
from boresight.console.jobs.intake import Intake, write_nothing
from boresight.errors import BoresightError, ConflictError, RefusedInputError, UnavailableError
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker
from boresight.settings import Settings

if TYPE_CHECKING:
    from boresight.console.ingest.bucket import ArrivedObject, WatchedBucket

log = logging.getLogger(__name__)

ROUND_S = 2.0
T = TypeVar("T")


def open_watched_bucket(settings: Settings) -> WatchedBucket | None:
    """Return the bucket that is watched; None where none is."""
    if not settings.watch_bucket:
        return None
    try:
        from boresight.console.ingest.bucket import WatchedBucket  # noqa: PLC0415 - an optional part
    except ImportError as error:
        raise RefusedInputError(
            "A watched bucket needs the object store's library: pip install 'boresight[object-store]'."
        ) from error
    return WatchedBucket(settings.watch_bucket, settings.watch_bucket_s)


@dataclass(frozen=True)
class FoundFile:
    """A file in a watched place: how it is copied, what follows once it is decided on, and what is written with the decision."""

    take: Callable[[Path, int], TakenFile | None]
    settle: Callable[[IngestPolicy, str, str], None]
    beside: Callable[[Session], None] = write_nothing


class IngestWatcher(PeriodicWorker):
    """The watcher of one server; without a folder or bucket it only decides on what was calibrated."""

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
        self._bucket = open_watched_bucket(settings)
        self._faults = {"folder": "", "bucket": ""}
        self._files = FileQueue("ingest")
        self._thread = PeriodicThread("ingest", [self.look, self.look_into_bucket], lambda: ROUND_S)
        self._judge = PeriodicThread("judgement", [self.decide], lambda: ROUND_S)

    def start(self) -> None:
        """Start the threads."""
        super().start()
        self._judge.start()

    def close(self) -> None:
        """Stop; safe to call twice."""
        super().close()
        self._judge.close()
        self._files.close()

    @property
    def places(self) -> list[str]:
        """Addresses of the watched folder and bucket."""
        folder = [] if self._folder is None else [str(self._folder.folder)]
        return folder + ([] if self._bucket is None else [self._bucket.address])

    @property
    def fault(self) -> str:
        """What is wrong with the watched folder or bucket, or with the files that are under way."""
        return " ".join(filter(None, [*self._faults.values(), self._files.fault]))

    def describe_work(self, sensor: str) -> str:
        """Say which file of a sensor is being read; empty where none is."""
        return self._files.describe(sensor)

    def count_waiting(self, sensor: str) -> int:
        """Count the files of a sensor that were not taken yet."""
        watched = (self._folder, self._bucket)
        return sum(place.count_waiting(sensor) for place in watched if place is not None)

    def look(self) -> None:
        """Take in the files that are complete, of sensors whose policy is active."""
        if self._folder is None or not (complete := self._list(self._folder.list_complete, "folder")):
            return
        sensors, files = self._read_active(), list[WaitingFile]()
        for arrival in complete:
            if arrival.sensor in sensors:
                sent = SentFile("FOLDER", arrival.name, None, arrival.size_bytes)
                settle = partial(self._settle, self._folder, arrival)
                found = FoundFile(partial(self._folder.take, arrival), settle)
                files.append(self._wait(arrival.sensor, sensors[arrival.sensor], sent, found))
        self._files.take_all(files, lambda: self._thread.closing)

    def look_into_bucket(self) -> None:
        """Take in the objects that are new, of sensors whose policy is active."""
        if self._bucket is None or not (sensors := self._read_active()):
            return
        arrived = self._list(partial(self._bucket.list_new, sorted(sensors)), "bucket")
        if not arrived:
            return
        with open_reading(self._database) as session:
            taken = rows.find_taken_objects(session, {one.address for one in arrived})
        files: list[WaitingFile] = []
        for one in arrived:
            if one.key in taken:
                self._bucket.note_known(one)
                continue
            sent = SentFile("BUCKET", one.name, None, one.size_bytes)
            beside = partial(rows.note_taken_object, address=one.address, version=one.version)
            found = FoundFile(partial(self._bucket.take, one), partial(self._know, one), beside)
            files.append(self._wait(one.sensor, sensors[one.sensor], sent, found))
        if not self._files.take_all(files, lambda: self._thread.closing):
            self._bucket.look_again()

    def _wait(self, sensor: str, sensor_id: int, sent: SentFile, found: FoundFile) -> WaitingFile:
        take = partial(self._thread.take, partial(self._take, sensor_id, sent, found))
        return WaitingFile(sensor, sent.name, take)

    def _read_active(self) -> dict[str, int]:
        """Return the sensors whose policy is active, by their names."""
        with open_reading(self._database) as session:
            active = {row.sensor_id for row in rows.list_policies_in_force(session) if row.state == "ACTIVE"}
            return {name: number for number, name in sensor_rows.read_names(session, active).items()} if active else {}

    def _list(self, look: Callable[[], list[T]], place: str) -> list[T]:
        """Look into a place; what is wrong with it is logged once and shown on the page until it is mended."""
        try:
            found = look()
        except BoresightError as error:
            if str(error) != self._faults[place]:
                log.warning("%s", error)
            self._faults[place] = str(error)
            return []
        self._faults[place] = ""
        return found

    def _take(self, sensor_id: int, sent: SentFile, found: FoundFile) -> None:
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
        try:
            with tempfile.TemporaryDirectory(dir=uploads) as place:
                most_bytes = int(self._settings.upload_limit_mb * 1e6)
                taken = found.take(Path(place) / "file", most_bytes)
                if taken is None:
                    return  # it is still written
                sent = replace(sent, sha256=taken.sha256, size_bytes=taken.size_bytes)
                to, reason = self._read(policy, taken, sent, found)
        except FileNotFoundError:
            return  # another server took it
        except (UnavailableError, ConflictError):
            raise  # it is tried again, and the file is where it was
        except BoresightError as error:
            decision = self._intake.refuse(policy, sent, error, found.beside)
            to, reason = REFUSED, f"Decision {decision.id}: {error}"
        found.settle(policy, to, reason)
        self._tell()

    def _read(self, policy: IngestPolicy, taken: TakenFile, sent: SentFile, found: FoundFile) -> tuple[str, str]:
        """Read, check and receive a file; returns where it goes, and why."""
        row, came_before = self._intake.receive(policy, taken, sent, found.beside)
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

    def _know(self, arrived: ArrivedObject, _policy: IngestPolicy, _to: str, _reason: str) -> None:
        """Leave an object as it is, and remember it."""
        if self._bucket is not None:
            self._bucket.note_known(arrived)

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
            if self._judge.closing:
                return
            self._judge.take(partial(self._decide, decision_id))
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
