"""A real server on a real port over a real database, with people, a sensor, telemetry and calibrations in it.

Nothing computes behind it (no workers): a run stays QUEUED until a test ends it. The calibration is a real one.
"""

import dataclasses
import itertools
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import orjson
import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.console.jobs import alignment_thread
from boresight.console.runs.queries import Line, write_event
from boresight.console.runs.tables import Run
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing
from boresight.platform.web.connections import Connections
from boresight.server import _Server, configured, create_app
from boresight.settings import Settings, read_settings
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.choices import made_choice
from tests.passwords import add_person
from tests.stores import environment_in, open_migrated

PASSWORD = "correct horse battery"
PEOPLE = {
    "ada": ("analyst",),
    "alan": ("approver",),
    "olga": ("operator",),
    "adele": ("administrator",),
    "victor": ("viewer",),
    "bo": ("analyst", "approver"),
}
SCENARIO = dataclasses.replace(calibration_scenario(1), frames=30)
_numbers = itertools.count(100)
alignment_thread.ROUND_S = 0.05  # the tests ask for an alignment and wait for it
PLAIN = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # no TLS here, and reading who is trusted takes 20 ms


def settings_in(folder: Path, **given: str) -> Settings:
    named = {f"BORESIGHT_{name.upper()}": value for name, value in given.items()}
    own = {"BORESIGHT_DATA_FOLDER": str(folder), "BORESIGHT_WORKERS": "0", "BORESIGHT_ANCHOR_MINUTES": "0"}
    own["BORESIGHT_MAIL_SERVER"] = "mailto://127.0.0.1:9?from=boresight@mission.invalid"  # takes no mail
    own["BORESIGHT_SECOND_PERSON"] = "0"  # tests of it switch it on
    own |= environment_in(folder)
    return read_settings({**own, **named})


@contextmanager
def serving(
    settings: Settings, catalogue: Catalogue | None = None, connections: Connections | None = None, **given: Any
) -> Iterator[tuple[str, Any]]:
    app = create_app(settings, **given)
    app.state.catalogue = lambda: catalogue
    server = _Server(configured(app, dataclasses.replace(settings, host="127.0.0.1", port=0), connections))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive(), "the server ended before it began"
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}", app
    finally:
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive(), "the server did not stop"


@dataclass
class House:
    address: str
    app: Any
    telemetry_csv: bytes = field(repr=False)
    result: dict[str, Any] = field(repr=False)
    clients: dict[str, httpx.Client] = field(default_factory=dict, repr=False)
    opened: list[httpx.Client] = field(default_factory=list, repr=False)

    def person(self, name: str) -> httpx.Client:
        if name not in self.clients:
            self.clients[name] = self.log_in(name)
        return self.clients[name]

    def log_in(self, name: str) -> httpx.Client:
        client = self.anybody()
        answer = client.post("/api/v1/sessions", json={"name": name, "password": PASSWORD})
        assert answer.status_code == 201, answer.text
        client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
        return client

    def new_person(self, *roles: str) -> tuple[str, int]:
        name = f"person-{next(_numbers)}"
        body = {"name": name, "printed_name": name.title(), "password": PASSWORD, "roles": roles}
        answer = self.person("adele").post("/api/v1/users", json=body)
        assert answer.status_code == 201, answer.text
        return name, answer.json()["id"]

    def anybody(self, **headers: str) -> httpx.Client:
        client = httpx.Client(base_url=self.address, headers=headers, timeout=30, verify=PLAIN)
        self.opened.append(client)
        return client

    def key(self, owner: str, *scopes: str) -> httpx.Client:
        client = self.person(owner)
        answer = client.post("/api/v1/api-keys", json={"label": "test", "scopes": list(scopes)})
        assert answer.status_code == 201, answer.text
        return self.anybody(Authorization=f"Bearer {answer.json()['secret']}")

    def sensor_file(self, **changed: Any) -> dict[str, Any]:
        return {**sensor_document(SCENARIO.sensor), "name": f"ST-{next(_numbers)}", **changed}

    def new_sensor(self) -> dict[str, Any]:
        client = self.person("ada")
        return client.post("/api/v1/sensors", json=self.sensor_file()).json()

    def upload(
        self, client: httpx.Client, sensor_id: int, content: bytes | None = None, **fields: Any
    ) -> httpx.Response:
        headers = fields.pop("headers", {})
        name = fields.pop("file_name", "telemetry.csv")
        return client.post(
            "/api/v1/telemetry-sets",
            data={"sensor_id": str(sensor_id), **fields},
            files={"file": (name, self.telemetry_csv if content is None else content)},
            headers=headers,
        )

    def ready_sensor(self) -> tuple[int, int]:
        sensor = self.new_sensor()
        client = self.person("ada")
        answer = self.upload(client, sensor["id"])
        assert answer.status_code == 201, answer.text
        return sensor["id"], answer.json()["id"]

    def launched(self, launcher: str = "ada", **changed: Any) -> dict[str, Any]:
        sensor_id, set_id = self.ready_sensor()
        client = self.person(launcher)
        order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "batch"}, **changed}
        answer = client.post("/api/v1/runs", json=order)
        assert answer.status_code == 202, answer.text
        return answer.json()

    def end(self, run_id: int, state: str = "SUCCEEDED") -> None:
        with open_writing(self.app.state.engine) as session:
            self._end(session, session.get_one(Run, run_id), state)

    def end_queued(self) -> None:
        """End what is queued, in the transaction that reads it, but for `ekf`, which an example cancels."""
        queued = select(Run).where(Run.state == "QUEUED", Run.method != "ekf")
        with open_writing(self.app.state.engine) as session:
            for run in session.scalars(queued).all():
                self._end(session, run, "SUCCEEDED")

    def _end(self, session: Session, run: Run, state: str) -> None:
        blobs = self.app.state.blobs
        result = self.result if run.choice_of is None else made_choice().to_dict()
        sha256 = blobs.put(orjson.dumps(result))
        register_blob(session, blobs, sha256, "application/json")
        run.state, run.result_sha256 = state, sha256
        write_event(session, run.id, 1, Line.moved(state, "ended by the test"))
        audit.append(session, SYSTEM, "ended", f"runs/{run.id}", None, {"state": state})

    def finished(self, launcher: str = "ada") -> int:
        run = self.launched(launcher)
        self.end(run["id"])
        return run["id"]

    def converged(self) -> int:
        """A run that has ended with its summary, as one that is started from has."""
        run_id = self.finished()
        with open_writing(self.app.state.engine) as session:
            session.get_one(Run, run_id).summary = {"status": "converged"}
            audit.append(session, SYSTEM, "summarised", f"runs/{run_id}")
        return run_id

    def chosen(self) -> int:
        run_id = self.finished()
        asked = self.person("ada").post(f"/api/v1/runs/{run_id}/choice").json()
        self.end(asked["id"])
        return run_id

    def candidate(self, launcher: str = "ada") -> dict[str, Any]:
        run_id = self.finished(launcher)
        client = self.person("ada")
        return client.post("/api/v1/parameter-sets", json={"run_id": run_id}).json()

    def submitted(self, submitter: str = "ada", launcher: str = "ada") -> dict[str, Any]:
        row = self.candidate(launcher)
        client = self.person(submitter)
        answer = client.post(
            f"/api/v1/parameter-sets/{row['id']}:submit",
            json={"reason": "It moved."},
            headers={"If-Match": f'"v{row["version"]}"'},
        )
        assert answer.status_code == 201, answer.text
        return answer.json()

    def sign(self, name: str, approval: dict[str, Any], decision: str = "approve", **changed: Any) -> httpx.Response:
        body = {"meaning": "I approve this set for baseline.", "password": PASSWORD, "comment": "Seen.", **changed}
        client = self.person(name)
        return client.post(
            f"/api/v1/approvals/{approval['id']}:{decision}",
            json=body,
            headers={"If-Match": f'"v{approval["version"]}"'},
        )

    def approved(self) -> dict[str, Any]:
        approval = self.submitted()
        assert self.sign("alan", approval).status_code == 200
        client = self.person("ada")
        return client.get(f"/api/v1/parameter-sets/{approval['parameter_set_id']}").json()


def add_people(settings: Settings) -> None:
    engine = open_migrated(settings.database_url)
    with open_writing(engine) as session:
        for name, roles in PEOPLE.items():
            add_person(session, name, *roles)
    engine.dispose()


@contextmanager
def house_in(folder: Path, catalogue: Catalogue) -> Iterator[House]:
    telemetry = simulate(SCENARIO, np.random.default_rng(1), catalogue)
    write_csv(telemetry, folder / "telemetry.csv")
    result = calibrate(telemetry, SCENARIO.sensor, catalogue, CalibrationSettings(method="batch")).to_dict()
    settings = settings_in(folder / "data", login_attempts="1000", second_factor="optional")
    add_people(settings)
    with serving(settings, catalogue) as (address, app):
        made = House(address, app, (folder / "telemetry.csv").read_bytes(), result)
        yield made
        for client in made.opened:
            client.close()


@pytest.fixture(scope="session")
def house(tmp_path_factory, catalogue) -> Iterator[House]:
    with house_in(tmp_path_factory.mktemp("house"), catalogue) as made:
        yield made
