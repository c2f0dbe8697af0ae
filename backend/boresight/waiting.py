"""Who is told how far something is that is done once a machine, when somebody has to wait for it: the loops being compiled."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

Report = Callable[[str, float], None]  # message, and the share that is done

_told: list[Report] = []


@contextmanager
def report_waits_to(report: Report) -> Iterator[None]:
    """Let `report` be told of what this process waits for within; of several the innermost is."""
    _told.append(report)
    try:
        yield
    finally:
        _told.remove(report)


def tell(message: str, share: float) -> None:
    """Tell whoever is to be told; where nobody is, the log once."""
    if _told:
        _told[-1](message, share)
    elif share == 0.0:
        log.warning("Boresight is %s; a few seconds.", message)
