"""A Parquet file cut into stretches is the file, and what must be read from its start has none."""

from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.read import parquet
from boresight.telemetry.read.readers import read_telemetry, stretches, write_parquet
from boresight.telemetry.schema import joined
from tests.effort import effort
from tests.strategies import telemetry_tables
from tests.telemetry.files import GOOD
from tests.telemetry.test_readers import assert_same

EXAMPLES = settings(
    max_examples=effort(12, 60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def in_groups(telemetry, path, rows):
    write_parquet(telemetry, path)
    arrow_parquet.write_table(arrow_parquet.read_table(path), path, row_group_size=rows)


def of_frames(frame, path, rows=4):
    n = len(frame)
    cells = {"exposure": np.zeros(n, np.int64), "row_px": np.arange(n) + 0.5, "col_px": np.arange(n) + 0.5}
    arrow_parquet.write_table(pa.table({"frame": frame} | cells), path, row_group_size=rows)
    return path


@EXAMPLES
@given(telemetry=telemetry_tables(), group=st.integers(1, 40), batch=st.integers(1, 50), frames=st.integers(1, 3))
def test_the_stretches_put_together_are_the_file(telemetry, group, batch, frames, tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "_BATCH_ROWS", batch)
    path = tmp_path / "pass.parquet"
    in_groups(telemetry, path, group)
    found = stretches(path, path.name, frames)
    parts = [part for stretch in found for part in stretch.chunks(frames)]
    whole = read_telemetry(path)
    if found:
        assert_same(joined(parts), whole)
        assert [part.first_row for part in parts] == [1 + sum(map(len, parts[:k])) for k in range(len(parts))]
        assert (found[0].begins, found[-1].ends) == (0, len(whole))
        assert all(one.ends == other.begins for one, other in pairwise(found))
        assert all(whole.frame[one.ends - 1] < whole.frame[one.ends] for one in found[:-1])
        assert all(len(np.unique(whole.frame[one.begins : one.ends])) >= 4 * frames for one in found[:-1])


def test_a_stretch_begins_where_a_frame_begins_in_a_group(tmp_path):
    frame = np.repeat(np.arange(40), 3)  # groups of 10 rows: frame 4 begins in row 12, frame 7 in row 21, ...
    found = stretches(of_frames(frame, tmp_path / "a.parquet", rows=10), "a.parquet", 1)
    assert [one.begins for one in found] == [0, 12, 30, 42, 60, 72, 90, 102]


def test_a_frame_longer_than_a_group_is_in_one_stretch(tmp_path):
    frame = np.repeat([1, 2, 3, 4, 5, 6, 7, 8, 9], [1, 1, 1, 1, 50, 1, 1, 1, 1])
    found = stretches(of_frames(frame, tmp_path / "a.parquet"), "a.parquet", 1)
    assert [(one.begins, one.ends) for one in found] == [(0, 4), (4, 58)]


@pytest.mark.parametrize(
    "frame",
    [
        np.append(np.arange(30), 3),
        np.arange(30, dtype=np.float64),
        pa.array([*range(30), None]),
        np.zeros(30, np.int64),
        np.arange(4),
        [str(k) for k in range(30)],
    ],
    ids=["descends", "no integers", "a cell is empty", "one frame", "one group", "text"],
)
def test_what_must_be_read_from_its_start_has_no_stretches(frame, tmp_path):
    assert stretches(of_frames(frame, tmp_path / "a.parquet"), "a.parquet", 1) == []


def test_text_has_no_stretches(tmp_path):
    path = tmp_path / "pass.csv"
    path.write_text(GOOD)
    assert stretches(path, path.name, 1) == []


def test_a_file_without_frames_has_no_stretches(tmp_path):
    arrow_parquet.write_table(pa.table({"exposure": [1, 2, 3]}), tmp_path / "a.parquet", row_group_size=1)
    assert stretches(tmp_path / "a.parquet", "a.parquet", 1) == []


def test_a_stretch_refuses_its_own_faults_by_the_rows_of_the_file(tmp_path):
    path = of_frames(np.arange(40), tmp_path / "a.parquet")
    table = arrow_parquet.read_table(path)
    row_px = table["row_px"].to_numpy().copy()
    row_px[33] = np.inf
    arrow_parquet.write_table(table.set_column(2, "row_px", pa.array(row_px)), path, row_group_size=4)
    *sound, torn, _ = stretches(path, "a.parquet", 1)
    assert torn.begins <= 33 < torn.ends
    assert sum(len(part) for one in sound for part in one.chunks(1)) == torn.begins
    with pytest.raises(RefusedInputError, match="row 34, column row_px"):
        list(torn.chunks(1))


def test_a_damaged_file_is_refused(tmp_path):
    path = of_frames(np.arange(40), tmp_path / "a.parquet")
    path.write_bytes(path.read_bytes()[:-9] + b"PAR1")
    with pytest.raises(RefusedInputError, match="truncated or damaged"):
        stretches(path, "a.parquet", 1)
