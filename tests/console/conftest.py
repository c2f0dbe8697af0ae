"""A store with people in it: a real database, copied for each test from one that was filled once."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import orjson
import pytest

from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Engine, Session, open_engine, open_reading, open_writing, utc_now
from tests.passwords import add_person, approve
from tests.served import house
from tests.sites import furnished, read, results, site
from tests.stores import copied, open_migrated, url_in

__all__ = ["furnished", "house", "read", "results", "site"]
PASSWORD = "correct horse battery"
PEOPLE: Mapping[str, tuple[str, ...]] = {
    "ana": ("analyst",),
    "bo": ("analyst", "approver"),
    "cy": ("approver",),
    "dee": ("operator",),
    "eve": ("viewer",),
    "root": ("administrator",),
}
SENSOR: dict[str, Any] = {
    "name": "ST16-1",
    "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
    "camera_model": "inverted_wang",
    "parity": 1,
    "centroid_sigma_px": 0.1,
    "initial": {
        "f_m": 0.016,
        "m0_px": 971.5,
        "n0_px": 1295.5,
        "b4_per_m4": 0.0,
        "b2_per_m2": 0.0,
        "a1_rad": 0.0,
        "a2_rad": 0.0,
        "g_y": 1.0,
    },
    "typical_sigma": {
        "f_m": 5e-5,
        "m0_px": 50.0,
        "n0_px": 50.0,
        "b4_per_m4": 1e6,
        "b2_per_m2": 50.0,
        "a1_rad": 0.01,
        "a2_rad": 0.01,
        "g_y": 0.001,
    },
}


@pytest.fixture(scope="session")
def filled(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("filled")
    engine = open_migrated(url_in(folder))
    with open_writing(engine) as session:
        for name, roles in PEOPLE.items():
            add_person(session, name, *roles)
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
    engine.dispose()  # the last connection folds the write-ahead log into the file
    return folder


@pytest.fixture
def engine(filled, tmp_path) -> Iterator[Engine]:
    engine = open_engine(copied(filled, tmp_path))
    yield engine
    engine.dispose()


@pytest.fixture
def session(engine) -> Iterator[Session]:
    with open_writing(engine) as session:
        yield session


@pytest.fixture
def blobs(tmp_path) -> BlobStore:
    return FolderBlobStore(tmp_path / "blobs")


@pytest.fixture
def people(engine) -> Mapping[str, Actor]:
    with open_reading(engine) as session:
        rows = {row.name: row for row in users.list_users(session)}
        return {name: users.get_actor(session, row.id) for name, row in rows.items()}


@pytest.fixture
def finished_run(blobs) -> Callable[..., Run]:
    def make(session: Session, launched_by: int | None = None, state: str = "SUCCEEDED", **result: Any) -> Run:
        sensor = session.get_one(Sensor, 1)
        document = _result() | result
        run = Run(
            sensor_id=sensor.id,
            telemetry_set_id=_telemetry(session, blobs).id,
            method="batch",
            settings={},
            sensor_document=sensor.document,
            state=state,
            launched_utc=utc_now(),
            launched_by=launched_by,
            result_sha256=_stored(session, blobs, orjson.dumps(document)),
            summary={"status": document["status"]},
        )
        session.add(run)
        session.flush()
        audit.append(session, COMMAND_LINE, "brought in", f"runs/{run.id}")
        return run

    return make


@pytest.fixture
def candidate(engine, blobs, people, finished_run) -> Callable[..., ParameterSet]:
    made = []

    def make(launched_by: str = "ana") -> ParameterSet:
        with open_writing(engine) as session:
            made.append(launched_by)
            parameters = SENSOR["initial"] | {"f_m": 0.016 + 1e-6 * len(made)}
            run = finished_run(session, people[launched_by].user_id, parameters=parameters)
            return parameter_sets.create_from_run(session, people["ana"], blobs, run.id)

    return make


@pytest.fixture
def submitted(engine, people, candidate, blobs) -> Callable[[], ParameterSet]:
    def make() -> ParameterSet:
        row = candidate()
        with open_writing(engine) as session:
            approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
            return session.get_known(ParameterSet, row.id)

    return make


@pytest.fixture
def approved(engine, people, submitted) -> Callable[[], ParameterSet]:
    def make() -> ParameterSet:
        row = submitted()
        with open_writing(engine) as session:
            approval = lists.list_newest(session, Approval, set=row.id)[0]
            approve(session, people["cy"], approval)
            return session.get_known(ParameterSet, row.id)

    return make


def _telemetry(session: Session, blobs: BlobStore) -> TelemetrySet:
    if (row := session.get(TelemetrySet, 1)) is not None:
        return row
    sha256 = _stored(session, blobs, b"telemetry")
    row = TelemetrySet(
        sensor_id=1,
        name="stars.csv",
        purpose="calibration",
        original_sha256=sha256,
        table_sha256=sha256,
        frames=10,
        stars=100,
        quality={},
        uploaded_utc=utc_now(),
    )
    session.add(row)
    session.flush()
    return row


def _stored(session: Session, blobs: BlobStore, content: bytes) -> str:
    return register_blob(session, blobs, blobs.put(content), "application/json").sha256


def _result() -> dict[str, Any]:
    names = list(SENSOR["initial"])
    sigma = dict.fromkeys(names, 1e-6)
    matrix = [[1e-12 if row == column else 0.0 for column in range(8)] for row in range(8)]
    return {
        "schema": "boresight.calibration/1",
        "sensor": "ST16-1",
        "camera_model": "inverted_wang",
        "method": "batch",
        "variant": "no-q",
        "free": names,
        "parameters": SENSOR["initial"],
        "sigma": sigma,
        "covariance": {"names": names, "matrix": matrix},
        "status": "converged",
        "advice": [],
        "frames": 10,
        "stars": 100,
        "rms_arc_rad": {"initial": 1e-4, "final": 1e-5},
        "chi2_per_dof": 1.0,
        "inputs": {"telemetry_sha256": "a" * 64},
    }
