"""The stored working table and files read in chunks."""

import time
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from boresight.disks import compute_digest
from boresight.errors import CorruptFileError, NotFoundError, RefusedInputError
from boresight.library.results import save_telemetry
from boresight.telemetry import readers
from boresight.telemetry.read import formats, parquet
from boresight.telemetry.read.frames import evenly, frame_index, read_sample
from boresight.telemetry.read.limits import Limits
from boresight.telemetry.readers import read_chunks, read_telemetry, rows_in, stretches
from boresight.telemetry.sampling import exposure_keys, shared_exposures
from boresight.telemetry.schema import Telemetry, joined, select_rows
from boresight.telemetry.working_table import (
    FrameImage,
    WorkingTable,
    WorkingTableParts,
    find_image,
    is_working_table,
)
from boresight.telemetry.writing import ROW_GROUP, write_csv, write_parquet
from tests.calibration.conftest import telemetry as simulated
from tests.effort import effort
from tests.refusals import has_code
from tests.strategies import telemetry_tables
from tests.telemetry.files import GOOD, MINIMAL, assert_same, parquet_bytes
from tests.working_tables import write_working_table

FRAMES, ROWS = 60, 7
CALM = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def telemetry(frames=FRAMES, rows=ROWS):
    """Frames 10, 13, 16, ... of two exposures each, with every kind of column."""
    rng, n = np.random.default_rng(1), frames * rows
    frame = np.repeat(10 + 3 * np.arange(frames), rows)
    seconds = np.repeat(np.arange(frames), rows)
    return Telemetry(
        frame=frame,
        exposure=np.tile(np.arange(rows) // 4, frames),
        row_px=rng.uniform(0, 1000, n),
        col_px=rng.uniform(0, 1000, n),
        time_utc=np.datetime64("2026-01-01T00:00:00", "us") + seconds * np.timedelta64(1_000_000, "us"),
        star_id=np.tile([11, 22, 0, 33, 44, 11, 0], frames),
        quaternion=np.tile([0.0, 0.6, 0.0, 0.8], (n, 1)),
    )


@pytest.fixture(scope="module", params=[1, 9, FRAMES], ids=["a frame a part", "some frames a part", "one part"])
def stored_in_parts(request, tmp_path_factory):
    path, whole, rows = tmp_path_factory.mktemp("table") / "table", telemetry(), request.param * ROWS
    with WorkingTableParts(path) as parts:
        for begin in range(0, len(whole), rows):
            parts.write(select_rows(whole, slice(begin, min(begin + rows, len(whole)))))
    return path


@CALM
@given(place=st.integers(0, FRAMES - 1), neighbours=st.integers(0, 5))
def test_a_frame_with_its_neighbours_is_those_rows_of_the_whole_set(stored_in_parts, place, neighbours):
    whole, index = telemetry(), frame_index(stored_in_parts)
    first, last = max(place - neighbours, 0) * ROWS, min(place + neighbours + 1, FRAMES) * ROWS
    expected, read = select_rows(whole, slice(first, last)), index.read(place, neighbours)
    for item in fields(Telemetry):
        value = getattr(expected, item.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(read, item.name), value)
        elif item.name == "first_row":
            assert read.first_row == value


def test_the_index_knows_frames_stars_and_how_many_an_exposure_has(stored_in_parts):
    index = frame_index(stored_in_parts)
    assert index.frame.tolist() == list(range(10, 10 + 3 * FRAMES, 3))
    assert index.find_place(16) == 2
    assert index.named_stars.tolist() == [11, 22, 33, 44]
    assert index.typical_stars == 3.5  # exposures of four and of three
    assert frame_index(stored_in_parts) is index


@pytest.mark.parametrize("frame", [9, 11, 10_000])
def test_a_frame_that_is_not_there_is_refused_with_those_that_are(stored_in_parts, frame):
    with pytest.raises(NotFoundError, match="10 to 187", check=has_code("no-such-frame")):
        frame_index(stored_in_parts).find_place(frame)


def test_a_damaged_table_is_refused_with_what_to_do_by_index_sample_and_marks(tmp_path):
    path = tmp_path / "damaged"
    path.write_bytes(b"PAR1 and then nothing of the kind")
    with pytest.raises(RefusedInputError, check=has_code("damaged-table")):
        frame_index(path)
    damaged = tmp_path / "table"
    damaged.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(RefusedInputError, check=has_code("damaged-table")):
        read_sample(damaged, 10, 100)
    (tmp_path / "broken").write_bytes(b"no table")
    with pytest.raises(RefusedInputError, match="damaged"):
        exposure_keys(tmp_path / "broken")


def test_a_table_that_names_no_stars_or_has_no_rows_is_read(tmp_path):
    write_working_table(replace(telemetry(), star_id=None), tmp_path / "table")
    assert frame_index(tmp_path / "table").named_stars.tolist() == []
    assert shared_exposures(written(tmp_path / "a", []), written(tmp_path / "b", [1, 2])) == (0, 0)


def test_a_frame_of_a_large_set_is_read_without_reading_the_set(tmp_path):
    path = tmp_path / "large"
    write_working_table(telemetry(frames=40_000), path)
    index = frame_index(path)
    index.read(0)
    spent = []
    for place in range(100, 40_000, 4_000):
        began = time.thread_time()
        index.read(place)
        spent.append(time.thread_time() - began)

    assert np.median(spent) < 0.1


def full():
    """Every kind of array, with cells that are absent."""
    whole = telemetry()
    n = len(whole)
    holes = np.where(np.arange(n) % 3 == 0, np.nan, np.linspace(-1, 1, n))
    times = np.where(np.arange(n) % 5 == 0, np.datetime64("NaT", "us"), whole.time_utc)
    return replace(
        whole, time_utc=times, magnitude=holes, ra_rad=holes, dec_rad=holes, velocity_m_s=np.column_stack([holes] * 3)
    )


def in_parts(whole, path, frames):
    with WorkingTableParts(path) as parts:
        for begin in range(0, len(whole), frames * ROWS):
            parts.write(select_rows(whole, slice(begin, min(begin + frames * ROWS, len(whole)))))
    return path


def assert_same_bits(one, other):
    for item in fields(Telemetry):
        mine, theirs = getattr(one, item.name), getattr(other, item.name)
        if isinstance(mine, np.ndarray):
            assert (mine.dtype, mine.shape, mine.tobytes()) == (theirs.dtype, theirs.shape, theirs.tobytes()), item.name
        elif item.name != "unknown":
            assert mine == theirs, item.name


@pytest.mark.parametrize("frames", [1, 7, 1000])
def test_every_array_comes_back_bit_for_bit_whatever_the_parts(tmp_path, frames):
    table = WorkingTable(in_parts(full(), tmp_path / "table", frames))
    assert is_working_table(table.path)
    assert len(table) == len(full())
    assert_same_bits(table.read(), full())
    assert_same_bits(table.rows(20, 90), select_rows(full(), slice(20, 90)))


@pytest.mark.parametrize("frames", [1, 7, 1000])
def test_which_image_a_frame_is_comes_back_and_other_columns_of_the_file_s_own_do_not(tmp_path, frames):
    whole = full()
    names = [f"night-{frame}.fits" for frame in whole.frame]
    hashes = [f"{frame:064x}" for frame in whole.frame]
    texts = pa.chunked_array([pa.array(names).dictionary_encode()])
    unknown = {"image": texts, "image_sha256": pa.chunked_array([hashes]), "flux_dn": texts}
    path = in_parts(replace(whole, unknown=unknown), tmp_path / "table", frames)
    read = WorkingTable(path).read()
    assert {name: cells.to_pylist() for name, cells in read.unknown.items()} == {"image": names, "image_sha256": hashes}
    assert_same_bits(read, whole)
    index = frame_index(path)
    assert find_image(index.read(2), 0) == FrameImage("night-16.fits", f"{16:064x}")
    assert len(index.read(2).unknown["image"]) == ROWS


def test_a_table_that_names_no_images_reads_as_before(tmp_path):
    write_working_table(full(), tmp_path / "table")
    read = WorkingTable(tmp_path / "table").read()
    assert read.unknown == {}
    assert find_image(read, 0) is None
    columns = pa.ipc.open_file(str(tmp_path / "table")).schema.names
    assert not {"image", "image_sha256"} & set(columns)


def test_writing_into_mapped_arrays_leaves_the_file_alone_and_other_bytes_than_its_address_are_refused(tmp_path):
    write_working_table(full(), tmp_path / "table")
    before = compute_digest(tmp_path / "table")
    telemetry = WorkingTable(tmp_path / "table").read()
    assert not telemetry.row_px.flags.owndata
    telemetry.row_px[:] = 0
    telemetry.quaternion[:] = 0
    assert compute_digest(tmp_path / "table") == before
    write_working_table(full(), tmp_path / "table")
    with pytest.raises(CorruptFileError) as refused:
        WorkingTable(tmp_path / "table", "0" * 64).read()
    assert refused.value.sha256 == "0" * 64


@pytest.mark.parametrize("content", [b"", b"PAR1 and then nothing", b"ARROW1 and then nothing"])
def test_what_is_no_such_table_is_refused(tmp_path, content):
    (tmp_path / "table").write_bytes(content)
    assert is_working_table(tmp_path / "table") is content.startswith(b"ARROW1")
    with pytest.raises(RefusedInputError, check=has_code("damaged-table")):
        WorkingTable(tmp_path / "table").read()


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "table"
    write_working_table(simulated(1, frames=50, stars=7), path)
    return path


@given(n=st.integers(1, 5000), most=st.integers(1, 400))
def test_places_are_in_the_set_apart_evenly_and_as_many_as_asked(n, most):
    places = evenly(n, most)
    assert len(places) == min(n, most)
    assert places[0] == 0
    assert np.ptp(np.diff(places)) <= 1 if len(places) > 1 else True
    assert places[-1] <= n - 1


def test_a_sample_holds_whole_frames_row_for_row_and_fewer_where_each_has_many_stars(stored):
    whole, sample = WorkingTable(stored).read(), read_sample(stored, 9, 10_000)
    rows = np.isin(whole.frame, sample.telemetry.frame)
    assert (sample.frames, sample.frames_in_set) == (9, 50)
    for name in ("frame", "exposure", "row_px", "col_px", "star_id", "ra_rad"):
        np.testing.assert_array_equal(getattr(sample.telemetry, name), getattr(whole, name)[rows])
    sample = read_sample(stored, 200, 14 * 5)
    assert (sample.frames, len(sample.telemetry)) == (5, 14 * 5)


STARS = 5


def written(path, exposures, first_frame=0):
    """Write a table whose exposures are those of these numbers; frames are counted from `first_frame`."""
    stars = [np.random.default_rng(number).uniform(0, 1000, (STARS, 2)) for number in exposures]
    place = np.concatenate(stars) if stars else np.zeros((0, 2))
    frame = np.repeat(np.arange(first_frame, first_frame + len(exposures)), STARS)
    write_working_table(Telemetry(frame, np.zeros_like(frame), place[:, 0], place[:, 1]), path)
    return path


@settings(max_examples=20)
@given(st.sets(st.integers(0, 30), min_size=1), st.sets(st.integers(0, 30), min_size=1))
def test_the_shares_are_those_of_the_sets(tmp_path_factory, one, other):
    folder = tmp_path_factory.mktemp("tables")
    paths = written(folder / "a", sorted(one)), written(folder / "b", sorted(other), first_frame=500)
    common = len(one & other)
    assert shared_exposures(*paths) == (common / len(one), common / len(other))


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
    monkeypatch.setattr(formats, "PIECE_BYTES", 700)


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
        patch.setattr(formats, "PIECE_BYTES", piece_bytes)
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
    with pytest.raises(RefusedInputError, match=r"row 11\b.*row_px.*'x'.* 49"):
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
    with pytest.raises(RefusedInputError, match=r"frame 0 .*10 rows", check=has_code("frame-too-large")):
        list(read_chunks(tmp_path / "pass.parquet"))


@pytest.mark.usefixtures("in_small_pieces")
def test_a_line_without_end_is_refused(tmp_path):
    (tmp_path / "pass.csv").write_text(GOOD + "1,0,9,9," + "9" * 5000)
    with pytest.raises(RefusedInputError, match=r"row 6.*700 bytes"):
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
    with pytest.raises(RefusedInputError, match=r"row 34\b.*row_px"):
        list(torn.chunks(1))
    path.write_bytes(path.read_bytes()[:-9] + b"PAR1")
    with pytest.raises(RefusedInputError, check=has_code("damaged-parquet")):
        stretches(path, "a.parquet", 1)


def test_what_is_saved_as_parquet_keeps_rows_together_in_groups_that_one_frame_is_read_from_soon(tmp_path):
    n = ROW_GROUP + 10
    ones = np.ones(n)
    saved = Telemetry(frame=np.arange(n) // 10, exposure=np.zeros(n, np.int64), row_px=ones, col_px=ones)
    save_telemetry(saved, tmp_path / "saved.parquet")
    file = arrow_parquet.ParquetFile(tmp_path / "saved.parquet")
    assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [ROW_GROUP, 10]
