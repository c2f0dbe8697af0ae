"""A telemetry file as a run of tables, whatever its form: what the three formats offer to the reader.

What is wrong with the form of a file (blank rows, rows of too few cells, lines that are no JSON) is collected while the tables
are taken, for the cells of such a file mean nothing; whoever takes them refuses it at the end, before all else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pyarrow as pa

from boresight.telemetry.formats import blank_rows
from boresight.telemetry.refusals import MOST_FAULTS, Faults


class FormFaults:
    """What is wrong with the form of a file: blank rows first, then all else."""

    def __init__(self, subject: str) -> None:
        self._blank, self.rows = Faults(subject), Faults(subject)

    @property
    def found(self) -> bool:
        """Whether there is something to refuse."""
        return bool(self._blank.count or self.rows.count)

    @property
    def has_blank_rows(self) -> bool:
        """Whether rows are blank, so that nothing else will be told."""
        return bool(self._blank.count)

    def look_for_blank_rows(self, text: bytes, first_row: int) -> None:
        """Collect the blank rows of a piece of text whose first row has this number."""
        rows = blank_rows(text)
        for row in rows[:MOST_FAULTS].tolist():
            self._blank.add("is blank: delete it", row=row + first_row - 1)
        self._blank.count += max(len(rows) - MOST_FAULTS, 0)

    def refuse(self) -> None:
        """Raise what was collected.

        Raises
        ------
        RefusedInputError
            When there is anything.
        """
        self._blank.refuse()
        self.rows.refuse()


@dataclass(frozen=True)
class Tables:
    """A telemetry file.

    Parameters
    ----------
    columns
        Names of all columns, in the file's order.
    first_row
        Number of the first row, as an editor counts.
    read
        Yields the rows in tables of bounded size; a column may be missing in one where it is absent there. What is wrong
        with the form goes into `form`; after that, tables are no longer complete.
    form
        What was wrong so far.
    """

    columns: tuple[str, ...]
    first_row: int
    read: Callable[[], Iterator[pa.Table]]
    form: FormFaults
