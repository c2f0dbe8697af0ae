"""The working copies of a large run are held against what was written."""

from pathlib import Path

import numpy as np
import pytest

from boresight.columns import write_columns
from boresight.errors import CorruptFileError
from boresight.telemetry.read.limits import LIMITS
from boresight.telemetry.read.parquet import Layout
from boresight.telemetry.read.readers import Stretch


def test_a_flipped_bit_in_a_working_copy_is_refused(tmp_path: Path) -> None:
    arrays = {"row_px": np.linspace(0, 1, 1001), "time_utc": np.array(["2026-11-21"], "M8[us]"), "none": np.empty(0)}
    columns = write_columns(tmp_path / "piece", arrays)
    for name, values in columns.read().items():
        assert np.array_equal(values, arrays[name]), name
    content = bytearray(Path(columns.path).read_bytes())
    content[8000] ^= 1
    Path(columns.path).write_bytes(content)
    with pytest.raises(CorruptFileError, match="working copy piece was altered"):
        columns.read()


def test_a_stretch_of_a_table_that_was_altered_is_refused(tmp_path: Path) -> None:
    (tmp_path / "table").write_bytes(b"PAR1")
    with pytest.raises(CorruptFileError) as refused:
        next(Stretch(tmp_path / "table", "table", 0, 1, Layout((), 0, (), 1), LIMITS, "0" * 64).chunks(1))
    assert refused.value.sha256 == "0" * 64
