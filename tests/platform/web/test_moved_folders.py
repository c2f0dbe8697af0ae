"""A data folder or a folder of files that is moved away under a running server is one sentence, and used again when it is back."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from boresight.errors import StorageError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import open_engine, open_reading, open_writing
from boresight.platform.web import metrics as cached_check
from boresight.sky.catalogue import Catalogue
from tests.served import House, house_in

pytestmark = pytest.mark.sqlite("its file is moved")


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


def test_connections_that_are_open_on_a_moved_database_are_refused_too(tmp_path: Path) -> None:
    place = tmp_path / "data" / "boresight.sqlite3"
    engine = open_engine(f"sqlite:///{place}")
    marks = DataVersionReader(engine)
    assert marks.look() is not None
    place.parent.rename(tmp_path / "away")
    for opened in (open_reading, open_writing):
        with pytest.raises(StorageError, match="is not there any more"), opened(engine) as session:
            session.connection()
    assert marks.look() is None
    place.parent.mkdir()
    place.touch()
    with pytest.raises(StorageError, match="not what this process opened"), open_reading(engine) as session:
        session.connection()
    engine.dispose()


def test_a_stored_file_is_not_called_missing_where_its_folder_is(tmp_path: Path) -> None:
    blobs = FolderBlobStore(tmp_path / "blobs")
    sha256 = blobs.put(b"stars")
    blobs.folder.rename(tmp_path / "away")
    for act in (lambda: blobs.read(sha256), lambda: blobs.put(b"more"), blobs.refuse_unusable):
        with pytest.raises(StorageError, match="is not there any more"):
            act()
    (tmp_path / "away").rename(blobs.folder)
    assert blobs.read(sha256) == b"stars"
