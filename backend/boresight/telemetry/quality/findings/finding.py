"""One thing a quality report has found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from boresight.telemetry.quality.inputs import QualityInputs

Severity = Literal["NORMAL", "CAUTION", "SERIOUS"]

#: From harmless to unusable.
SEVERITIES: tuple[Severity, ...] = ("NORMAL", "CAUTION", "SERIOUS")

_MOST_ROWS = 20


@dataclass(frozen=True)
class Finding:
    """A fact about a telemetry set that an operator should know."""

    code: str
    severity: Severity
    sentence: str
    count: int
    rows: tuple[int, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the finding for a JSON document."""
        return {
            "code": self.code,
            "severity": self.severity,
            "sentence": self.sentence,
            "count": self.count,
            "rows": list(self.rows),
        }


def row_numbers(inputs: QualityInputs, marked: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the numbers, as an editor counts, of the first twenty marked rows of (n_rows,)."""
    entries = np.flatnonzero(marked)[:_MOST_ROWS]
    rows = entries + inputs.telemetry.first_row if inputs.rows is None else inputs.rows[entries]
    return tuple(rows.tolist())


def counted(count: int, one: str, many: str) -> str:
    """Return how many, and what of them in agreement: `1 row names`, `1,204 rows name`."""
    return f"{count:,} {one if count == 1 else many}"
