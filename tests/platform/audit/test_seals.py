"""Seals: whatever a transaction changed is in its audit records, and nothing changes past them."""

import pytest
import sqlalchemy as sa

from boresight.console.access.tables import ApiKey, FactorChallenge, LoginSession, User, UserPreference
from boresight.console.approvals.tables import FigureDelivery, Opening
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import TakenObject
from boresight.console.messages.tables import Message
from boresight.console.mission_control.tables import MissionControlLink
from boresight.console.runs.queries import finish
from boresight.console.runs.tables import ArchivedRun, Run, RunEvent
from boresight.console.saved_views.tables import SavedView
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.webhooks.tables import WebhookDelivery
from boresight.platform.audit import chain, seals, verification
from boresight.platform.audit.tables import AuditAnchor, AuditRecord, IdempotentResponse
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, downgrade, mark_dry_run, migrate, open_reading, open_writing, utc_now

NOW = "2026-11-21T00:00:00.000000Z"


def _user(name: str = "ana") -> User:
    return User(name=name, printed_name=name.title(), password_hash="x", roles=["analyst"], created_utc=NOW)


@pytest.fixture
def inhabited(engine: Engine) -> Engine:
    with open_writing(engine) as session:
        session.add(_user())
        session.flush()
        session.add(ApiKey(user_id=1, label="k", prefix="p", key_hash="h", scopes=[], created_utc=NOW))
        chain.append_own(session, "furnished", "users/1")
    return engine


def _found(engine: Engine) -> verification.VerificationFindings:
    with open_reading(engine) as session:
        return verification.verify(session, None)


def _records(engine: Engine) -> list[AuditRecord]:
    with open_reading(engine) as session:
        return list(session.scalars(sa.select(AuditRecord).order_by(AuditRecord.id)))


def test_every_table_is_sealed_or_says_why_not() -> None:
    tables = {mapper.class_ for mapper in Base.registry.mappers}
    unsealed = {LoginSession, Opening, RunEvent, WebhookDelivery, AuditAnchor, AuditRecord, IdempotentResponse, Blob}
    unsealed |= {ArchivedRun, UserPreference, SavedView, FigureDelivery, Message, FactorChallenge, MissionControlLink}
    unsealed |= {TakenObject}
    assert {*seals.list_sealed()} == tables - unsealed
    assert all(model.sealing.unsealed for model in unsealed)


def test_every_column_of_a_sealed_table_is_lasting_or_says_why_not() -> None:
    for model in seals.list_sealed():
        names = set(model.__table__.columns.keys())
        fleeting = model.sealing.fleeting
        assert names == {*seals.lasting(model)} | {*fleeting}
        assert names >= {*fleeting}
        assert seals.lasting(model)[0] == "id"
    assert {*seals.lasting(Run)} >= Run.sealing.moving


def test_the_last_record_of_a_transaction_carries_the_digests_of_all_that_it_changed(inhabited: Engine) -> None:
    with open_writing(inhabited) as session:
        chain.append_own(session, "first", "users/1")
        session.get_one(User, 1).roles = ["viewer"]
        session.add(_user("bo"))
        chain.append_own(session, "second", "users/2")
        session.get_one(User, 1).printed_name = "Ana Lima"  # after its record, and sealed all the same
    first, second = _records(inhabited)[-2:]
    assert (first.action, first.rows) == ("first", None)
    assert second.action == "second"
    assert second.rows is not None
    assert set(second.rows) == {"users/1", "users/2"}
    assert _found(inhabited).misfit is None


def test_a_change_without_a_record_is_refused_and_undone(inhabited: Engine) -> None:
    with pytest.raises(ValueError, match="users/1"), open_writing(inhabited) as session:
        session.get_one(User, 1).roles = ["administrator"]
    with open_reading(inhabited) as session:
        assert session.get_one(User, 1).roles == ["analyst"]


def test_a_trial_is_refused_for_a_missing_record_too(inhabited: Engine) -> None:
    def attempt() -> None:
        with open_writing(inhabited) as session:
            mark_dry_run(session)
            session.get_one(User, 1).roles = ["viewer"]

    with pytest.raises(ValueError, match="audit record"):
        attempt()


def test_a_column_that_is_not_lasting_needs_no_record(inhabited: Engine) -> None:
    with open_writing(inhabited) as session:
        session.get_one(ApiKey, 1).last_used_utc = utc_now()
    assert len(_records(inhabited)) == 1
    assert _found(inhabited).misfit is None


def test_a_bulk_change_of_a_sealed_table_is_refused(inhabited: Engine) -> None:
    with pytest.raises(ValueError, match="bulk statement"), open_writing(inhabited) as session:
        session.execute(sa.update(User).values(roles=["administrator"]))


def test_a_change_after_the_log_was_read_is_sealed_by_a_closing_record(inhabited: Engine) -> None:
    with open_writing(inhabited) as session:
        chain.append_own(session, "looked", "users/1")
        assert session.scalar(sa.select(AuditRecord.action).order_by(AuditRecord.id.desc()).limit(1)) == "looked"
        session.get_one(User, 1).roles = ["viewer"]
    last = _records(inhabited)[-1]
    assert (last.action, set(last.rows or ())) == ("sealed", {"users/1"})
    assert _found(inhabited).misfit is None


def test_what_was_rolled_back_leaves_neither_records_nor_seals(inhabited: Engine) -> None:
    with open_writing(inhabited) as session:
        session.get_one(User, 1).printed_name = "Tried"
        chain.append_own(session, "tried", "users/1")
        session.rollback()
        chain.append_own(session, "did nothing", "users/1")
    last = _records(inhabited)[-1]
    assert (last.action, last.rows) == ("did nothing", None)
    assert _found(inhabited).broken_id is None


def _run(engine: Engine) -> None:
    with open_writing(engine) as session:
        session.add(Sensor(name="ST1", document={}, created_utc=NOW))
        session.flush()
        session.connection().exec_driver_sql(
            "INSERT INTO blobs VALUES ('a', 1, 'text/csv', '2026', NULL)",
        )
        session.connection().exec_driver_sql(
            "INSERT INTO telemetry_sets (id, sensor_id, name, purpose, original_sha256, table_sha256, frames, stars, "
            "quality, uploaded_utc) VALUES (1, 1, 'a', 'calibration', 'a', 'a', 1, 1, '{}', '2026')"
        )
        seals.note(session, TelemetrySet, 1)
        run = Run(sensor_id=1, telemetry_set_id=1, method="batch", settings={}, sensor_document={}, launched_utc=NOW)
        run.state, run.attempt = "RUNNING", 1
        session.add(run)
        chain.append_own(session, "launched", "runs/1")


def test_a_run_under_way_moves_without_a_record_and_its_end_is_one(inhabited: Engine) -> None:
    _run(inhabited)
    with open_writing(inhabited) as session:
        session.get_one(Run, 1).progress = {"fraction": 0.5}
    assert _found(inhabited).misfit is None
    with open_writing(inhabited) as session:
        assert finish(session, 1, 1, "FAILED", "it diverged") == "FAILED"
    last = _records(inhabited)[-1]
    assert (last.actor, last.action, last.object, last.reason) == ("Boresight", "ended", "runs/1", "it diverged")
    assert set(last.rows or ()) == {"runs/1", "run_events/1"}  # the end, and the newest line of the log
    assert _found(inhabited).misfit is None


def test_an_end_that_came_too_late_is_not_on_record(inhabited: Engine) -> None:
    _run(inhabited)
    with open_writing(inhabited) as session:
        assert finish(session, 1, 0, "FAILED") is None
    assert [record.action for record in _records(inhabited)] == ["furnished", "launched"]


def test_a_database_from_before_the_seals_is_sealed_once(inhabited: Engine) -> None:
    with open_writing(inhabited) as session:  # as an old version left it: records without seals
        drop = f"DROP TRIGGER audit_no_removal{' ON audit' * (inhabited.dialect.name == 'postgresql')}"
        for statement in (drop, "DELETE FROM audit"):
            session.connection().exec_driver_sql(statement)
    downgrade(inhabited, "0002")
    migrate(inhabited)
    sealed = _records(inhabited)
    assert {record.action for record in sealed} == {"sealed"}
    assert {key for record in sealed for key in record.rows or ()} == {"users/1", "api_keys/1"}
    migrate(inhabited)
    assert len(_records(inhabited)) == len(sealed)
    found = _found(inhabited)
    assert (found.misfit, found.broken_id, found.rows) == (None, None, 2)
