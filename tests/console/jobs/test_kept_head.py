"""The head of the audit log kept elsewhere: written when it moved, missed when records vanish, and never the reason of a crash."""

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner

from boresight.cli import main
from boresight.console.access.sessions import SessionLimits
from boresight.console.alarms import service as alarms
from boresight.console.jobs.maintenance import ExternalHeadFile, Maintenance
from boresight.console.webhooks.service import HEAD
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.audit.external_head import ExternalHead, read_head, write_head
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import Engine, open_engine, open_reading, open_writing, utc_now
from boresight.settings import read_settings
from tests.refusals import has_code
from tests.stores import open_migrated, url_in

LIMITS = SessionLimits(age_s=12 * 3600.0, idle_s=3600.0)


@pytest.fixture
def store(tmp_path) -> Iterator[Engine]:
    (tmp_path / "data").mkdir()
    store = open_migrated(url_in(tmp_path / "data"))
    _count(store, 3)
    yield store
    store.dispose()


def _count(store: Engine, times: int) -> None:
    for number in range(times):
        with open_writing(store) as session:
            audit.append(session, COMMAND_LINE, "counted", f"numbers/{number}")


def _upkeep(store: Engine, file: Path | None, every_s: float = 0.0) -> Maintenance:
    folder = Path(str(store.url.database)).parent if store.dialect.name == "sqlite" else Path("/nowhere")
    return Maintenance(store, LIMITS, FolderBlobStore(folder / "blobs"), ExternalHeadFile(file, every_s))


def _round(maintenance: Maintenance) -> None:
    maintenance.verify()
    maintenance.keep_head()
    maintenance.apply_alarm_rules()


def _kinds(store: Engine) -> list[str]:
    with open_reading(store) as session:
        return [row.kind for row in alarms.list_alarms(session) if row.active]


def test_the_head_is_written_when_it_moved_and_on_its_schedule(store, tmp_path):
    file = tmp_path / "heads"
    maintenance = _upkeep(store, file)
    for _ in range(2):
        _round(maintenance)
    _count(store, 1)
    _round(maintenance)
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["id"] for line in lines] == [3, 4, 5]  # the fourth says that heads are kept there
    with open_reading(store) as session:
        assert lines[-1]["hash"] == audit.head(session)
    rarely = _upkeep(store, tmp_path / "other", every_s=300.0)
    _round(rarely)
    _count(store, 1)
    _round(rarely)
    assert len((tmp_path / "other").read_text().splitlines()) == 2


@pytest.mark.sqlite("it is its write-ahead log that is damaged")
def test_ten_records_that_vanish_with_a_damaged_write_ahead_log_are_told_by_the_kept_head(store, tmp_path):
    store.dispose()  # what was written so far is in the file
    path, file = Path(str(store.url.database)), tmp_path / "heads"
    with closing(sqlite3.connect(path)) as open_reader:  # keeps the log from being folded into the file
        open_reader.execute("PRAGMA wal_autocheckpoint=0")
        open_reader.execute("SELECT count(*) FROM audit").fetchall()
        _count(store, 10)
        _round(_upkeep(store, file))
        damaged = tmp_path / "damaged" / path.name
        damaged.parent.mkdir()
        for end in ("", "-wal"):
            shutil.copy(f"{path}{end}", f"{damaged}{end}")
    log = bytearray(Path(f"{damaged}-wal").read_bytes())
    log[32 : 32 + 4096] = bytes(byte ^ 0xFF for byte in log[32 : 32 + 4096])
    Path(f"{damaged}-wal").write_bytes(log)
    engine = open_engine(f"sqlite:///{damaged}")
    try:
        with open_reading(engine) as session:
            alone, found = audit.verify(session), audit.verify(session, kept=read_head(file))
        assert (alone.ok, alone.records) == (True, 3)  # ten are gone, and the chain holds
        assert (found.ok, "record 14" in found.sentence) == (False, True)  # the one that says that heads are kept
        maintenance = _upkeep(engine, file)
        _count(engine, 1)
        _round(maintenance)
        assert read_head(file).id == 14  # not written over
        assert "CHAIN" in _kinds(engine)
    finally:
        engine.dispose()


def test_records_lost_between_two_walks_keep_the_next_head_from_being_written(store, tmp_path):
    file, lost = tmp_path / "heads", ExternalHead(9, "f" * 64, utc_now())
    maintenance = _upkeep(store, file)
    _round(maintenance)
    write_head(file, lost)
    maintenance.keep_head()
    maintenance.apply_alarm_rules()
    assert read_head(file) == lost
    assert _kinds(store) == ["CHAIN"]


def test_a_head_file_that_is_gone_is_a_finding_and_is_not_begun_anew(store, tmp_path):
    file = tmp_path / "share" / "heads"
    file.parent.mkdir()
    with open_reading(store) as session:
        before = audit.verify(session, kept=read_head(file), head_file=file)
    assert (before.ok, str(file) in before.sentence) == (True, True)  # a note
    maintenance = _upkeep(store, file)
    _round(maintenance)
    file.parent.rename(tmp_path / "unmounted")
    maintenance.keep_head()  # before the next walk
    maintenance.apply_alarm_rules()
    assert (maintenance.light().state, _kinds(store)) == ("broken", ["CHAIN"])
    file.parent.mkdir()
    _round(_upkeep(store, file))  # another server, and an empty folder in its place
    assert not file.exists()
    with open_reading(store) as session:
        assert not audit.verify(session, kept=read_head(file), head_file=file).ok
    file.parent.rmdir()
    (tmp_path / "unmounted").rename(file.parent)
    maintenance = _upkeep(store, file)
    _round(maintenance)
    assert (maintenance.light().state, _kinds(store)) == ("verified", [])


def test_the_command_fails_where_the_kept_head_is_gone(store, tmp_path, monkeypatch):
    file = tmp_path / "share" / "head.txt"
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", store.url.render_as_string(hide_password=False))
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(tmp_path / "data"))
    monkeypatch.setenv("BORESIGHT_AUDIT_HEAD_FILE", str(file))

    def verified() -> int:
        return CliRunner().invoke(main, ["audit", "verify"]).exit_code

    assert verified() == 0  # none was kept yet
    file.parent.mkdir()
    _round(_upkeep(store, file))
    assert verified() == 0
    file.rename(tmp_path / "elsewhere")
    assert verified() == 1
    file.touch()
    assert verified() == 1  # emptied
    (tmp_path / "elsewhere").replace(file)
    assert verified() == 0


def test_a_head_that_cannot_be_written_is_an_alarm_that_returns(store, tmp_path):
    file = tmp_path / "absent" / "heads"
    maintenance = _upkeep(store, file)
    _round(maintenance)
    assert _kinds(store) == ["HEAD"]
    file.parent.mkdir()
    _round(maintenance)
    assert _kinds(store) == []
    assert read_head(file) is not None


def test_a_webhook_that_asked_for_heads_gets_each_once(store):
    with open_writing(store) as session:
        for label, actions in (("heads", [HEAD]), ("all", [])):
            session.add(
                Webhook(label=label, url="https://x.example", actions=actions, secret="s", created_utc=utc_now())
            )
        audit.append(session, COMMAND_LINE, "made", "webhooks/1")
    maintenance = _upkeep(store, None)
    for _ in range(2):
        _round(maintenance)
    with open_reading(store) as session:
        newest = audit.find_newest_head(session)
        sent = [row for row in session.query(WebhookDelivery).all() if f'"{HEAD}"' in row.body]
    assert [(row.webhook_id, json.loads(row.body)["data"]["audit_hash"]) for row in sent] == [(1, newest.hash)]


def test_a_torn_line_is_passed_over_and_not_written_into(tmp_path):
    file, heads = tmp_path / "heads", [ExternalHead(number, f"{number:064d}", utc_now()) for number in (1, 2)]
    assert read_head(file) is None
    write_head(file, heads[0])
    with file.open("ab") as stream:
        stream.write(b'{"id": 2, "ha')
    assert read_head(file) == heads[0]
    write_head(file, heads[1])
    assert read_head(file) == heads[1]
    (tmp_path / "other").write_text("no head\n")
    with pytest.raises(RefusedInputError, check=has_code("no-audit-head")):
        read_head(tmp_path / "other")


def test_a_file_in_the_data_folder_is_refused(tmp_path):
    inside = {"BORESIGHT_DATA_FOLDER": str(tmp_path), "BORESIGHT_AUDIT_HEAD_FILE": str(tmp_path / "x" / "heads")}
    with pytest.raises(RefusedInputError, check=has_code("head-in-data-folder")):
        _ = read_settings(inside).kept_head_file


def test_a_clock_that_runs_backwards_is_a_record_of_its_own(store, monkeypatch):
    monkeypatch.setattr("boresight.platform.audit.chain.utc_now", lambda: "2020-01-01T00:00:00.000000Z")
    _count(store, 2)
    with open_reading(store) as session:
        told = [row.action for row in audit.list_records(session)][::-1]
        report = audit.verify(session)
    assert told == [*["counted"] * 3, "clock ran backwards", *["counted"] * 2]
    assert report.ok
