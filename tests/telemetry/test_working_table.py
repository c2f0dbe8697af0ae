"""The stored table of a set: bit for bit, mapped in parts; its frames, its sample and the exposures it shares with another."""

import time
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.disks import compute_digest
from boresight.errors import CorruptFileError, NotFoundError, RefusedInputError
from boresight.telemetry.read.frames import evenly, frame_index, read_sample
from boresight.telemetry.sampling import exposure_marks, shared_exposures
from boresight.telemetry.schema import Telemetry, select_rows
from boresight.telemetry.working_table import WorkingTable, WorkingTableParts, is_working_table, write_working_table
from tests.calibration.conftest import telemetry as simulated

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
def stored_in_parts(request, tmp_path_factory):
    path, whole, rows = tmp_path_factory.mktemp("table") / "table", telemetry(), request.param * ROWS
    with WorkingTableParts(path) as parts:
        for begin in range(0, len(whole), rows):
            parts.write(select_rows(whole, slice(begin, min(begin + rows, len(whole)))))
    return path


@CALM
@given(place=st.integers(0, FRAMES - 1), neighbours=st.integers(0, 5))
def test_a_frame_with_its_neighbours_is_those_rows_of_the_whole_set(stored_in_parts, place, neighbours):
    whole, index = telemetry(), frame_index(stored_in_parts)
    first, last = max(place - neighbours, 0) * ROWS, min(place + neighbours + 1, FRAMES) * ROWS
    expected, read = select_rows(whole, slice(first, last)), index.read(place, neighbours)
    for item in fields(Telemetry):
        value = getattr(expected, item.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(read, item.name), value)
        elif item.name == "first_row":
            assert read.first_row == value


def test_the_index_knows_frames_stars_and_how_many_an_exposure_has(stored_in_parts):
    index = frame_index(stored_in_parts)
    assert index.frame.tolist() == list(range(10, 10 + 3 * FRAMES, 3))
    assert index.find_place(16) == 2
    assert index.named_stars.tolist() == [11, 22, 33, 44]
    assert index.typical_stars == 3.5  # exposures of four and of three
    assert frame_index(stored_in_parts) is index


@pytest.mark.parametrize("frame", [9, 11, 10_000])
def test_a_frame_that_is_not_there_is_refused_with_those_that_are(stored_in_parts, frame):
    with pytest.raises(NotFoundError, match="its 60 frames are numbered from 10 to 187"):
        frame_index(stored_in_parts).find_place(frame)


def test_a_damaged_table_is_refused_with_what_to_do_by_index_sample_and_marks(tmp_path):
    path = tmp_path / "damaged"
    path.write_bytes(b"PAR1 and then nothing of the kind")
    with pytest.raises(RefusedInputError, match="is damaged: restore it from a backup"):
        frame_index(path)
    damaged = tmp_path / "table"
    damaged.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(RefusedInputError, match="upload the telemetry again"):
        read_sample(damaged, 10, 100)
    (tmp_path / "broken").write_bytes(b"no table")
    with pytest.raises(RefusedInputError, match="damaged"):
        exposure_marks(tmp_path / "broken")


def test_a_table_that_names_no_stars_or_has_no_rows_is_read(tmp_path):
    write_working_table(replace(telemetry(), star_id=None), tmp_path / "table")
    assert frame_index(tmp_path / "table").named_stars.tolist() == []
    assert shared_exposures(written(tmp_path / "a", []), written(tmp_path / "b", [1, 2])) == (0, 0)


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


def test_writing_into_mapped_arrays_leaves_the_file_alone_and_other_bytes_than_its_address_are_refused(tmp_path):
    write_working_table(full(), tmp_path / "table")
    before = compute_digest(tmp_path / "table")
    telemetry = WorkingTable(tmp_path / "table").read()
    assert not telemetry.row_px.flags.owndata
    telemetry.row_px[:] = 0
    telemetry.quaternion[:] = 0
    assert compute_digest(tmp_path / "table") == before
    write_working_table(full(), tmp_path / "table")
    with pytest.raises(CorruptFileError) as refused:
        WorkingTable(tmp_path / "table", "0" * 64).read()
    assert refused.value.sha256 == "0" * 64


@pytest.mark.parametrize("content", [b"", b"PAR1 and then nothing", b"ARROW1 and then nothing"])
def test_what_is_no_such_table_is_refused(tmp_path, content):
    (tmp_path / "table").write_bytes(content)
    assert is_working_table(tmp_path / "table") is content.startswith(b"ARROW1")
    with pytest.raises(RefusedInputError, match="is damaged: restore it"):
        WorkingTable(tmp_path / "table").read()


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "table"
    write_working_table(simulated(1, frames=50, stars=7), path)
    return path


@given(n=st.integers(1, 5000), most=st.integers(1, 400))
def test_places_are_in_the_set_apart_evenly_and_as_many_as_asked(n, most):
    places = evenly(n, most)
    assert len(places) == min(n, most)
    assert places[0] == 0
    assert np.ptp(np.diff(places)) <= 1 if len(places) > 1 else True
    assert places[-1] <= n - 1


def test_a_sample_holds_whole_frames_row_for_row_and_fewer_where_each_has_many_stars(stored):
    whole, sample = WorkingTable(stored).read(), read_sample(stored, 9, 10_000)
    rows = np.isin(whole.frame, sample.telemetry.frame)
    assert (sample.frames, sample.frames_in_set) == (9, 50)
    for name in ("frame", "exposure", "row_px", "col_px", "star_id", "ra_rad"):
        np.testing.assert_array_equal(getattr(sample.telemetry, name), getattr(whole, name)[rows])
    sample = read_sample(stored, 200, 14 * 5)
    assert (sample.frames, len(sample.telemetry)) == (5, 14 * 5)


STARS = 5


def written(path, exposures, first_frame=0):
    """Write a table whose exposures are those of these numbers; frames are counted from `first_frame`."""
    stars = [np.random.default_rng(number).uniform(0, 1000, (STARS, 2)) for number in exposures]
    place = np.concatenate(stars) if stars else np.zeros((0, 2))
    frame = np.repeat(np.arange(first_frame, first_frame + len(exposures)), STARS)
    write_working_table(Telemetry(frame, np.zeros_like(frame), place[:, 0], place[:, 1]), path)
    return path


@settings(max_examples=20)
@given(st.sets(st.integers(0, 30), min_size=1), st.sets(st.integers(0, 30), min_size=1))
def test_the_shares_are_those_of_the_sets(tmp_path_factory, one, other):
    folder = tmp_path_factory.mktemp("tables")
    paths = written(folder / "a", sorted(one)), written(folder / "b", sorted(other), first_frame=500)
    common = len(one & other)
    assert shared_exposures(*paths) == (common / len(one), common / len(other))
