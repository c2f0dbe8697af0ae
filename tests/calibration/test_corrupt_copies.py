"""The working copies of a large run are held against what was written."""

from pathlib import Path

import numpy as np
import pytest

from boresight.columns import write_columns
from boresight.errors import CorruptFileError
from boresight.telemetry.working_table import WorkingTable, write_working_table
from tests.calibration.judged import field


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


def test_a_part_of_a_stored_table_that_was_altered_is_refused(tmp_path: Path) -> None:
    write_working_table(field(1, frames=2), tmp_path / "table")
    with pytest.raises(CorruptFileError) as refused:
        WorkingTable(tmp_path / "table", "0" * 64).part(0)
    assert refused.value.sha256 == "0" * 64
