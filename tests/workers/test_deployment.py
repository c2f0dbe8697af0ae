"""The plain commands of the page on deployment, run as they stand there: a run ends, also when the scheduler dies in its middle."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import uuid
from pathlib import Path

import httpx
import numpy as np
import pytest
from services import wait_for

from benchmarks.servers import free_port
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_parquet
from tests.postgresql import server

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "deployment.md").read_text()
PASSWORD = "correct horse battery"
SCENARIO = calibration_scenario(1)

pytestmark = pytest.mark.full  # the page's commands, each a process that takes seconds to start


class Site:
    """What the page makes, with its folder, database and ports replaced by free ones."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: dict[str, subprocess.Popen] = {}
        self.port = str(free_port())
        self.instead = {
            "/srv/boresight": f"{folder}/data",
            "postgresql://boresight@127.0.0.1:5432/boresight": server().make(f"site_{uuid.uuid4().hex}", "template0"),
            "8786": str(free_port()),
            "8000": self.port,
        }
        self.exports, self.once = self.blocks("sh")
        self.services = {re.match(r"boresight (\w+)", block)[1]: block for block in self.blocks("sh service")}

    def blocks(self, kind: str) -> list[str]:
        """The fenced blocks of the page of one kind, for this site."""
        found = re.findall(rf"^```{kind}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
        for stands, meant in self.instead.items():
            found = [block.replace(stands, meant) for block in found]
        return found

    def shell(self, block: str, *, exports: str | None = None) -> subprocess.Popen:
        """Run a block in a shell with the settings of the page."""
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(
                ["sh", "-ec", f"{exports or self.exports}\n{block}"],
                env=os.environ | {"PATH": path, "PYTHONUNBUFFERED": "1"}, cwd=self.folder, stdout=log, stderr=log,
            )  # fmt: skip

    def start(self, name: str) -> None:
        """Start a service."""
        self.started[name] = self.shell(f"exec {self.services[name]}")

    def log(self) -> str:
        """What all of them have said."""
        return (self.folder / "log").read_text()

    def stop(self) -> None:
        """End what still runs."""
        for process in reversed(self.started.values()):
            process.terminate()
        for process in self.started.values():
            process.wait(60)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Do what the page says."""
    made = Site(tmp_path_factory.mktemp("site"))
    (made.folder / "data").mkdir()
    (made.folder / "password.txt").write_text(f"{PASSWORD}\n")
    assert made.shell(made.once).wait(600) == 0, made.log()
    try:
        for name in made.services:
            made.start(name)
        wait_for(lambda: is_ready(made) or any(process.poll() is not None for process in made.started.values()), 300)
        assert is_ready(made), made.log()[-3000:]
        yield made
    finally:
        made.stop()


def is_ready(site: Site) -> bool:
    """Ask the server."""
    try:
        return httpx.get(f"http://127.0.0.1:{site.port}/readyz", timeout=10).status_code == 200
    except httpx.HTTPError:
        return False


@pytest.fixture(scope="module")
def launch(site):
    """Log in and put telemetry of a sensor there; returns a function that launches a run and gives its address."""
    client = httpx.Client(base_url=f"http://127.0.0.1:{site.port}/api/v1", timeout=120)
    answer = client.post("/sessions", json={"name": "ada", "password": PASSWORD})
    assert answer.status_code == 201, answer.text
    client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
    sensor_id = client.post("/sensors", json=sensor_document(SCENARIO.sensor)).json()["id"]
    table = site.folder / "telemetry.parquet"
    write_parquet(
        simulate(SCENARIO, np.random.default_rng(1), load_catalogue(site.folder / "data" / "catalogue")), table
    )
    with table.open("rb") as file:
        sent = client.post("/telemetry-sets", data={"sensor_id": str(sensor_id)}, files={"file": (table.name, file)})
    assert sent.status_code == 201, sent.text

    def launched(**settings) -> str:
        order = {"sensor_id": sensor_id, "telemetry_set_id": sent.json()["id"], **settings}
        answer = client.post("/runs", json=order)
        assert answer.status_code == 202, answer.text
        return f"/runs/{answer.json()['id']}"

    launched.client = client
    yield launched
    client.close()


def ended(launch, run: str) -> dict:
    """Wait for a run's end."""
    return wait_for(
        lambda: found if (found := launch.client.get(run).json())["state"] not in {"QUEUED", "RUNNING"} else None, 300
    )


def test_a_run_of_the_site_that_the_page_makes_ends(launch):
    found = ended(launch, launch())

    assert found["state"] == "SUCCEEDED", json.dumps(found)


def test_when_the_scheduler_is_killed_the_workers_come_back_by_themselves_and_the_run_ends(site, launch):
    runs = [launch() for _ in range(6)]
    wait_for(lambda: any(launch.client.get(run).json()["state"] == "RUNNING" for run in runs))
    site.started["scheduler"].send_signal(signal.SIGKILL)
    site.started["scheduler"].wait()
    wait_for(lambda: site.log().count("A worker has left") == 2)
    site.start("scheduler")

    assert [ended(launch, run)["state"] for run in runs] == ["SUCCEEDED"] * len(runs)
    assert site.log().count("A worker has joined") == 4
    assert site.started["worker"].poll() is None


def test_every_service_ends_in_order_when_it_is_asked_to(site, launch):
    assert ended(launch, launch())["state"] == "SUCCEEDED"
    for name in ("serve", "worker", "scheduler"):
        site.started[name].terminate()
        assert site.started[name].wait(60) == 0, name
    assert "Traceback" not in site.log()
