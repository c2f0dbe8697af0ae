"""The retention thread: removes the files of telemetry that nothing needs, where a policy is set."""

from __future__ import annotations

import logging
from collections.abc import Callable

from boresight.console.retention import service
from boresight.errors import ConflictError
from boresight.platform.actors import SYSTEM
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, open_reading
from boresight.platform.jobs.periodic_thread import PeriodicThread, PeriodicWorker

log = logging.getLogger(__name__)

ROUND_S = 3600.0
MOST_REMOVED = 100  # sets a round


class RetentionThread(PeriodicWorker):
    """The retention of one server; several may share a database: each removal is judged in its transaction."""

    patience_s = 5.0

    def __init__(self, database: Engine, blobs: BlobStore, keep_days: float, tell: Callable[[], None]) -> None:
        self._database = database
        self._blobs = blobs
        self._keep_days = keep_days
        self._tell = tell
        self._thread = PeriodicThread("retention", [self.sweep, self.work], lambda: ROUND_S)

    def start(self) -> None:
        """Start the thread, where there is a policy."""
        if self._keep_days > 0:
            super().start()

    def sweep(self) -> None:
        """Take off the disk what a server that was killed had marked alone."""
        with open_reading(self._database) as session:
            removed = service.list_swept(session)
        service.discard(self._database, self._blobs, removed)

    def work(self) -> None:
        """Remove what the policy lets go."""
        with open_reading(self._database) as session:
            going = service.preview(session, self._keep_days).going[:MOST_REMOVED]
        for one in going:
            if self._thread.closing:
                return
            try:
                service.remove(self._database, self._blobs, SYSTEM, one.row.id, self._keep_days)
            except ConflictError as error:
                log.info("%s", error)  # somebody has used it meanwhile
        if going:
            self._tell()
