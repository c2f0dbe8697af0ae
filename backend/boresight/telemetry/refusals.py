"""Collecting what is wrong with an input before refusing it, so that one reading names every fault.

The first twenty faults are kept and the rest counted: a file exported in the wrong units has one fault a row; what has a
hundred thousand is refused there and then. A file read
in parts collects into the same faults part by part, `first_row` moving on: which faults are kept does not depend on the parts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from boresight.errors import Fault, RefusedInputError

MOST_FAULTS = 20
#: Faults that are met one by one are not looked for beyond so many: each costs some microseconds.
MOST_COUNTED = 100_000
_MOST_HELD = 50 * MOST_FAULTS


class Faults:
    """Faults of one input in the order of its rows.

    Parameters
    ----------
    subject
        What is being read, as the refusal names it: a file's or a sensor's name.
    first_row
        Row of entry 0, as an editor counts.
    """

    def __init__(self, subject: str, first_row: int = 1) -> None:
        self.subject = subject
        self.first_row = first_row
        self.count = 0
        self._kept: list[Fault] = []
        self._last: int | None = None  # row from which on a fault is none of the first, once there are enough

    def add(self, detail: str, *, column: str | None = None, row: int | None = None) -> None:
        """Add one fault; `row` as an editor counts.

        Raises
        ------
        RefusedInputError
            When there are more than are counted.
        """
        self.count += 1
        if self.count > MOST_COUNTED:
            self.refuse()
        if self._last is None or (row or 0) < self._last:
            self._keep([Fault(row, column, detail)])

    def add_entries(self, wrong: NDArray[np.bool_], column: str | None, detail: Callable[[int], str]) -> None:
        """Add a fault for every entry of the (n,) mask; `detail` writes the sentence of one entry."""
        entries = np.flatnonzero(wrong)
        self.count += len(entries)
        self._keep([Fault(entry + self.first_row, column, detail(entry)) for entry in entries[:MOST_FAULTS].tolist()])

    def absorb(self, other: Faults) -> None:
        """Take over the faults of another collection; at the same row they come after those that are here."""
        self.count += other.count
        self._keep(other._kept)

    def refuse(self) -> None:
        """Raise what was collected, if anything was.

        Raises
        ------
        RefusedInputError
            Its sentence is the first fault and the number of the others; its faults are the first twenty.
        """
        if self.count:
            raise self.refusal()

    def refusal(self) -> RefusedInputError:
        """Return what `refuse` raises, of at least one fault."""
        kept = _first(self._kept)
        others = self.count - 1
        more = f" (and {others} more {'fault' if others == 1 else 'faults'})" if others else ""
        return RefusedInputError(f"{self.subject}: {kept[0]}{more}", tuple(kept))

    def _keep(self, faults: list[Fault]) -> None:
        """Hold faults, and of very many only those that can be among the first."""
        self._kept += faults
        if len(self._kept) > _MOST_HELD:
            self._kept = _first(self._kept)
            self._last = self._kept[-1].row or 0


def _first(faults: list[Fault]) -> list[Fault]:
    """Return the first twenty by row; those of one row in the order in which they came."""
    return sorted(faults, key=lambda fault: fault.row or 0)[:MOST_FAULTS]
