"""Progress on standard error: a bar in a terminal, one plain line elsewhere, nothing for what ends within a second."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import click

PATIENCE_S = 1.0


class Progress:
    """A bar or a line; call it with a message, and with a fraction where one is known."""

    def __init__(self, message: str) -> None:
        self._message = message
        self._bar = _Bar(message) if sys.stderr.isatty() else None
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
            click.echo(f"boresight: {self._message} ...", err=True)

    def close(self) -> None:
        """Take the bar away."""
        self._timer.cancel()
        if self._bar is not None:
            self._bar.stop()


class _Bar:
    """The bar itself; loads its library only in a terminal."""

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


@contextmanager
def progress(message: str) -> Iterator[Progress]:
    """Show progress while the block runs."""
    shown = Progress(message)
    try:
        yield shown
    finally:
        shown.close()
