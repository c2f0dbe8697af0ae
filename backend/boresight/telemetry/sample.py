"""Some frames of a stored set, taken evenly over it, without checking all of it: it was checked when it came in.

Every k-th of n frames stands for the set where its frames are alike in kind, which is what a forecast asks. Only the column
of frame numbers is looked at in full; the rows of the frames that are taken are cut out before they become arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
from numpy.typing import NDArray

from boresight.errors import RefusedInputError
from boresight.telemetry.readers import telemetry_of
from boresight.telemetry.refusals import Faults
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Telemetry


@dataclass(frozen=True)
class Sample:
    """Frames of a set that stand for all.

    Parameters
    ----------
    telemetry
        Their rows.
    frames, frames_in_set
        How many frames these are, and how many the set has.
    """

    telemetry: Telemetry
    frames: int
    frames_in_set: int


def evenly(n: int, most: int) -> NDArray[np.int64]:
    """Places of at most `most` of n things, as evenly as whole numbers allow, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def read_sample(path: Path, most_frames: int, most_stars: int) -> Sample:
    """Read some frames of a stored Parquet table.

    Parameters
    ----------
    path
        The table, as `writers.write_parquet` wrote it.
    most_frames, most_stars
        Fewer frames are taken where their stars would be more than so many.

    Raises
    ------
    RefusedInputError
        When the file is damaged.
    """
    try:
        file = arrow_parquet.ParquetFile(path)
        known = [name for name in file.schema_arrow.names if name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)]
        frame = file.read(["frame"])["frame"].to_numpy()
        first = np.flatnonzero(np.append(True, np.diff(frame) != 0))
        most = min(most_frames, max(1, most_stars * len(first) // len(frame)))
        taken = evenly(len(first), most)
        rows = _rows(first, len(frame), taken)
        table = file.read(known).take(pa.array(rows))
    except (pa.ArrowException, OSError) as error:
        raise RefusedInputError(f"The stored table {path.name[:12]} cannot be read; upload the set again.") from error
    return Sample(telemetry_of(table, Faults(path.name[:12], 1)), len(taken), len(first))


def _rows(first: NDArray[np.int64], n_rows: int, taken: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the frames taken, from the first row of each frame."""
    ends = np.append(first, n_rows)
    return np.concatenate([np.arange(ends[k], ends[k + 1]) for k in taken])
