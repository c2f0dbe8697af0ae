"""Several servers on one database: simultaneous starts, locks of one database, and what is said when it does not answer."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from boresight.console.runs import queries as runs
from boresight.errors import UnavailableError
from boresight.platform.audit import chain
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db import engines
from boresight.platform.db.sessions import (
    Engine,
    Session,
    current_revision,
    head_revision,
    open_engine,
    open_reading,
    open_writing,
)
from tests.furniture import rows_of_tables
from tests.postgresql import TEMPLATE, Server, server

SERVERS = 3


@pytest.fixture
def postgresql_server() -> Server:
    return server()


@pytest.fixture
def two(postgresql_server: Server) -> Iterator[list[Engine]]:
    names = ("beside-1", "beside-2")
    opened = [open_engine(postgresql_server.make(name)) for name in names]
    yield opened
    for engine, name in zip(opened, names, strict=True):
        engine.dispose()
        postgresql_server.drop(name)


def _start_at_once(url: str, folder: Path, times: int = SERVERS) -> list[tuple[int, str]]:
    environment = os.environ | {"BORESIGHT_DATABASE_URL": url, "BORESIGHT_DATA_FOLDER": str(folder)}
    command = (sys.executable, "-m", "boresight", "migrate")
    started = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for _ in range(times)
    ]
    return [(process.communicate(timeout=120)[0], process.returncode)[::-1] for process in started]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_servers_that_start_at_once_on_an_empty_database_make_one_schema(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    url = f"sqlite:///{tmp_path}/empty.sqlite3"
    if kind == "postgresql":
        place = request.getfixturevalue("postgresql_server")
        url = place.make("empty", "template0")
    ended = _start_at_once(url, tmp_path)
    assert [code for code, _ in ended] == [0] * SERVERS, ended
    engine = open_engine(url)
    assert current_revision(engine) == head_revision()
    engine.dispose()
    if kind == "postgresql":
        place.drop("empty")


def test_writers_of_two_databases_on_one_server_do_not_wait_for_each_other(two: list[Engine]) -> None:
    with open_writing(two[0]) as first, open_writing(two[1]) as second:
        for session in (first, second):
            chain.append_own(session, "wrote", "here/1")


def test_a_writer_that_waits_too_long_is_told_so(two: list[Engine], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines.be_the_only_writer, "__kwdefaults__", {"wait_s": 1})
    with open_writing(two[0]), pytest.raises(UnavailableError, match="held by another writer"), open_writing(two[0]):
        pytest.fail("there are two writers")


def test_a_sqlite_writer_that_waits_too_long_is_told_the_same(sqlite: Engine) -> None:
    with sqlite.connect() as impatient:
        impatient.connection.driver_connection.execute("PRAGMA busy_timeout=10")
    with open_writing(sqlite), pytest.raises(UnavailableError, match="held by another writer"), open_writing(sqlite):
        pytest.fail("there are two writers")


def test_a_writer_whose_server_died_gives_the_lock_back(two: list[Engine], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "IDLE_S", 1)
    with pytest.raises(UnavailableError, match="does not answer"), open_writing(two[0]) as dead:
        _outlast(two[0], dead)


def _outlast(engine: Engine, dead: Session) -> None:
    with open_writing(engine) as session:
        chain.append_own(session, "wrote", "here/1")
    dead.execute(sa.text("SELECT 1"))


def test_runs_are_claimed_once_by_several_servers(two: list[Engine]) -> None:
    with open_writing(two[0]) as session:
        for row in rows_of_tables():
            session.add(row)
            session.flush()
        values = {"sensor_id": 1, "telemetry_set_id": 1, "method": "batch", "settings": {}, "sensor_document": {}}
        made = {runs.add_run(session, **values).id for _ in range(40)}
        chain.append_own(session, "launched", "runs")
    claimed: list[tuple[int, int]] = []

    def serve(owner: str) -> None:
        while True:
            with open_writing(two[0]) as session:
                taken = runs.claim(session, owner, 60, 3)
            if not taken:
                return
            claimed.extend((run.run_id, run.attempt) for run in taken)

    threads = [threading.Thread(target=serve, args=(f"server {n}",)) for n in range(SERVERS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(claimed) == sorted((run_id, 1) for run_id in made)


def test_after_a_restart_of_postgresql_the_next_request_is_answered(
    two: list[Engine], postgresql_server: Server
) -> None:
    lost = "The database does not answer: check that PostgreSQL runs"
    with pytest.raises(UnavailableError, match=lost), open_writing(two[0]) as session:
        _cut_off(session, postgresql_server)
    try:
        with pytest.raises(UnavailableError, match=lost), open_reading(two[0]) as session:
            session.scalar(sa.select(AuditRecord.id))
    finally:
        postgresql_server.start()
    with open_writing(two[0]) as session:
        chain.append_own(session, "wrote", "here/2")
    with open_reading(two[0]) as session:
        assert session.scalars(sa.select(AuditRecord.object)).all() == ["here/2"]


def _cut_off(session: Session, place: Server) -> None:
    chain.append_own(session, "cut off", "here/1")
    place.stop()


def test_a_command_without_its_database_says_so_in_one_line(tmp_path: Path, postgresql_server: Server) -> None:
    url = postgresql_server.url(TEMPLATE).replace(str(postgresql_server.folder), str(tmp_path))
    ((code, said),) = _start_at_once(url, tmp_path, 1)
    assert (code, said.count("\n")) == (1, 1)
    assert "The database does not answer" in said
