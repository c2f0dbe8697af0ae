"""Alarms come and go by themselves, and leave only by a person: every step allowed or refused, on record."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from boresight.console.access.sessions import SessionLimits
from boresight.console.alarms import rules
from boresight.console.alarms import service as alarms
from boresight.console.alarms.rules import check_chain
from boresight.console.alarms.tables import Alarm
from boresight.console.fleet.status import list_fleet_tiles
from boresight.console.fleet.trend import GROUND_SHIFTED
from boresight.console.jobs.maintenance import Maintenance
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import (
    ConflictError,
    CorruptFileError,
    ForbiddenError,
    NotFoundError,
    PreconditionRequiredError,
    RefusedInputError,
    StaleError,
)
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after
from tests.missions import add_run, add_set, make_baseline
from tests.refusals import has_code
from tests.stores import open_migrated, url_in

BROKEN = check_chain("broken", "Record 7 is not as it was written.")


@pytest.fixture
def alarm(session) -> Alarm:
    assert rules.update_installation_alarms(session, {rules.CHAIN: BROKEN}) == 1
    (row,) = alarms.list_alarms(session)
    return row


def _events(session: Session, row: Alarm) -> list[str]:
    return [event.event for event in alarms.list_alarm_events(session, row.id)]


def test_a_condition_raises_one_alarm_and_looking_again_writes_nothing(session, alarm):
    assert alarms.get_alarm_state(alarm) == "unacknowledged, active"
    before = session.scalar(sa.select(sa.func.count()).select_from(AuditRecord))
    assert not rules.has_installation_changed(session, {rules.CHAIN: BROKEN})
    assert rules.update_installation_alarms(session, {rules.CHAIN: BROKEN}) + rules.update_alarms(session) == 0
    assert session.scalar(sa.select(sa.func.count()).select_from(AuditRecord)) == before
    assert alarms.count_unacknowledged(session) == 1


def test_it_returns_by_itself_and_stays_until_a_person_has_seen_it(session, alarm, people):
    assert rules.has_installation_changed(session, {rules.CHAIN: None})
    rules.update_installation_alarms(session, {rules.CHAIN: None})
    assert alarms.get_alarm_state(alarm) == "unacknowledged, returned to normal"
    assert alarms.count_unacknowledged(session) == 1
    alarms.acknowledge(session, people["dee"], alarm.id, "Seen.", alarm.version)
    assert alarms.get_alarm_state(alarm) == "closed"
    assert _events(session, alarm) == ["RAISED", "RETURNED", "ACKNOWLEDGED", "CLOSED"]
    rules.update_installation_alarms(session, {rules.CHAIN: BROKEN})
    assert [row.id for row in alarms.list_alarms(session)] == [alarm.id + 1]


def test_acknowledged_first_it_closes_when_it_is_over_and_its_return_wants_to_be_seen(session, alarm, people):
    alarms.acknowledge(session, people["ana"], alarm.id, "", alarm.version)
    assert (alarms.get_alarm_state(alarm), alarms.count_unacknowledged(session)) == ("acknowledged, active", 0)
    worse = check_chain("broken", "Record 5 is not as it was written.")
    rules.update_installation_alarms(session, {rules.CHAIN: worse})
    assert (alarm.sentence, alarm.acknowledged) == ("Record 5 is not as it was written.", 1)
    rules.update_installation_alarms(session, {rules.CHAIN: None})
    assert alarms.get_alarm_state(alarm) == "closed"


def test_one_that_comes_back_before_it_was_seen_is_the_same_alarm_again(session, alarm):
    rules.update_installation_alarms(session, {rules.CHAIN: None})
    rules.update_installation_alarms(session, {rules.CHAIN: BROKEN})
    assert alarms.get_alarm_state(alarm) == "unacknowledged, active"
    assert _events(session, alarm) == ["RAISED", "RETURNED", "RAISED AGAIN"]


def test_a_shelved_alarm_counts_for_nobody_until_its_time(session, alarm, people):
    alarms.shelve(session, people["ana"], alarm.id, utc_after(3600), "The pass is in an hour.", alarm.version)
    assert alarms.get_alarm_state(alarm).startswith("unacknowledged, active, shelved")
    assert alarms.count_unacknowledged(session) == 0
    assert [row.id for row in alarms.list_alarms(session, alarms.AlarmFilter(state="shelved"))] == [alarm.id]
    alarm.shelved_until_utc = utc_after(-1)
    assert alarms.count_unacknowledged(session) == 1
    assert rules.update_alarms(session) == 1
    assert (_events(session, alarm)[-1], alarm.shelved_until_utc) == ("UNSHELVED", None)


def test_a_shelf_has_an_end_that_is_near_and_can_be_left_before_it(session, alarm, people):
    for until in ("tomorrow", "", "2020-01-01", "2099-01-01T00:00:00Z"):
        with pytest.raises(RefusedInputError):
            alarms.shelve(session, people["ana"], alarm.id, until, "Later.", alarm.version)
    with pytest.raises(ConflictError, match="not shelved"):
        alarms.unshelve(session, people["ana"], alarm.id, alarm.version)
    alarms.shelve(session, people["ana"], alarm.id, utc_after(3600), "Later.", alarm.version)
    alarms.unshelve(session, people["ana"], alarm.id, alarm.version)
    assert alarms.count_unacknowledged(session) == 1


def test_a_person_is_asked_and_asked_no_more_and_what_they_say_is_on_record(session, alarm, people):
    alarms.assign(session, people["ana"], alarm.id, people["dee"].user_id, alarm.version)
    assert alarm.assigned_to == people["dee"].user_id
    alarms.assign(session, people["ana"], alarm.id, None, alarm.version)
    assert [event.text for event in alarms.list_alarm_events(session, alarm.id)][1:] == ["to Dee", "to nobody"]
    with pytest.raises(NotFoundError, match="no user 99"):
        alarms.assign(session, people["ana"], alarm.id, 99, alarm.version)
    alarms.comment(session, people["dee"], alarm.id, "A pass is asked for.", alarm.version)
    with pytest.raises(RefusedInputError):
        alarms.comment(session, people["dee"], alarm.id, "  ", alarm.version)
    record = audit.find_last_change(session, f"alarms/{alarm.id}")
    assert (record.action, record.actor, record.reason) == ("alarm commented", "Dee", "A pass is asked for.")
    with pytest.raises(RefusedInputError, match="unacknowledged"):
        alarms.list_alarms(session, alarms.AlarmFilter(state="loud"))


STEPS: dict[str, Any] = {
    "acknowledge": lambda session, actor, number, seen: alarms.acknowledge(session, actor, number, "x", seen),
    "shelve": lambda session, actor, number, seen: alarms.shelve(session, actor, number, utc_after(60), "x", seen),
    "unshelve": alarms.unshelve,
    "assign": lambda session, actor, number, seen: alarms.assign(session, actor, number, None, seen),
    "comment": lambda session, actor, number, seen: alarms.comment(session, actor, number, "x", seen),
}


@pytest.mark.parametrize("step", STEPS)
def test_every_step_asks_who_acts_what_was_seen_and_whether_it_is_open(session, alarm, people, step):
    act, seen = STEPS[step], alarm.version
    key = Actor(people["ana"].user_id, "ana", "Ana", frozenset({"analyst"}), "key:abc")
    for nobody in (people["eve"], key):
        with pytest.raises(ForbiddenError):
            act(session, nobody, alarm.id, seen)
    with pytest.raises(PreconditionRequiredError):
        act(session, people["ana"], alarm.id, None)
    with pytest.raises(StaleError, check=has_code("changed-since-read")):
        act(session, people["ana"], alarm.id, seen - 1)
    with pytest.raises(NotFoundError):
        act(session, people["ana"], 99, seen)
    rules.update_installation_alarms(session, {rules.CHAIN: None})
    alarms.acknowledge(session, people["dee"], alarm.id, "", alarm.version)
    with pytest.raises(ConflictError, match="closed"):
        act(session, people["ana"], alarm.id, alarm.version)


def test_an_old_baseline_and_a_failed_read_back_raise_alarms(session):
    row = session.get_one(ParameterSet, 1)
    row.baseline_from_utc, row.onboard_state = utc_after(-200 * 86400), "MISMATCH"
    audit.append(session, Actor(None, "x", "X", frozenset(), "system"), "aged", "parameter-sets/1")
    assert rules.update_alarms(session, [2]) == 0
    assert rules.find_changed_sensors(session) == [1]
    assert rules.update_alarms(session, [1]) == 2
    found = {alarm.kind: alarm.level for alarm in alarms.list_alarms(session)}
    assert found == {"MISMATCH": "critical", "AGE": "caution"}
    assert rules.find_changed_sensors(session) == []


def test_a_drift_raises_an_alarm_and_a_promotion_lets_it_return(session):
    rng = np.random.default_rng(1)
    make_baseline(session, add_run(session, add_set(session, 1, 0), rng))
    moved = add_run(session, add_set(session, 1, 90), rng, np.eye(8)[0])
    rules.update_alarms(session, [1])
    (row,) = alarms.list_alarms(session, alarms.AlarmFilter(kind="DRIFT", sensor_id=1))
    assert (row.level, row.evidence["run_id"]) == ("serious", moved.id)
    make_baseline(session, moved)
    rules.update_alarms(session, [1])
    assert (bool(row.active), bool(row.acknowledged)) == (False, False)


def test_a_ground_calibration_that_does_not_hold_raises_no_alarm_and_is_a_caution_of_the_fleet(session):
    rng = np.random.default_rng(1)
    moved = add_run(session, add_set(session, 1, 90), rng, 20 * np.eye(8)[0])
    rules.update_alarms(session, [1])
    assert alarms.list_alarms(session, alarms.AlarmFilter(sensor_id=1)) == []
    (tile,) = [tile for tile in list_fleet_tiles(session) if tile.sensor.id == 1]
    assert (tile.status, tile.sentence) == ("caution", GROUND_SHIFTED)
    make_baseline(session, moved)
    (tile,) = [tile for tile in list_fleet_tiles(session) if tile.sensor.id == 1]
    assert tile.status == "normal"


CONTENT = b'{"f_m":0.016}'


@pytest.fixture
def store(tmp_path) -> Iterator[Engine]:
    store = open_migrated(url_in(tmp_path))
    yield store
    store.dispose()


@pytest.fixture
def blobs(tmp_path, store) -> BlobStore:
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


def _round(maintenance: Maintenance) -> None:
    maintenance.read_files()
    maintenance.apply_alarm_rules()


def _spoil(blobs: BlobStore) -> str:
    sha256 = blobs.put(CONTENT)
    blobs.path(sha256).write_bytes(CONTENT.replace(b"6", b"7"))
    return sha256


def test_a_file_that_nobody_asks_for_is_found_by_the_upkeep_altered_or_missing(store, blobs):
    maintenance = _upkeep(store, blobs)
    _round(maintenance)
    assert _alarms(store) == []
    sha256 = _spoil(blobs)
    for _ in range(3):
        _round(maintenance)
    (row,) = _alarms(store)
    assert (row.level, row.active, row.evidence["files"][0]["sha256"]) == ("critical", 1, sha256)
    assert row.version == 1  # said once
    blobs.path(blobs.put(b"other")).unlink()
    _round(_upkeep(store, blobs))
    whats = {file["sha256"]: file["what"] for file in _alarms(store)[0].evidence["files"]}
    assert (len(whats), whats[blobs.put(b"other")]) == (2, "missing")


def test_what_a_reader_found_is_in_alarm_with_the_next_round(store, blobs):
    maintenance = _upkeep(store, blobs)
    maintenance._read_to = "f" * 64
    blobs.tell_corrupt = maintenance.suspect
    with pytest.raises(CorruptFileError):
        blobs.document(_spoil(blobs))
    _round(maintenance)
    assert len(_alarms(store)) == 1


def test_another_server_and_one_that_was_started_anew_leave_the_alarm_up_until_the_file_is_back(store, blobs):
    sha256 = _spoil(blobs)
    _round(_upkeep(store, blobs))
    again = _upkeep(store, FolderBlobStore(blobs.folder))
    again._read_to = "f" * 64
    _round(again)
    assert _alarms(store)[0].active
    assert blobs.put(CONTENT) == sha256
    _round(again)
    assert not _alarms(store)[0].active
