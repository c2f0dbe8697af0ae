"""Which exposures two telemetry tables share, told by their centroids alone.

Frame numbers may be counted anew in every download, so an exposure is known by what was seen in it: the sums of its rows and
of its columns, to a millionth of a pixel, which no two exposures of noisy centroids share.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from numpy.typing import NDArray

from boresight.errors import RefusedInputError

#: Tables whose exposures are remembered: the files are named by their content, so what was read stays true.
REMEMBERED = 32
DECIMALS = 6
COLUMNS = ["frame", "exposure", "row_px", "col_px"]


@lru_cache(REMEMBERED)
def exposure_marks(path: Path) -> NDArray[np.complex128]:
    """Return what each exposure of a stored table is known by: sum of rows + i sum of columns, (n_exposures,).

    Raises
    ------
    RefusedInputError
        When the table is damaged.
    """
    try:
        table = arrow_parquet.read_table(path, columns=COLUMNS)
    except pa.ArrowException as error:
        raise RefusedInputError(f"The stored table {path.name[:12]} is damaged; restore it from a backup.") from error
    frame, exposure, row, col = (table.column(name).to_numpy() for name in COLUMNS)
    if not len(frame):
        return np.zeros(0, dtype=np.complex128)
    new = np.flatnonzero((np.diff(frame) != 0) | (np.diff(exposure) != 0)) + 1
    start = np.concatenate([[0], new])
    return np.asarray(np.round(np.add.reduceat(row, start) + 1j * np.add.reduceat(col, start), DECIMALS))


def shared_exposures(one: Path, other: Path) -> tuple[float, float]:
    """Return the share of each table's exposures that the other table has too, 0 to 1.

    Raises
    ------
    RefusedInputError
        When a table is damaged.
    """
    if one == other:
        return 1.0, 1.0
    marks = exposure_marks(one), exposure_marks(other)
    common = len(np.intersect1d(*marks))
    return common / max(len(marks[0]), 1), common / max(len(marks[1]), 1)
