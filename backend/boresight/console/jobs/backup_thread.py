"""The backup thread: takes the backup that is due, tries to restore it, and removes what newer ones replace."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from boresight.console.backups import service
from boresight.console.backups.service import ClaimedBackup
from boresight.errors import BoresightError, CancelledError
from boresight.platform.audit import log as audit
from boresight.platform.backups.destinations import Destination, open_destination
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db import backup as backups
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs.periodic_thread import ClaimingWorker, PeriodicThread
from boresight.settings import Settings

log = logging.getLogger(__name__)

ROUND_S = 20.0
MOST_REMOVED = 20  # files a round


class BackupThread(ClaimingWorker[ClaimedBackup]):
    """The scheduled backups of one server; several servers may share a database."""

    patience_s = 10.0

    def __init__(self, database: Engine, blobs: BlobStore, settings: Settings, tell: Callable[[], None]) -> None:
        super().__init__(database, service, tell)
        self._blobs = blobs
        self._url = settings.database_url
        self._scratch = settings.data_folder
        self._keys = settings.backup_keys
        self._is_lost = False
        self._thread = PeriodicThread("backups", [self.work, self.remove_superfluous], lambda: ROUND_S)

    def work(self) -> None:
        """Take the backup that is due, if one is."""
        self.take_next(self._take)

    @contextmanager
    def _renewing(self, claimed: ClaimedBackup) -> Iterator[None]:
        """Keep a claim while a backup is taken, however long that is."""

        def renew() -> None:
            with open_writing(self._database) as session:
                self._is_lost = not service.renew(session, claimed)

        renewing = PeriodicThread("backup-lease", [renew], lambda: service.LEASE_S / 6)
        renewing.start()
        try:
            yield
        finally:
            renewing.close()
            self._is_lost = False

    def _refuse_to_go_on(self) -> None:
        if self._thread.closing or self._is_lost:
            raise CancelledError("The backup was stopped; it is taken again.")

    def _take(self, claimed: ClaimedBackup) -> None:
        """Take a backup while its claim is renewed."""
        with self._renewing(claimed):
            self._write_and_try(claimed)

    def _write_and_try(self, claimed: ClaimedBackup) -> None:
        """Write a backup, restore it on trial, and write how it ended, whatever happens."""
        try:
            destination = open_destination(claimed.destination, self._scratch)
            if claimed.former_name is not None:
                destination.remove(claimed.former_name)
            if not self._write(claimed, destination):
                destination.remove(claimed.name)
                return
            with destination.open(claimed.name) as file:
                found = backups.try_restore(file, self._scratch, self._keys)
            with open_writing(self._database) as session:
                service.record_test(session, claimed, found)
        except CancelledError:
            self._put_back(claimed)
        except BoresightError as error:
            self._fail(claimed, str(error))
        except Exception as error:
            log.exception("Backup %d failed", claimed.backup_id)
            self._fail(claimed, f"It stopped with {type(error).__name__}, {error}: look into the server's log.")

    def _write(self, claimed: ClaimedBackup, destination: Destination) -> bool:
        """Write a backup to its place; False where another server has taken it meanwhile."""
        key = self._keys.first()
        with open_reading(self._database) as session:
            head = audit.head(session)
        taken: list[backups.BackupSummary] = []

        def write(place: Path) -> None:
            taken.append(
                backups.write_backup(
                    self._url,
                    self._blobs,
                    head,
                    place,
                    keep_going=True,
                    key=key,
                    scratch=self._scratch,
                    proceed=self._refuse_to_go_on,
                )
            )

        size = destination.write(claimed.name, write)
        with open_writing(self._database) as session:
            return service.record_written(session, claimed, taken[0], size, key.id)

    def _fail(self, claimed: ClaimedBackup, sentence: str) -> None:
        log.error("Backup %d failed: %s", claimed.backup_id, sentence)
        with open_writing(self._database) as session:
            service.fail(session, claimed, sentence)

    def remove_superfluous(self) -> None:
        """Remove the files of backups that newer ones replace: first the file, then its row says so."""
        with open_reading(self._database) as session:
            schedule = service.find_schedule(session)
            rows = service.list_superfluous(session)[:MOST_REMOVED]
        if schedule is None or not rows:
            return
        destination = open_destination(schedule.destination, self._scratch)
        for row in rows:
            destination.remove(row.name)
            with open_writing(self._database) as session:
                service.record_removed(session, row.id)
        self._tell()
