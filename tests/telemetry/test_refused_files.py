"""A file that cannot be read as a whole is refused in one sentence that says what it is."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.read.readers import read_telemetry
from tests.telemetry.files import GOOD, HEADER, MINIMAL, assert_single_fault, parquet_bytes, refused


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\n \n", "nothing but blanks"),
        (b"\xef\xbb\xbf", "nothing but blanks"),
        (HEADER.encode(), "header but no rows"),
        (HEADER.encode() + b"\n\n", "header but no rows"),
        (GOOD.encode("utf-16"), "UTF-16"),
        (GOOD.encode("utf-16-le"), "UTF-16"),
        (GOOD.encode("utf-32"), "UTF-16 or UTF-32"),
        (GOOD.replace("star_id", "étoile").encode("latin-1"), "row 1: the byte 0xe9 is not UTF-8"),
        ((GOOD + "1,0,9,9,é").encode("latin-1"), "row 6: the byte 0xe9 is not UTF-8"),
        (GOOD.replace(",", ";").encode(), "semicolons"),
        (GOOD.replace(",", "\t").encode(), "tabs"),
        (GOOD.replace("star_id", "").encode(), "column 5 has no name"),
        (GOOD.replace("star_id", "frame").encode(), "row 1, column frame: is there twice"),
        (GOOD.replace("\n0,1", "\n\n0,1").encode(), "row 4: is blank"),
        (GOOD.replace("40.25,", "40.25,,").encode(), "row 3: has 6 cells where the header has 5"),
        (GOOD.replace("40.25,", "40.25").encode(), "row 3: has 4 cells where the header has 5"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is a PNG image: Boresight reads star centroids"),
        (b"PK\x03\x04rest of a spreadsheet", "spreadsheet"),
        (b"PAR1 rest", "is named as CSV but its content looks like Parquet"),
        (b'{"frame": 0}', "is named as CSV but its content looks like JSON Lines"),
    ],
)
def test_a_file_that_is_no_csv_is_refused_with_what_it_is(read, content, words):
    assert words in str(refused(read, content))


@pytest.mark.parametrize(
    "content",
    [
        'frame,exposure,row_px,col_px,note\n0,0,1,2,"a\nb"\n0,0,3,4,c\n',
        'frame,exposure,row_px,col_px,note\n0,0,1,2,"a\n0,0,3,4,c\n',
    ],
    ids=["line break in a cell", "quotation mark not closed"],
)
def test_cells_over_several_lines_are_refused(read, content):
    assert any(word in str(refused(read, content)) for word in ("line breaks", "quotation", "cells where"))


@pytest.mark.parametrize(
    ("line", "row", "column", "words"),
    [
        ('{"frame":1,"exposure":0,"row_px":"abc","col_px":2}', 2, "row_px", "'abc' is not a number"),
        ('{"frame":1,"exposure":0,"row_px":true,"col_px":2}', 2, "row_px", "'true' is not a number"),
        ('{"frame":1,"exposure":0,"row_px":[1],"col_px":2}', 2, "row_px", "'[1]' is not a number"),
        ('{"frame":1.5,"exposure":0,"row_px":1,"col_px":2}', 2, "frame", "whole number"),
        ('{"frame":1,"exposure":0,"row_px":1}', 2, "col_px", "empty"),
        ('{"frame":1,"exposure":0,"row_px":NaN,"col_px":2}', 2, "row_px", "not a measurement"),
        ('{"frame":1,"exposure":0,"row_px":1,"col_px":2', 2, None, "not JSON"),
        ("[1, 2]", 2, None, "not a JSON object"),
        ('{"frame":1,"exposure":0,"row_px":1,"col_px":2}{"frame":1}', 2, None, "not JSON"),
    ],
)
def test_a_wrong_line_of_json_is_named(read, line, row, column, words):
    first = '{"frame":0,"exposure":0,"row_px":1,"col_px":2}'
    assert_single_fault(refused(read, f"{first}\n{line}\n", "pass.jsonl"), row, column, words)


def test_a_json_number_written_as_text_is_a_number(read):
    telemetry = read(
        '{"frame":0,"exposure":0,"row_px":"1.5","col_px":2,"star_id":"","note":[1,{"a":2}]}', "pass.ndjson"
    )
    assert telemetry.row_px.tolist() == [1.5]
    assert telemetry.star_id.tolist() == [0]
    assert telemetry.unknown["note"].to_pylist() == ['[1,{"a":2}]']


@pytest.mark.parametrize(
    ("content", "words"), [("\n", "blanks"), ("a,b\n1,2", "named as JSON Lines"), ("{}\n\n{}", "row 2: is blank")]
)
def test_a_file_that_is_no_json_lines_is_refused(read, content, words):
    assert words in str(refused(read, content, "pass.jsonl"))


@pytest.mark.parametrize("keep", [4, 20, 200, -1])
def test_truncated_parquet_is_refused(read, keep):
    error = refused(read, parquet_bytes(MINIMAL)[:keep], "pass.parquet")
    assert "truncated or damaged" in str(error)


def test_damaged_pages_of_parquet_are_refused(read):
    content = bytearray(parquet_bytes({**MINIMAL, "note": ["x" * 500, "y" * 500]}))
    content[4:60] = bytes(56)
    assert "truncated or damaged" in str(refused(read, bytes(content), "pass.parquet"))


@pytest.mark.parametrize("text", [b"note", b"x" * 7])
def test_parquet_text_that_is_not_utf8_is_refused(read, text):
    content = parquet_bytes({**MINIMAL, "note": ["x" * 7, "y"]}).replace(text, b"\xff" * len(text))
    assert "truncated or damaged" in str(refused(read, content, "pass.parquet"))


@pytest.mark.parametrize(
    ("columns", "row", "column", "words"),
    [
        ({**MINIMAL, "row_px": [1.0, None]}, 2, "row_px", "empty"),
        ({**MINIMAL, "row_px": [1.0, float("nan")]}, 2, "row_px", "not a measurement"),
        ({**MINIMAL, "row_px": [[1.0], [2.0]]}, None, "row_px", "numbers are expected"),
        ({**MINIMAL, "row_px": ["1.0", "x"]}, 2, "row_px", "'x' is not a number"),
        ({**MINIMAL, "time_utc": [1, 2]}, None, "time_utc", "times are expected"),
        ({key: [] for key in MINIMAL}, None, None, "no rows"),
    ],
)
def test_parquet_cells_are_held_to_the_same(read, columns, row, column, words):
    assert_single_fault(refused(read, parquet_bytes(columns), "pass.parquet"), row, column, words)


def test_parquet_types_of_other_programs_are_understood(read):
    content = parquet_bytes(
        {
            "frame": pa.array([0, 1], pa.uint8()),
            "exposure": pa.array([0.0, 0.0], pa.float32()),
            "row_px": pa.array([1, 2], pa.int32()),
            "col_px": pa.array(["3", "4"]).dictionary_encode(),
            "time_utc": pa.array(["2024-01-01", None]).cast(pa.timestamp("ns")),
            "star_id": pa.array([None, 5.0], pa.float64()),
            "magnitude": pa.nulls(2),
            "blob": pa.array([b"\xff", None], pa.binary()),
        }
    )
    telemetry = read(content, "pass.parquet")
    assert telemetry.col_px.tolist() == [3.0, 4.0]
    assert telemetry.star_id.tolist() == [0, 5]
    assert telemetry.time_utc[0] == np.datetime64("2024-01-01", "us")
    assert np.isnan(telemetry.magnitude).all()
    assert len(telemetry.unknown["blob"]) == 2


def test_text_named_parquet_is_refused(read):
    assert "named as Parquet" in str(refused(read, GOOD, "pass.parquet"))


def test_a_column_twice_in_parquet_is_refused(read):
    sink = pa.BufferOutputStream()
    arrow_parquet.write_table(pa.Table.from_arrays([pa.array([1]), pa.array([2])], names=["frame", "frame"]), sink)
    assert_single_fault(refused(read, sink.getvalue().to_pybytes(), "pass.parquet"), None, "frame", "twice")


def test_a_folder_or_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RefusedInputError, match="is a folder"):
        read_telemetry(tmp_path)
    with pytest.raises(RefusedInputError, match="does not exist"):
        read_telemetry(tmp_path / "nowhere.csv")


def test_only_the_first_twenty_faults_are_listed_and_the_others_counted(read):
    error = refused(read, "\n".join([HEADER, *(f"{k},0,x,2,3" for k in range(500))]))
    assert len(error.faults) == 20
    assert [fault.row for fault in error.faults] == list(range(2, 22))
    assert str(error).endswith("(and 499 more faults)")
