"""Executors: compute the pieces of a large set in this process, or on machines that share its folder.

Everything that runs over a set larger than memory is cut into pieces, and each piece is one call `function(*arguments)`. `function`
stands at the top of a module, its arguments are small values (paths, ranges of blocks, states) and so is what it returns; what is
large lies in files of the scratch folder. A piece that writes does so under a temporary name and renames, so it may be computed
twice, by two machines at once, or again after one of them died in the middle: the answer is the same.

Sums are taken by the caller, over blocks in their order (`estimation.blocks`). So it changes no bit who computed which piece.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from boresight.errors import CancelledError

#: Told how many pieces of how many are done.
ProgressCallback = Callable[[int, int], None]


def refuse_cancelled(cancelled: Callable[[], bool] | None, where: str) -> None:
    """Raise CancelledError where a computation was asked to stop; `where` says how far it was, as "after 3 of 7 pieces"."""
    if cancelled is not None and cancelled():
        raise CancelledError(f"Cancelled {where}")


class Executor(Protocol):
    """What computes pieces."""

    def map(
        self,
        function: Callable[..., Any],
        arguments: Sequence[tuple[Any, ...]],
        *,
        done: ProgressCallback | None = None,
    ) -> list[Any]:
        """Call `function(*arguments[k])` for every k and return the results in the order of k."""


class LocalExecutor:
    """Computes the pieces one after the other, where it is called; blocks within a piece go to threads, see `estimation.blocks`."""

    def __init__(self, cancelled: Callable[[], bool] | None = None) -> None:
        self._cancelled = cancelled

    def map(
        self,
        function: Callable[..., Any],
        arguments: Sequence[tuple[Any, ...]],
        *,
        done: ProgressCallback | None = None,
    ) -> list[Any]:
        """Call `function(*arguments[k])` for every k and return the results in the order of k."""
        results: list[Any] = []
        for piece in arguments:
            refuse_cancelled(self._cancelled, f"after {len(results)} of {len(arguments)} pieces")
            results.append(function(*piece))
            if done is not None:
                done(len(results), len(arguments))
        return results
