"""The audit log: one chain whoever writes, and a change by hand is found where it was made."""

from concurrent.futures import ThreadPoolExecutor

import pytest
import sqlalchemy as sa

from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.stores import triggers_aside


@pytest.fixture
def log(engine: Engine) -> Engine:
    with open_writing(engine) as session:
        for number in range(10):
            audit.append(session, SYSTEM, "counted", f"numbers/{number}", None, {"ψ": number / 7}, "because")
    return engine


def _by_hand(engine: Engine, statement: str) -> None:
    with open_writing(engine) as session:
        connection = session.connection()
        with triggers_aside(connection):
            connection.exec_driver_sql(statement)


def _verify(engine: Engine, head: str | None = None) -> audit.ChainReport:
    with open_reading(engine) as session:
        return audit.verify(session, head)


def _count(session: Session) -> int:
    return session.scalar(sa.select(sa.func.count()).select_from(AuditRecord)) or 0


def test_an_untouched_chain_verifies_and_counts(log: Engine) -> None:
    with open_reading(log) as session:
        count, head = _count(session), audit.head(session)
    report = _verify(log)
    assert (report.ok, report.records, report.head, report.first_broken_id) == (True, count, head, None)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE audit SET reason = 'another' WHERE id = 5",
        "UPDATE audit SET after = '{}' WHERE id = 5",
        "UPDATE audit SET actor = 'Mallory' WHERE id = 5",
        "UPDATE audit SET request_id = 'x' WHERE id = 5",
        "UPDATE audit SET hash = 'x' WHERE id = 5",
        "UPDATE audit SET previous_hash = 'x' WHERE id = 5",
    ],
)
def test_a_record_edited_by_hand_is_named(log: Engine, change: str) -> None:
    _by_hand(log, change)
    report = _verify(log)
    assert (report.ok, report.first_broken_id, report.records) == (False, 5, 4)
    assert "Record 5" in report.sentence


def test_a_record_removed_by_hand_is_missed_at_the_next(log: Engine) -> None:
    _by_hand(log, "DELETE FROM audit WHERE id = 5")
    assert _verify(log).first_broken_id == 6


@pytest.mark.parametrize(("which", "broken_id"), [("id > 5", 1006), ("id = 18", 1018), ("id > 0", 1001)])
def test_records_renumbered_by_hand_are_found_with_and_without_a_head(log: Engine, which: str, broken_id: int) -> None:
    with open_reading(log) as session:
        head = audit.head(session)
        assert _count(session) == 18
    _by_hand(log, f"UPDATE audit SET id = id + 1000 WHERE {which}")  # noqa: S608 - words of our own
    for known in (None, head):
        report = _verify(log, known)
        assert (report.ok, report.first_broken_id) == (False, broken_id)
        assert "renumbered" in report.sentence


def test_two_records_exchanged_are_found(log: Engine) -> None:
    _by_hand(log, "UPDATE audit SET id = CASE id WHEN 5 THEN -6 ELSE -5 END WHERE id IN (5, 6)")
    _by_hand(log, "UPDATE audit SET id = -id WHERE id < 0")
    assert _verify(log).first_broken_id == 5


def test_a_tail_cut_off_is_found_only_with_a_head_from_outside(log: Engine) -> None:
    with open_reading(log) as session:
        head = audit.head(session)
    _by_hand(log, "DELETE FROM audit WHERE id > 8")
    assert _verify(log).ok
    report = _verify(log, head)
    assert not report.ok
    assert "rewritten" in report.sentence


def test_a_head_of_before_is_still_in_the_chain(log: Engine) -> None:
    with open_writing(log) as session:
        head = audit.head(session)
        audit.append(session, SYSTEM, "counted", "numbers/10")
    assert _verify(log, head).ok


def test_many_writers_at_once_keep_one_chain(log: Engine) -> None:
    def write(number: int) -> None:
        with open_writing(log) as session:
            audit.append(session, SYSTEM, "raced", f"numbers/{number}")

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(write, range(60)))
    report = _verify(log)
    assert report.ok
    with open_reading(log) as session:
        assert _count(session) == report.records
        assert len(audit.list_records(session, limit=1000)) == report.records


def test_the_database_itself_refuses_to_change_a_record(log: Engine) -> None:
    for statement in ("UPDATE audit SET reason = 'x'", "DELETE FROM audit"):
        with pytest.raises(sa.exc.DBAPIError, match="a record of audit"), open_writing(log) as session:
            session.connection().exec_driver_sql(statement)
    assert _verify(log).ok


def test_pages_are_newest_first_and_do_not_overlap(log: Engine) -> None:
    with open_reading(log) as session:
        first = audit.list_records(session, limit=4)
        second = audit.list_records(session, limit=4, before_id=first[-1].id)
    ids = [record.id for record in (*first, *second)]
    assert ids == sorted(ids, reverse=True)
    assert len(set(ids)) == 8


def test_the_log_of_one_object_is_its_own(log: Engine) -> None:
    with open_reading(log) as session:
        records = audit.list_records(session, subject="numbers/3")
    assert [record.object for record in records] == ["numbers/3"]
