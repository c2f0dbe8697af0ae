"""The server's heartbeat: what happens because time passes, and nobody asks for it.

One thread looks every few seconds for requests for approval whose time is over, in a reading transaction that holds
nobody up, and writes only when there are any.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from boresight.services import approvals
from boresight.store.sessions import Engine, reading, writing

log = logging.getLogger(__name__)

BEAT_S = 5.0


class Heartbeat:
    """The heartbeat of one server.

    Parameters
    ----------
    database
        Where the requests are.
    tell
        Called after something was written, for those who follow the store.
    """

    def __init__(self, database: Engine, tell: Callable[[], None]) -> None:
        self._database = database
        self._tell = tell
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to beat; the first beat is at once, for what became due while no server ran."""
        self._closing.clear()
        self._thread = threading.Thread(target=self._run, name="boresight-heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; safe to call twice."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def beat(self) -> None:
        """Let everything expire whose time is over."""
        with reading(self._database) as session:
            waiting = approvals.any_due(session)
        if waiting:
            with writing(self._database) as session:
                approvals.expire_due(session)
            self._tell()

    def _run(self) -> None:
        """Beat until closed; an error is logged and the next beat tries again."""
        while not self._closing.is_set():
            try:
                self.beat()
            except Exception:
                log.exception("The heartbeat could not let requests expire and tries again")
            self._closing.wait(BEAT_S)
