"""Some frames of a stored set: whole frames, evenly taken, the same rows as the set's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.read.frames import evenly, read_sample
from boresight.telemetry.working_table import WorkingTable, write_working_table
from tests.calibration.conftest import telemetry


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "table"
    write_working_table(telemetry(1, frames=50, stars=7), path)
    return path


@given(n=st.integers(1, 5000), most=st.integers(1, 400))
def test_places_are_in_the_set_apart_evenly_and_as_many_as_asked(n, most):
    places = evenly(n, most)

    assert len(places) == min(n, most)
    assert places[0] == 0
    assert np.ptp(np.diff(places)) <= 1 if len(places) > 1 else True
    assert places[-1] <= n - 1


def test_a_sample_holds_whole_frames_of_the_set_row_for_row(stored):
    whole, sample = WorkingTable(stored).read(), read_sample(stored, 9, 10_000)
    rows = np.isin(whole.frame, sample.telemetry.frame)

    assert (sample.frames, sample.frames_in_set) == (9, 50)
    for name in ("frame", "exposure", "row_px", "col_px", "star_id", "ra_rad"):
        np.testing.assert_array_equal(getattr(sample.telemetry, name), getattr(whole, name)[rows])


def test_fewer_frames_are_taken_where_each_has_many_stars(stored):
    sample = read_sample(stored, 200, 14 * 5)

    assert (sample.frames, len(sample.telemetry)) == (5, 14 * 5)


def test_a_damaged_table_is_refused_with_what_to_do(tmp_path):
    damaged = tmp_path / "table"
    damaged.write_bytes(b"PAR1 and then nothing")

    with pytest.raises(RefusedInputError, match="upload the telemetry again"):
        read_sample(damaged, 10, 100)
