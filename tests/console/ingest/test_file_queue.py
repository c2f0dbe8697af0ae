"""The queue of files: a file that hangs or many files of one sensor hold up no other, and what hangs is said."""

import threading
import time

import pytest

from boresight.console.jobs import file_queue
from boresight.console.jobs.file_queue import AT_ONCE, MOST, FileQueue, WaitingFile


class Folder:
    """Files that end at once, but for those that hang until they are let go."""

    def __init__(self):
        self.taken, self.let_go, self.most = [], threading.Event(), 0
        self._open = set()

    def file(self, sensor, name="a", *, hangs=False):
        def take():
            self._open.add((sensor, name))
            self.most = max(self.most, len(self._open))
            if hangs:
                self.let_go.wait(30)
            self._open.discard((sensor, name))
            self.taken.append((sensor, name))

        return WaitingFile(sensor, name, take)


@pytest.fixture
def folder(monkeypatch):
    monkeypatch.setattr(file_queue, "SLOW_S", 0.2)
    monkeypatch.setattr(file_queue, "ROUND_BUDGET_S", 3.0)
    made = Folder()
    yield made
    made.let_go.set()


@pytest.fixture
def taking():
    return FileQueue("test")


def never():
    return False


def test_a_file_that_hangs_keeps_its_own_sensor_waiting_and_no_other(folder, taking):
    files = [folder.file("ST-1", "hangs", hangs=True), folder.file("ST-1", "next"), folder.file("ST-3")]
    began = time.monotonic()
    assert not taking.take_all([*files, *(folder.file("ST-2", f"{k}") for k in range(20))], never)
    assert time.monotonic() - began < 2.0
    assert {sensor for sensor, _ in folder.taken} == {"ST-2", "ST-3"}
    assert len(folder.taken) == 21
    assert taking.describe("ST-1").startswith("reading hangs for ")
    assert "other sensors are not affected" in taking.describe("ST-1")
    assert (taking.describe("ST-2"), taking.fault) == ("", "")
    folder.let_go.set()
    while taking.describe("ST-1"):
        time.sleep(0.01)
    assert taking.take_all([folder.file("ST-1", "next")], never)
    assert [name for sensor, name in folder.taken if sensor == "ST-1"] == ["hangs", "next"]


def test_many_files_of_one_sensor_wait_for_the_one_of_another(folder, taking):
    assert taking.take_all([*(folder.file("ST-1", f"{k:02}") for k in range(30)), folder.file("ST-2")], never)
    assert folder.taken.index(("ST-2", "a")) <= AT_ONCE
    assert [name for sensor, name in folder.taken if sensor == "ST-1"] == [f"{k:02}" for k in range(30)]
    assert folder.most <= AT_ONCE


def test_files_that_never_end_take_so_many_threads_and_are_said(folder, taking):
    files = [folder.file(f"ST-{k}", hangs=True) for k in range(MOST + 3)]
    while taking.fault == "":
        assert not taking.take_all(files, never)
    assert folder.most == MOST
    assert taking.fault.startswith(f"Reading {MOST} files does not finish")
    folder.let_go.set()
    while any(taking.describe(f"ST-{k}") for k in range(MOST)):
        time.sleep(0.01)
    assert taking.take_all(files[MOST:], never)
    assert taking.fault == ""


def test_an_error_of_a_file_frees_its_place(folder, taking):
    def fails():
        raise RuntimeError("a defect")

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(threading, "excepthook", lambda _: None)
        assert taking.take_all([WaitingFile("ST-1", "bad", fails), folder.file("ST-1", "good")], never)
    assert folder.taken == [("ST-1", "good")]


def test_a_server_that_stops_begins_nothing(folder, taking):
    assert not taking.take_all([folder.file("ST-1")], lambda: True)
    assert folder.taken == []
