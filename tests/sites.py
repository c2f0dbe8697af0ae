"""A store with one simulated sensor, its people and two real calibrations, and visitors who open the pages."""

from __future__ import annotations

import asyncio
import dataclasses
import html
import re
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import orjson
import pytest
from fastapi import Response

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.console.access import sessions
from boresight.console.access.credentials import SESSION_COOKIE
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE, Actor
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import migrate, open_engine, open_writing, utc_now
from boresight.platform.jobs.worker_news import WorkerState
from boresight.platform.web import static_files
from boresight.server import create_app
from boresight.settings import Settings, read_settings
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.simulation.sensors import st16_truth
from boresight.telemetry.sensors import sensor_document
from boresight.verdicts.numbers import show_numbers
from boresight.verdicts.verdict import summarise_run
from tests.passwords import add_person
from tests.stores import copied, environment_in

PASSWORD = "correct horse battery"
PEOPLE = {
    "ada": ("Ada Analyst", ("analyst",)),
    "alan": ("Alan Approver", ("approver",)),
    "olga": ("Olga Operator", ("operator",)),
    "adele": ("Adele Administrator", ("administrator",)),
    "victor": ("Victor Viewer", ("viewer",)),
    "both": ("Bo Both", ("analyst", "approver")),
}


def codes(page: str) -> list[str]:
    """Return which notices, refusals and empty views a page shows, by their codes."""
    return re.findall(r'data-code="([\w-]+)"', page)


def strip_tags(markup: str) -> str:
    """Return the text of a part of a page."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", markup)).split())


def text_of(page: str, place: str) -> str:
    """Return the text of the element with an id, up to the end of the paragraph, cell or heading that it is."""
    tag, _, rest = re.split(rf'<(\w+)[^<>]*\bid="{place}"[^<>]*(>)', page, maxsplit=1)[1:]
    return strip_tags(rest.split(f"</{tag}>")[0])


def as_shown(sentence: str) -> str:
    """Return a stored sentence as a page has it: with its numbers written as in the tables."""
    return words(show_numbers(f"<main>{html.escape(sentence)}</main>")).strip()


@pytest.fixture(scope="session")
def results(catalogue) -> dict[str, dict[str, Any]]:
    scenario = dataclasses.replace(calibration_scenario(1), frames=40)
    validation_frames = dataclasses.replace(validation_scenario(1), frames=20)
    telemetry = simulate(scenario, np.random.default_rng(1), catalogue)
    validation = simulate(validation_frames, np.random.default_rng(2), catalogue)
    sensor, found, partials = scenario.sensor, {}, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "boresight.calibration.calibrate.REPORT_EVERY_S", 0.0
        )  # of a run as short as this nothing would be told on its way
        for method in ("batch", "sqrf"):
            settings = CalibrationSettings(method=method)
            found[method] = calibrate(
                telemetry,
                sensor,
                catalogue,
                settings,
                validation=validation,
                sha256s={"telemetry": "ab" * 32},
                report=partials.append,
            ).to_dict()
    found["sqrf-partial"] = partials[-1].partial.to_dict()
    return found


def _settings(folder: Path) -> Settings:
    own = {"BORESIGHT_DATA_FOLDER": str(folder), **environment_in(folder)}
    return read_settings({**own, "BORESIGHT_MODE": "SIM", "BORESIGHT_WORKERS": "0", "BORESIGHT_SECOND_PERSON": "0"})


@pytest.fixture(scope="session")
def furnished(tmp_path_factory, results) -> Path:
    settings = _settings(tmp_path_factory.mktemp("furnished"))
    engine, blobs = open_engine(settings.database_url), open_blobs(settings.blob_location)
    migrate(engine)
    with open_writing(engine) as session:
        for name, (printed_name, roles) in PEOPLE.items():
            add_person(session, name, *roles, printed_name=printed_name)
        description = calibration_scenario(1).sensor
        names = CAMERA_MODELS[description.camera_model].parameter_names
        sensor = Sensor(
            name=description.name,
            document=sensor_document(description),
            created_utc=utc_now(),
            simulated=1,
            truth=dict(zip(names, st16_truth(1).tolist(), strict=True)),
        )
        session.add(sensor)
        session.flush()
        parameter_sets.create_ground_calibration(session, COMMAND_LINE, sensor, description)
        for purpose in ("calibration", "validation"):
            sha256 = blobs.put(purpose.encode())
            session.add(Blob(sha256=sha256, size_bytes=len(purpose), media_type="text/csv", created_utc=utc_now()))
            session.flush()
            session.add(
                TelemetrySet(
                    sensor_id=sensor.id,
                    name=f"TS-{purpose}",
                    purpose=purpose,
                    original_sha256=sha256,
                    table_sha256=sha256,
                    frames=40,
                    stars=760,
                    quality={"exposures": 80, "warnings": ["One gap of 400 s."]},
                    uploaded_utc=utc_now(),
                )
            )
        session.flush()
    engine.dispose()
    site = Site(settings)
    site.add_run("batch", state="SUCCEEDED", result=results["batch"], label="reference")
    site.add_run("sqrf", state="SUCCEEDED", result=results["sqrf"], label="filter")
    site.engine.dispose()
    return settings.data_folder


@dataclass
class Site:
    settings: Settings
    app: Any = field(init=False)

    def __post_init__(self) -> None:
        self.app = create_app(self.settings)
        self.app.state.write_lock = asyncio.Lock()
        # nothing computes behind the pages' tests
        self.app.state.workers = SimpleNamespace(notify=lambda: None, state=WorkerState)
        self.engine = self.app.state.engine
        self.blobs = self.app.state.blobs

    def add_run(self, method: str = "batch", *, state: str = "QUEUED", result: Any = None, **columns: Any) -> int:
        with open_writing(self.engine) as session:
            sensor = session.get_one(Sensor, columns.pop("sensor_id", 1))
            values = {
                "sensor_id": sensor.id,
                "telemetry_set_id": 1,
                "validation_set_id": 2,
                "method": method,
                "settings": CalibrationSettings(method=method).document(),
                "sensor_document": sensor.document,
                "state": state,
                "launched_utc": utc_now(),
                "launched_by": 1,
            }
            if result is not None:
                values["result_sha256"] = self.blobs.put(orjson.dumps(result))
                values["summary"] = to_plain(summarise_run(parse_calibration(result)))
                if session.get(Blob, values["result_sha256"]) is None:
                    session.add(
                        Blob(
                            sha256=values["result_sha256"],
                            size_bytes=len(orjson.dumps(result)),
                            media_type="application/json",
                            created_utc=utc_now(),
                        )
                    )
                    session.flush()
            run = Run(**{**values, **columns})
            session.add(run)
            session.flush()
            audit.append(session, COMMAND_LINE, "brought in", f"runs/{run.id}")
            return run.id

    def actor(self, name: str) -> Actor:
        number = list(PEOPLE).index(name) + 1
        return Actor(number, name, PEOPLE[name][0], frozenset(PEOPLE[name][1]), "session")

    def visitor(self, name: str) -> Visitor:
        carrier = Response()
        with open_writing(self.engine) as session:
            _, token = sessions.begin(session, list(PEOPLE).index(name) + 1, sessions.ClientAddress())
        csrf_token = self.app.state.log_in_cookie.write(carrier, token)
        value = re.search(f"{SESSION_COOKIE}=([^;]+)", carrier.headers["set-cookie"])[1]
        return Visitor(self.app, csrf_token, httpx.Cookies({SESSION_COOKIE: value}))


@dataclass
class Visitor:
    app: Any
    csrf_token: str
    cookies: httpx.Cookies

    def send(self, method: str, path: str, **options: Any) -> httpx.Response:
        async def exchange() -> httpx.Response:
            transport = httpx.ASGITransport(self.app)
            async with httpx.AsyncClient(transport=transport, base_url="http://test", cookies=self.cookies) as client:
                answer = await client.request(method, path, **options)
                self.cookies = client.cookies
                return answer

        return asyncio.run(exchange())

    def get(self, path: str, *, status: int = 200) -> str:
        answer = self.send("GET", path)
        assert answer.status_code == status, answer.text
        return answer.text

    def post(self, path: str, **form: Any) -> httpx.Response:
        return self.send("POST", path, data={"csrf_token": self.csrf_token, **form})


@pytest.fixture
def site(furnished, catalogue, tmp_path) -> Any:
    """An application of its own for each test, as most of them write; it takes 8 ms."""
    shutil.copytree(furnished, tmp_path / "data")
    copied(furnished, tmp_path / "data")
    site = Site(_settings(tmp_path / "data"))
    site.app.state.catalogue = lambda: catalogue
    yield site
    site.engine.dispose()


def words(page: str) -> str:
    main = page[page.index("<main") : page.index("</main>")]
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", main)))


@pytest.fixture
def read() -> Any:
    return words


def answer_points(page):
    """Answer every point of a request's panel: ticked, with a reason."""
    ticks = re.findall(r'name="(tick:[^"]+)"', page)
    return dict.fromkeys(ticks, "1") | {tick.replace("tick", "reason", 1): "Known and accepted." for tick in ticks}


def put_documentation(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Let pages find a built documentation, so that they lead there."""
    (folder / "index.html").touch()
    of_product = static_files.folder
    patch.setattr(static_files, "folder", lambda name: folder if name == "documentation" else of_product(name))
