"""One frame out of a stored table is that frame of the whole set, in whatever parts it was written."""

import time
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.errors import NotFoundError, RefusedInputError
from boresight.telemetry.read.frames import frame_index
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.working_table import WorkingTableParts, write_working_table

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
def stored(request, tmp_path_factory):
    path, whole, rows = tmp_path_factory.mktemp("table") / "table", telemetry(), request.param * ROWS
    with WorkingTableParts(path) as parts:
        for begin in range(0, len(whole), rows):
            parts.write(select_rows(whole, slice(begin, min(begin + rows, len(whole)))))
    return path


@CALM
@given(place=st.integers(0, FRAMES - 1), neighbours=st.integers(0, 5))
def test_a_frame_with_its_neighbours_is_those_rows_of_the_whole_set(stored, place, neighbours):
    whole, index = telemetry(), frame_index(stored)
    first, last = max(place - neighbours, 0) * ROWS, min(place + neighbours + 1, FRAMES) * ROWS
    expected, read = select_rows(whole, slice(first, last)), index.read(place, neighbours)

    for item in fields(Telemetry):
        value = getattr(expected, item.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(read, item.name), value)
        elif item.name == "first_row":
            assert read.first_row == value


def test_the_index_knows_frames_stars_and_how_many_an_exposure_has(stored):
    index = frame_index(stored)

    assert index.frame.tolist() == list(range(10, 10 + 3 * FRAMES, 3))
    assert index.find_place(16) == 2
    assert index.named_stars.tolist() == [11, 22, 33, 44]
    assert index.typical_stars == 3.5  # exposures of four and of three
    assert frame_index(stored) is index


@pytest.mark.parametrize("frame", [9, 11, 10_000])
def test_a_frame_that_is_not_there_is_refused_with_those_that_are(stored, frame):
    with pytest.raises(NotFoundError, match="its 60 frames are numbered from 10 to 187"):
        frame_index(stored).find_place(frame)


def test_a_damaged_table_is_refused(tmp_path):
    path = tmp_path / "damaged"
    path.write_bytes(b"PAR1 and then nothing of the kind")

    with pytest.raises(RefusedInputError, match="is damaged: restore it from a backup"):
        frame_index(path)


def test_a_table_that_names_no_stars_has_none(tmp_path):
    write_working_table(replace(telemetry(), star_id=None), tmp_path / "table")

    assert frame_index(tmp_path / "table").named_stars.tolist() == []


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
