"""A mark moves with every commit of anybody, and with nothing else, on either engine."""

import time

import pytest

from boresight.platform.audit.chain import append_own
from boresight.platform.db.data_version import DataVersionReader, VersionedCache
from boresight.platform.db.sessions import open_engine, open_reading, open_writing


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request):
    return request.getfixturevalue(request.param)


def test_a_mark_moves_with_every_commit_and_with_nothing_else(store):
    another = open_engine(store.url.render_as_string(hide_password=False))
    reader = DataVersionReader(store)
    seen = [reader.look()]
    for database in (store, another, store):
        with open_reading(database) as session:
            session.connection()
        assert reader.look() == seen[-1]
        with open_writing(database) as session:
            append_own(session, "did", "thing/1")
            session.flush()
            assert reader.look() == seen[-1], "what is not committed is not to be seen"
        seen.append(reader.look())
    assert None not in seen
    assert len(set(seen)) == len(seen)
    reader.close()
    another.dispose()


def test_versions_of_another_connection_are_others(store):
    reader = DataVersionReader(store)
    first = reader.look()
    reader.close()
    assert reader.look() != first
    reader.close()


def test_a_look_holds_no_connection_of_the_pool(store):
    reader = DataVersionReader(store)
    reader.look()
    assert store.pool.checkedout() == 0
    reader.close()


def test_only_sqlite_is_asked_at_once(sqlite, postgresql):
    assert DataVersionReader(sqlite).at_once
    assert not DataVersionReader(postgresql).at_once


def test_a_store_that_cannot_say_gives_no_mark(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path}/no-store.sqlite3")
    (tmp_path / "no-store.sqlite3").write_bytes(b"this is no database, however long it may be " * 50)
    assert DataVersionReader(engine).look() is None
    engine.dispose()


def test_what_was_read_is_read_again_only_after_a_commit_or_for_another_question(store):
    reader = DataVersionReader(store)
    cache, asked = VersionedCache(reader), []

    def answer(question):
        return cache.answer(question, lambda: asked.append(question) or len(asked))

    assert [answer("a"), answer("a"), answer("b"), answer("b"), answer("a")] == [1, 1, 2, 2, 3]
    with open_writing(store) as session:
        append_own(session, "did", "thing/1")
    assert [answer("a"), answer("a")] == [4, 4]
    reader.close()


def test_what_is_committed_while_it_is_read_is_read_again(store):
    reader = DataVersionReader(store)
    cache = VersionedCache(reader)

    def read():
        with open_writing(store) as session:
            append_own(session, "did", "thing/1")

    cache.answer("a", read)
    assert cache.answer("a", lambda: "again") == "again"
    reader.close()


def test_who_asked_before_it_was_read_is_given_it_whatever_is_committed_after_and_told_so(store):
    reader = DataVersionReader(store)
    cache, asked_s = VersionedCache(reader), time.monotonic()
    assert cache.answer_to("a", lambda: "once", time.monotonic()) == ("once", False)
    with open_writing(store) as session:
        append_own(session, "did", "thing/1")
    assert cache.answer_to("a", lambda: "again", asked_s) == ("once", True)
    assert cache.answer_to("b", lambda: "of another question", asked_s) == ("of another question", False)
    assert cache.answer("b", lambda: "again") == "of another question"
    with open_writing(store) as session:
        append_own(session, "did", "thing/1")
    assert cache.answer_to("b", lambda: "again", time.monotonic()) == ("again", False)
    reader.close()


def test_nothing_is_kept_of_a_store_that_cannot_say(store, monkeypatch):
    reader = DataVersionReader(store)
    monkeypatch.setattr(reader, "look", lambda: None)
    cache = VersionedCache(reader)
    assert [cache.answer("a", lambda number=number: number) for number in (1, 2)] == [1, 2]
