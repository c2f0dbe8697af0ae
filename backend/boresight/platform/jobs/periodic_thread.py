"""The periodic thread: runs its steps, waits, and runs them again until it is closed."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextvars import copy_context
from functools import partial

log = logging.getLogger(__name__)


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
