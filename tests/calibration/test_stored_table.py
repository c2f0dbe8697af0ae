"""A calibration of a stored table: the bits of the set in memory, without reading the upload again."""

from unittest import mock

import numpy as np
import pytest

from boresight.calibration.telemetry_pieces import StoredTable
from boresight.disks import compute_digest
from boresight.telemetry.schema import select_rows
from boresight.telemetry.working_table import WorkingTableParts
from tests.calibration.rematched import sky
from tests.calibration.streamed import differences, in_memory


@pytest.mark.parametrize("large_rows", [0, 10**9])
@pytest.mark.parametrize("shared", [True, False])
def test_a_calibration_of_a_stored_table_parses_checks_and_converts_nothing(tmp_path, catalogue, large_rows, shared):
    field = sky(catalogue, 3, 40)
    path = tmp_path / "table"
    with WorkingTableParts(path) as parts:
        for frames in (field.telemetry.frame < 15, field.telemetry.frame >= 15):
            rows = np.flatnonzero(frames)
            parts.write(select_rows(field.telemetry, slice(rows[0], rows[-1] + 1)))
    stored = StoredTable(path, compute_digest(path), large_rows, shared)
    for match in ("given", "rematch"):
        whole = in_memory(field.telemetry, field.sensor, catalogue, match=match)
        with (
            mock.patch("boresight.telemetry.read.readers.open_tables", side_effect=AssertionError),
            mock.patch("boresight.telemetry.read.readers.Checks", side_effect=AssertionError),
            mock.patch("boresight.telemetry.read.readers.make_arrays", side_effect=AssertionError),
        ):
            found = in_memory(stored, field.sensor, catalogue, match=match, scratch_folder=tmp_path)

        assert differences(whole, found) == []
