"""Migrations: the way up and down, on data, ends in the tables the models say; the database guards its own rules."""

import json
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy.orm import Session as UnsealedSession

from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.runs.tables import Run, RunEvent
from boresight.console.uplinks.tables import Uplink
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.audit.chain import append_own
from boresight.platform.audit.seals import FIRST_HASH, AppendOnlyTable, iterate_rows
from boresight.platform.audit.tables import IdempotentResponse
from boresight.platform.audit.verification import WORDS
from boresight.platform.blobs.tables import Blob as BlobRow
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import (
    DowngradeLoss,
    Engine,
    current_revision,
    downgrade,
    head_revision,
    list_downgrade_losses,
    migrate,
    open_engine,
    open_reading,
    open_writing,
)
from tests.effort import effort
from tests.furniture import NOW, alarm, parameter_set, rows_of_tables
from tests.refusals import has_code


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    return store


def _fill(store: Engine) -> None:
    with UnsealedSession(store) as session, session.begin():  # past the seals: only the schema is looked at here
        for row in rows_of_tables():
            session.add(row)
            session.flush()


def test_the_migrated_schema_is_the_one_of_the_models(store: Engine) -> None:
    with store.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_data_survive_a_migration_that_has_nothing_to_do(store: Engine) -> None:
    _fill(store)
    migrate(store)
    with open_reading(store) as session:
        sensor = session.get_one(Sensor, 1)
        assert sensor.document == {"name": "ST1", "f_m": 1e22}
        assert isinstance(sensor.document["f_m"], float)
        assert session.get_one(BlobRow, "b" * 64).size_bytes == 3_000_000_000


def test_a_full_store_goes_down_and_up_again(store: Engine) -> None:
    _fill(store)
    assert current_revision(store) == head_revision()
    downgrade(store, "base")
    assert current_revision(store) is None
    with store.connect() as connection:
        assert sa.inspect(connection).get_table_names() == ["alembic_version"]
    migrate(store)
    assert current_revision(store) == head_revision()
    _fill(store)


def test_the_data_survive_the_way_down_to_every_revision_and_up_again(store: Engine) -> None:
    _fill(store)
    with open_writing(store) as session:
        kept = {"request_sha256": "s", "status": 201, "headers": {}, "body": {"id": 1}, "created_utc": NOW}
        session.add(IdempotentResponse(key="k", actor="ana session", **kept))
    for number in range(int(head_revision()) - 1, 0, -effort(8, 1)):
        revision = f"{number:04}"
        downgrade(store, revision)
        assert current_revision(store) == revision
        assert _has_age_index(store) == (revision >= "0002")
        migrate(store)
        assert current_revision(store) == head_revision()
        assert _has_age_index(store)
        with open_reading(store) as session:
            assert session.get_one(IdempotentResponse, ("k", "ana session")).body == {"id": 1}
            assert session.get_one(Sensor, 1).name == "ST1"


#: Sentences as versions before 0012 wrote them, with the columns that they are read into.
SAID = [
    ("state", "QUEUED", ("QUEUED", None, "info", None)),
    ("state", "RUNNING: attempt 1 on host/7", ("RUNNING", None, "info", None)),
    ("log", "45 %: frame 17: 17 of 40 frames", (None, None, "info", {"fraction": 0.45})),
    ("log", "Attempt 1: its server was stopped", (None, "its server was stopped", "warning", None)),
    ("state", "QUEUED: again, because the disk: full", ("QUEUED", "the disk: full", "warning", None)),
    ("lost", "Attempt 2: its worker\nprocess died", (None, "its worker\nprocess died", "error", None)),
    ("log", "Traceback (most recent call last)", (None, None, "error", None)),
    ("log", "Computed in 1.25 s: converged.", (None, None, "info", {"seconds": 1.25})),
    ("state", "CANCELLING: by Ana: wrong set", ("CANCELLING", "by Ana: wrong set", "warning", None)),
    ("state", "FAILED: given up", ("FAILED", "given up", "error", None)),
    ("state", "SUCCEEDED", ("SUCCEEDED", None, "info", None)),
]


@pytest.mark.full
def test_what_the_log_of_runs_said_is_in_its_columns_after_the_way_up_and_the_journal_still_holds(
    store: Engine,
) -> None:
    _fill(store)
    with open_writing(store) as session:
        for kind, message, _ in SAID:
            session.add(RunEvent(run_id=1, attempt=1, at_utc=NOW, kind=kind, message=message))
    downgrade(store, "0011")
    with store.connect() as connection:
        assert "state" not in {column["name"] for column in sa.inspect(connection).get_columns("run_events")}
    migrate(store)
    with open_reading(store) as session:
        rows = session.scalars(sa.select(RunEvent).order_by(RunEvent.id)).all()
        assert [(row.state, row.cause, row.level, row.numbers) for row in rows] == [columns for *_, columns in SAID]
        assert [row.message for row in rows] == [message for _, message, _ in SAID]
        journal, previous = AppendOnlyTable(RunEvent), FIRST_HASH
        for line in iterate_rows(session, journal):
            assert line["hash"] == journal.compute_hash(previous, line)
            assert line["outcome_hash"] == journal.compute_outcome_hash(line)
            previous = line["hash"]


@pytest.mark.full
def test_a_webhook_knows_which_head_it_was_told_of_newest_after_the_way_up(store: Engine) -> None:
    with open_writing(store) as session:
        hook = session.put(Webhook(label="x", url="https://mission.invalid/", actions=[], secret="s", created_utc=NOW))
        for kind, number in (("audit.head", 1), ("audit.head", 2), ("runs.launched", 3)):
            body = json.dumps({"type": kind, "data": {"audit_hash": f"hash {number}"}})
            session.put(WebhookDelivery(webhook_id=hook.id, body=body, state="DELIVERED", due_utc=NOW, created_utc=NOW))
        hook_id = hook.id
        append_own(session, "made", f"webhooks/{hook_id}")
    downgrade(store, "0012")
    migrate(store)
    with open_reading(store) as session:
        assert session.get_one(Webhook, hook_id).told_head == "hash 2"


def test_a_record_of_c_sd_alone_is_no_step_after_the_way_back_and_what_is_recorded_is_still_guarded(
    store: Engine,
) -> None:
    _fill(store)
    said = {"parameter_set_id": 1, "source": "pass 2", "recorded_utc": NOW, "recorded_by": 1, "c_sd": "LOADED"}
    with open_writing(store) as session:
        session.add(Uplink(onboard_state="LOADED", **said))
        session.add(Uplink(onboard_state="ACTIVE", leaves_state=1, **said))
        append_own(session, "recorded", "parameter-sets/1")
    assert DowngradeLoss("uplinks", None, 1) in list_downgrade_losses(store, "0032")
    downgrade(store, "0032")
    with pytest.raises(sa.exc.DBAPIError, match="removed"):
        _execute(store, "DELETE FROM uplinks")
    migrate(store)
    with open_reading(store) as session:
        states = [row.onboard_state for row in session.scalars(sa.select(Uplink).order_by(Uplink.id))]
    assert states == ["SENT", "LOADED"]


def test_an_older_version_can_number_records_itself_again(store: Engine) -> None:
    with open_writing(store) as session:
        for number in range(3):
            append_own(session, "counted", f"numbers/{number}")
    downgrade(store, "0002")
    columns = "at_utc, actor, credential, action, object, previous_hash, hash"
    _execute(store, f"INSERT INTO audit ({columns}) VALUES ('2026', 'a', 'b', 'c', 'd', 'e', 'f')")  # noqa: S608 - words of our own
    with store.connect() as connection:
        assert connection.exec_driver_sql("SELECT max(id) FROM audit").scalar() == 4


def _has_age_index(store: Engine) -> bool:
    with store.connect() as connection:
        indexes = sa.inspect(connection).get_indexes("idempotent_responses")
    return "ix_idempotent_responses_created_utc" in {index["name"] for index in indexes}


def test_a_migration_leaves_foreign_keys_on(sqlite: Engine) -> None:
    migrate(sqlite)
    with pytest.raises(sa.exc.IntegrityError, match="FOREIGN KEY"), open_writing(sqlite) as session:
        session.add(Promotion(sensor_id=9, parameter_set_id=9, at_utc=NOW))


def test_a_database_of_a_newer_version_is_refused_and_left_alone(store: Engine) -> None:
    with store.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(ConflictError, match="newer version"):
        migrate(store)
    with pytest.raises(ConflictError, match="newer version"):
        downgrade(store, "0001")
    assert current_revision(store) == "9999"


def test_a_way_back_to_no_revision_is_refused_with_those_there_are(store: Engine) -> None:
    for revision in ("xyz", "", "-1", "+1", "9999", "base:head"):
        with pytest.raises(RefusedInputError, match=r"base or 0001( or \d{4})*\.$", check=has_code("unknown-revision")):
            downgrade(store, revision)
        assert current_revision(store) == head_revision()


def test_an_empty_store_goes_back_to_base_only(sqlite: Engine) -> None:
    downgrade(sqlite, "base")
    with pytest.raises(RefusedInputError, match=r"'0001'.* base\.$", check=has_code("unknown-revision")):
        downgrade(sqlite, "0001")
    downgrade(sqlite, "base")
    assert current_revision(sqlite) is None


KEPT = (
    "audit",
    "signatures",
    "uplinks",
    "promotions",
    "parameter_sets",
    "alarms",
    "alarm_events",
    "notes",
    "presets",
    "import_profiles",
    "campaigns",
    "campaign_runs",
    "change_proposals",
    "alignments",
)
FIXED = (
    ("audit", "reason = 'another'"),
    ("signatures", "decision = 'REFUSE'"),
    ("uplinks", "onboard_state = 'ACTIVE'"),
    ("promotions", "at_utc = '2020'"),
    ("parameter_sets", "document = '{}'"),
    ("parameter_sets", "sha256 = 'x'"),
    ("parameter_sets", "run_id = 1"),
    ("runs", "state = 'FAILED'"),
    ("runs", "result_sha256 = NULL"),
    ("alarms", "source = 'sensors/2/AGE'"),
    ("alarms", "raised_utc = '2020'"),
    ("alarm_events", "text = 'another'"),
    ("notes", "text = 'another'"),
    ("presets", "document = '{1}'"),
    ("presets", "sentence = 'another'"),
    ("import_profiles", "document = '{1}'"),
    ("campaigns", "settings = '{1}'"),
    ("campaign_runs", "refusal = 'another'"),
    ("change_proposals", "document = '{1}'"),
    ("change_proposals", "proposed_by = 2"),
    ("alignments", "options = '{1}'"),
    ("alignments", "state = 'FAILED'"),
)


def test_what_is_on_record_cannot_be_removed(store: Engine) -> None:
    _fill(store)
    for table in KEPT:
        with pytest.raises(sa.exc.DBAPIError, match=WORDS["refuse_removal"]):
            _execute(store, f"DELETE FROM {table}")  # noqa: S608 - names of our own


def test_what_is_on_record_cannot_be_changed(store: Engine) -> None:
    _fill(store)
    for table, change in FIXED:
        with pytest.raises(sa.exc.DBAPIError, match=WORDS["refuse_change"]):
            _execute(store, f"UPDATE {table} SET {change}")  # noqa: S608 - names of our own


def test_what_may_change_does(store: Engine) -> None:
    _fill(store)
    _execute(store, "UPDATE parameter_sets SET ground_state = 'SUPERSEDED', version = 2")
    _execute(store, "UPDATE runs SET label = 'best'")
    _execute(store, "UPDATE presets SET archived_utc = '2026'")
    _execute(store, "UPDATE campaigns SET cancelled_utc = '2026'")
    with open_reading(store) as session:
        assert session.get_one(ParameterSet, 1).ground_state == "SUPERSEDED"
        assert session.get_one(Run, 1).label == "best"


def test_a_source_has_one_open_alarm_and_a_closed_one_stays_as_it_was(store: Engine) -> None:
    _fill(store)
    with pytest.raises(sa.exc.IntegrityError), UnsealedSession(store) as session, session.begin():
        session.add(alarm())
    _execute(store, f"UPDATE alarms SET active = 0, acknowledged = 1, closed_utc = '{NOW}'")  # noqa: S608 - a time of our own
    with UnsealedSession(store) as session, session.begin():
        session.add(alarm())
    with pytest.raises(sa.exc.DBAPIError, match=WORDS["refuse_change"]):
        _execute(store, "UPDATE alarms SET closed_utc = NULL WHERE id = 1")


def test_postgresql_does_not_truncate_the_record_either(postgresql: Engine) -> None:
    _fill(postgresql)
    with pytest.raises(sa.exc.DBAPIError, match=WORDS["refuse_removal"]):
        _execute(postgresql, "TRUNCATE audit")


@pytest.mark.parametrize(
    "row", [parameter_set(1, "BASELINE"), parameter_set(0, "CANDIDATE"), parameter_set(2, "ELSEWHERE")]
)
def test_a_second_baseline_or_number_or_an_unknown_state_is_refused(store: Engine, row: ParameterSet) -> None:
    _fill(store)
    copy = parameter_set(row.number, row.ground_state)
    with pytest.raises(sa.exc.IntegrityError), open_writing(store) as session:
        session.add(copy)


def test_a_second_open_request_for_a_set_is_refused(store: Engine) -> None:
    _fill(store)
    row = Approval(parameter_set_id=1, state="OPEN", reason="r", submitted_utc=NOW, submitted_by=1, bound={})
    with pytest.raises(sa.exc.IntegrityError), open_writing(store) as session:
        session.add(row)


def test_text_in_a_number_is_refused(sqlite: Engine) -> None:
    _fill(sqlite)
    with pytest.raises(sa.exc.IntegrityError, match="TEXT"):
        _execute(sqlite, "UPDATE runs SET attempt = 'twice'")


def _execute(store: Engine, statement: str) -> None:
    with open_writing(store) as session:
        session.connection().exec_driver_sql(statement)


def test_every_table_and_index_is_spelled_as_the_models_spell_it(sqlite: Engine, tmp_path: Any) -> None:
    direct = open_engine(f"sqlite:///{tmp_path}/direct.sqlite3")
    with direct.begin() as connection:
        Base.metadata.create_all(connection)
    migrated, modelled = _spelling(sqlite), _spelling(direct)
    assert {name: _parts(sql) for name, sql in migrated.items()} == {
        name: _parts(sql) for name, sql in modelled.items()
    }
    direct.dispose()


def _parts(sql: str) -> set[str]:
    head, _, rest = sql.partition("(")
    body, _, tail = rest.rpartition(")")
    depths = accumulate((letter == "(") - (letter == ")") for letter in body)
    cut = "".join("\n" if letter == "," and depth == 0 else letter for letter, depth in zip(body, depths, strict=True))
    return {head.strip().replace('"', ""), tail.strip(), *(part.strip().replace('"', "") for part in cut.split("\n"))}


def _spelling(engine: Engine) -> dict[str, str]:
    query = "SELECT name, sql FROM sqlite_master WHERE type IN ('table', 'index') AND sql IS NOT NULL"
    with engine.connect() as connection:
        rows = connection.exec_driver_sql(query)
        return {name: " ".join(sql.split()) for name, sql in rows if name != "alembic_version"}


def test_every_table_is_strict(sqlite: Engine) -> None:
    tables = {name: sql for name, sql in _spelling(sqlite).items() if sql.startswith("CREATE TABLE")}
    assert len(tables) == len(Base.metadata.tables)
    assert all(sql.endswith("STRICT") for sql in tables.values())


def test_stores_of_one_process_are_migrated_beside_one_another(tmp_path: Path) -> None:
    engines = [open_engine(f"sqlite:///{tmp_path}/{number}.sqlite3") for number in range(4)]
    with ThreadPoolExecutor(len(engines)) as threads:
        list(threads.map(migrate, engines))
    assert {current_revision(engine) for engine in engines} == {head_revision()}
    for engine in engines:
        engine.dispose()
