"""Scheduled backups: each is taken by one server, restored before it counts, and kept as long as the schedule says."""

from __future__ import annotations

import dataclasses
import time
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from click.testing import CliRunner

from boresight.cli import main
from boresight.console.alarms import rules
from boresight.console.alarms.tables import Alarm
from boresight.console.backups import queries, service
from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.console.fleet import service as sensors
from boresight.console.jobs import backup_thread
from boresight.console.jobs.backup_thread import BackupThread
from boresight.console.jobs.maintenance import Maintenance
from boresight.errors import ForbiddenError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE, SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.backups.encryption import DecryptedFile, EncryptingFile
from boresight.platform.backups.generations import Generations
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import register_blob
from boresight.platform.db import backup as backups
from boresight.platform.db.sessions import open_engine, open_reading, open_writing
from tests.console.conftest import SENSOR
from tests.served import PASSWORD, PLAIN, add_people, serving, settings_in

KEPT = Generations(2, 0, 0)


@pytest.fixture
def place(tmp_path) -> Path:
    (tmp_path / "elsewhere").mkdir()
    return tmp_path / "elsewhere"


@pytest.fixture
def servers(engine, tmp_path, blobs):
    settings = dataclasses.replace(settings_in(tmp_path), database_url=engine.url.render_as_string(hide_password=False))
    settings.backup_keys.add()
    with open_writing(engine) as session:
        register_blob(session, blobs, blobs.put(b"telemetry"), "text/csv")
        audit.append(session, COMMAND_LINE, "uploaded", "files/1")
    return [BackupThread(engine, blobs, settings, lambda: None) for _ in range(2)]


@pytest.fixture
def scheduled(engine, place):
    def schedule(every_hours: int = 24, kept: Generations = KEPT, destination: str | None = None) -> None:
        with open_writing(engine) as session:
            service.set_schedule(session, COMMAND_LINE, destination or str(place), 120, every_hours, kept)

    return schedule


def _rows(engine) -> list[Backup]:
    with open_reading(engine) as session:
        return list(service.list_backups(session))[::-1]


def test_one_of_two_servers_takes_what_is_due_and_restores_it(engine, servers, scheduled, place, tmp_path):
    for server in servers:
        server.work()
    assert _rows(engine) == []  # nothing is scheduled
    scheduled()
    for server in (*servers, *servers):
        server.work()
    (row,) = _rows(engine)
    assert (row.state, row.attempt, row.files, row.tested_utc is not None) == ("SUCCEEDED", 1, 1, True), row.sentence
    (file,) = place.iterdir()
    assert (file.name, file.stat().st_size, file.stat().st_mode & 0o077) == (row.name, row.size_bytes, 0)
    content = file.read_bytes()
    assert b"telemetry" not in content
    assert b"SQLite format" not in content
    assert list(tmp_path.glob(".backup-*")) + list(tmp_path.glob(".restore-*")) == []
    with open_reading(engine) as session:
        assert audit.verify(session).ok
        numbers = service.measure(session)
    assert (numbers.scheduled, numbers.failed, numbers.newest_bytes) == (True, False, row.size_bytes)
    assert 0 <= numbers.newest_age_s < 60


def test_it_comes_back_as_it_was(servers, scheduled, place, tmp_path):
    scheduled()
    servers[0].work()
    (file,) = place.iterdir()
    url, restored = f"sqlite:///{tmp_path}/second/own.sqlite3", FolderBlobStore(tmp_path / "second" / "blobs")
    with pytest.raises(RefusedInputError):
        backups.read_backup(file, url, restored)
    keys = settings_in(tmp_path).backup_keys
    taken = backups.read_backup(file, url, restored, keys)
    assert taken.blobs == 1
    second = open_engine(url)
    with open_reading(second) as session:
        assert audit.verify(session, taken.head, restored).ok
        assert queries.find_newest(session).state == "RUNNING"  # as it stood when the copy was made
    second.dispose()
    with file.open("rb") as stream, zipfile.ZipFile(DecryptedFile(stream, keys)) as archive:
        assert "MANIFEST.json" in archive.namelist()


def test_what_was_due_while_no_server_ran_is_taken_at_once_and_once(engine, scheduled, monkeypatch):
    scheduled(every_hours=6)
    monkeypatch.setattr(service, "utc_now", lambda: "2031-05-05T13:00:00.000000Z")
    monkeypatch.setattr(service, "utc_after", lambda _: "2031-05-05T13:02:00.000000Z")
    with open_writing(engine) as session:
        claimed = service.claim(session)
        assert session.get_one(Backup, claimed.backup_id).due_utc == "2031-05-05T08:00:00.000000Z"
        assert service.claim(session) is None  # another server's try
        service.record_written(session, claimed, backups.BackupSummary(0, 1, "0" * 64), 1, "k")
        service.record_test(session, claimed, backups.RestoreFindings(True, "Restored.", 1, 1, 0))
        for now, due in (
            ("2031-05-05T13:59:59.9Z", False),
            ("2031-05-05T14:00:00Z", True),
            ("2031-05-09T00:00:00Z", True),
        ):
            assert service.is_any_due(session, now) is due


def test_another_server_begins_again_where_one_was_killed(engine, servers, scheduled, place):
    scheduled()
    with open_writing(engine) as session:
        killed = service.claim(session)
    (place / killed.name).write_bytes(b"half")  # written, and its server killed before it said so
    servers[1].work()
    assert [row.attempt for row in _rows(engine)] == [1]  # the lease holds
    with open_writing(engine) as session:
        session.get_one(Backup, killed.backup_id).lease_until_utc = "2020-01-01T00:00:00.000000Z"
    servers[1].work()
    (row,) = _rows(engine)
    assert (row.state, row.attempt) == ("SUCCEEDED", 2)
    assert [file.name for file in place.iterdir()] == [row.name]
    with open_writing(engine) as session:  # the first one was only slow: it writes nothing more
        assert not service.record_written(session, killed, backups.BackupSummary(0, 1, "0" * 64), 1, "k")
        service.fail(session, killed, "late")
    assert _rows(engine)[0].state == "SUCCEEDED"


def test_a_server_that_stops_leaves_the_backup_to_the_next_one(engine, servers, scheduled, place, monkeypatch):
    scheduled()
    writing = backups.write_backup

    def stopped(*given, **options):
        servers[0]._thread.close()
        return writing(*given, **options)

    monkeypatch.setattr(backup_thread.backups, "write_backup", stopped)
    servers[0].work()
    (row,) = _rows(engine)
    assert (row.state, row.attempt, list(place.iterdir())) == ("RUNNING", 0, [])
    monkeypatch.undo()
    servers[1].work()
    assert [(row.state, row.attempt) for row in _rows(engine)] == [("SUCCEEDED", 1)]


def test_a_backup_that_cannot_be_restored_fails_and_raises_an_alarm_until_one_succeeds(
    engine, servers, scheduled, place, blobs, monkeypatch
):
    maintenance = Maintenance(engine, SessionLimits(3600, 3600), blobs)

    def alarm() -> Alarm | None:
        maintenance.apply_alarm_rules()
        with open_reading(engine) as session:
            return rules.find_active(session, rules.BACKUP)

    scheduled()
    assert alarm() is None
    sha256 = blobs.put(b"telemetry")
    write = EncryptingFile.write

    def flipping(file, content):  # a bit that turns after the stored file was read and verified
        return write(file, b"telemetrx" if bytes(content) == b"telemetry" else content)

    monkeypatch.setattr(EncryptingFile, "write", flipping)
    servers[0].work()
    (row,) = _rows(engine)
    assert (row.state, sha256[:12] in row.sentence) == ("FAILED", True), row.sentence
    assert row.sentence in alarm().sentence
    servers[0].work()
    assert len(_rows(engine)) == 1  # it is as large as a good one: the next is taken when it is due
    monkeypatch.undo()
    later = service.utc_after(24 * 3600)
    monkeypatch.setattr(service, "utc_now", lambda: later)
    servers[0].work()
    assert [row.state for row in _rows(engine)] == ["FAILED", "SUCCEEDED"]
    assert alarm() is None
    assert len(list(place.iterdir())) == 2
    servers[0].remove_superfluous()
    assert [file.name for file in place.iterdir()] == [_rows(engine)[1].name]


@pytest.mark.parametrize("what", ["key", "folder", "file"])
def test_what_is_missing_is_said_in_the_alarm(engine, servers, scheduled, place, blobs, what):
    scheduled()
    if what == "key":
        servers[0]._keys.file.unlink()
    elif what == "folder":
        place.rmdir()
    else:
        next(path for path in blobs.folder.rglob("*") if path.is_file()).unlink()
    servers[0].work()
    (row,) = _rows(engine)
    assert row.state == "FAILED"
    with open_reading(engine) as session:
        assert service.is_any_due(session, service.utc_after(service.RETRY_S + 1)) is (what != "file")
        assert row.sentence in service.find_fault(session)
        assert service.measure(session).failed
    assert what in row.sentence


def test_none_for_two_intervals_is_an_alarm(engine, scheduled, monkeypatch):
    scheduled(every_hours=6)
    for hours, late in ((12.9, False), (13.1, True)):
        now = service.utc_after(hours * 3600)
        monkeypatch.setattr(service, "utc_now", lambda now=now: now)
        with open_reading(engine) as session:
            assert bool(service.find_fault(session)) is late


def test_old_ones_are_removed_and_strangers_stay(engine, servers, scheduled, place):
    scheduled()
    (place / "of-somebody-else.backup").write_bytes(b"")
    with open_writing(engine) as session:
        schedule = queries.find_schedule(session)
        for day in (1, 2, 3, 4):
            at = f"2026-03-0{day}T02:00:00.000000Z"
            (place / f"b{day}").write_bytes(b"x")
            session.put(
                Backup(
                    schedule_id=schedule.id,
                    due_utc=at,
                    state="SUCCEEDED",
                    attempt=1,
                    name=f"b{day}",
                    started_utc=at,
                    written_utc=at,
                    ended_utc=at,
                )
            )
        audit.append(session, COMMAND_LINE, "brought in", "backups")
    servers[0].remove_superfluous()
    assert sorted(file.name for file in place.iterdir()) == ["b3", "b4", "of-somebody-else.backup"]
    assert [row.removed_utc is not None for row in _rows(engine)] == [True, True, False, False]
    (place / "b3").unlink()
    servers[1].remove_superfluous()  # nothing to do, and what somebody removed by hand is no error
    with open_reading(engine) as session:
        assert audit.verify(session).ok


def test_only_administrators_set_a_schedule_and_the_log_says_what_it_was(engine, people, scheduled, place):
    with open_writing(engine) as session, pytest.raises(ForbiddenError):
        service.set_schedule(session, people["ana"], str(place), 0, 24, KEPT)
    for minute, hours, kept in (
        (-1, 24, KEPT),
        (0, 5, KEPT),
        (0, 24, Generations(0, 0, 0)),
        (0, 24, Generations(-1, 1, 1)),
    ):
        with open_writing(engine) as session, pytest.raises(RefusedInputError):
            service.set_schedule(session, COMMAND_LINE, str(place), minute, hours, kept)
    scheduled()
    scheduled(every_hours=6)
    with open_reading(engine) as session:
        record = audit.find_last_change(session, "backups")
        assert (record.before["every_hours"], record.after["every_hours"]) == (24, 6)
    with engine.connect() as connection, pytest.raises(sa.exc.DBAPIError):
        connection.execute(sa.update(BackupSchedule).values(every_hours=1))


def test_a_server_takes_what_a_command_has_scheduled_and_its_pages_say_so(tmp_path, place, monkeypatch):
    settings = settings_in(tmp_path / "data")
    add_people(settings)
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(settings.data_folder))
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", settings.database_url)
    run = CliRunner().invoke
    done = run(main, ["backup", "--schedule", "02:30", "--to", str(place), "--every-hours", "6"])
    assert done.exit_code == 0, done.output
    engine = open_engine(settings.database_url)
    with open_writing(engine) as session:
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)  # the overview of no sensor shows nothing else
    engine.dispose()
    with serving(settings) as (address, app), httpx.Client(base_url=address, verify=PLAIN, timeout=30) as client:
        assert client.post("/api/v1/sessions", json={"name": "adele", "password": PASSWORD}).status_code == 201

        def newest() -> dict[str, Any]:
            return next(iter(client.get("/api/v1/backups").json()["items"]), {"state": "none"})

        ends_s = time.monotonic() + 60
        while newest()["state"] not in {"SUCCEEDED", "FAILED"}:
            app.state.backup_thread._thread.nudge()
            assert time.monotonic() < ends_s
            time.sleep(0.1)
        row = newest()
        assert row["state"] == "SUCCEEDED", row
        pages = {path: client.get(path).text for path in ("/backups", "/administration", "/")}
    assert all("Restorable" in page or "RESTORABLE" in page for page in pages.values())
    assert row["name"] in pages["/backups"]
    assert row["name"] in run(main, ["backup", "list"]).output
    file = place / row["name"]
    assert run(main, ["backup", "verify", row["name"]]).exit_code == 0
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert run(main, ["backup", "verify", row["name"]]).exit_code == 1
    assert f"{row['name']}  " in (listed := run(main, ["backup", "list"]).output)
    assert "FAILED" in listed
    assert run(main, ["backup", "--schedule", "off"]).exit_code == 0
    assert file.exists()


@pytest.mark.parametrize(
    "words",
    [
        ["--schedule", "25:00", "--to", "."],
        ["--schedule", "2", "--to", "."],
        ["--schedule", "02:00"],
        [],
        ["--out", "a.zip", "--schedule", "02:00"],
        ["--schedule", "02:00", "--to", ".", "--every-hours", "5"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_told_apart_from_refusals(words, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(tmp_path))
    assert CliRunner().invoke(main, ["backup", *words]).exit_code == 2


def test_a_place_that_is_not_there_is_refused_before_anything_is_scheduled(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(tmp_path))
    words = ["backup", "--schedule", "02:00", "--to", str(tmp_path / "unmounted")]
    assert CliRunner().invoke(main, words).exit_code == 1
    assert list(tmp_path.glob("*.key")) == []
