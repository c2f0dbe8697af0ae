"""Stores for measurements: one as it is after years, made within seconds, and a constellation of trackers to calibrate.

All is made by the services but for runs that have ended: these are rows, added some hundred to a transaction with one audit
record that seals them all, so that the store verifies as any other does.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import sqlalchemy as sa
from starlette.responses import Response

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.console.access import api_keys, sessions, users
from boresight.console.access.credentials import LogInCookie
from boresight.console.access.passwords import prepare_unjudged
from boresight.console.access.sessions import ClientAddress
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE, SYSTEM, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, migrate, open_engine, open_writing, utc_after
from boresight.settings import Settings, read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.working_table import WorkingTable
from boresight.telemetry.writing import write_parquet

PEOPLE = 10
PASSWORD = "a long enough password"  # noqa: S105 - of people who exist for a measurement
FRAMES = 20  # of the set that years of runs share
RUNS_A_RECORD, SENSORS_A_RECORD = 500, 250
METHODS = ("batch", "sqrf", "ekf", "ukf")
SUMMARY = {
    "status": "converged", "level": "normal", "advice": None, "chi2_consistent": True, "weak_directions": 0,
    "rms_initial_arc_rad": 2.4e-5, "rms_final_arc_rad": 1.1e-5, "chi2_per_dof": 1.003, "iterations": 4, "frames": 200,
    "stars": 2400, "weakest": "the principal point along the columns is known to 0.8 px", "tail_rms_rad": None,
    "availability": 0.98, "validation_rms_initial_arc_rad": 2.5e-5, "validation_rms_final_arc_rad": 1.2e-5,
}  # fmt: skip
FAINTEST = 4.9  # of a constellation's tables: twelve stars an exposure
OWN = ("timing_s", "sensor")  # of a result: what two runs of the same work do not share
REPEATS = 3


def settings_in(folder: Path) -> Settings:
    """Return the default settings, with their data in a folder."""
    return read_settings({"BORESIGHT_DATA_FOLDER": str(folder)})


@contextmanager
def opened(folder: Path) -> Iterator[Engine]:
    """Open a folder's store."""
    engine = open_engine(settings_in(folder).database_url)
    try:
        yield engine
    finally:
        engine.dispose()


def analysts(engine: Engine, count: int) -> list[Actor]:
    """Make analysts, every other with one role more, who act as if they had logged in."""
    password, made = prepare_unjudged(PASSWORD), []
    with open_writing(engine) as session:
        for number in range(count):
            name, roles = f"analyst-{number}", ("analyst", "viewer") if number % 2 else ("analyst",)
            row = users.create_user(session, COMMAND_LINE, name=name, printed_name=name, password=password, roles=roles)
            made.append(Actor(row.id, row.name, row.printed_name, frozenset(row.roles), "session"))
    return made


def make_key(engine: Engine, actor: Actor, label: str = "measurement") -> dict[str, str]:
    """Make a key that may launch runs; returns the header that sends it."""
    with open_writing(engine) as session:
        return {"Authorization": f"Bearer {api_keys.create_key(session, actor, label=label, scopes=('runs',))[1]}"}


@contextmanager
def uploaded(telemetry: Telemetry, catalogue: Catalogue, number: int) -> Iterator[telemetry_sets.PreparedUpload]:
    """Prepare a table for storing, as an upload of sensor `number` is."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"table-{number}.parquet"
        write_parquet(telemetry, path)
        with telemetry_sets.hold_prepared(sensor_document(st16_sensor(number)), catalogue, path, path.name) as upload:
            yield upload


@dataclass(frozen=True)
class Filled:
    """What was made: the rows to launch with, and the credentials, each a header that one client sends."""

    sensor_id: int
    telemetry_set_id: int
    log_ins: list[Mapping[str, str]]
    keys: list[Mapping[str, str]]

    @property
    def order(self) -> dict[str, Any]:
        """Return the order of a run."""
        return {
            "sensor_id": self.sensor_id, "telemetry_set_id": self.telemetry_set_id, "settings": {"method": "batch"},
        }  # fmt: skip


def fill(folder: Path, runs: int, clients: int, people_in_all: int = PEOPLE) -> Filled:
    """Make a store in a folder, with so many runs, and a log-in and a key for each of so many clients."""
    settings = settings_in(folder)
    with opened(folder) as engine:
        migrate(engine)
        people = analysts(engine, people_in_all)
        catalogue, blobs = load_catalogue(settings.catalogue_folder), open_blobs(settings.blob_location)
        telemetry = simulate(replace(calibration_scenario(1), frames=FRAMES), np.random.default_rng(1), catalogue)
        document = sensor_document(st16_sensor(1))
        with uploaded(telemetry, catalogue, 1) as upload, open_writing(engine) as session:
            sensor_id = sensors.register_sensor(session, people[0], document).id
            set_id = telemetry_sets.store_prepared(session, people[0], blobs, sensor_id, upload).id
        for first in range(0, runs, RUNS_A_RECORD):
            with open_writing(engine) as session:
                numbers = range(first, min(first + RUNS_A_RECORD, runs))
                session.add_all(_run(number, runs, sensor_id, set_id, document) for number in numbers)
                audit.append(session, SYSTEM, "imported", "runs", None, {"runs": len(numbers)})
        each = [people[number % len(people)] for number in range(clients)]
        keys = [make_key(engine, person, f"client {number}") for number, person in enumerate(each)]
        with open_writing(engine) as session:
            log_ins = [_log_in(session, settings, person) for person in each]
    return Filled(sensor_id, set_id, log_ins, list(keys))


def add_sensors(folder: Path, filled: Filled, sensors_in_all: int, runs_each: int) -> None:
    """Add sensors like the first one until there are so many, each with runs that have ended and a set on the first one's file."""
    document = sensor_document(st16_sensor(1))
    with opened(folder) as engine:
        for first in range(1, sensors_in_all, SENSORS_A_RECORD):
            with open_writing(engine) as session:
                person = users.list_users(session)[0]
                actor = Actor(person.id, person.name, person.printed_name, frozenset(person.roles), "session")
                like = session.get_one(TelemetrySet, filled.telemetry_set_id)
                for number in range(first, min(first + SENSORS_A_RECORD, sensors_in_all)):
                    row = sensors.register_sensor(session, actor, document | {"name": f"ST-{number:05d}"})
                    made = _set_like(like, row)
                    session.add(made)
                    session.flush()
                    session.add_all(_run(place, runs_each, row.id, made.id, document) for place in range(runs_each))
                audit.append(session, SYSTEM, "imported", "sensors", None, {"from": first})


def _set_like(like: TelemetrySet, sensor: Sensor) -> TelemetrySet:
    columns = {column.key: getattr(like, column.key) for column in sa.inspect(TelemetrySet).column_attrs}
    return TelemetrySet(**columns | {"id": None, "sensor_id": sensor.id, "name": f"set of {sensor.name}"})


def _run(number: int, runs: int, sensor_id: int, set_id: int, document: dict[str, Any]) -> Run:
    """Make a run that was launched a minute after the one before, the newest an hour ago."""
    ended_s = -3600.0 - 60.0 * (runs - number)
    method, failed = METHODS[number % len(METHODS)], number % 20 == 0
    return Run(
        sensor_id=sensor_id, telemetry_set_id=set_id, method=method, settings={"method": method}, sensor_document=document,
        label=f"pass {number}", state="FAILED" if failed else "SUCCEEDED", reason="The matrix is singular." if failed else None,
        attempt=1, launched_utc=utc_after(ended_s - 5), started_utc=utc_after(ended_s - 4), ended_utc=utc_after(ended_s),
        summary=None if failed else SUMMARY | {"rms_final_arc_rad": 1.1e-5 * (1.0 + 0.1 * (number % 7))},
    )  # fmt: skip


def _log_in(session: Session, settings: Settings, person: Actor) -> Mapping[str, str]:
    """Make a log-in; returns the header that sends it."""
    response = Response()
    LogInCookie(settings).write(response, sessions.begin(session, person.user_id or 0, ClientAddress("127.0.0.1"))[1])
    return {"Cookie": response.headers["set-cookie"].partition(";")[0]}


@dataclass(frozen=True)
class Constellation:
    """A store of trackers, which share a few tables of a real sky over an ST-16, and what each table must come to.

    `expected` has the digest of the result that a run must have, by the address of its table, computed in this process;
    `computing_s` are the seconds of such a run here, alone, the fastest of some repeats; that and `stars` are means over the
    tables.
    """

    database: Engine
    blobs: BlobStore
    sensor_ids: list[int]
    headers: Mapping[str, str]
    settings: Mapping[str, Any]
    expected: Mapping[str, str]
    computing_s: float
    stars: float


def furnish(installed: Settings, trackers: int, frames: int, settings: Mapping[str, Any]) -> Constellation:
    """Fill an empty data folder."""
    database, blobs = open_engine(installed.database_url), open_blobs(installed.blob_location)
    migrate(database)
    analyst = analysts(database, 1)[0]
    tables = min(trackers, len(SENSOR_NUMBERS))
    sensor_ids, addresses, stars = [], {}, 0
    catalogue = load_catalogue(installed.catalogue_folder)
    for number in SENSOR_NUMBERS[:tables]:
        scenario = replace(calibration_scenario(number, frames), magnitude_limit=FAINTEST)
        telemetry = simulate(scenario, np.random.default_rng(number), catalogue)
        stars += len(telemetry)
        document = sensor_document(st16_sensor(number))
        with uploaded(telemetry, catalogue, number) as upload, open_writing(database) as session:
            for tracker in range(number, trackers + 1, tables):
                row = sensors.register_sensor(session, analyst, document | {"name": f"ST-{tracker:05d}"})
                stored = telemetry_sets.store_prepared(session, analyst, blobs, row.id, upload)
                sensor_ids.append(row.id)
                addresses[stored.table_sha256] = number
    expected, times_s = {}, []
    for address, number in addresses.items():
        content, seconds = min(
            (
                wait_for_result(blobs.path(address), number, catalogue, settings, installed.catalogue_folder)
                for _ in range(REPEATS)
            ),
            key=lambda run: run[1],
        )
        expected[address] = compute_digest(content)
        times_s.append(seconds)
    headers, mean_s = make_key(database, analyst), sum(times_s) / len(times_s)
    return Constellation(database, blobs, sorted(sensor_ids), headers, settings, expected, mean_s, stars / tables)


def wait_for_result(
    table: Path, number: int, catalogue: Catalogue, settings: Mapping[str, Any], cache: Path
) -> tuple[bytes, float]:
    """Calibrate sensor `number` by a table as a worker does: the result as JSON, and the seconds until it was computed."""
    began_s, chosen = time.perf_counter(), CalibrationSettings.parse(settings)
    document = calibrate(WorkingTable(table).read(), st16_sensor(number), catalogue, chosen, cache_folder=cache)
    seconds = time.perf_counter() - began_s
    return orjson.dumps(document.to_dict()), seconds


def compute_digest(result: bytes) -> str:
    """Return the digest of what two runs of the same work share of their results."""
    document = {name: value for name, value in orjson.loads(result).items() if name not in OWN}
    document.get("inputs", {}).pop("sha256s", None)  # of the upload, which the same work alone is not given
    return hashlib.sha256(orjson.dumps(document, option=orjson.OPT_SORT_KEYS)).hexdigest()
