"""Holding rows against the chain, on both engines: what was changed, removed or inserted by hand is named."""

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session as UnsealedSession

from boresight.console.access.tables import User
from boresight.console.fleet.tables import Sensor
from boresight.platform.audit import chain, verification
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.audit.verification import RowMismatch, VerificationFindings
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.stores import drop_triggers

NOW = "2026-11-21T00:00:00.000000Z"
MALLORY = (
    "INSERT INTO users (id, name, printed_name, password_hash, roles, created_utc, session_epoch) "
    "VALUES (9, 'mallory', 'M', 'x', '[]', '2026', 0)"
)


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    for name in ("ana", "bo", "cy"):
        with open_writing(store) as session:
            session.add(User(name=name, printed_name=name, password_hash="x", roles=["analyst"], created_utc=NOW))
            chain.append_own(session, "added", f"users/{name}")
    with open_writing(store) as session:
        session.add(Sensor(name="ST1", document={"ψ": 1e22, "n": [0.1, None]}, created_utc=NOW, created_by=1))
        chain.append_own(session, "registered", "sensors/1")
    return store


def _by_hand(store: Engine, *statements: str) -> None:
    with store.begin() as connection:
        drop_triggers(connection)
        for statement in statements:
            connection.exec_driver_sql(statement)


def _found(store: Engine, head: str | None = None) -> VerificationFindings:
    with open_reading(store) as session:
        return verification.verify(session, head)


def test_what_nobody_touched_is_as_it_was_written(store: Engine) -> None:
    found = _found(store)
    assert (found.records, found.rows, found.misfits, found.misfit, found.broken_id) == (4, 4, 0, None, None)


@pytest.mark.few(8)
@pytest.mark.parametrize(
    ("statement", "misfit"),
    [
        ("UPDATE users SET roles = '[\"administrator\"]' WHERE id = 2", RowMismatch("users/2", "changed", 2)),
        ("UPDATE users SET roles = '[\"analyst\" ]' WHERE id = 2", RowMismatch("users/2", "changed", 2)),
        ("UPDATE users SET disabled_utc = '2026' WHERE id = 3", RowMismatch("users/3", "changed", 3)),
        ("UPDATE users SET session_epoch = 1 WHERE id = 3", RowMismatch("users/3", "changed", 3)),
        ("UPDATE sensors SET document = '{}'", RowMismatch("sensors/1", "changed", 4)),
        ("DELETE FROM users WHERE id = 3", RowMismatch("users/3", "removed", 3)),
        (MALLORY, RowMismatch("users/9", "inserted", None)),
        ("UPDATE users SET id = 8 WHERE id = 2", RowMismatch("users/2", "removed", 2)),
    ],
)
def test_an_edit_by_hand_is_named_with_its_record(store: Engine, statement: str, misfit: RowMismatch) -> None:
    _by_hand(store, statement)
    assert _found(store).misfit == misfit


@pytest.mark.few(8)
@pytest.mark.parametrize(
    ("statements", "broken_id"),
    [
        (("UPDATE audit SET reason = 'x' WHERE id = 2",), 2),
        (("UPDATE audit SET rows = NULL WHERE id = 3",), 3),
        (("DELETE FROM audit WHERE id = 2",), 3),
        (("UPDATE audit SET id = 20 WHERE id = 2", "UPDATE audit SET id = 2 WHERE id = 3"), 2),
        (("UPDATE audit SET id = id + 1000",), 1001),
        (("UPDATE audit SET id = id + 1000 WHERE id > 2",), 1003),
        (("UPDATE audit SET id = 1004 WHERE id = 4",), 1004),
        (("UPDATE audit SET id = 0 WHERE id = 1",), 0),
    ],
)
def test_a_record_edited_by_hand_is_named(store: Engine, statements: tuple[str, ...], broken_id: int) -> None:
    _by_hand(store, *statements)
    assert _found(store).broken_id == broken_id


def test_a_gap_is_let_pass_before_a_record_of_before_there_were_seals_and_before_no_other(store: Engine) -> None:
    _by_hand(store, "DELETE FROM audit")
    head = chain.FIRST_HASH
    with UnsealedSession(store) as session, session.begin():  # as an older version wrote: without rows and roles
        for record_id in (2, 5):
            raw = dict.fromkeys(chain.COLUMNS) | dict.fromkeys(
                ("at_utc", "actor", "credential", "action", "object"), "x"
            )
            raw |= {"id": record_id, "previous_hash": head, "hash": chain.compute_hash(head, raw)}
            session.add(AuditRecord(**raw))
            head = raw["hash"]
    with open_writing(store) as session:
        chain.append_own(session, "looked", "users/1")
    found = _found(store)
    assert (found.broken_id, found.records, found.last_id) == (None, 3, 6)
    _by_hand(store, "UPDATE audit SET id = 7 WHERE id = 6")
    assert _found(store).broken_id == 7


def test_records_are_numbered_without_a_gap_although_transactions_were_undone(store: Engine) -> None:
    for kept in (False, True):
        with open_writing(store) as session:
            chain.append_own(session, "first", "users/1")
            chain.append_own(session, "second", "users/1")
            chain.write_out(session)
            if not kept:
                session.rollback()
    with open_reading(store) as session:
        ids = session.scalars(sa.select(AuditRecord.id).order_by(AuditRecord.id)).all()
        unsaid = session.scalars(sa.select(AuditRecord.id).where(AuditRecord.roles.is_(None))).all()
    assert (ids, unsaid) == ([1, 2, 3, 4, 5, 6], [])
    assert _found(store).broken_id is None


def test_a_tail_that_was_cut_leaves_rows_without_seals_and_misses_the_head(store: Engine) -> None:
    head = _found(store).head
    _by_hand(store, "DELETE FROM audit WHERE id = 4")
    found = _found(store, head)
    assert (found.unmet, found.misfit) == ([head], RowMismatch("sensors/1", "inserted", None))


def test_a_later_seal_stands_for_the_row(store: Engine) -> None:
    with open_writing(store) as session:
        session.get_one(User, 2).roles = ["viewer"]
        chain.append_own(session, "changed", "users/2")
    assert _found(store).misfit is None
    _by_hand(store, "UPDATE users SET roles = '[\"analyst\"]' WHERE id = 2")  # as it was sealed before
    assert _found(store).misfit == RowMismatch("users/2", "changed", 5)


def test_many_misfits_are_counted_and_the_one_with_the_oldest_record_kept(store: Engine) -> None:
    _by_hand(store, "UPDATE sensors SET version = 7", "UPDATE users SET printed_name = 'M'")
    found = _found(store)
    assert (found.misfits, found.misfit) == (4, RowMismatch("users/1", "changed", 1))


def test_the_chain_is_walked_in_pieces(store: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("boresight.platform.audit.queries.RAW_AT_A_TIME", 2)
    monkeypatch.setattr("boresight.platform.audit.seals.ROWS_AT_A_TIME", 2)
    found = _found(store)
    assert (found.records, found.rows, found.misfits) == (4, 4, 0)
    with open_reading(store) as session:
        assert session.scalar(sa.select(sa.func.max(AuditRecord.id))) == found.last_id
