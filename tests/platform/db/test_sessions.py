"""Transactions: one writer at a time, one state for a reader, refusals that leave nothing or what they must."""

import threading
from contextlib import suppress
from datetime import UTC, datetime, timedelta, timezone

import pytest
import sqlalchemy as sa

from boresight.errors import BoresightError, RefusedInputError, UnauthenticatedError
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import (
    Engine,
    Session,
    keep_despite_refusal,
    open_engine,
    open_reading,
    open_writing,
    utc_after,
    utc_now,
    utc_text,
)


def _count(session: Session) -> int:
    return session.scalar(sa.select(sa.func.count()).select_from(Blob)) or 0


def _blob(name: str = "0") -> Blob:
    return Blob(sha256=name, size_bytes=1, media_type="text/plain", created_utc=utc_now())


def _write_and_raise(engine: Engine, error: Exception, *, keep: bool) -> None:
    with open_writing(engine) as session:
        session.add(_blob())
        session.flush()
        if keep:
            keep_despite_refusal(session)
        raise error


def test_every_sqlite_connection_has_the_pragmas(sqlite: Engine) -> None:
    with sqlite.connect() as connection:
        values = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout", "journal_size_limit")
        }
    assert values == {
        "journal_mode": "wal",
        "synchronous": 1,
        "foreign_keys": 1,
        "busy_timeout": 10000,
        "journal_size_limit": 67108864,
    }


def test_a_writer_commits_at_its_end(engine: Engine) -> None:
    with open_writing(engine) as session:
        session.add(_blob())
    with open_reading(engine) as session:
        assert _count(session) == 1


@pytest.mark.parametrize("error", [ValueError, BoresightError])
def test_an_error_leaves_nothing(engine: Engine, error: type[Exception]) -> None:
    with pytest.raises(error):
        _write_and_raise(engine, error(), keep=False)
    with open_reading(engine) as session:
        assert _count(session) == 0


def test_a_refusal_that_must_be_remembered_is_kept(engine: Engine) -> None:
    with pytest.raises(UnauthenticatedError):
        _write_and_raise(engine, UnauthenticatedError(), keep=True)
    with open_reading(engine) as session:
        assert _count(session) == 1


def test_a_fault_of_the_program_is_never_kept(engine: Engine) -> None:
    with pytest.raises(ZeroDivisionError):
        _write_and_raise(engine, ZeroDivisionError(), keep=True)
    with open_reading(engine) as session:
        assert _count(session) == 0


def test_a_reader_changes_nothing(engine: Engine) -> None:
    with suppress(sa.exc.InternalError), open_reading(engine) as session:  # PostgreSQL refuses it, SQLite forgets it
        session.add(_blob())
        session.flush()
    with open_reading(engine) as session:
        assert _count(session) == 0


def test_a_reader_sees_one_state_while_others_write(engine: Engine) -> None:
    with open_reading(engine) as reader:
        assert _count(reader) == 0
        with open_writing(engine) as session:
            session.add(_blob())
        assert _count(reader) == 0


def _count_up(engine: Engine, times: int) -> None:
    for _ in range(times):
        with open_writing(engine) as session:
            number = _count(session)
            session.add(_blob(str(number)))


def _race(engine: Engine, threads: int, times: int) -> list[str]:
    workers = [threading.Thread(target=_count_up, args=(engine, times)) for _ in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    with open_reading(engine) as session:
        return sorted(session.scalars(sa.select(Blob.sha256)), key=int)


def test_reading_then_writing_is_safe_against_other_writers(engine: Engine) -> None:
    assert _race(engine, threads=4, times=25) == [str(number) for number in range(100)]


def test_reading_then_writing_is_safe_on_postgresql_too(postgresql: Engine) -> None:
    assert _race(postgresql, threads=4, times=10) == [str(number) for number in range(40)]


def test_a_postgresql_reader_sees_one_state_and_may_not_write(postgresql: Engine) -> None:
    with open_reading(postgresql) as reader:
        assert _count(reader) == 0
        with open_writing(postgresql) as session:
            session.add(_blob())
        assert _count(reader) == 0
    with open_reading(postgresql) as session:
        session.add(_blob())
        with pytest.raises(sa.exc.InternalError, match="read-only"):
            session.flush()


@pytest.mark.parametrize("url", ["", "no address", "mysql://host/name", "sqlite://"])
def test_an_address_that_is_no_store_is_refused(url: str) -> None:
    with pytest.raises(RefusedInputError, match="database address"):
        open_engine(url)


def test_times_sort_as_text_and_are_utc() -> None:
    assert utc_after(-1.0) < utc_now() < utc_after(1.0)
    east = datetime(2026, 11, 21, 3, 4, 5, 6, tzinfo=timezone(timedelta(hours=2)))
    assert utc_text(east) == "2026-11-21T01:04:05.000006Z"
    assert utc_text(datetime(2026, 1, 2)) == utc_text(datetime(2026, 1, 2, tzinfo=UTC))  # noqa: DTZ001 - a time without a zone is the case
