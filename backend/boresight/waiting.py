"""Reports of progress, and those on compiling the kernels, which is done once per machine and makes the caller wait."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

Report = Callable[[str, float], None]  # message, and the fraction that is done

_receivers: list[Report] = []


def ignore_progress(message: str, share: float | None) -> None:
    """Take a report of progress where nobody asks for it."""


@contextmanager
def report_waits_to(report: Report) -> Iterator[None]:
    """Send reports of compiling within the block to `report`; of nested blocks the innermost receives them."""
    _receivers.append(report)
    try:
        yield
    finally:
        _receivers.remove(report)


def tell(message: str, share: float) -> None:
    """Report progress to the innermost receiver, or without one log the start once."""
    if _receivers:
        _receivers[-1](message, share)
    elif share == 0.0:
        log.warning("Boresight is %s; this takes a few seconds.", message)
