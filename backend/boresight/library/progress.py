"""Progress of long computations on standard error: a bar in a terminal or a notebook, elsewhere one line after a second."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from boresight.waiting import report_waits_to

PATIENCE_S = 1.0
#: Called with a message and, if known, the fraction that is done.
Report = Callable[[str, float | None], None]
#: True always shows progress, False never, a function receives it, None shows it in terminals and notebooks.
Wanted = bool | Report | None


class Progress:
    """A bar or a line; call it with a message, and with a fraction where one is known."""

    def __init__(self, message: str) -> None:
        self._message = message
        self._bar = _Bar(message) if sys.stderr.isatty() or _has_widgets() else None
        self._timer = threading.Timer(PATIENCE_S, self._speak)
        self._timer.daemon = True
        self._timer.start()

    def __call__(self, message: str, fraction: float | None = None) -> None:
        """Say what is being done, and how much of it is done (0 to 1)."""
        self._message = message
        if self._bar is not None:
            self._bar.update(message, fraction)

    def _speak(self) -> None:
        if self._bar is not None:
            self._bar.start()
        else:
            print(f"boresight: {self._message} ...", file=sys.stderr)  # noqa: T201 - it is what was asked for

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        if self._bar is not None:
            self._bar.stop()


class _Bar:
    """The bar, whose library is loaded only where it is shown."""

    def __init__(self, message: str) -> None:
        from rich import progress as rich
        from rich.console import Console

        columns = (
            rich.SpinnerColumn(),
            rich.TextColumn("{task.description}", markup=False),
            rich.BarColumn(),
            rich.TaskProgressColumn(),
            rich.TimeElapsedColumn(),
        )
        self._progress = rich.Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(message, total=None)

    def start(self) -> None:
        self._progress.start()

    def update(self, message: str, fraction: float | None) -> None:
        self._progress.update(self._task, description=message, completed=fraction or 0.0)
        if fraction is not None:
            self._progress.update(self._task, total=1.0)

    def stop(self) -> None:
        self._progress.stop()


def is_watched() -> bool:
    """Whether the output is a terminal or a notebook."""
    return sys.stderr.isatty() or _is_notebook()


def _is_notebook() -> bool:
    return "ipykernel" in sys.modules


def _has_widgets() -> bool:
    """Whether a notebook can show a bar; without widgets it shows lines."""
    return _is_notebook() and find_spec("ipywidgets") is not None


@contextmanager
def progress(message: str) -> Iterator[Progress]:
    """Show progress while the block runs."""
    shown = Progress(message)
    try:
        with report_waits_to(shown):
            yield shown
    finally:
        shown.close()


@contextmanager
def reporting(wanted: Wanted, message: str) -> Iterator[Report]:
    """Report progress as the caller asked; where nobody watches, only compiling is logged, and with False nothing."""
    if callable(wanted):
        with report_waits_to(wanted):
            yield wanted
    elif wanted or (wanted is None and is_watched()):
        with progress(message) as shown:
            yield shown
    elif wanted is None:
        yield _say_nothing
    else:
        with report_waits_to(_say_nothing):
            yield _say_nothing


def _say_nothing(message: str, fraction: float | None = None) -> None:
    """Ignore a report."""
