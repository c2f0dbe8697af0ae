"""A file read in chunks or cut into stretches is the file, or refused as the file is, wherever it is cut."""

from itertools import pairwise

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.read import parquet, readers, text
from boresight.telemetry.read.limits import Limits
from boresight.telemetry.read.readers import read_chunks, read_telemetry, rows_in, stretches, write_csv, write_parquet
from boresight.telemetry.schema import Telemetry, joined
from tests.effort import effort
from tests.strategies import telemetry_tables
from tests.telemetry.files import GOOD, MINIMAL, parquet_bytes
from tests.telemetry.test_readers import assert_same

EXAMPLES = settings(
    max_examples=effort(12, 60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def write_json_lines(telemetry, path):
    write_parquet(telemetry, path)
    rows = arrow_parquet.read_table(path).to_pylist()
    present = [{key: cell for key, cell in row.items() if cell is not None} for row in rows]  # absent, not null
    path.write_bytes(b"".join(orjson.dumps(row, option=orjson.OPT_APPEND_NEWLINE) for row in present))


def write_in_small_groups(telemetry, path, rows=3):
    write_parquet(telemetry, path)
    arrow_parquet.write_table(arrow_parquet.read_table(path), path, row_group_size=rows)


WRITERS = {"csv": write_csv, "jsonl": write_json_lines, "parquet": write_in_small_groups}


@pytest.fixture
def in_small_pieces(monkeypatch):
    monkeypatch.setattr(parquet, "_BATCH_ROWS", 2)
    monkeypatch.setattr(text, "PIECE_BYTES", 700)


def whole_frames(parts):
    return all(one.frame[-1] != other.frame[0] for one, other in pairwise(parts))


@pytest.mark.usefixtures("in_small_pieces")
@EXAMPLES
@given(telemetry=telemetry_tables(), form=st.sampled_from(sorted(WRITERS)), frames=st.integers(1, 6))
def test_the_chunks_put_together_are_the_file(telemetry, form, frames, tmp_path):
    path = tmp_path / f"pass.{form}"
    WRITERS[form](telemetry, path)
    parts = list(read_chunks(path, frames=frames))
    assert whole_frames(parts)
    assert [len(np.unique(part.frame)) for part in parts[:-1]] == [frames] * (len(parts) - 1)
    assert [part.first_row for part in parts] == [
        parts[0].first_row + sum(len(part) for part in parts[:k]) for k in range(len(parts))
    ]
    assert_same(joined(parts), read_telemetry(path))


PLACES = [(frame, exposure, star) for frame in range(9) for exposure in (0, 1) for star in range(1, 5)]
LINES = [f"{frame},{exposure},{star * 3}.5,{frame * 7 + star},{star}" for frame, exposure, star in PLACES]
FAULTS = [
    "abc", "nan", "-inf", "1e999", "", " ", '"', '"a', 'a"b', '""', "0x1F", "3.0", "1.5", "9007199254740993", "-1", "-7", ",",
    "1,2", "99999999999999999999", "2,0,6.5,16,2\n2,0,6.5,16,2", "0,0,1,2,3\n4", "\n\n", "+5", "1_0", "\n  \n", "é",
]  # fmt: skip


@settings(EXAMPLES, max_examples=effort(60, 300))
@given(
    spoils=st.lists(st.tuples(st.integers(0, 71), st.integers(0, 4), st.sampled_from(FAULTS)), min_size=1, max_size=4),
    form=st.sampled_from(["csv", "jsonl"]),
    piece_bytes=st.integers(300, 1500),
    frames=st.integers(1, 12),
)
@example(spoils=[(19, 4, '"')], form="csv", piece_bytes=300, frames=1)  # an open quote ends the piece
@example(spoils=[(0, 0, 'a"b'), (20, 0, '"')], form="csv", piece_bytes=300, frames=1)  # and a quote within a cell none
@example(spoils=[(0, 0, "3.0"), (4, 0, "9007199254740993")], form="jsonl", piece_bytes=300, frames=1)  # read as floats
def test_a_refusal_is_the_same_wherever_the_file_is_cut(spoils, form, piece_bytes, frames, tmp_path):
    lines = [line.split(",") for line in LINES]
    for line, cell, fault in spoils:
        lines[line][cell] = fault
    path = tmp_path / f"pass.{form}"
    path.write_text(as_csv(lines) if form == "csv" else as_json(lines), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        whole = outcome(lambda: [read_telemetry(path)])
        patch.setattr(text, "PIECE_BYTES", piece_bytes)
        parts = outcome(lambda: list(read_chunks(path, frames=frames)))
    if isinstance(whole, RefusedInputError):
        assert (str(parts), getattr(parts, "faults", None)) == (str(whole), whole.faults)
    else:
        assert_same(joined(parts), whole[0])


def outcome(reading):
    try:
        return reading()
    except RefusedInputError as error:
        return error


def as_csv(lines):
    return "\n".join(["frame,exposure,row_px,col_px,star_id", *(",".join(cells) for cells in lines)]) + "\n"


def as_json(lines):
    keys = [f'"{key}":' for key in ("frame", "exposure", "row_px", "col_px", "star_id")]
    return "\n".join(f"{{{','.join(map(''.join, zip(keys, cells, strict=True)))}}}" for cells in lines) + "\n"


@pytest.mark.parametrize(
    ("column", "change", "words"),
    [
        ("frame", {5: 0}, "frame 0 follows frame 2: sort the rows by frame"),
        ("row_px", {1: None, 9: float("nan")}, "the cell is empty"),
        ("row_px", {7: 12.0, 6: 12.0}, "the centroid is that of row 7"),
    ],
)
def test_parquet_is_refused_alike_in_any_batches(column, change, words, tmp_path, monkeypatch):
    columns = {"frame": [k // 2 for k in range(12)], "exposure": [0] * 12}
    columns |= {"row_px": [float(k) for k in range(12)], "col_px": [1.0] * 12}
    for row, cell in change.items():
        columns[column][row] = cell
    path = tmp_path / "pass.parquet"
    arrow_parquet.write_table(pa.table(columns), path, row_group_size=5)
    whole = outcome(lambda: read_telemetry(path))
    for batch_rows in (1, 2, 3, 7):
        monkeypatch.setattr(parquet, "_BATCH_ROWS", batch_rows)
        parts = outcome(lambda: list(read_chunks(path, frames=1)))
        assert (str(parts), parts.faults) == (str(whole), whole.faults)
    assert words in str(whole)


@pytest.mark.usefixtures("in_small_pieces")
def test_a_column_that_only_a_late_line_has_is_in_every_chunk(tmp_path):
    lines = [f'{{"frame":{k},"exposure":0,"row_px":{k}.5,"col_px":2}}' for k in range(40)]
    lines[-1] = lines[-1][:-1] + ',"star_id":5,"note":"late"}'
    (tmp_path / "pass.jsonl").write_text("\n".join(lines))
    parts = list(read_chunks(tmp_path / "pass.jsonl", frames=10))
    assert [part.star_id.tolist() for part in parts[:-1]] == [[0] * 10] * 3
    assert parts[-1].star_id[-1] == 5
    assert joined(parts).unknown["note"].to_pylist() == [""] * 39 + ["late"]


@pytest.mark.usefixtures("in_small_pieces")
def test_nothing_comes_out_after_the_first_fault_and_all_faults_are_counted(tmp_path):
    rows = [f"{k},0,{'x' if k % 10 == 9 else k},2" for k in range(500)]
    (tmp_path / "pass.csv").write_text("\n".join(["frame,exposure,row_px,col_px", *rows]))
    seen = []
    with pytest.raises(RefusedInputError, match=r"row 11, column row_px: 'x' is not a number.*and 49 more"):
        seen.extend(read_chunks(tmp_path / "pass.csv", frames=2))
    assert all(part.frame[-1] < 9 for part in seen)


@pytest.mark.usefixtures("in_small_pieces")
def test_frames_of_very_many_rows_come_out_as_soon_as_they_are_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(readers, "MOST_ROWS", 10)
    n = np.arange(64)
    telemetry = Telemetry(frame=n // 8, exposure=0 * n, row_px=n * 1.0, col_px=n * 1.0)
    write_parquet(telemetry, tmp_path / "pass.parquet")
    parts = list(read_chunks(tmp_path / "pass.parquet"))
    assert whole_frames(parts)
    assert max(map(len, parts)) <= 16
    assert_same(joined(parts), telemetry)


@pytest.mark.usefixtures("in_small_pieces")
def test_a_frame_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(readers, "MOST_ROWS", 10)
    n = np.arange(64)
    write_parquet(Telemetry(frame=0 * n, exposure=n, row_px=n * 1.0, col_px=n * 1.0), tmp_path / "pass.parquet")
    with pytest.raises(RefusedInputError, match="frame 0 has over 10 rows: give every reading"):
        list(read_chunks(tmp_path / "pass.parquet"))


@pytest.mark.usefixtures("in_small_pieces")
def test_a_line_without_end_is_refused(tmp_path):
    (tmp_path / "pass.csv").write_text(GOOD + "1,0,9,9," + "9" * 5000)
    with pytest.raises(RefusedInputError, match="row 6: is over 700 bytes long"):
        list(read_chunks(tmp_path / "pass.csv", limits=Limits(line_bytes=700)))


def test_only_parquet_tells_its_rows_at_once(tmp_path):
    (tmp_path / "pass.parquet").write_bytes(parquet_bytes(MINIMAL))
    (tmp_path / "pass.csv").write_text(GOOD)
    assert rows_in(tmp_path / "pass.parquet") == 2
    assert rows_in(tmp_path / "pass.csv") is None


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
    write_in_small_groups(telemetry, path, group)
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


def test_a_stretch_begins_where_a_frame_begins_in_a_group_and_holds_a_longer_frame_whole(tmp_path):
    frame = np.repeat(np.arange(40), 3)  # groups of 10 rows: frame 4 begins in row 12, frame 7 in row 21, ...
    found = stretches(of_frames(frame, tmp_path / "a.parquet", rows=10), "a.parquet", 1)
    assert [one.begins for one in found] == [0, 12, 30, 42, 60, 72, 90, 102]
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
    arrow_parquet.write_table(pa.table({"exposure": [1, 2, 3]}), tmp_path / "b.parquet", row_group_size=1)
    (tmp_path / "pass.csv").write_text(GOOD)
    assert [stretches(tmp_path / name, name, 1) for name in ("b.parquet", "pass.csv")] == [[], []]


def test_a_stretch_refuses_its_own_faults_by_the_rows_of_the_file_and_a_damaged_file_is_refused(tmp_path):
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
    path.write_bytes(path.read_bytes()[:-9] + b"PAR1")
    with pytest.raises(RefusedInputError, match="truncated or damaged"):
        stretches(path, "a.parquet", 1)
