"""Log lines of runs and messages of webhooks edited, put in or removed by hand are told, and so are triggers; on both engines."""

import pytest
import sqlalchemy as sa

from boresight.console.fleet.tables import Sensor
from boresight.console.runs.queries import Line, write_event, write_events
from boresight.console.runs.tables import Run, RunEvent
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.platform.audit import chain, verification
from boresight.platform.audit import seals as journals
from boresight.platform.audit.verification import RowMismatch, VerificationFindings
from boresight.platform.blobs.tables import Blob as BlobRow
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.stores import triggers_aside

NOW = "2026-11-21T00:00:00.000000Z"


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    with open_writing(store) as session:
        session.add(Sensor(name="ST1", document={}, created_utc=NOW))
        session.add(BlobRow(sha256="a", size_bytes=1, media_type="text/csv", created_utc=NOW))
        session.flush()
        given = {
            "name": "a",
            "purpose": "calibration",
            "original_sha256": "a",
            "table_sha256": "a",
            "frames": 1,
            "stars": 1,
        }
        session.add(TelemetrySet(sensor_id=1, quality={}, uploaded_utc=NOW, **given))
        session.flush()
        session.add(
            Run(
                sensor_id=1,
                telemetry_set_id=1,
                method="batch",
                settings={},
                sensor_document={},
                state="QUEUED",
                launched_utc=NOW,
            )
        )
        session.add(Webhook(label="w", url="https://x", actions=[], secret="s", created_utc=NOW))
        session.flush()
        write_event(session, 1, 0, Line.moved("QUEUED"))
        write_events(session, [(1, 1, Line.begun(1, "host")), (1, 1, Line.log("ψ"))])
        chain.append_own(session, "furnished", "sensors/1")
    with open_writing(store) as session:
        write_events(session, [(1, 1, Line.log(f"step {number}", {"fraction": number / 3})) for number in range(3)])
    with open_writing(store) as session:
        for number in range(3):
            values = {"body": f"{{{number}}}", "state": "PENDING", "due_utc": NOW, "created_utc": NOW}
            session.add(WebhookDelivery(webhook_id=1, **values))
    with open_writing(store) as session:
        session.get_one(WebhookDelivery, 2).state = "DELIVERED"
    return store


def _by_hand(store: Engine, statement: str) -> None:
    with store.begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.exec_driver_sql("SET LOCAL session_replication_role = replica")
            connection.exec_driver_sql(statement)
            return
        with triggers_aside(connection):
            connection.exec_driver_sql(statement)


def _found(store: Engine) -> VerificationFindings:
    with open_reading(store) as session:
        return verification.verify(session, None)


def test_journals_that_nobody_touched_hold(store: Engine) -> None:
    found = _found(store)
    assert (found.ok, found.misfit, found.guards) == (True, None, [])
    assert found.rows == 4 + 6 + 3


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("statement", "misfit"),
    [
        ("UPDATE run_events SET message = 'CANCELLED' WHERE id = 2", RowMismatch("run_events/2", "changed", 1)),
        ("UPDATE run_events SET at_utc = '2020' WHERE id = 5", RowMismatch("run_events/5", "changed", None)),
        ("UPDATE run_events SET state = 'SUCCEEDED' WHERE id = 2", RowMismatch("run_events/2", "changed", 1)),
        ("UPDATE run_events SET cause = 'another' WHERE id = 5", RowMismatch("run_events/5", "changed", None)),
        ("UPDATE run_events SET numbers = NULL WHERE id = 5", RowMismatch("run_events/5", "changed", None)),
        ("DELETE FROM run_events WHERE id = 2", RowMismatch("run_events/2", "removed", 1)),
        ("DELETE FROM run_events WHERE id = 5", RowMismatch("run_events/5", "removed", None)),
        ("DELETE FROM run_events WHERE id > 2", RowMismatch("run_events/3", "removed", 1)),
        (
            "INSERT INTO run_events (id, run_id, attempt, at_utc, kind, message) VALUES (7, 1, 1, '2026', 'log', 'x')",
            RowMismatch("run_events/7", "inserted", None),
        ),
        (
            "UPDATE webhook_deliveries SET body = '{}' WHERE id = 1",
            RowMismatch("webhook_deliveries/1", "changed", None),
        ),
        (
            "UPDATE webhook_deliveries SET state = 'PENDING' WHERE id = 2",
            RowMismatch("webhook_deliveries/2", "changed", None),
        ),
        (
            "UPDATE webhook_deliveries SET status = 200 WHERE id = 1",
            RowMismatch("webhook_deliveries/1", "changed", None),
        ),
        ("DELETE FROM webhook_deliveries WHERE id = 1", RowMismatch("webhook_deliveries/1", "removed", None)),
    ],
)
def test_an_edit_of_a_journal_is_told(store: Engine, statement: str, misfit: RowMismatch) -> None:
    _by_hand(store, statement)
    assert (_found(store).ok, _found(store).misfit) == (False, misfit)


def test_the_last_messages_cut_are_told_once_a_record_came_after_them(store: Engine) -> None:
    with open_writing(store) as session:
        chain.append_own(session, "looked", "webhooks/1")
    _by_hand(store, "DELETE FROM webhook_deliveries WHERE id = 3")
    assert _found(store).misfit == RowMismatch("webhook_deliveries/3", "removed", 2)


def test_a_journal_chained_anew_meets_the_audit_log(store: Engine) -> None:
    journal = journals.AppendOnlyTable(RunEvent)
    with open_reading(store) as session:
        rows = list(journals.iterate_rows(session, journal))
    rows[0]["message"], previous = "SUCCEEDED", journals.FIRST_HASH
    for row in rows:
        previous = row["hash"] = journal.compute_hash(previous, row)
        hashes = f"hash = '{previous}', outcome_hash = '{journal.compute_outcome_hash(row)}'"
        said = f"message = '{row['message']}', {hashes} WHERE id = {row['id']}"
        _by_hand(store, f"UPDATE run_events SET {said}")  # noqa: S608 - words of our own
    assert _found(store).misfit == RowMismatch("run_events/3", "changed", 1)


def test_what_was_rolled_back_is_carried_by_the_next_record(store: Engine) -> None:
    with open_writing(store) as session:
        write_event(session, 1, 1, Line.log("undone"))
        chain.append_own(session, "undone", "runs/1")
        chain.write_out(session)
        session.rollback()
    with open_writing(store) as session:
        record = chain.append_own(session, "looked", "runs/1")
    assert {"run_events/6", "webhook_deliveries/3"} <= set(record.rows or ())
    with open_writing(store) as session:
        again = chain.append_own(session, "looked again", "runs/1")
    assert again.rows is None
    assert _found(store).ok


def test_lines_keep_their_order_however_they_are_written(store: Engine) -> None:
    with open_writing(store) as session:
        write_event(session, 1, 2, Line.log("one"))
        session.add(RunEvent(run_id=1, attempt=2, at_utc=NOW, kind="log", message="two"))
        write_events(session, [(1, 2, Line.log("three"))])
    with open_reading(store) as session:
        said = session.scalars(sa.select(RunEvent.message).where(RunEvent.attempt == 2).order_by(RunEvent.id)).all()
    assert said == ["one", "two", "three"]
    assert _found(store).ok


REMOVED = {"sqlite": "DROP TRIGGER audit_no_change", "postgresql": "DROP TRIGGER audit_no_change ON audit"}
INSERTED = {
    "sqlite": "CREATE TRIGGER evil AFTER INSERT ON users BEGIN UPDATE users SET roles = '[\"administrator\"]'; END",
    "postgresql": "CREATE TRIGGER evil BEFORE UPDATE ON users FOR EACH ROW EXECUTE FUNCTION refuse_change('x')",
}
CHANGED = {
    "sqlite": (
        "DROP TRIGGER audit_no_change",
        "CREATE TRIGGER audit_no_change BEFORE UPDATE ON audit FOR EACH ROW WHEN (OLD.id > 9) BEGIN SELECT 1; END",
    ),
    "postgresql": (
        "DROP TRIGGER audit_no_change ON audit",
        "CREATE TRIGGER audit_no_change BEFORE UPDATE ON audit FOR EACH ROW WHEN (OLD.id > 9) EXECUTE FUNCTION refuse_change('x')",
    ),
}
SILENCED = (
    "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RETURN NEW; END $$",
    "ALTER TABLE audit DISABLE TRIGGER audit_no_removal",
)


def _execute(store: Engine, *statements: str) -> None:
    with store.begin() as connection:
        for statement in statements:
            connection.exec_driver_sql(statement)


@pytest.mark.parametrize(
    ("statements", "name", "what"),
    [(REMOVED, "audit_no_change", "removed"), (INSERTED, "evil", "inserted"), (CHANGED, "audit_no_change", "changed")],
)
def test_a_missing_foreign_or_changed_trigger_is_told(store: Engine, statements: dict, name: str, what: str) -> None:
    of_engine = statements[store.dialect.name]
    _execute(store, *([of_engine] if isinstance(of_engine, str) else of_engine))
    found = _found(store)
    assert (found.ok, found.guards) == (False, [RowMismatch(f"the trigger {name}", what, None)])


@pytest.mark.parametrize("statement", SILENCED)
def test_a_trigger_that_was_silenced_is_told(postgresql: Engine, statement: str) -> None:
    _execute(postgresql, statement)
    found = _found(postgresql)
    assert not found.ok
    assert {misfit.what for misfit in found.guards} == {"changed"}
