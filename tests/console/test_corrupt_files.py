"""A stored file with a flipped bit is refused in one sentence by every address that reads it, and nothing is made of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from tests.served import House
from tests.sites import codes

CORRUPT = "urn:boresight:problem:corrupt-file"


@contextmanager
def _flipped(path: Path, bit: int = 100) -> Iterator[None]:
    content = path.read_bytes()
    path.write_bytes(content[: bit // 8] + bytes([content[bit // 8] ^ 1 << bit % 8]) + content[bit // 8 + 1 :])
    yield
    path.write_bytes(content)


def _stored(house: House, sha256: str | None) -> Path:
    return house.app.state.blobs.path(str(sha256))


@pytest.fixture(scope="module")
def run(house) -> Run:
    house.result["label"] = "of this module"
    run_id = house.finished()
    with house.app.state.engine.connect() as connection:
        return Run(**connection.execute(Run.__table__.select().where(Run.id == run_id)).mappings().one())


@pytest.mark.parametrize(
    "address",
    [
        "/api/v1/runs/{}/result",
        "/api/v1/runs/{}/report",
        "/api/v1/runs/{}/figures/radial",
        "/api/v1/runs/{}/figures/radial/data",
    ],
)
def test_a_corrupt_result_is_refused_and_comes_back_with_its_bytes(house, run, address):
    client = house.person("ada")
    with _flipped(_stored(house, run.result_sha256)):
        refused = client.get(address.format(run.id))
    assert (refused.status_code, refused.json()["type"]) == (409, CORRUPT)
    assert client.get(address.format(run.id)).status_code == 200


@pytest.mark.parametrize("tab", ["", "?tab=frames", "?tab=files"])
def test_a_page_about_a_corrupt_result_is_a_sentence(house, run, tab):
    with _flipped(_stored(house, run.result_sha256)):
        page = house.person("ada").get(f"/runs/{run.id}{tab}", headers={"Accept": "text/html"})
    assert page.status_code == 409
    assert codes(page.text) == ["altered-file"]


def test_a_parameter_set_is_never_made_of_a_corrupt_result(house, run):
    with _flipped(_stored(house, run.result_sha256)):
        refused = house.person("ada").post("/api/v1/parameter-sets", json={"run_id": run.id})
    assert (refused.status_code, refused.json()["type"]) == (409, CORRUPT)


def test_corrupt_telemetry_is_not_given_out(house, run):
    with house.app.state.engine.connect() as connection:
        found = connection.execute(TelemetrySet.__table__.select().where(TelemetrySet.id == run.telemetry_set_id)).one()
    with _flipped(_stored(house, found.original_sha256)):
        refused = house.person("ada").get(f"/api/v1/telemetry-sets/{found.id}/file")
    assert (refused.status_code, refused.json()["type"]) == (409, CORRUPT)


def test_a_corrupt_package_is_refused_and_built_again_when_it_is_exported(house):
    client, row = house.person("olga"), house.approved()
    made = client.post(f"/api/v1/parameter-sets/{row['id']}:export", json={}).json()
    place = _stored(house, made["sha256"])
    place.write_bytes(place.read_bytes()[:-1] + b"?")
    assert client.get(f"/api/v1/packages/{made['id']}/content").json()["type"] == CORRUPT
    assert client.post(f"/api/v1/parameter-sets/{row['id']}:export", json={}).json()["sha256"] == made["sha256"]
    assert client.get(f"/api/v1/packages/{made['id']}/content").status_code == 200
