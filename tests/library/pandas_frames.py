"""The library with pandas installed: frames in and out; run with pandas on the path, it asserts, and prints what it went through.

`test_inputs.py` runs it in a process of its own, for where pandas is, PyArrow loads it.
"""

import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import boresight as bs
from boresight.telemetry.writing import contract_table


def check_that_a_frame_is_the_same_telemetry(made, table):
    read = bs.read_telemetry(table.to_pandas())
    for name in ("frame", "exposure", "row_px", "col_px", "star_id", "magnitude", "quaternion", "velocity_m_s"):
        np.testing.assert_allclose(getattr(read, name), getattr(made.telemetry, name), rtol=1e-12, err_msg=name)
    assert np.array_equal(read.time_utc, made.telemetry.time_utc)


def check_that_a_frame_gives_the_calibration_of_its_arrays_and_parameters_come_as_a_frame(made, table):
    cal, again = (bs.calibrate(one, made.sensor, progress=False) for one in (made.telemetry, table.to_pandas()))
    assert again.parameters.to_dict() == cal.parameters.to_dict()
    for frame in (cal.to_frame("pandas"), cal.to_frame()):  # where it is installed it is the first choice
        assert isinstance(frame, pd.DataFrame)
        assert list(frame["parameter"]) == list(cal.parameters)


def check_that_a_wrong_cell_is_named_by_its_row_and_column(_, table):
    frame = table.to_pandas()
    frame.loc[7, "row_px"] = np.inf
    with pytest.raises(bs.RefusedInputError) as refused:
        bs.read_telemetry(frame)
    assert [(fault.row, fault.column) for fault in refused.value.faults] == [(7, "row_px")]


def check_that_a_column_that_is_there_twice_is_named(_, table):
    frame = table.to_pandas()
    with pytest.raises(bs.RefusedInputError, match="two columns 'row_px'"):
        bs.read_telemetry(pd.concat([frame, frame[["row_px"]]], axis=1))


def check_that_an_index_without_a_name_is_no_column(_, table):
    frame = table.to_pandas()
    frame.index = frame.index[::-1]
    assert bs.read_telemetry(frame).unknown == {}


def check_that_texts_and_categories_are_kept_and_missing_names_are_none(_, table):
    frame = table.to_pandas().assign(night="first", mode=pd.Categorical(["a"] * len(table)))
    frame["star_id"] = frame["star_id"].astype("Int64").mask(frame.index == 3)
    read = bs.read_telemetry(frame)
    assert set(read.unknown) == {"night", "mode"}
    assert read.star_id[3] == 0


if __name__ == "__main__":
    simulated = bs.simulate("st16-1", frames=30, progress=False)
    assert isinstance(simulated.to_frame("pandas"), pd.DataFrame)
    assert "pandas" in sys.modules
    assert pa.Table.from_pandas(simulated.to_frame(), preserve_index=False).num_rows == len(simulated.telemetry)
    for name, check in list(globals().items()):
        if name.startswith("check_"):
            check(simulated, contract_table(simulated.telemetry))
            sys.stdout.write(f"{name}\n")
