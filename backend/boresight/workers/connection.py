"""A dask client that leaves nothing behind when it cannot connect.

A client computes its side of the link on a thread of its own. Where the scheduler does not answer, dask's leaves that thread for
good, one for each attempt; where the link fails otherwise, as between certificates that do not fit, the thread ends when the
collector finds the client. If that is while the next client starts its thread, both wait for one lock, and the next fails too.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from distributed import Client


class Connection(Client):  # type: ignore[misc] # dask is not typed
    """A connection to a scheduler, as `distributed.Client`."""

    def start(self, **options: Any) -> None:
        """Connect, as the constructor does; what fails ends with its thread.

        Raises
        ------
        OSError
            When the scheduler does not answer, or refuses.
        TypeError
            When certificates do not fit.
        """
        try:
            super().start(**options)
        except BaseException:
            with suppress(Exception):
                self.close()
            self._loop_runner.stop()  # a client that is closed already does not do so
            raise
