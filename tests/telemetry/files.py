"""Small telemetry files as text, and what a refusal of one must name."""

import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.errors import RefusedInputError

HEADER = "frame,exposure,row_px,col_px,star_id"
ROWS = ["0,0,10.5,20.25,11", "0,0,30.5,40.25,", "0,1,10.5,20.25,11", "1,0,50,60,-1"]
GOOD = "\n".join([HEADER, *ROWS]) + "\n"


def with_columns(columns, cells):
    return f"frame,exposure,row_px,col_px,{columns}\n0,0,1,2,{cells}\n"


def refused(read, content, name="pass.csv"):
    with pytest.raises(RefusedInputError) as caught:
        read(content, name)
    return caught.value


def assert_single_fault(error, row, column, *words):
    assert [(fault.row, fault.column) for fault in error.faults] == [(row, column)]
    for word in words:
        assert word in str(error)


def parquet_bytes(columns):
    sink = pa.BufferOutputStream()
    arrow_parquet.write_table(columns if isinstance(columns, pa.Table) else pa.table(columns), sink)
    return sink.getvalue().to_pybytes()


MINIMAL = {"frame": [0, 0], "exposure": [0, 0], "row_px": [1.0, 2.0], "col_px": [3.0, 4.0]}
