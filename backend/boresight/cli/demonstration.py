"""The demonstration: six simulated star trackers, their telemetry, their first runs, and one person for every role."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from boresight.cameras import CAMERA_MODELS
from boresight.console.access import users
from boresight.console.access.passwords import prepare_unjudged
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.runs import service as runs
from boresight.console.telemetry import queries as set_rows
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import table_definitions
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from boresight.simulation.scenes import Scenario, calibration_scenario, simulate, validation_scenario
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.read.readers import write_parquet
from boresight.telemetry.sensors import sensor_document
from boresight.uplink.table_definition import plain_definition

WATCHED_NUMBER, WATCHED_FRAMES_PER_S = 1, 3.5
OTHER_FRAMES_PER_S = 20.0
FILTER_LABEL = "Square-root filter, fed as frames come down"


@dataclass(frozen=True)
class LogIn:
    """A person of the demonstration, with the password that is printed for the visitor."""

    name: str
    printed_name: str
    password: str
    roles: tuple[str, ...]


LOG_INS = tuple(
    LogIn(role, printed_name, f"{role}-of-the-fleet", (role,))
    for role, printed_name in (
        ("analyst", "Ada Analyst"),
        ("approver", "Alan Approver"),
        ("operator", "Olga Operator"),
        ("administrator", "Adele Administrator"),
        ("viewer", "Victor Viewer"),
    )
)


def create_demonstration(
    engine: Engine, blobs: BlobStore, catalogue: Catalogue, report: Callable[[str], None]
) -> list[LogIn]:
    """Fill a store with the demonstration, or with the missing parts of it."""
    started_s = time.perf_counter()
    fleet = _Fleet(engine, blobs, catalogue, _make_people(engine))
    report(f"{len(LOG_INS)} people can log in.")
    trackers = {number: fleet.sensor_id(number) for number in SENSOR_NUMBERS}
    report(f"{len(trackers)} simulated star trackers are registered.")
    for number, sensor_id in trackers.items():
        fleet.add_sets(sensor_id, number)
        is_new = fleet.launch(sensor_id, "Batch", {"method": "batch"})
        report(f"{st16_sensor(number).name} has its telemetry, and {_of_runs('its batch run', 'is', is_new)}.")
    new_filters = 0
    for number, sensor_id in trackers.items():
        pace = WATCHED_FRAMES_PER_S if number == WATCHED_NUMBER else OTHER_FRAMES_PER_S
        settings = {"method": "sqrf", "variant": "no-q", "replay_frames_per_s": pace}
        new_filters += fleet.launch(sensor_id, FILTER_LABEL, settings)
    of_filters = _of_runs("The filters", "are", new_filters > 0)
    report(f"{of_filters}; the demonstration is ready after {time.perf_counter() - started_s:.1f} s.")
    return list(LOG_INS)


def _of_runs(what: str, verb: str, is_new: bool) -> str:
    """Return a sentence on whether runs were queued or existed already."""
    return f"{what} {verb} queued" if is_new else f"{what} {verb} there already"


def _make_people(engine: Engine) -> Actor:
    """Create the missing people of the demonstration, and return the analyst, who acts from then on."""
    with open_reading(engine) as session:
        missing = [person for person in LOG_INS if _user_id(session, person.name) is None]
    for person in missing:
        password = prepare_unjudged(person.password)  # they are printed on the screen anyway
        with open_writing(engine) as session:
            if _user_id(session, person.name) is None:  # another server may have been faster
                users.create_user(
                    session,
                    COMMAND_LINE,
                    name=person.name,
                    printed_name=person.printed_name,
                    password=password,
                    roles=person.roles,
                )
    analyst = LOG_INS[0]
    with open_reading(engine) as session:
        user_id = _user_id(session, analyst.name)
    return Actor(user_id, analyst.name, analyst.printed_name, frozenset(analyst.roles), COMMAND_LINE.credential)


def _user_id(session: Session, name: str) -> int | None:
    """Return the id of the person with a log-in name."""
    return next((user.id for user in users.list_users(session) if user.name == name), None)


@dataclass(frozen=True)
class _Fleet:
    """Fills the store as the analyst; each missing item is one transaction."""

    engine: Engine
    blobs: BlobStore
    catalogue: Catalogue
    analyst: Actor

    def sensor_id(self, number: int) -> int:
        """Return the id of a simulated sensor, registered if needed."""
        sensor = st16_sensor(number)
        names = CAMERA_MODELS[sensor.camera_model].parameter_names
        truth = dict(zip(names, st16_truth(number).tolist(), strict=True))
        with open_writing(self.engine) as session:
            for row in sensor_queries.list_sensors(session):
                if row.name == sensor.name:
                    return row.id
            document = sensor_document(sensor)
            sensor_id = sensors.register_sensor(session, self.analyst, document, simulated=True, truth=truth).id
            table = plain_definition(sensor.camera_model)
            table_definitions.set_definition(
                session, self.analyst, sensor_id, table, "The simulated flight software's.", 0
            )
            return sensor_id

    def add_sets(self, sensor_id: int, number: int) -> None:
        """Add the calibration and the validation set of a sensor."""
        for purpose, scenario in (
            ("calibration", calibration_scenario(number)),
            ("validation", validation_scenario(number)),
        ):
            with open_writing(self.engine) as session:
                if _oldest_set(session, sensor_id, purpose, archived=True) is None:
                    self._simulate_set(session, sensor_id, purpose, scenario)

    def _simulate_set(self, session: Session, sensor_id: int, purpose: str, scenario: Scenario) -> None:
        """Simulate a telemetry set and upload it as a Parquet file."""
        telemetry = simulate(scenario, np.random.default_rng(scenario.seed), self.catalogue)
        with tempfile.TemporaryDirectory(prefix="boresight-demo-") as folder:
            path = Path(folder) / f"{scenario.sensor.name}-{purpose}.parquet"
            write_parquet(telemetry, path)
            telemetry_sets.add_telemetry_set(
                session, self.analyst, self.blobs, self.catalogue, sensor_id, path, path.name, purpose
            )

    def launch(self, sensor_id: int, label: str, settings: Mapping[str, Any]) -> bool:
        """Queue a run with validation, unless the sensor has one of the same method; return whether it was queued."""
        with open_writing(self.engine) as session:
            calibration = _oldest_set(session, sensor_id, "calibration", archived=False)
            validation = _oldest_set(session, sensor_id, "validation", archived=False)
            had_one = runs.list_runs(session, sensor_id=sensor_id, method=settings["method"], limit=1)
            if calibration is None or had_one:
                return False
            runs.launch(
                session, self.analyst, sensor_id, calibration, settings, validation_set_id=validation, label=label
            )
            return True


def _oldest_set(session: Session, sensor_id: int, purpose: str, *, archived: bool) -> int | None:
    """Return a sensor's oldest set of a purpose, of those in use or of all."""
    return set_rows.find_oldest_set(session, sensor_id, purpose, archived=archived)
