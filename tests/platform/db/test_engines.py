"""PostgreSQL beside SQLite, and several servers on one database: simultaneous starts, locks, a database that is gone."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.approvals import service as approvals
from boresight.console.fleet import service as sensors
from boresight.console.fleet import timeline
from boresight.console.fleet.status import list_fleet_tiles
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as runs
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.read_backs import get_sent_table, read_back
from boresight.errors import StaleError, UnavailableError
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import chain
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db import engines
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import (
    Engine,
    Session,
    current_revision,
    head_revision,
    open_engine,
    open_reading,
    open_writing,
)
from boresight.uplink.table_definition import plain_definition
from tests.effort import effort, few_of
from tests.furniture import rows_of_tables
from tests.passwords import add_person, approve, proved
from tests.postgresql import TEMPLATE, Server, server
from tests.refusals import has_code

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


@pytest.mark.full
@pytest.mark.parametrize("kind", few_of(["sqlite", "postgresql"], 1))
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


def test_a_new_file_that_several_open_at_once_refuses_none_of_them(tmp_path: Path) -> None:
    def open_it(url: str, start: threading.Barrier) -> None:
        start.wait()
        engine = open_engine(url)
        with engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA user_version")
        engine.dispose()

    with ThreadPoolExecutor(8) as pool:
        for number in range(effort(30, 300)):
            start = threading.Barrier(8)
            opened = [pool.submit(open_it, f"sqlite:///{tmp_path}/{number}.sqlite3", start) for _ in range(8)]
            assert [one.exception() for one in opened] == [None] * 8


@pytest.mark.full
def test_writers_of_two_databases_on_one_server_do_not_wait_for_each_other(two: list[Engine]) -> None:
    with open_writing(two[0]) as first, open_writing(two[1]) as second:
        for session in (first, second):
            chain.append_own(session, "wrote", "here/1")


def test_a_writer_that_waits_too_long_is_told_so(two: list[Engine], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines.be_the_only_writer, "__kwdefaults__", {"wait_s": 1})
    with (
        open_writing(two[0]),
        pytest.raises(UnavailableError, check=has_code("database-busy")),
        open_writing(two[0]),
    ):
        pytest.fail("there are two writers")


def test_a_sqlite_writer_that_waits_too_long_is_told_the_same(sqlite: Engine) -> None:
    sqlite.dispose()  # its connections wait for ten seconds
    sa.event.listen(sqlite, "connect", lambda opened, _: opened.execute("PRAGMA busy_timeout=10"))
    with (
        open_writing(sqlite),
        pytest.raises(UnavailableError, check=has_code("database-busy")),
        open_writing(sqlite),
    ):
        pytest.fail("there are two writers")


def test_a_writer_whose_server_died_gives_the_lock_back(two: list[Engine], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "IDLE_S", 1)
    with pytest.raises(UnavailableError, check=has_code("database-unreachable")), open_writing(two[0]) as dead:
        _outlast(two[0], dead)


def _outlast(engine: Engine, dead: Session) -> None:
    with open_writing(engine) as session:
        chain.append_own(session, "wrote", "here/1")
    dead.execute(sa.text("SELECT 1"))


@pytest.mark.full
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


@pytest.mark.full
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
    assert engines.GONE in said


PASSWORD = "correct horse battery"
PEOPLE: Mapping[str, tuple[str, ...]] = {"ana": ("analyst",), "cy": ("approver",), "dee": ("operator",)}
NAMES = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
INITIAL = dict(zip(NAMES, (0.016, 971.5, 1295.5, 0.0, 0.0, 0.0, 0.0, 1.0), strict=True))
SPREAD = dict(zip(NAMES, (5e-5, 50.0, 50.0, 1e6, 50.0, 0.01, 0.01, 0.001), strict=True))
SENSOR: dict[str, Any] = {
    "name": "ST16-1",
    "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
    "camera_model": "inverted_wang",
    "parity": 1,
    "centroid_sigma_px": 0.1,
    "initial": INITIAL,
    "typical_sigma": SPREAD,
}
CSV = "frame,exposure,row_px,col_px,ra_deg,dec_deg\n" + "".join(f"1,0,{n}.5,{n * n}.0,{n}.0,1.0\n" for n in range(5))


@pytest.fixture
def people(postgresql: Engine) -> Mapping[str, Actor]:
    with open_writing(postgresql) as session:
        rows = {name: add_person(session, name, *roles) for name, roles in PEOPLE.items()}
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
        return {name: users.get_actor(session, row.id) for name, row in rows.items()}


def _candidate(engine: Engine, ana: Actor, blobs: BlobStore, folder: Path, f_m: float) -> ParameterSet:
    (folder / "a.csv").write_text(CSV, encoding="utf-8")
    names = list(NAMES)
    result = {
        "schema": "boresight.calibration/1",
        "sensor": SENSOR["name"],
        "method": "batch",
        "camera_model": "inverted_wang",
        "rms_arc_rad": {"initial": 1e-4, "final": 1e-5},
        "parameters": INITIAL | {"f_m": f_m},
        "sigma": SPREAD,
        "covariance": {"names": names, "matrix": np.diag([SPREAD[name] ** 2 for name in names]).tolist()},
        "status": "converged",
    }
    with open_writing(engine) as session:
        telemetry = telemetry_sets.add_telemetry_set(session, ana, blobs, None, 1, folder / "a.csv", "a.csv")
        sha256 = blobs.put(canonical(result).encode())
        telemetry_sets.register_blob(session, blobs, sha256, "application/json")
        run = Run(
            sensor_id=1,
            telemetry_set_id=telemetry.id,
            method="batch",
            settings={},
            sensor_document=SENSOR,
            state="SUCCEEDED",
            launched_utc=telemetry.uploaded_utc,
            launched_by=ana.user_id,
            result_sha256=sha256,
        )
        session.add(run)
        session.flush()
        return parameter_sets.create_from_run(session, ana, blobs, run.id)


def _approve(engine: Engine, people: Mapping[str, Actor], row: ParameterSet, blobs: BlobStore) -> int:
    with open_writing(engine) as session:
        approval = approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
        approve(session, people["cy"], approval)
        return session.get_known(ParameterSet, row.id).version


@pytest.mark.full
def test_promotions_at_once_leave_one_baseline_and_one_chain(
    postgresql: Engine, people: Mapping[str, Actor], tmp_path: Path
) -> None:
    blobs = FolderBlobStore(tmp_path / "blobs")
    rows = [_candidate(postgresql, people["ana"], blobs, tmp_path, 0.016 + n * 1e-6) for n in range(3)]
    versions = [_approve(postgresql, people, row, blobs) for row in rows]

    def promote(number: int) -> str:
        try:
            with open_writing(postgresql) as session:
                return approvals.promote(session, people["dee"], rows[number].id, versions[number]).name
        except StaleError:
            return "stale"

    with ThreadPoolExecutor(3) as pool:
        outcomes = sorted(pool.map(promote, range(3)))
    assert outcomes[1:] == ["stale", "stale"]
    with open_reading(postgresql) as session:
        listed = lists.list_newest(session, ParameterSet)
        assert [row.name for row in listed if row.ground_state == "BASELINE"] == outcomes[:1]
        assert audit.verify(session).ok


def test_the_ladder_and_the_question_of_when_work(
    postgresql: Engine, people: Mapping[str, Actor], tmp_path: Path
) -> None:
    dee, blobs, plain = people["dee"], FolderBlobStore(tmp_path / "blobs"), plain_definition("inverted_wang")
    with open_writing(postgresql) as session:
        table_definitions.set_definition(session, people["ana"], 1, plain, "As flown.", 0)
        for state in ("SENT", "LOADED"):
            uplinks.record(session, dee, 1, state, "pass 4711")
        seen = session.get_one(ParameterSet, 1)
        sent = get_sent_table(session, blobs, seen).content
        blobs.put(sent)
        read_back(session, dee, blobs, 1, sent, "pass 4711", seen.version)
        uplinks.activate(session, dee, 1, "pass 4711", "I saw it.", proved(session, dee, PASSWORD), seen.version)
    with open_reading(postgresql) as session:
        assert uplinks.find_baseline_at(session, 1, "2000-01-01") is None
        assert [row.name for row, _ in uplinks.list_onboard_at(session, 1, "2100-01-01")] == ["PS-ST16-1-0"]
        assert (
            timeline.get_state_at(session, 1).sentence == "baseline PS-ST16-1-0, on board PS-ST16-1-0 ACTIVE: the same"
        )
        listed = timeline.list_events(session, 1)
        assert [event.state for event in listed] == ["ACTIVE", "VERIFIED", "LOADED", "SENT", None, "BASELINE"]
        assert timeline.list_events(session, 1, before_id=listed[1].id, limit=2) == listed[2:4]
        tile = list_fleet_tiles(session)[0]
    assert (tile.status, tile.active is not None) == ("off", True)
