"""A slow health check whose result is cached for some seconds, so that monitoring does not load the server."""

from __future__ import annotations

import time
from collections.abc import Callable

from boresight.errors import BoresightError

LOOK_AGAIN_S = 5.0


class CachedCheck:
    """Something that is usable or not."""

    def __init__(self, refuse: Callable[[], None]) -> None:
        self._refuse = refuse
        self._fault = ""
        self._looked_s = float("-inf")

    def fault(self) -> str:
        """Return what is wrong, as it was some seconds ago at most; empty where nothing is."""
        if time.monotonic() - self._looked_s > LOOK_AGAIN_S:
            try:
                self._refuse()
                self._fault = ""
            except BoresightError as error:
                self._fault = str(error)
            self._looked_s = time.monotonic()
        return self._fault
