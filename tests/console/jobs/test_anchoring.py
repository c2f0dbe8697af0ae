"""Anchors by the clock: made while the log verifies, time-stamped, missed where they stay away, and never of a broken chain."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from boresight.cli import main
from boresight.console.access.sessions import SessionLimits
from boresight.console.alarms import service as alarms
from boresight.console.jobs.anchoring import Anchoring
from boresight.console.jobs.maintenance import Maintenance
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.audit.signing import SigningKey
from boresight.platform.audit.tables import AuditAnchor
from boresight.platform.audit.time_stamps import TimeStampService, read_certificates
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_after
from tests.stores import drop_triggers, open_migrated, url_in
from tests.time_stamps import time_stamp_service

LIMITS = SessionLimits(age_s=12 * 3600.0, idle_s=3600.0)
EVERY_S = 3600.0


@pytest.fixture
def store(tmp_path) -> Iterator[Engine]:
    (tmp_path / "data").mkdir()
    store = open_migrated(url_in(tmp_path / "data"))
    _count(store)
    yield store
    store.dispose()


@pytest.fixture
def anchoring(store, tmp_path) -> Anchoring:
    return Anchoring(store, SigningKey(tmp_path / "signing.key"), None, EVERY_S)


def _count(store: Engine) -> None:
    with open_writing(store) as session:
        audit.append(session, COMMAND_LINE, "counted", "numbers/1")


def _round(anchoring: Anchoring, tmp_path: Path) -> Maintenance:
    maintenance = Maintenance(anchoring.database, LIMITS, FolderBlobStore(tmp_path / "blobs"), anchoring=anchoring)
    maintenance.verify()
    maintenance.anchor()
    maintenance.apply_alarm_rules()
    return maintenance


def _anchors(store: Engine) -> list[AuditAnchor]:
    with open_reading(store) as session:
        return list(reversed(audit.list_anchors(session)))


def _alarms(store: Engine) -> list[tuple[str, bool]]:
    with open_reading(store) as session:
        return sorted((row.source, bool(row.active)) for row in alarms.list_alarms(session))


def _later(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    for module in ("boresight.console.jobs.anchoring", "boresight.platform.audit.anchors"):
        monkeypatch.setattr(f"{module}.utc_now", lambda: utc_after(seconds))


def test_a_head_is_signed_at_once_then_each_hour_and_only_where_it_has_moved(store, anchoring, tmp_path, monkeypatch):
    _round(anchoring, tmp_path)
    _count(store)
    _round(anchoring, tmp_path)
    assert [one.record_id for one in _anchors(store)] == [1]
    for hours in (1.1, 2.2):  # nothing moved between the two
        _later(monkeypatch, hours * EVERY_S)
        _round(anchoring, tmp_path)
    assert [one.record_id for one in _anchors(store)] == [1, 2]
    assert _alarms(store) == []


def test_with_an_interval_of_zero_nothing_is_signed_and_nothing_is_overdue(store, anchoring, tmp_path, monkeypatch):
    anchoring.every_s = 0.0
    _later(monkeypatch, 1e6)
    _round(anchoring, tmp_path)
    assert (_anchors(store), _alarms(store)) == ([], [])


def test_a_log_that_does_not_verify_is_not_signed(store, anchoring, tmp_path):
    with store.begin() as connection:
        drop_triggers(connection)
        connection.exec_driver_sql("UPDATE audit SET actor = 'Eve'")
    _round(anchoring, tmp_path)
    assert _anchors(store) == []
    assert _alarms(store) == [("audit/CHAIN", True)]


def test_an_edited_anchor_breaks_the_log_for_the_server_too(store, anchoring, tmp_path):
    _round(anchoring, tmp_path)
    with store.begin() as connection:
        connection.exec_driver_sql("UPDATE audit_anchors SET made_by = 'Eve'")
    assert _round(anchoring, tmp_path).light().state == "broken"


def test_a_key_that_cannot_be_used_is_an_alarm_after_three_intervals_until_it_can(
    store, anchoring, tmp_path, monkeypatch
):
    anchoring.key.file.write_text("nothing")
    anchoring.key.file.chmod(0o600)
    _round(anchoring, tmp_path)
    assert _alarms(store) == []
    _later(monkeypatch, 3.1 * EVERY_S)
    _round(anchoring, tmp_path)
    assert _alarms(store) == [("audit/ANCHOR", True)]
    with open_reading(store) as session:
        assert "no usable Ed25519 key" in anchoring.find_overdue(session)
    anchoring.key.file.unlink()
    _round(anchoring, tmp_path)
    assert dict(_alarms(store))["audit/ANCHOR"] is False


def test_the_newest_anchor_is_stamped_and_a_service_that_stays_away_is_an_alarm(
    store, anchoring, tmp_path, monkeypatch
):
    with time_stamp_service(tmp_path / "tsa") as stand_in:
        authorities = read_certificates(stand_in.authority.read_bytes(), "x")
        anchoring.service = TimeStampService(stand_in.url, authorities)
        _round(anchoring, tmp_path)
        assert [one.stamped_utc is not None for one in _anchors(store)] == [True]
        _round(anchoring, tmp_path)
        assert len(stand_in.asked) == 1  # once an anchor
        stand_in.instead = b"closed"
        _count(store)
        _later(monkeypatch, 1.1 * EVERY_S)
        _round(anchoring, tmp_path)
        assert anchoring.fault != ""
        _later(monkeypatch, 4.3 * EVERY_S)
        _round(anchoring, tmp_path)
        source, active = next(one for one in _alarms(store) if one[0] == "audit/ANCHOR")
        assert active
        stand_in.instead = None
        _round(anchoring, tmp_path)
    assert [one.stamped_utc is not None for one in _anchors(store)][-1]
    assert (anchoring.fault, dict(_alarms(store))[source]) == ("", False)
    with open_reading(store) as session:
        found = audit.verify(session, trust=anchoring.trust())
    assert (found.ok, found.time_stamped) == (True, 2)


def _said(*command: str) -> Any:
    return CliRunner().invoke(main, ["audit", *command])


def test_the_commands_sign_verify_rotate_and_take_a_lost_key_back(store, tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(tmp_path / "data"))
    monkeypatch.setenv("BORESIGHT_DATABASE_URL", store.url.render_as_string(hide_password=False))
    key, kept = tmp_path / "data" / "signing.key", tmp_path / "kept.pem"
    assert _said("keys", "--out", str(kept)).exit_code == 0
    assert "signs record 1 " in _said("anchor").output
    assert _said("verify", "--public-keys", str(kept)).exit_code == 0
    (first,) = _anchors(store)
    assert _said("rotate-key").exit_code == 0
    assert "signs record 2 " in _said("anchor").output  # the second record is of the rotation
    done = _said("verify")
    assert (done.exit_code, "2 anchors cover the records up to 2" in done.output) == (0, True)
    done = _said("verify", "--public-keys", str(kept))  # kept before the rotation
    assert (done.exit_code, _anchors(store)[1].key in done.output) == (1, True)
    key.unlink()
    assert _said("keys", "--out", str(kept)).exit_code == 0  # a new key, which signed nothing
    assert _said("verify").exit_code == 1
    assert _said("anchor").exit_code == 1
    for one in _anchors(store):
        assert _said("trust", one.public_key).exit_code == 0
    assert _said("verify").exit_code == 0
    assert _said("trust", "AAAA").exit_code == 1
    assert first.key != _anchors(store)[1].key
