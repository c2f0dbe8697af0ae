"""The upkeep of a server: the light of the chain, and the last use of keys."""

import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console.access import api_keys, users
from boresight.console.alarms import service as alarms
from boresight.console.jobs import maintenance as upkeep_module
from boresight.console.jobs.maintenance import Maintenance
from boresight.platform.actors import SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.passwords import add_person
from tests.stores import open_migrated, url_in

LIMITS = SessionLimits(age_s=12 * 3600.0, idle_s=3600.0)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Engine]:
    store = open_migrated(url_in(tmp_path))
    with open_writing(store) as session:
        row = add_person(session, "ada")
        actor = users.get_actor(session, row.id)
        api_keys.create_key(session, actor, label="passes")
    yield store
    store.dispose()


def _upkeep(store: Engine) -> Maintenance:
    return Maintenance(store, LIMITS, FolderBlobStore(Path(tempfile.mkdtemp())))


def test_before_the_first_walk_nothing_is_claimed(store: Engine) -> None:
    light = _upkeep(store).light()
    assert (light.state, light.at_utc) == ("not yet", None)


def test_the_light_tells_through_which_record_and_when(store: Engine) -> None:
    upkeep = _upkeep(store)
    upkeep.verify()
    with open_reading(store) as session:
        newest = audit.list_records(session, limit=1)[0]
    light = upkeep.light()
    assert (light.state, light.last_id) == ("verified", newest.id)
    assert light.at_utc is not None
    assert light.at_utc >= newest.at_utc


def test_an_edit_by_hand_turns_the_light(store: Engine, caplog: pytest.LogCaptureFixture) -> None:
    upkeep = _upkeep(store)
    with store.begin() as connection:
        connection.exec_driver_sql("UPDATE users SET roles = '[\"administrator\"]'")
    for _ in range(2):
        upkeep.verify()
    light = upkeep.light()
    assert light.state == "broken"
    assert "users/1 was changed outside Boresight" in light.sentence
    assert caplog.text.count("The audit log does not hold") == 1  # said when it is found, not every minute


def test_a_finding_that_is_not_renewed_becomes_stale(store: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    upkeep = _upkeep(store)
    upkeep.verify()
    monkeypatch.setattr(time, "monotonic", lambda: 1e9)
    assert upkeep.light().state == "stale"


def test_a_running_upkeep_looks_at_once_and_writes_the_last_uses_when_it_stops(store: Engine) -> None:
    upkeep = _upkeep(store)
    with open_reading(store) as session:
        key = api_keys.list_keys(session)[0]
    upkeep.start()
    for _ in range(200):
        if upkeep.light().state == "verified":
            break
        time.sleep(0.05)
    upkeep.used(f"key:{key.prefix}")
    upkeep.close()
    upkeep.close()
    assert upkeep.light().state == "verified"
    with open_reading(store) as session:
        assert api_keys.get_key(session, key.id).last_used_utc is not None


def test_what_fails_is_tried_again(store: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    walks = []

    def failing(session: object, **_: object) -> None:
        walks.append(session)
        raise OSError("no disk")

    monkeypatch.setattr(upkeep_module, "ROUND_S", 0.01)
    monkeypatch.setattr(audit, "verify", failing)
    upkeep = _upkeep(store)
    upkeep.start()
    for _ in range(200):
        if len(walks) > 1:
            break
        time.sleep(0.02)
    upkeep.close()
    assert len(walks) > 1
    assert upkeep.light().state == "not yet"


def test_a_round_raises_the_alarm_of_a_broken_log_once_and_a_good_walk_lets_it_return(store: Engine) -> None:
    upkeep = _upkeep(store)
    upkeep.verify()
    with store.begin() as connection:
        before = connection.exec_driver_sql("SELECT roles FROM users").scalar()
        connection.exec_driver_sql("UPDATE users SET roles = '[\"administrator\"]'")
    upkeep.verify()
    for _ in range(2):
        upkeep.watch()
    with open_reading(store) as session:
        (raised,) = alarms.list_alarms(session)
    assert (raised.kind, raised.level, raised.version) == ("CHAIN", "critical", 1)
    assert "users/1 was changed outside Boresight" in raised.sentence
    with store.begin() as connection:
        connection.execute(sa.text("UPDATE users SET roles = :roles"), {"roles": before})
    upkeep.verify()
    upkeep.watch()
    with open_reading(store) as session:
        (over,) = alarms.list_alarms(session)
        assert alarms.get_alarm_state(over) == "unacknowledged, returned to normal"


def test_a_server_that_stops_does_not_wait_for_a_long_look(store: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, released = threading.Event(), threading.Event()
    monkeypatch.setattr(upkeep_module, "PATIENCE_S", 0.05)
    upkeep = _upkeep(store)
    monkeypatch.setattr(upkeep_module.rules, "find_changed_sensors", lambda _: begun.set() or [released.wait(30.0)][:0])
    upkeep.start()
    assert begun.wait(30.0)
    upkeep.close()
    assert not released.is_set()
    released.set()
