"""The maintenance of a server: the light of the chain, and the last use of keys."""

import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import api_keys, users
from boresight.console.access.tables import ApiKey
from boresight.console.alarms import rules as alarm_rules
from boresight.console.alarms import service as alarms
from boresight.console.alarms.tables import Alarm
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.jobs import maintenance as upkeep_module
from boresight.console.jobs.heartbeat import Heartbeat
from boresight.console.jobs.maintenance import Maintenance
from boresight.platform.actors import Policy, SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.passwords import add_person, approve
from tests.stores import open_migrated, url_in

LIMITS = SessionLimits(age_s=12 * 3600.0, idle_s=3600.0)


@pytest.fixture
def store(tmp_path) -> Iterator[Engine]:
    store = open_migrated(url_in(tmp_path))
    with open_writing(store) as session:
        row = add_person(session, "ada")
        actor = users.get_actor(session, row.id)
        api_keys.create_key(session, actor, label="passes")
    yield store
    store.dispose()


def _upkeep(store: Engine) -> Maintenance:
    return Maintenance(store, LIMITS, FolderBlobStore(Path(tempfile.mkdtemp())))


def test_the_light_tells_through_which_record_and_when_and_whether_it_is_stale(store, monkeypatch):
    maintenance = _upkeep(store)
    assert (maintenance.light().state, maintenance.light().at_utc) == ("not yet", None)  # before the first walk
    maintenance.verify()
    with open_reading(store) as session:
        newest = audit.list_records(session, limit=1)[0]
    light = maintenance.light()
    assert (light.state, light.last_id) == ("verified", newest.id)
    assert light.at_utc is not None
    assert light.at_utc >= newest.at_utc
    monkeypatch.setattr(time, "monotonic", lambda: 1e9)
    assert maintenance.light().state == "stale"  # what is not renewed


def test_an_edit_by_hand_turns_the_light(store, caplog):
    maintenance = _upkeep(store)
    with store.begin() as connection:
        connection.exec_driver_sql("UPDATE users SET roles = '[\"administrator\"]'")
    for _ in range(2):
        maintenance.verify()
    light = maintenance.light()
    assert light.state == "broken"
    assert "users/1 was changed" in light.sentence
    assert caplog.text.count("The audit log is broken") == 1  # said when it is found, not every minute


def test_a_running_upkeep_looks_at_once_and_writes_the_last_uses_when_it_stops(store):
    maintenance = _upkeep(store)
    with open_reading(store) as session:
        key = api_keys.list_keys(session)[0]
    maintenance.start()
    for _ in range(200):
        if maintenance.light().state == "verified":
            break
        time.sleep(0.05)
    maintenance.used(key.prefix)
    maintenance.close()
    maintenance.close()
    assert maintenance.light().state == "verified"
    with open_reading(store) as session:
        assert session.get_known(ApiKey, key.id).last_used_utc is not None


def test_what_fails_is_tried_again(store, monkeypatch):
    walks = []

    def failing(session: object, **_: object) -> None:
        walks.append(session)
        raise OSError("no disk")

    monkeypatch.setattr(upkeep_module, "ROUND_S", 0.01)
    monkeypatch.setattr(audit, "verify", failing)
    maintenance = _upkeep(store)
    maintenance.start()
    for _ in range(200):
        if len(walks) > 1:
            break
        time.sleep(0.02)
    maintenance.close()
    assert len(walks) > 1
    assert maintenance.light().state == "not yet"


def test_a_round_raises_the_alarm_of_a_broken_log_once_and_a_good_walk_lets_it_return(store):
    maintenance = _upkeep(store)
    maintenance.verify()
    with store.begin() as connection:
        before = connection.exec_driver_sql("SELECT roles FROM users").scalar()
        connection.exec_driver_sql("UPDATE users SET roles = '[\"administrator\"]'")
    maintenance.verify()
    for _ in range(2):
        maintenance.apply_alarm_rules()
    with open_reading(store) as session:
        (raised,) = alarms.list_alarms(session)
    assert (raised.kind, raised.level, raised.version) == ("CHAIN", "critical", 1)
    assert "users/1 was changed" in raised.sentence
    with store.begin() as connection:
        connection.execute(sa.text("UPDATE users SET roles = :roles"), {"roles": before})
    maintenance.verify()
    maintenance.apply_alarm_rules()
    with open_reading(store) as session:
        (over,) = alarms.list_alarms(session)
        assert (bool(over.active), bool(over.acknowledged)) == (False, False)


def test_a_server_that_stops_does_not_wait_for_a_long_look(store, monkeypatch):
    begun, released = threading.Event(), threading.Event()
    monkeypatch.setattr(upkeep_module.Maintenance, "patience_s", 0.05)
    maintenance = _upkeep(store)
    monkeypatch.setattr(upkeep_module.rules, "find_changed_sensors", lambda _: begun.set() or [released.wait(30.0)][:0])
    maintenance.start()
    assert begun.wait(30.0)
    maintenance.close()
    assert not released.is_set()
    released.set()


AT_ONCE = Policy(approval_days=0.0, rollback_days=0.0)
DAY_S = 86_400.0


class Hands:
    def __init__(self) -> None:
        self.wall_s, self.steady_s = 1.8e9, 1000.0

    def pass_by(self, seconds: float) -> None:
        self.wall_s += seconds
        self.steady_s += seconds


@pytest.fixture
def hands(monkeypatch) -> Hands:
    hands = Hands()
    monkeypatch.setattr(alarm_rules, "OURS", alarm_rules.Clock(lambda: hands.wall_s, lambda: hands.steady_s))
    return hands


@pytest.fixture
def due(engine, people, blobs, candidate) -> Approval:
    row = candidate()
    with open_writing(engine) as session:
        return approvals.submit(session, people["ana"], blobs, row.id, "better", row.version, policy=AT_ONCE)


def _state(engine: Engine, approval: Approval) -> str:
    with open_reading(engine) as session:
        return session.get_known(Approval, approval.id).state


def _alarm(engine: Engine) -> Alarm | None:
    with open_reading(engine) as session:
        return next((row for row in alarms.list_alarms(session) if row.kind == "CLOCK"), None)


@pytest.mark.parametrize("jump_s", [40 * DAY_S, -40 * DAY_S])
def test_a_jump_expires_no_request_before_somebody_has_acknowledged_it(engine, people, due, hands, jump_s):
    heart = Heartbeat(engine, lambda: None)
    hands.wall_s += jump_s
    for _ in range(3):
        heart.beat()
        hands.pass_by(5.0)
    row = _alarm(engine)
    assert (_state(engine, due), row.level, row.version) == ("OPEN", "serious", 1)
    with open_writing(engine) as session:
        alarms.acknowledge(session, people["ana"], row.id, "GPS was lost; the clock is right.", row.version)
    heart.beat()
    heart.beat()
    assert (_state(engine, due), _alarm(engine)) == ("EXPIRED", None)


def test_a_request_that_a_jump_would_let_expire_still_waits_for_who_may_sign_it_and_is_signed(
    engine, people, due, hands
):
    def waiting() -> int:
        with open_reading(engine) as session:
            return lists.count(session, "approvals", {"open_to": approvals.find_signatory(session, people["cy"])})

    assert waiting() == 0
    hands.wall_s += 40 * DAY_S
    assert waiting() == 1
    with open_writing(engine) as session:
        approve(session, people["cy"], due)
    assert _state(engine, due) == "APPROVED"


def test_time_that_passes_and_small_corrections_are_no_jump(engine, due, hands):
    hands.pass_by(40 * DAY_S)
    hands.wall_s += 2.0
    Heartbeat(engine, lambda: None).beat()
    assert (_state(engine, due), _alarm(engine)) == ("EXPIRED", None)


@pytest.mark.parametrize(("seen_s", "asks"), [(2 * DAY_S, True), (3600.0, False)])
def test_a_server_asks_before_anything_expires_if_it_was_last_seen_long_ago(engine, due, hands, tmp_path, seen_s, asks):
    seen = tmp_path / "last-seen"
    seen.write_text(str(hands.wall_s - seen_s))
    Heartbeat(engine, lambda: None, seen).beat()
    assert (_state(engine, due), _alarm(engine) is not None) == ("OPEN" if asks else "EXPIRED", asks)
