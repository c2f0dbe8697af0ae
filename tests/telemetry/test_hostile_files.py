"""Files made to exhaust whoever reads them, and the limits that hold them."""

import contextlib
import json
import subprocess
import sys
import time

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.errors import RefusedInputError
from boresight.settings import read_settings
from boresight.telemetry.read.limits import LIMITS, STORED, Limits
from boresight.telemetry.read.parquet import DamagedPageError, iterate_pages, read_layout
from boresight.telemetry.read.tables import read_table
from boresight.telemetry.readers import read_chunks, read_telemetry, stretches
from tests.refusals import has_code
from tests.telemetry import hostile_files
from tests.telemetry.files import GOOD

MOST_S, MOST_MB = 5.0, 500.0
#: Made quickly, one of each kind of trouble; the others run with --full.
QUICK = (
    "header of 100,000 columns.csv",
    "996 columns of nothing.csv",
    "every quote unclosed.csv",
    "blank lines forever.csv",
    "exposures of 10,000 stars in a line.csv",
    "arrays nested over lines.jsonl",
    "a thousand keys, then empty lines.jsonl",
    "text of 4000 bytes in a million rows.parquet",
    "pages larger than they are.parquet",
    "64 bits flipped.parquet",
)


@pytest.fixture(scope="module")
def reading():
    command = [sys.executable, "-m", "tests.telemetry.reading_process"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"

        def read(path):
            process.stdin.write(f"{path}\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield read
        process.stdin.close()


def names():
    assert len(hostile_files.FILES) >= 100
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.full) for name in hostile_files.FILES]


@pytest.mark.few(4)
@pytest.mark.parametrize("name", names())
def test_a_hostile_file_ends_soon_and_in_little_memory(name, reading, tmp_path):
    path = tmp_path / name
    path.write_bytes(hostile_files.content(name))
    done = reading(path)
    assert done["outcome"][0] in {"accepted", "refused"}, done
    assert done["cpu_s"] < MOST_S
    assert done["peak_mb"] < MOST_MB


#: Seeds among whose files are footers over which Arrow ended the process when it was asked for a column of a group of rows.
ENDED_THE_PROCESS = (13, 35)


def mutated(rng):
    kind = rng.choice(["csv", "jsonl", "parquet"])
    if kind == "csv":
        data = GOOD.encode() * 1
    elif kind == "jsonl":
        data = b'{"frame":0,"exposure":0,"row_px":1.5,"col_px":2,"note":"a","time_utc":"2026-01-01T00:00:00Z"}\n' * 4
    else:
        options = [
            {},
            {"use_dictionary": False},
            {"data_page_version": "2.0"},
            {"compression": "gzip"},
            {"row_group_size": 7},
        ]
        columns = {
            **hostile_files.make_rows(60),
            "note": ["a", "bb", "ccc"] * 20,
            "time_utc": ["2026-01-01T00:00:00Z"] * 60,
        }
        data = hostile_files.parquet(columns, **options[rng.integers(len(options))])
    data = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 2, 4, 16]))):
        place = int(rng.integers(len(data)))
        match rng.integers(4):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place] = int(rng.integers(256))
            case 2:
                del data[place : place + int(rng.integers(1, 9))]
            case _:
                data[place:place] = data[place : place + int(rng.integers(1, 30))]
        if not data:
            break
    return f"pass.{kind}", bytes(data)


@pytest.mark.parametrize(
    "seed",
    [
        0,
        *ENDED_THE_PROCESS,
        *(pytest.param(seed, marks=pytest.mark.full) for seed in range(1, 40) if seed not in ENDED_THE_PROCESS),
    ],
)
def test_fifty_mutated_files_are_read_or_refused_in_words(seed, tmp_path):
    rng = np.random.default_rng(seed)
    for _ in range(50):
        name, data = mutated(rng)
        (tmp_path / name).write_bytes(data)
        with contextlib.suppress(RefusedInputError):  # anything else fails the test
            read_telemetry(tmp_path / name)


FORMS = ["csv", "jsonl", "parquet"]


def make_columns(rows=2, **more):
    k = np.arange(rows)
    return {"frame": k // 2, "exposure": 0 * k, "row_px": k * 1.5, "col_px": k * 2.5} | more


def write(path, columns):
    rows = [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)]
    if path.suffix == ".csv":
        path.write_text("\n".join([",".join(columns), *(",".join(map(str, row.values())) for row in rows)]))
    elif path.suffix == ".jsonl":
        path.write_bytes(b"\n".join(orjson.dumps(row, option=orjson.OPT_SERIALIZE_NUMPY) for row in rows))
    else:
        arrow_parquet.write_table(pa.table(columns), path)
    return path


def refusal(path, limits=LIMITS):
    with pytest.raises(RefusedInputError) as caught:
        list(read_chunks(path, limits=limits))
    return caught.value


@pytest.mark.parametrize("form", FORMS)
def test_a_thousand_columns_are_read_and_one_more_is_refused(form, tmp_path):
    wide = make_columns(**{f"c{k}": ["a", "b"] for k in range(996)})
    assert len(read_telemetry(write(tmp_path / f"wide.{form}", wide)).unknown) == 996
    path = write(tmp_path / f"wider.{form}", wide | {"more": ["a", "b"]})
    assert "1,001 columns, at most 1,000 are read" in str(refusal(path))
    assert len(read_telemetry(path, limits=Limits(columns=1001)).unknown) == 997


def test_a_header_of_a_hundred_thousand_columns_is_refused_in_no_time(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(",".join(["frame,exposure,row_px,col_px", *(f"c{k}" for k in range(100_000))]) + "\n0,0,1,2")
    began = time.process_time()
    error = refusal(path)
    assert time.process_time() - began < 1.0
    assert "100,004 columns, at most 1,000" in str(error)


@pytest.mark.parametrize("form", FORMS)
def test_too_many_rows_too_long_texts_and_names_are_refused(form, tmp_path):
    long = write(tmp_path / f"long.{form}", make_columns(9))
    assert len(read_telemetry(long, limits=Limits(rows=9))) == 9
    assert "has over 8 rows" in str(refusal(long, Limits(rows=8)))
    path = write(tmp_path / f"note.{form}", make_columns(note=["short", "x" * 4096]))
    assert read_telemetry(path).unknown["note"].to_pylist() == ["short", "x" * 4096]
    error = str(refusal(write(tmp_path / f"note.{form}", make_columns(note=["short", "x" * 4097]))))
    assert "4,096" in error
    assert "note" in error
    named = refusal(write(tmp_path / f"name.{form}", make_columns(**{"n" * 256: [1, 2]})))
    assert "the name of column 5 is over 255 bytes long" in str(named)


@pytest.mark.parametrize("form", ["csv", "jsonl"])
def test_a_line_that_is_too_long_is_refused_by_its_row(form, tmp_path):
    error = refusal(write(tmp_path / f"line.{form}", make_columns(note=["short", "x" * 1_000_000])))
    assert f"row {3 if form == 'csv' else 2}: is over 1,000,000 bytes long" in str(error)


@pytest.mark.parametrize("length", [1000, 100_000])
def test_a_small_parquet_file_that_repeats_a_long_text_is_refused_before_it_is_expanded(length, tmp_path):
    rows = 1_000_000
    note = pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), pa.array(["x" * length]))
    path = tmp_path / "bomb.parquet"
    arrow_parquet.write_table(pa.table(make_columns(rows, note=note)), path, compression="zstd")
    before = pa.default_memory_pool().max_memory()
    error = refusal(path)
    assert path.stat().st_size < 10e6
    assert ("64 times its size" if length == 1000 else "4,096 bytes") in str(error)
    assert pa.default_memory_pool().max_memory() - before < 100e6


def test_what_a_file_says_in_its_page_headers_is_held_to_the_limits(tmp_path):
    path = tmp_path / "zeros.parquet"
    zeros = {"frame": pa.array(np.zeros(40_000_000, np.int8))}
    arrow_parquet.write_table(pa.table(zeros), path, compression="zstd", use_dictionary=False)
    with pytest.raises(RefusedInputError, match="64 times", check=has_code("expands-too-far")):
        read_layout(path, path.name)
    assert path.stat().st_size < 1e6
    assert read_layout(path, path.name, STORED).rows == 40_000_000


@pytest.mark.parametrize(
    "damage", [b"\x00", b"\x15\xff", b"\x1c" * 40, b"\x19\xfc\xff\xff\xff\x0f", b"\x18\xff\xff\x03"]
)
def test_a_damaged_page_header_is_told(damage):
    with pytest.raises(DamagedPageError):
        list(iterate_pages(damage, 0, len(damage)))


@pytest.mark.parametrize(
    ("column", "options", "words"),
    [
        ([[1, 2], []], {}, "one value per row is expected"),
        ([{"a": 1}, {"a": 2}], {}, "one value per row is expected"),
        (pa.array([b"x" * 33] * 2, pa.binary(33)), {}, "33 bytes per value"),
        (["aa", "ab"], {"use_dictionary": False, "column_encoding": {"note": "DELTA_BYTE_ARRAY"}}, "DELTA_BYTE_ARRAY"),
    ],
)
def test_columns_whose_size_nothing_bounds_are_refused(column, options, words, tmp_path):
    path = tmp_path / "pass.parquet"
    arrow_parquet.write_table(pa.table(make_columns(note=column)), path, **options)
    assert words in str(refusal(path))


def test_exposures_that_cannot_be_compared_and_sparse_json_are_refused(tmp_path):
    path = tmp_path / "pass.parquet"
    k = np.arange(10_001)
    columns = {"frame": 0 * k, "exposure": 0 * k, "row_px": k * 1.0, "col_px": k * 1.0}
    arrow_parquet.write_table(pa.table(columns), path)
    assert "exposure 0 of frame 0 has over 10,000 detections" in str(refusal(path))
    path = tmp_path / "sparse.jsonl"
    path.write_bytes(orjson.dumps({f"k{k}": 1 for k in range(900)}) + b"\n{}" * 100_000)
    assert "different keys" in str(refusal(path))


def test_texts_of_parquet_stay_shared_and_are_written_as_they_came(tmp_path):
    notes = ["alpha", None, "beta", "alpha"]
    path = write(tmp_path / "pass.parquet", make_columns(4, note=notes))
    unknown = read_telemetry(path).unknown["note"]
    assert pa.types.is_dictionary(unknown.type)
    assert unknown.to_pylist() == ["alpha", "", "beta", "alpha"]
    assert read_table(path, path.name)["note"].to_pylist() == notes


def test_an_ordinary_large_file_is_far_from_every_limit_and_settings_raise_them(tmp_path):
    rng, rows = np.random.default_rng(3), 200_000
    k = np.arange(rows)
    names = ("q_x", "q_y", "q_z", "q_w", "vx_km_s", "vy_km_s", "vz_km_s", "sigma_px")
    constant = dict.fromkeys(names, np.full(rows, 0.5))
    noise = {name: rng.uniform(0, 1000, rows) for name in ("row_px", "col_px")}
    path = tmp_path / "pass.parquet"
    times = {"time_utc": ["2026-01-01T00:00:00Z"] * rows, "star_id": k % 20}
    arrow_parquet.write_table(pa.table(make_columns(rows) | noise | constant | times), path, compression="zstd")
    read_telemetry(path)
    layout = read_layout(path, path.name)
    assert layout.batch_rows == 131_072
    assert rows * len(layout.columns) * 8 < LIMITS.expanded(path.stat().st_size) / 5
    assert stretches(path, path.name, 100) == []
    limits = read_settings({"BORESIGHT_TELEMETRY_ROWS": "7", "BORESIGHT_TELEMETRY_COLUMNS": "9"}).telemetry_limits
    assert (limits.rows, limits.columns) == (7, 9)
