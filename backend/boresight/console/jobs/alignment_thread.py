"""The alignment thread: computes one alignment after the other outside of transactions; see `console.alignments.service`."""

from __future__ import annotations

import logging
from collections.abc import Callable

from boresight.console.alignments import service
from boresight.console.alignments.computation import compute
from boresight.console.alignments.service import ClaimedAlignment
from boresight.errors import BoresightError, CancelledError
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.periodic_thread import PeriodicThread

log = logging.getLogger(__name__)

ROUND_S = 2.0
PATIENCE_S = 10.0


class AlignmentThread:
    """The alignments of one server; several servers may share a database."""

    def __init__(self, database: Engine, sources: ForecastSources, tell: Callable[[], None]) -> None:
        self._database = database
        self._sources = sources
        self._tell = tell
        self._held: ClaimedAlignment | None = None
        self._thread = PeriodicThread("alignments", [self.work], lambda: ROUND_S)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop, and queue again what does not end in time; safe to call twice."""
        self._thread.close(PATIENCE_S)
        if self._held is not None:
            with open_writing(self._database) as session:
                service.put_back(session, self._held)

    def work(self) -> None:
        """Compute every alignment that waits."""
        while not self._thread.closing:
            with open_reading(self._database) as session:
                if not service.is_any_due(session):
                    return
            with open_writing(self._database) as session:
                claimed = service.claim(session)
            if claimed is not None:
                self._held = claimed
                self._compute(claimed)
                self._held = None
            self._tell()

    def _compute(self, claimed: ClaimedAlignment) -> None:
        """Compute one and write how it ended, whatever happens."""
        try:
            made = compute(claimed, self._sources, lambda: self._thread.closing)
        except CancelledError:
            with open_writing(self._database) as session:
                service.put_back(session, claimed)
            return
        except BoresightError as error:
            self._fail(claimed, str(error))
            return
        except Exception as error:
            log.exception("Alignment %d failed", claimed.alignment_id)
            self._fail(claimed, f"The computation failed, {type(error).__name__}: {error}")
            return
        with open_writing(self._database) as session:
            service.finish(session, self._sources.blobs, claimed, made)

    def _fail(self, claimed: ClaimedAlignment, reason: str) -> None:
        with open_writing(self._database) as session:
            service.fail(session, claimed, reason)
