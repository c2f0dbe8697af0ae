"""An installation with people, a sensor and as many calibrations as a test wants, made through the services.

The telemetry is simulated and the calibration a real one; what a test makes further candidates of is that calibration
with the focal length moved a little, stored as the result of a run of its own.
"""

from __future__ import annotations

import itertools
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import orjson
from argon2 import PasswordHasher

from boresight.console.access import api_keys, users
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Engine, Session, migrate, open_engine, open_reading, open_writing, utc_now
from boresight.settings import Settings
from tests.passwords import add_person

PASSWORD = "correct horse battery"
CHEAP_HASH = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1).hash(PASSWORD)  # hundreds sign with it
TRUST = ssl.create_default_context()  # once: to make it costs more than a request
WORDS = {"meaning": "I reviewed the evidence.", "comment": "Seen.", "password": PASSWORD}


@dataclass
class ExampleRun:
    sensor: dict[str, Any]
    telemetry: Path
    result: dict[str, Any]


@dataclass
class Installation:
    settings: Settings
    example_run: ExampleRun
    people: Mapping[str, tuple[str, ...]]
    address: str = ""
    engine: Engine = field(init=False)
    blobs: BlobStore = field(init=False)
    _numbers: itertools.count[int] = field(default_factory=lambda: itertools.count(1))
    _credentials: dict[str, tuple[dict[str, str], dict[str, str]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.engine = open_engine(self.settings.database_url)
        self.blobs = open_blobs(self.settings.blob_location)
        migrate(self.engine)
        with open_writing(self.engine) as session:
            for name, roles in self.people.items():
                row = add_person(session, name, *roles)
                row.password_hash = CHEAP_HASH

    def actor(self, name: str) -> Actor:
        with open_reading(self.engine) as session:
            row = next(row for row in users.list_users(session) if row.name == name)
            return users.get_actor(session, row.id)

    def sensor(self) -> int:
        document = {**self.example_run.sensor, "name": f"ST-{next(self._numbers)}"}
        with open_writing(self.engine) as session:
            row = sensors.register_sensor(session, COMMAND_LINE, document)
            path, name = self.example_run.telemetry, self.example_run.telemetry.name
            telemetry_sets.add_telemetry_set(session, COMMAND_LINE, self.blobs, None, row.id, path, name)
            return row.id

    def candidate(self, sensor_id: int, launcher: Actor, creator: Actor | None = None) -> ParameterSet:
        with open_writing(self.engine) as session:
            run = self._run(session, sensor_id, launcher)
            return parameter_sets.create_from_run(session, creator or launcher, self.blobs, run.id)

    def _run(self, session: Session, sensor_id: int, analyst: Actor) -> Run:
        found = self.example_run.result
        nudged = {**found["parameters"], "f_m": found["parameters"]["f_m"] * (1.0 + 1e-7 * next(self._numbers))}
        sha256 = self.blobs.put(orjson.dumps({**found, "parameters": nudged}, option=orjson.OPT_SERIALIZE_NUMPY))
        register_blob(session, self.blobs, sha256, "application/json")
        run = Run(
            sensor_id=sensor_id,
            telemetry_set_id=telemetry_sets.list_telemetry_sets(session, sensor_id=sensor_id)[0].id,
            method="batch",
            settings={"method": "batch"},
            sensor_document=session.get_one(Sensor, sensor_id).document,
            state="SUCCEEDED",
            launched_utc=utc_now(),
            launched_by=analyst.user_id,
            result_sha256=sha256,
            summary={"status": "converged"},
        )
        session.add(run)
        session.flush()
        audit.append(session, analyst, "launched", f"runs/{run.id}")
        return run

    def find_set(self, set_id: int) -> ParameterSet:
        with open_reading(self.engine) as session:
            return session.get_known(ParameterSet, set_id)

    def client(self, name: str) -> httpx.Client:
        if name not in self._credentials:
            with httpx.Client(base_url=self.address, timeout=60, verify=TRUST) as first:
                answer = first.post("/api/v1/sessions", json={"name": name, "password": PASSWORD})
                assert answer.status_code == 201, answer.text
                token = answer.json()["csrf_token"]
                self._credentials[name] = ({"X-CSRF-Token": token}, dict(first.cookies))
        headers, cookies = self._credentials[name]
        return httpx.Client(base_url=self.address, headers=headers, cookies=cookies, timeout=60, verify=TRUST)

    def key(self, name: str) -> httpx.Client:
        scopes = ("sensors", "telemetry-sets", "runs", "parameter-sets", "uplinks")
        with open_writing(self.engine) as session:
            secret = api_keys.create_key(session, self.actor(name), label="test", scopes=scopes)[1]
        return httpx.Client(
            base_url=self.address, headers={"Authorization": f"Bearer {secret}"}, timeout=60, verify=TRUST
        )


def tag(version: int) -> dict[str, str]:
    return {"If-Match": f'"v{version}"'}
