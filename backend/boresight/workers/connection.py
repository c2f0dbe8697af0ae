"""A dask client that leaves nothing behind, however its link ends.

A client computes its side of the link on a thread of its own. Where the scheduler does not answer, or the link was lost, dask's
leaves that thread for good, one for each attempt; where the link fails otherwise, as between certificates that do not fit, the
thread ends when the collector finds the client. If that is while the next client starts its thread, both wait for one lock, and
the next fails too: so a connection ends its thread once, itself, and the collector finds nothing to do.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from distributed import Client

END_S = 2.0  # a thread that is stuck, as in asking for a name, is left to itself


class Connection(Client):  # type: ignore[misc] # dask is not typed
    """A connection to a scheduler, as `distributed.Client`."""

    _is_over = False

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
            raise

    def close(self, *arguments: Any, **options: Any) -> None:
        """Let go of the scheduler, and end the thread, which dask's does only where the link still holds; safe to call twice."""
        if self._is_over:
            return
        self._is_over = True
        try:
            super().close(*arguments, **options)
        finally:
            with suppress(Exception):
                self._loop_runner.stop(timeout=END_S)
