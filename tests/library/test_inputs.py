"""Telemetry from a file, a table or arrays is the same telemetry, and what is wrong with it is said in the same words."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

import boresight as bs
from boresight.telemetry.writing import contract_table

PANDAS_FRAMES = Path(__file__).parent / "pandas_frames.py"
ROOT = PANDAS_FRAMES.parents[2]


class OnlyInterchange:
    """A table as libraries hand it on that have no Arrow."""

    def __init__(self, table):
        self._table = table

    def __dataframe__(self, nan_as_null=False, allow_copy=True):
        return self._table.__dataframe__(nan_as_null, allow_copy)


def columns_of(table):
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def structured(table):
    arrays = {
        name: np.nan_to_num(values.astype(np.float64), nan=0.0)
        for name, values in columns_of(table).items()
        if name != "time_utc"
    }
    rows = np.zeros(table.num_rows, dtype=[(name, np.float64) for name in arrays])
    for name, values in arrays.items():
        rows[name] = values
    return rows


WAYS = {
    "polars": pl.DataFrame,
    "pyarrow": lambda table: table,
    "interchange": lambda table: OnlyInterchange(table.drop_columns("time_utc")),
    "arrays": columns_of,
    "structured": structured,
}


@pytest.fixture(scope="module")
def table(simulated):
    return contract_table(simulated.telemetry)


@pytest.mark.parametrize("way", WAYS)
def test_a_table_in_memory_is_the_same_telemetry(way, table, simulated):
    read = bs.read_telemetry(WAYS[way](table))
    for name in ("frame", "exposure", "row_px", "col_px", "star_id", "magnitude", "quaternion", "velocity_m_s"):
        np.testing.assert_allclose(getattr(read, name), getattr(simulated.telemetry, name), rtol=1e-12, err_msg=name)
    if read.time_utc is not None:
        assert np.array_equal(read.time_utc, simulated.telemetry.time_utc)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_file_is_the_same_telemetry(kind, simulated, tmp_path):
    simulated.save(tmp_path, kind)
    read = bs.read_telemetry(tmp_path / f"calibration.{kind}")
    np.testing.assert_allclose(read.row_px, simulated.telemetry.row_px, rtol=1e-12)
    assert np.array_equal(read.star_id, simulated.telemetry.star_id)


def test_a_frame_and_its_file_give_the_same_calibration(cal, simulated):
    assert simulated.to_frame("pyarrow").equals(contract_table(simulated.telemetry))
    again = bs.calibrate(simulated.to_frame("polars"), sensor=simulated.sensor, progress=False)
    assert again.parameters.to_dict() == cal.parameters.to_dict()
    assert again.sigma.to_dict() == cal.sigma.to_dict()


def test_texts_and_categories_of_polars_are_kept_as_they_are(table):
    frame = pl.DataFrame(table).with_columns(
        pl.lit("night").alias("pass"), pl.lit("a").cast(pl.Categorical).alias("mode")
    )
    assert set(bs.read_telemetry(frame).unknown) == {"pass", "mode"}


@pytest.mark.parametrize("way", ["polars", "arrays"])
def test_a_wrong_cell_is_named_by_its_row_and_column_counted_as_the_table_counts(way, table):
    row_px = table["row_px"].to_numpy().copy()
    row_px[7] = np.inf
    broken = table.set_column(table.column_names.index("row_px"), "row_px", pa.array(row_px))
    with pytest.raises(bs.RefusedInputError) as refused:
        bs.read_telemetry(WAYS[way](broken))
    assert [(fault.row, fault.column) for fault in refused.value.faults] == [(7, "row_px")]
    assert str(refused.value).count("\n") == 0


@pytest.mark.parametrize(
    ("source", "word"),
    [
        (3.0, "float"),
        (pl.LazyFrame({"frame": [1]}), r"LazyFrame.*\.collect\(\)"),
        ({}, "columns"),
        ({"frame": [1, 2], "exposure": [0]}, "exposure"),
        ({"frame": np.zeros((2, 2))}, "frame"),
        (pl.DataFrame({"frame": [1], "exposure": [0], "row_px": [1.0]}), "col_px"),
        (pa.table([[1], [0], [2]], ["frame", "exposure", "frame"]), "two columns 'frame'"),
        ("nowhere.csv", "nowhere.csv"),
    ],
    ids=["number", "lazy", "nothing", "lengths", "shape", "column", "twice", "file"],
)
def test_what_is_no_telemetry_is_refused_in_one_sentence_that_names_it(source, word):
    with pytest.raises(bs.RefusedInputError, match=word) as refused:
        bs.read_telemetry(source)
    assert "\n" not in str(refused.value)


def test_rows_in_place_of_columns_are_refused(simulated):
    rows = pl.DataFrame(contract_table(simulated.telemetry)).to_dicts()
    with pytest.raises(bs.RefusedInputError, match="rows; give columns"):
        bs.calibrate(rows, simulated.sensor)


@pytest.mark.parametrize(("column", "remedy"), [("row_px", "drop the row"), ("magnitude", "leave it empty")])
@pytest.mark.parametrize("cell", ["abc", "inf"])
def test_only_a_cell_that_may_be_empty_is_advised_to_be(column, remedy, cell, table):
    cells = [cell, *table[column].to_pylist()[1:]]
    broken = table.set_column(table.column_names.index(column), column, pa.array(list(map(str, cells))))
    with pytest.raises(bs.RefusedInputError, match=f"correct it or {remedy}"):
        bs.read_telemetry(broken)


def test_a_sensor_is_a_file_what_it_says_or_itself(simulated, tmp_path):
    simulated.save(tmp_path)
    for source in (
        tmp_path / "sensor.json",
        str(tmp_path / "sensor.json"),
        simulated.scenario["sensor"],
        simulated.sensor,
    ):
        assert bs.read_sensor(source).name == simulated.sensor.name


def test_frames_of_pandas_are_telemetry_and_parameters_come_as_one(data_folder):
    told = os.environ.get("PANDAS_FOLDER")  # by make, which installs it there
    folder = Path(told or f"{sys.prefix}/pandas")
    if told is None and not folder.is_dir():
        pytest.skip("there is no pandas beside the other packages: `make test` installs it")
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    environment |= {"BORESIGHT_DATA_FOLDER": str(data_folder)}
    del environment["NUMBA_CACHE_DIR"]
    command = [sys.executable, "-m", "tests.library.pandas_frames"]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("check_") == len(re.findall(r"^def check_", PANDAS_FRAMES.read_text(), re.MULTILINE))
