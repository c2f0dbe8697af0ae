"""A folder that is moved, a disk that is full, a database that is gone: one sentence each, and used again when it is back."""

import errno
import gc
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psycopg
import pytest
import sqlalchemy as sa
from click.testing import CliRunner

from benchmarks.servers import wait_until
from boresight.cli import main
from boresight.disks import LEAST_FREE_BYTES, refuse_unwritable, storage_error
from boresight.errors import StorageError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.engines import GONE
from boresight.platform.db.sessions import Engine, open_engine, open_reading, open_writing
from boresight.platform.web import metrics as cached_check
from boresight.platform.web.problems import make_problem
from boresight.sky.catalogue import Catalogue
from tests.postgresql import server
from tests.refusals import has_code
from tests.served import PASSWORD, House, add_people, house_in, serving, settings_in

MOVED = pytest.mark.sqlite("its file is moved")


@pytest.fixture
def own(tmp_path: Path, catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> Iterator[House]:
    monkeypatch.setattr(cached_check, "LOOK_AGAIN_S", -1.0)
    with house_in(tmp_path, catalogue) as made:
        yield made


def _checks(house: House) -> tuple[int, dict[str, bool]]:
    answer = house.anybody().get("/readyz")
    return answer.status_code, {name: check["ready"] for name, check in answer.json()["checks"].items()}


def _answers(house: House, client: Any, sensor_id: int) -> dict[str, tuple[int, str | None]]:
    asked = {
        "list": client.get("/api/v1/sensors"),
        "register": client.post("/api/v1/sensors", json=house.sensor_file()),
        "upload": house.upload(client, sensor_id),
        "page": client.get("/sensors", headers={"Accept": "text/html"}),
    }
    return {name: (answer.status_code, answer.headers.get("retry-after")) for name, answer in asked.items()}


@MOVED
@pytest.mark.parametrize("instead", [False, True], ids=["absent", "another folder in its place"])
def test_a_data_folder_that_is_moved_away_is_refused_never_made_anew_and_used_again_when_it_is_back(
    own: House, tmp_path: Path, instead: bool
) -> None:
    client, data, away = own.person("ada"), tmp_path / "data", tmp_path / "data-away"
    sensor_id = own.new_sensor()["id"]
    assert own.upload(client, sensor_id).status_code == 201
    before = client.get("/api/v1/sensors").json()
    data.rename(away)
    if instead:
        data.mkdir()
    for _ in range(2):
        status, ready = _checks(own)
        assert (status, ready["store"], ready["files"]) == (503, False, False)
        assert set(_answers(own, client, sensor_id).values()) == {(503, "30")}
    assert not (data / "boresight.sqlite3").exists()
    assert not (data / "blobs").exists()
    if instead:
        for left in data.rglob("*"):
            left.is_dir() or left.unlink()
        for left in sorted(data.rglob("*"), reverse=True):
            left.rmdir()
        data.rmdir()
    assert not data.exists()
    away.rename(data)
    assert _checks(own)[0] == 200
    assert client.get("/api/v1/sensors").json() == before
    assert client.post("/api/v1/sensors", json=own.sensor_file()).status_code == 201


@MOVED
@pytest.mark.parametrize("instead", [False, True], ids=["absent", "an empty one in its place"])
def test_a_folder_of_files_that_is_moved_away_is_noticed_and_used_again_when_it_is_back(
    own: House, tmp_path: Path, instead: bool
) -> None:
    client, blobs, away = own.person("ada"), tmp_path / "data" / "blobs", tmp_path / "blobs-away"
    sensor_id = own.new_sensor()["id"]
    known = own.upload(client, sensor_id).json()["id"]
    blobs.rename(away)
    if instead:
        blobs.mkdir()
    for _ in range(2):
        status, ready = _checks(own)
        assert (status, ready["store"], ready["files"]) == (503, True, False)
        refused = own.upload(client, own.new_sensor()["id"])
        assert (refused.status_code, refused.headers.get("retry-after")) == (503, "30")
    assert blobs.exists() == instead
    assert client.get(f"/api/v1/telemetry-sets/{known}/file").status_code == 503
    if instead:
        assert list(blobs.iterdir()) == []
        blobs.rmdir()
    away.rename(blobs)
    assert _checks(own)[0] == 200
    assert own.upload(client, own.new_sensor()["id"]).status_code == 201


@MOVED
def test_connections_that_are_open_on_a_moved_database_are_refused_too(tmp_path: Path) -> None:
    place = tmp_path / "data" / "boresight.sqlite3"
    engine = open_engine(f"sqlite:///{place}")
    reader = DataVersionReader(engine)
    assert reader.look() is not None
    place.parent.rename(tmp_path / "away")
    for opened in (open_reading, open_writing):
        with pytest.raises(StorageError, check=has_code("folder-gone")), opened(engine) as session:
            session.connection()
    assert reader.look() is None
    place.parent.mkdir()
    place.touch()
    with pytest.raises(StorageError, check=has_code("folder-replaced")), open_reading(engine) as session:
        session.connection()
    engine.dispose()


def test_a_stored_file_is_not_called_missing_where_its_folder_is(tmp_path: Path) -> None:
    blobs = FolderBlobStore(tmp_path / "blobs")
    sha256 = blobs.put(b"stars")
    blobs.folder.rename(tmp_path / "away")
    for act in (lambda: blobs.read(sha256), lambda: blobs.put(b"more"), blobs.refuse_unusable):
        with pytest.raises(StorageError, check=has_code("folder-gone")):
            act()
    (tmp_path / "away").rename(blobs.folder)
    assert blobs.read(sha256) == b"stars"


ROOT = Path(__file__).resolve().parents[3]
MOUNT = "mount -t tmpfs -o size=32m none {disk} && exec {python} -m tests.platform.web.full_disk {disk}"


@pytest.mark.full
@pytest.mark.sqlite("its file is on the disk that is filled")
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("unshare") is None, reason="only root mounts a small disk")
def test_a_server_on_a_full_disk_says_so_stores_nothing_by_halves_and_goes_on_when_there_is_room(
    tmp_path: Path,
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    script = MOUNT.format(disk=disk, python=sys.executable)
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    told = json.loads(done.stdout.splitlines()[-1])
    for name in ("upload", "sensor", "log in"):
        status, retry_after, text = told["full"][name]
        assert (status, retry_after) == (503, "30"), (name, text)
        assert "make room" in json.loads(text)["detail"], (name, text)
    assert told["full"]["ready"][0] == 503
    assert told["read"] == 200
    assert told["left behind"] == []
    assert told["command"][0] == 1
    assert told["command"][1].startswith("boresight: The disk of the database is full")
    assert told["command"][1].count("\n") == 1
    assert told["again"] == 201
    assert told["read only"][0] == 1
    assert told["read only"][1].count("\n") == 1
    assert "cannot be written" in told["read only"][1]


def test_a_limit_on_the_size_of_files_is_a_full_disk_and_leaves_no_scraps(tmp_path: Path) -> None:
    blobs, child = FolderBlobStore(tmp_path / "blobs"), os.fork()
    if child == 0:  # the limit is for good
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
        try:
            blobs.put(bytes(50_000))
        except StorageError:
            os._exit(7)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert [path for path in blobs.folder.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("number", "said"), [(errno.ENOSPC, "is full"), (errno.EDQUOT, "is full"), (errno.EROFS, "cannot be written")]
)
def test_a_system_error_of_a_disk_is_503_with_a_time_to_come_back_and_any_other_is_a_defect(
    number: int, said: str
) -> None:
    problem = make_problem(OSError(number, os.strerror(number), "/data/x"))
    assert (problem.status, problem.headers) == (503, {"Retry-After": "30"})
    assert f"/data/x {said}" in problem.detail
    assert make_problem(OSError(errno.EIO, "io")).status == 500
    assert storage_error(FileNotFoundError(errno.ENOENT, "absent", "x")) is None


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="absent"):
        refuse_unwritable(tmp_path / "absent" / "file")
    refuse_unwritable(tmp_path / "file")
    assert LEAST_FREE_BYTES > 1 << 20


def test_a_command_whose_data_folder_cannot_be_made_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    environment = {"BORESIGHT_DATA_FOLDER": str(tmp_path / "file" / "data"), "BORESIGHT_DATABASE_URL": ""}
    done = CliRunner(env=environment).invoke(main, ["audit", "verify"])
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert str(tmp_path / "file" / "data") in done.stderr


PATIENCE_S = 30


@pytest.mark.full
def test_requests_are_refused_while_postgresql_is_gone_and_answered_when_it_is_back(
    postgresql: Engine, tmp_path: Path
) -> None:
    url = postgresql.url.render_as_string(hide_password=False)
    settings = settings_in(tmp_path / "data", database_url=url)
    add_people(settings)
    with serving(settings) as (address, _), httpx.Client(base_url=address, timeout=30) as client:
        assert client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).status_code == 201
        with postgresql.connect() as connection:
            connection.execute(sa.text("CHECKPOINT"))  # the tests' server writes no commit to disk by itself
        server().stop()
        try:
            gone = client.get("/api/v1/sensors")
            unready = client.get("/readyz")
        finally:
            server().start()
        assert (gone.status_code, gone.json()["title"]) == (503, "Unavailable")
        assert GONE in gone.json()["detail"]
        assert unready.status_code == 503
        wait_until(lambda: client.get("/api/v1/sensors").status_code == 200, PATIENCE_S)
    for cursor in [one for one in gc.get_objects() if isinstance(one, psycopg.ServerCursor)]:
        cursor._close()  # its connection is gone, and the driver would warn of it in whichever test comes then
