"""Small telemetry files as text, and what a refusal of one must name."""

from dataclasses import fields

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet
import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.schema import Telemetry

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


def format_cells(telemetry: Telemetry) -> dict[str, list[str]]:
    return {name: cells.to_pylist() for name, cells in telemetry.unknown.items()}


CONVERTED = {"ra_rad", "dec_rad", "quaternion", "velocity_m_s"}  # in another unit, or normalised


def assert_same(one, other):
    for name in (item.name for item in fields(Telemetry) if item.name not in {"unknown", "first_row"}):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            if name in CONVERTED:
                np.testing.assert_allclose(mine, theirs, rtol=1e-15, atol=1e-300, err_msg=name)
            else:
                np.testing.assert_array_equal(mine, theirs, err_msg=name)
    assert format_cells(one) == format_cells(other)
