"""The watched folder: what is complete, what is never opened, and where files go."""

import errno
import hashlib
import os
import threading

import pytest

from boresight.console.ingest.folder import DONE, REFUSED, WatchedFolder
from boresight.errors import RefusedInputError, UnavailableError
from tests.refusals import has_code

SETTLE_S = 10.0
LARGE = 1_000_000


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def watched(tmp_path, clock):
    (tmp_path / "in" / "ST-1").mkdir(parents=True)
    return WatchedFolder(tmp_path / "in", SETTLE_S, clock)


@pytest.fixture
def place(watched):
    return watched.folder / "ST-1"


def settled(watched, clock):
    watched.list_complete()
    clock.now_s += SETTLE_S
    return watched.list_complete()


def test_a_file_is_complete_once_neither_its_size_nor_its_time_has_changed(watched, place, clock):
    (place / "a.csv").write_bytes(b"frame")
    assert watched.list_complete() == []
    clock.now_s = 9.0
    (place / "a.csv").write_bytes(b"frame,exposure")
    assert watched.list_complete() == []
    clock.now_s = 18.0
    assert watched.list_complete() == []
    clock.now_s = 19.0
    assert [(one.sensor, one.name, one.size_bytes) for one in watched.list_complete()] == [("ST-1", "a.csv", 14)]


@pytest.mark.parametrize("name", [".a.csv", "a.csv.part", "a.csv.TMP", "a.csv~", "done", "refused", "b.reason.txt"])
def test_what_is_under_way_or_done_with_is_left_alone(watched, place, clock, name):
    (place / name).write_bytes(b"frame")
    assert settled(watched, clock) == []


def test_files_beside_the_sensors_folders_and_below_them_are_left_alone(watched, place, clock, tmp_path):
    (watched.folder / "a.csv").write_bytes(b"frame")
    (place / DONE).mkdir()
    (place / DONE / "b.csv").write_bytes(b"frame")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "c.csv").write_bytes(b"frame")
    (watched.folder / "ST-2").symlink_to(tmp_path / "elsewhere")
    assert settled(watched, clock) == []


def test_a_file_is_copied_with_its_sha256_and_one_that_changes_meanwhile_is_not(watched, place, clock, tmp_path):
    (place / "a.csv").write_bytes(b"frame" * 1000)
    (found,) = settled(watched, clock)
    taken = watched.take(found, tmp_path / "copy", LARGE)
    assert (taken.size_bytes, taken.sha256) == (5000, hashlib.sha256(b"frame" * 1000).hexdigest())
    assert taken.path.read_bytes() == b"frame" * 1000
    (place / "a.csv").write_bytes(b"frame" * 1001)
    assert watched.take(found, tmp_path / "other", LARGE) is None


def test_links_and_pipes_are_refused_and_never_opened(watched, place, clock, tmp_path):
    (tmp_path / "secret").write_text("of the host")
    (place / "link.csv").symlink_to(tmp_path / "secret")
    os.mkfifo(place / "pipe.csv")
    (place / "folder.csv").mkdir()
    found = settled(watched, clock)
    assert sorted(one.name for one in found) == ["folder.csv", "link.csv", "pipe.csv"]
    for one in found:
        with pytest.raises(RefusedInputError, check=has_code("not-a-plain-file")):
            watched.take(one, tmp_path / "copy", LARGE)
        watched.settle(one, REFUSED, "No plain file.")
    assert (place / REFUSED / "link.csv").is_symlink()
    assert (tmp_path / "secret").read_text() == "of the host"


def test_a_file_that_became_a_link_after_the_look_is_not_followed(watched, place, clock, tmp_path):
    (tmp_path / "secret").write_text("of the host")
    (place / "a.csv").write_bytes(b"frame")
    (found,) = settled(watched, clock)
    (place / "a.csv").unlink()
    (place / "a.csv").symlink_to(tmp_path / "secret")
    with pytest.raises(OSError, match="symbolic link"):
        watched.take(found, tmp_path / "copy", LARGE)
    assert not (tmp_path / "copy").exists()


def test_a_pipe_in_the_place_of_a_file_does_not_hold_the_watcher_up(watched, place, clock, tmp_path):
    (place / "a.csv").write_bytes(b"frame")
    (found,) = settled(watched, clock)
    (place / "a.csv").unlink()
    os.mkfifo(place / "a.csv")
    taken = []
    thread = threading.Thread(target=lambda: taken.append(watched.take(found, tmp_path / "copy", LARGE)), daemon=True)
    thread.start()
    thread.join(5)
    assert taken == [None]


def test_a_file_over_the_limit_is_refused_unread(watched, place, clock, tmp_path):
    (place / "a.csv").write_bytes(b"x" * 2001)
    (found,) = settled(watched, clock)
    with pytest.raises(RefusedInputError, match="BORESIGHT_UPLOAD_LIMIT_MB"):
        watched.take(found, tmp_path / "copy", 2000)
    assert not (tmp_path / "copy").exists()


def test_files_move_to_done_or_refused_with_the_reason_and_never_over_another(watched, place, clock):
    for content in (b"one", b"two"):
        (place / "a.csv").write_bytes(content)
        (found,) = settled(watched, clock)
        watched.settle(found, REFUSED, f"Because of {content.decode()}.")
    assert (place / REFUSED / "a.csv").read_bytes() == b"one"
    assert (place / REFUSED / "2-a.csv").read_bytes() == b"two"
    assert (place / REFUSED / "2-a.csv.reason.txt").read_text() == "Because of two.\n"
    assert watched.list_complete() == []


def test_done_that_leads_elsewhere_is_not_written_to(watched, place, clock, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (place / DONE).symlink_to(tmp_path / "elsewhere")
    (place / "a.csv").write_bytes(b"frame")
    (found,) = settled(watched, clock)
    with pytest.raises(OSError, check=lambda error: error.errno in (errno.ENOTDIR, errno.ELOOP)):
        watched.settle(found, DONE)
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert (place / "a.csv").exists()


def test_a_folder_that_is_not_there_says_so(tmp_path, clock):
    with pytest.raises(UnavailableError, match="BORESIGHT_WATCH_FOLDER"):
        WatchedFolder(tmp_path / "nowhere", SETTLE_S, clock).list_complete()
