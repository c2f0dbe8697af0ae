"""The library over a data folder of its own, and a small simulated set."""

import csv
import io
import threading

import pytest

import boresight as bs
from tests.served import house

__all__ = ["house"]

FRAMES = 30


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(autouse=True)
def _environment(data_folder, monkeypatch):
    monkeypatch.setenv("BORESIGHT_DATA_FOLDER", str(data_folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # the compiled loops stay where they are


@pytest.fixture(scope="session")
def simulated(data_folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_DATA_FOLDER", str(data_folder))
        return bs.simulate("st16-1", frames=FRAMES, progress=False)


@pytest.fixture(scope="session")
def cal(simulated, data_folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BORESIGHT_DATA_FOLDER", str(data_folder))
        return bs.calibrate(simulated.telemetry, sensor=simulated.sensor, validate=simulated.validation, progress=False)


SCOPES = ("sensors", "telemetry-sets", "runs", "parameter-sets", "uplinks")


def key_of(house, person):
    answer = house.person(person).post("/api/v1/api-keys", json={"label": "library", "scopes": list(SCOPES)})
    assert answer.status_code == 201, answer.text
    return answer.json()["secret"]


@pytest.fixture(scope="module")
def key(house):
    return key_of(house, "ada")


@pytest.fixture
def computing(house):
    """End every run that is queued, as workers would, until the test is over."""
    over = threading.Event()

    def compute():
        while not over.wait(0.05):
            house.end_queued()

    thread = threading.Thread(target=compute)
    thread.start()
    yield
    over.set()
    thread.join()


@pytest.fixture
def exchanged(house, tmp_path):
    """A file of the house's telemetry without names and attitudes, its rows and columns exchanged."""
    rows = csv.DictReader(io.StringIO(house.telemetry_csv.decode()))
    kept = [name for name in rows.fieldnames if name != "star_id" and not name.startswith("q_")]
    path = tmp_path / "exchanged.csv"
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, kept, extrasaction="ignore")
        table.writeheader()
        table.writerows(row | {"row_px": row["col_px"], "col_px": row["row_px"]} for row in rows)
    return path
