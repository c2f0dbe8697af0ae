"""A store as it is after years, made within seconds: people, their credentials, a simulated sensor, and a long table of runs.

Everything but the runs is made by the services. The runs are rows of one launch each, added some hundred to a transaction with
one audit record that seals them all, so that the store verifies as any other does.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa
from starlette.responses import Response

from boresight.api.cookies import LogInCookie
from boresight.services import api_keys, audit, sensors, sessions, telemetry_sets, users
from boresight.services.actors import COMMAND_LINE, SYSTEM, Actor
from boresight.services.passwords import prepare_unjudged
from boresight.services.sessions import Client
from boresight.settings import Settings, read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.store.blobs import open_blobs
from boresight.store.sessions import Engine, Session, migrate, open_engine, utc_after, writing
from boresight.store.tables import Run, Sensor, TelemetrySet
from boresight.telemetry.readers import write_parquet
from boresight.telemetry.sensors import sensor_document

PEOPLE = 10
FRAMES = 20
RUNS_A_RECORD = 500
SENSORS_A_RECORD = 250
PASSWORD = "a long enough password"  # noqa: S105 - of people who exist for a measurement
METHODS = ("batch", "sqrf", "ekf", "ukf")
SUMMARY = {
    "status": "converged",
    "level": "normal",
    "advice": None,
    "chi2_consistent": True,
    "weak_directions": 0,
    "rms_initial_arc_rad": 2.4e-5,
    "rms_final_arc_rad": 1.1e-5,
    "chi2_per_dof": 1.003,
    "iterations": 4,
    "frames": 200,
    "stars": 2400,
    "weakest": "the principal point along the columns is known to 0.8 px",
    "tail_rms_rad": None,
    "availability": 0.98,
    "validation_rms_initial_arc_rad": 2.5e-5,
    "validation_rms_final_arc_rad": 1.2e-5,
}


@dataclass(frozen=True)
class Filled:
    """What was made: the rows to launch with, and the credentials, each a header that one client sends."""

    sensor_id: int
    telemetry_set_id: int
    log_ins: list[Mapping[str, str]]
    keys: list[Mapping[str, str]]


def settings_in(folder: Path) -> Settings:
    """Return the default settings, with their data in a folder."""
    return read_settings({"BORESIGHT_DATA_FOLDER": str(folder)})


def fill(folder: Path, runs: int, clients: int, people_in_all: int = PEOPLE) -> Filled:
    """Make a store in a folder, with so many runs, and a log-in and a key for each of so many clients."""
    settings = settings_in(folder)
    engine = open_engine(settings.database_url)
    try:
        migrate(engine)
        people = _people(engine, people_in_all)
        sensor_id, set_id = _sensor(engine, settings, people[0])
        _add_runs(engine, runs, sensor_id, set_id)
        return Filled(sensor_id, set_id, _log_ins(engine, settings, people, clients), _keys(engine, people, clients))
    finally:
        engine.dispose()


def _people(engine: Engine, number_of_people: int) -> list[Actor]:
    """Make analysts, who act as if they had logged in."""
    password = prepare_unjudged(PASSWORD)
    with writing(engine) as session:
        made = [
            users.create_user(
                session,
                COMMAND_LINE,
                name=f"analyst-{number}",
                printed_name=f"Analyst {number}",
                password=password,
                roles=("analyst", "viewer") if number % 2 else ("analyst",),
            )
            for number in range(number_of_people)
        ]
    return [Actor(user.id, user.name, user.printed_name, frozenset(user.roles), "session") for user in made]


def _sensor(engine: Engine, settings: Settings, actor: Actor) -> tuple[int, int]:
    """Register a simulated sensor and upload its telemetry."""
    scenario = replace(calibration_scenario(1), frames=FRAMES)
    catalogue = load_catalogue(settings.catalogue_folder)
    telemetry = simulate(scenario, np.random.default_rng(1), catalogue)
    with tempfile.TemporaryDirectory() as place, writing(engine) as session:
        path = Path(place) / "telemetry.parquet"
        write_parquet(telemetry, path)
        sensor = sensors.register_sensor(session, actor, sensor_document(scenario.sensor))
        blobs = open_blobs(settings.blob_place)
        made = telemetry_sets.add_telemetry_set(
            session, actor, blobs, catalogue, sensor.id, path, path.name, "calibration"
        )
        return sensor.id, made.id


def _add_runs(engine: Engine, runs: int, sensor_id: int, set_id: int) -> None:
    """Add runs that have ended, the newest an hour ago."""
    document = sensor_document(calibration_scenario(1).sensor)
    for first in range(0, runs, RUNS_A_RECORD):
        with writing(engine) as session:
            numbers = range(first, min(first + RUNS_A_RECORD, runs))
            session.add_all(_run(number, runs, sensor_id, set_id, document) for number in numbers)
            audit.append(session, SYSTEM, "imported", "runs", None, {"runs": len(numbers)})


def add_sensors(folder: Path, filled: Filled, sensors_in_all: int, runs_each: int) -> None:
    """Add sensors like the first one until there are so many, each with a telemetry set of its own and runs that have ended.

    A set is a row on the first sensor's file: nothing of it is computed.
    """
    engine = open_engine(settings_in(folder).database_url)
    document = sensor_document(calibration_scenario(1).sensor)
    try:
        for first in range(1, sensors_in_all, SENSORS_A_RECORD):
            with writing(engine) as session:
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
    finally:
        engine.dispose()


def _set_like(like: TelemetrySet, sensor: Sensor) -> TelemetrySet:
    """Return the row of a telemetry set that has another's file."""
    columns = {column.key: getattr(like, column.key) for column in sa.inspect(TelemetrySet).column_attrs}
    return TelemetrySet(**columns | {"id": None, "sensor_id": sensor.id, "name": f"set of {sensor.name}"})


def _run(number: int, runs: int, sensor_id: int, set_id: int, document: dict[str, Any]) -> Run:
    """Make a run that was launched a minute after the one before."""
    ended_s = -3600.0 - 60.0 * (runs - number)
    method = METHODS[number % len(METHODS)]
    failed = number % 20 == 0
    return Run(
        sensor_id=sensor_id,
        telemetry_set_id=set_id,
        method=method,
        settings={"method": method},
        sensor_document=document,
        label=f"pass {number}",
        state="FAILED" if failed else "SUCCEEDED",
        reason="The matrix is singular." if failed else None,
        attempt=1,
        launched_utc=utc_after(ended_s - 5),
        started_utc=utc_after(ended_s - 4),
        ended_utc=utc_after(ended_s),
        summary=None if failed else SUMMARY | {"rms_final_arc_rad": 1.1e-5 * (1.0 + 0.1 * (number % 7))},
    )


def _log_ins(engine: Engine, settings: Settings, people: list[Actor], clients: int) -> list[Mapping[str, str]]:
    """Make a log-in of its own for each client."""
    cookie = LogInCookie(settings)
    made: list[Mapping[str, str]] = []
    with writing(engine) as session:
        for number in range(clients):
            response = Response()
            _, token = sessions.begin(session, people[number % len(people)].user_id or 0, Client("127.0.0.1"))
            cookie.write(response, token)
            made.append({"Cookie": response.headers["set-cookie"].partition(";")[0]})
    return made


def _keys(engine: Engine, people: list[Actor], clients: int) -> list[Mapping[str, str]]:
    """Make a key of its own for each client."""
    with writing(engine) as session:
        return [_key(session, people[number % len(people)], number) for number in range(clients)]


def _key(session: Session, actor: Actor, number: int) -> Mapping[str, str]:
    secret = api_keys.create_key(session, actor, label=f"client {number}", scopes=("runs",))[1]
    return {"Authorization": f"Bearer {secret}"}
