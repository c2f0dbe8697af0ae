"""Sets stored as Parquet before tables were mapped: converted once, to the numbers that every run made of them."""

from unittest import mock

import pytest

from boresight.disks import compute_digest
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.working_tables import table_path, working_table
from boresight.telemetry.read.limits import STORED
from boresight.telemetry.read.readers import read_telemetry, write_parquet
from boresight.telemetry.working_table import WorkingTable, write_working_table
from tests.telemetry.test_working_table import assert_same_bits, full


@pytest.fixture
def blobs(tmp_path):
    return FolderBlobStore(tmp_path / "blobs")


@pytest.fixture
def before(blobs, tmp_path):
    """The address of a set that was stored as Parquet."""
    write_parquet(full(), tmp_path / "before.parquet")
    return blobs.put(tmp_path / "before.parquet")


def test_a_set_stored_before_has_the_arrays_that_runs_made_of_it(blobs, before):
    path, sha256 = working_table(blobs, before)

    assert compute_digest(path) == sha256 != before
    assert_same_bits(WorkingTable(path, sha256).read(), read_telemetry(blobs.path(before), "t.parquet", STORED))


def test_it_is_converted_once_and_its_address_stays(blobs, before):
    first = table_path(blobs, before)
    with mock.patch("boresight.platform.blobs.working_tables.read_chunks", side_effect=AssertionError):
        assert table_path(blobs, before) == first
    assert blobs.path(before).read_bytes()[:4] == b"PAR1"


def test_a_converted_table_that_was_altered_is_made_again(blobs, before):
    path = table_path(blobs, before)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + b"x")

    assert table_path(blobs, before).read_bytes() == whole


def test_a_set_stored_as_a_mapped_table_is_that_file(blobs, tmp_path):
    write_working_table(full(), tmp_path / "table")
    sha256 = blobs.put(tmp_path / "table")

    assert working_table(blobs, sha256) == (blobs.path(sha256), sha256)
