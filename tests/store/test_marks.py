"""A mark moves with every commit of anybody, and with nothing else."""

from __future__ import annotations

from boresight.store.chain import append_own
from boresight.store.marks import Marks
from boresight.store.sessions import migrate, open_engine, reading, writing


def test_a_mark_moves_with_every_commit_and_with_nothing_else(tmp_path):
    address = f"sqlite:///{tmp_path}/store.sqlite3"
    engine, another = open_engine(address), open_engine(address)
    migrate(engine)
    marks = Marks(engine)
    seen = [marks.look()]
    assert marks.at_once
    for database in (engine, another, engine):
        with reading(database) as session:
            session.connection()
        assert marks.look() == seen[-1]
        with writing(database) as session:
            append_own(session, "did", "thing/1")
            session.flush()
            assert marks.look() == seen[-1], "what is not committed is not to be seen"
        seen.append(marks.look())
    assert len(set(seen)) == len(seen)
    marks.close()
    engine.dispose()
    another.dispose()


def test_marks_of_another_connection_are_others(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path}/store.sqlite3")
    migrate(engine)
    marks = Marks(engine)
    first = marks.look()
    marks.close()
    assert marks.look() != first
    marks.close()
    engine.dispose()


def test_a_store_that_cannot_say_gives_no_mark(tmp_path):
    engine = open_engine(f"sqlite:///{tmp_path}/store.sqlite3")
    marks = Marks(engine)
    (tmp_path / "store.sqlite3").write_bytes(b"this is no database, however long it may be " * 50)
    assert marks.look() is None
    engine.dispose()
