"""A server is killed with -9 in the middle of two hundred random transitions, and started again: nothing is half done."""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import pytest
import sqlalchemy as sa

from benchmarks.servers import Server, variables, wait_until
from boresight.console import list_queries as lists
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session, open_reading
from tests.served import settings_in
from tests.stores import environment_in
from tests.transitions.installation import WORDS, ExampleRun, Installation, tag

TRANSITIONS, KILLS, DRIVERS = 200, 3, 4
SENSORS, SETS = 2, 6
PEOPLE = {"ana": ("analyst",), "cy": ("approver",), "di": ("approver",), "olga": ("operator",)}
REASON = {"reason": "It moved."}
CHOICES = {  # of a set's state: who may ask what, and how often it is asked
    "CANDIDATE": (("ana", "submit", 1.0),),
    "WITHDRAWN": (("ana", "submit", 1.0),),
    "SUPERSEDED": (("ana", "roll-back", 1.0),),
    "SUBMITTED": (("cy", "approve", 0.5), ("di", "approve", 0.38), ("ana", "withdraw", 0.1), ("di", "refuse", 0.02)),
    "APPROVED": (("olga", "promote", 0.9), ("ana", "withdraw", 0.08), ("di", "refuse", 0.02)),
}


@dataclass
class Comings:
    """A server process of its own, as `boresight serve` starts it, that comes and goes."""

    folder: Path
    process: Server | None = None

    @property
    def address(self) -> str:
        """Where it listens."""
        assert self.process is not None
        return self.process.address

    def start(self) -> None:
        """Start it and wait until it answers."""
        environment = os.environ | variables(data_folder=self.folder, workers=0, login_attempts=1000)
        self.process = Server(self.folder.parent, environment | environment_in(self.folder))
        self.process.wait_until_ready("/healthz")

    def end(self, number: int) -> None:
        """Send a signal and wait for the end."""
        if self.process is not None:
            self.process.end(number)
            self.process = None


@pytest.fixture
def server(tmp_path: Path, catalogue_folder: Path, example_run: ExampleRun) -> Iterator[Comings]:
    """Prepare a server on an empty data folder; it is ended at the end."""
    assert example_run.result  # the catalogue was trimmed for it
    shutil.copytree(catalogue_folder, tmp_path / "data" / "catalogue")
    made = Comings(tmp_path / "data")
    yield made
    made.end(signal.SIGTERM)


@dataclass
class Traffic:
    """Random transitions from several people at once, while the server comes and goes."""

    house: Installation
    server: Comings
    begun: int = 0
    under_way: int = 0
    cut_off: int = 0
    accepted: list[str] = field(default_factory=list)
    refused: list[httpx.Response] = field(default_factory=list)
    up: threading.Event = field(default_factory=threading.Event)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def drive(self, seed: int) -> None:
        """Ask for transitions until enough were asked for."""
        rng = np.random.default_rng([20261121, seed])
        with ExitStack() as opened:
            clients = {name: opened.enter_context(self.house.client(name)) for name in PEOPLE}
            while self._next():
                self.up.wait()
                self._one(rng, clients)

    def _next(self) -> bool:
        with self._lock:
            self.begun += 1
            return self.begun <= TRANSITIONS

    def _one(self, rng: np.random.Generator, clients: Mapping[str, httpx.Client]) -> None:
        """Ask for one transition of a random set in the state that it is in now."""
        person, address, version, body = self._aim(rng)
        try:
            with self._counted():
                answer = clients[person].post(self.server.address + address, json=body, headers=tag(version))
        except httpx.TransportError:
            with self._lock:
                self.cut_off += 1
            return
        if answer.is_success:
            self.accepted.append(answer.headers["X-Request-ID"])
        else:
            self.refused.append(answer)

    @contextmanager
    def _counted(self) -> Iterator[None]:
        with self._lock:
            self.under_way += 1
        try:
            yield
        finally:
            with self._lock:
                self.under_way -= 1

    def _aim(self, rng: np.random.Generator) -> tuple[str, str, int, dict[str, str] | None]:
        """Choose a set, and a transition that its state has."""
        with open_reading(self.house.engine) as session:
            rows = [row for row in lists.list_newest(session, ParameterSet) if row.ground_state in CHOICES]
            row = rows[int(rng.integers(len(rows)))]
            choices = CHOICES[row.ground_state]
            person, name, _ = choices[int(rng.choice(len(choices), p=[choice[2] for choice in choices]))]
            if name in {"approve", "refuse"}:
                request = lists.list_newest(session, Approval, set=row.id)[0]
                return person, f"/api/v1/approvals/{request.id}:{name}", request.version, WORDS
        return person, f"/api/v1/parameter-sets/{row.id}:{name}", row.version, None if name == "promote" else REASON


@pytest.mark.full
def test_a_server_killed_in_the_middle_of_transitions_leaves_each_done_or_not_begun(
    server: Comings, example_run: ExampleRun
) -> None:
    house = Installation(settings_in(server.folder), example_run, PEOPLE)
    for sensor_id in [house.sensor() for _ in range(SENSORS)]:
        for _ in range(SETS):
            house.candidate(sensor_id, house.actor("ana"))
    traffic = Traffic(house, server)
    _serve(house, server, traffic)
    drivers = [threading.Thread(target=traffic.drive, args=(seed,), daemon=True) for seed in range(DRIVERS)]
    for driver in drivers:
        driver.start()
    rng = np.random.default_rng(20261121)
    for number in range(1, KILLS + 1):
        _wait_until(traffic, number * TRANSITIONS // (KILLS + 1))
        time.sleep(float(rng.uniform(0.0, 0.05)))
        cut_off = traffic.cut_off
        wait_until(lambda: traffic.under_way == DRIVERS, 120, 0.0005)
        traffic.up.clear()
        server.end(signal.SIGKILL)
        _is_whole(house, traffic)
        _serve(house, server, traffic)
        assert traffic.cut_off > cut_off  # it was killed in the middle
    for driver in drivers:
        driver.join(120)
    _is_whole(house, traffic)
    with house.client("ana") as client:
        assert client.get(f"{server.address}/api/v1/audit/verification").json()["ok"]
    assert len(traffic.accepted) > TRANSITIONS // 2
    assert {answer.status_code for answer in traffic.refused} <= {409, 412}
    house.engine.dispose()


def _serve(house: Installation, server: Comings, traffic: Traffic) -> None:
    """Start the server and let the people go on, each logged in."""
    server.start()
    house.address = server.address
    for name in PEOPLE:
        house.client(name).close()
    traffic.up.set()


def _wait_until(traffic: Traffic, number: int) -> None:
    """Wait until so many transitions were begun."""
    wait_until(lambda: traffic.begun >= number, 120, 0.002)


def _is_whole(house: Installation, traffic: Traffic) -> None:
    """Hold every row against the audit log: one baseline a sensor, no effect without its record, none that is lost."""
    with open_reading(house.engine) as session:
        assert audit.verify(session).ok
        for row in session.scalars(sa.select(ParameterSet).where(ParameterSet.number == 0)):
            sets = lists.list_newest(session, ParameterSet, sensor=row.sensor_id)
            baselines = [found.id for found in sets if found.ground_state == "BASELINE"]
            newest = session.scalar(
                sa.select(Promotion.parameter_set_id)
                .where(Promotion.sensor_id == row.sensor_id)
                .order_by(Promotion.id.desc())
                .limit(1)
            )
            assert baselines == [newest]
        _has_its_record(session)
        on_record = set(session.scalars(sa.select(AuditRecord.request_id)))
    assert set(traffic.accepted) <= on_record


def _has_its_record(session: Session) -> None:
    """Hold the state of every set and request, and every signature and promotion, against the record of it."""
    for noun, rows in (
        ("parameter-sets", session.scalars(sa.select(ParameterSet))),
        ("approvals", session.scalars(sa.select(Approval))),
    ):
        for row in rows:
            record = audit.find_last_change(session, f"{noun}/{row.id}")
            assert record is not None
            if row.version > 1:
                state = row.state if isinstance(row, Approval) else row.ground_state
                after = record.after or {}
                assert (after.get("state", after.get("ground_state")), after["version"]) == (state, row.version)
    actions = session.execute(sa.select(AuditRecord.action, AuditRecord.object)).all()
    signed = [subject for action, subject in actions if action in {"approved", "refused"} and "approvals/" in subject]
    promoted = [subject for action, subject in actions if action == "promoted"]
    assert session.scalar(sa.select(sa.func.count()).select_from(Signature)) == len(signed)
    assert session.scalar(sa.select(sa.func.count()).select_from(Promotion)) == len(promoted) + SENSORS
