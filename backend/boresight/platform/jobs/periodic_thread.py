"""Work beside the requests: a thread that runs its steps periodically, and work of one that is claimed first."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextvars import copy_context
from functools import partial
from typing import Generic, Protocol, TypeVar

from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing

log = logging.getLogger(__name__)

Claim = TypeVar("Claim")


class PeriodicThread:
    """A thread that runs its steps periodically."""

    def __init__(
        self, name: str, steps: Sequence[Callable[[], None]], rest_s: Callable[[], float], least_s: float = 0.0
    ) -> None:
        self._name = name
        self._steps = steps
        self._rest_s = rest_s
        self._least_s = least_s
        self._nudge = threading.Event()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def closing(self) -> bool:
        """Whether it was asked to stop."""
        return self._closing.is_set()

    def start(self) -> None:
        """Start the thread in the context of who starts it; the first round is at once."""
        self._closing.clear()
        run = partial(copy_context().run, self._run)
        self._thread = threading.Thread(target=run, name=f"boresight-{self._name}", daemon=True)
        self._thread.start()

    def nudge(self) -> None:
        """Begin the next round now."""
        self._nudge.set()

    def close(self, patience_s: float | None = None) -> None:
        """Stop after the step that is under way, waiting for it at most for a given time; safe to call twice."""
        self._closing.set()
        self._nudge.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(patience_s)
            self._thread = None

    def take(self, step: Callable[[], None]) -> None:
        """Run a step; an error is logged."""
        try:
            step()
        except Exception:
            log.exception("The %s failed and is tried again", self._name)

    def _run(self) -> None:
        while not self._closing.is_set():
            for step in self._steps:
                self.take(step)
            self._closing.wait(self._least_s)
            self._nudge.wait(self._rest_s())
            self._nudge.clear()


class PeriodicWorker:
    """What one server does in a periodic thread of its own."""

    _thread: PeriodicThread
    patience_s: float | None = None  # that its end waits for the step under way; None for as long as it takes

    def start(self) -> None:
        """Start the thread; the first round is at once, for what became due while no server ran."""
        self._thread.start()

    def nudge(self) -> None:
        """Begin the next round now."""
        self._thread.nudge()

    def close(self) -> None:
        """Stop after the step that is under way; safe to call twice."""
        self._thread.close(self.patience_s)


class ClaimService(Protocol[Claim]):
    """A service whose work one server at a time claims, does, and puts back where it does not end."""

    def is_any_due(self, session: Session, /) -> bool:
        """Whether there is work."""

    def claim(self, session: Session, /) -> Claim | None:
        """Take the next piece; None where another server took it."""

    def put_back(self, session: Session, claimed: Claim, /) -> None:
        """Leave a piece to whoever claims it next."""


class ClaimingWorker(PeriodicWorker, Generic[Claim]):
    """A server that claims pieces of work, one after the other; several servers may share a database."""

    def __init__(self, database: Engine, service: ClaimService[Claim], tell: Callable[[], None]) -> None:
        self._database = database
        self._service = service
        self._tell = tell
        self._held: Claim | None = None

    def close(self) -> None:
        """Stop, and put back what does not end in time; safe to call twice."""
        super().close()
        if self._held is not None:
            self._put_back(self._held)

    def take_next(self, work: Callable[[Claim], None]) -> bool:
        """Claim a piece and do it; False where nothing is due."""
        with open_reading(self._database) as session:
            if not self._service.is_any_due(session):
                return False
        with open_writing(self._database) as session:
            claimed = self._service.claim(session)
        if claimed is not None:
            self._held = claimed
            work(claimed)
            self._held = None
        self._tell()
        return True

    def _put_back(self, claimed: Claim) -> None:
        with open_writing(self._database) as session:
            self._service.put_back(session, claimed)
