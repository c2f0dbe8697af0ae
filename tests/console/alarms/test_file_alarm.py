"""A corrupt stored file raises an alarm, whoever finds it, and the alarm is over when the file is back, not before."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from boresight.console.access.sessions import SessionLimits
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import Alarm
from boresight.console.jobs.maintenance import Maintenance
from boresight.errors import CorruptFileError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.stores import open_migrated, url_in

CONTENT = b'{"f_m":0.016}'


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Engine]:
    store = open_migrated(url_in(tmp_path))
    yield store
    store.dispose()


@pytest.fixture
def blobs(tmp_path: Path, store: Engine) -> BlobStore:
    blobs = FolderBlobStore(tmp_path / "blobs")
    with open_writing(store) as session:
        for content in (CONTENT, b"other"):
            register_blob(session, blobs, blobs.put(content), "application/json")
        audit.append(session, COMMAND_LINE, "stored", "blobs")
    return blobs


def _upkeep(store: Engine, blobs: BlobStore) -> Maintenance:
    return Maintenance(store, SessionLimits(age_s=12 * 3600.0, idle_s=3600.0), blobs)


def _alarms(store: Engine) -> list[Alarm]:
    with open_reading(store) as session:
        return [row for row in alarms.list_alarms(session) if row.kind == "FILES"]


def _round(upkeep: Maintenance) -> None:
    upkeep.read_files()
    upkeep.watch()


def _spoil(blobs: BlobStore) -> str:
    sha256 = blobs.put(CONTENT)
    blobs.path(sha256).write_bytes(CONTENT.replace(b"6", b"7"))
    return sha256


def test_a_file_that_nobody_asks_for_is_found_by_the_upkeep(store: Engine, blobs: BlobStore) -> None:
    upkeep = _upkeep(store, blobs)
    _round(upkeep)
    assert _alarms(store) == []
    sha256 = _spoil(blobs)
    for _ in range(3):
        _round(upkeep)
    (row,) = _alarms(store)
    assert (row.level, row.active, row.evidence["files"][0]["sha256"]) == ("critical", 1, sha256)
    assert row.version == 1  # said once


def test_what_a_reader_found_is_in_alarm_with_the_next_round(store: Engine, blobs: BlobStore) -> None:
    upkeep = _upkeep(store, blobs)
    upkeep._read_to = "f" * 64
    blobs.tell_corrupt = upkeep.suspect
    with pytest.raises(CorruptFileError):
        blobs.document(_spoil(blobs))
    _round(upkeep)
    assert len(_alarms(store)) == 1


def test_a_missing_file_is_in_alarm_too(store: Engine, blobs: BlobStore) -> None:
    blobs.path(blobs.put(b"other")).unlink()
    _round(_upkeep(store, blobs))
    (row,) = _alarms(store)
    assert row.evidence["files"][0]["what"] == "missing"


def test_another_server_and_one_that_was_started_anew_leave_the_alarm_up_until_the_file_is_back(
    store: Engine, blobs: BlobStore
) -> None:
    sha256 = _spoil(blobs)
    _round(_upkeep(store, blobs))
    again = _upkeep(store, FolderBlobStore(blobs.folder))
    again._read_to = "f" * 64
    _round(again)
    assert _alarms(store)[0].active
    assert blobs.put(CONTENT) == sha256
    _round(again)
    assert not _alarms(store)[0].active
