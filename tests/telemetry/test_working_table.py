"""The stored table of a set: its arrays bit for bit, mapped in parts, and used by a calibration as they are."""

from dataclasses import fields, replace

import numpy as np
import pytest

from boresight.disks import compute_digest
from boresight.errors import CorruptFileError, RefusedInputError
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.working_table import WorkingTable, WorkingTableParts, is_working_table, write_working_table
from tests.telemetry.test_frames import ROWS, telemetry


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


def test_arrays_lie_on_the_mapping_and_writing_into_them_leaves_the_file_alone(tmp_path):
    write_working_table(full(), tmp_path / "table")
    before = compute_digest(tmp_path / "table")
    telemetry = WorkingTable(tmp_path / "table").read()

    assert not telemetry.row_px.flags.owndata
    telemetry.row_px[:] = 0
    telemetry.quaternion[:] = 0
    assert compute_digest(tmp_path / "table") == before


@pytest.mark.parametrize("content", [b"", b"PAR1 and then nothing", b"ARROW1 and then nothing"])
def test_what_is_no_such_table_is_refused(tmp_path, content):
    (tmp_path / "table").write_bytes(content)

    assert is_working_table(tmp_path / "table") is content.startswith(b"ARROW1")
    with pytest.raises(RefusedInputError, match="is damaged: restore it"):
        WorkingTable(tmp_path / "table").read()


def test_bytes_other_than_those_of_its_address_are_refused(tmp_path):
    write_working_table(full(), tmp_path / "table")

    with pytest.raises(CorruptFileError) as refused:
        WorkingTable(tmp_path / "table", "0" * 64).read()
    assert refused.value.sha256 == "0" * 64
