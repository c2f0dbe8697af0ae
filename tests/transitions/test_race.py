"""Fifty at once on one sensor: one baseline at every moment, every accepted transition on record, losers told why."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
import pytest
import sqlalchemy as sa

from boresight.console import list_queries as lists
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval, Signature
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.sky.catalogue import Catalogue
from tests.passwords import proved
from tests.served import serving, settings_in
from tests.transitions.installation import PASSWORD, WORDS, ExampleRun, Installation, tag

AT_ONCE = 50
FORMER, READY = 6, 14  # sets that were baseline, and that are asked for
SIGNED = (2, 0, 2)  # of these approved before each round: where none is, nothing can move the ground under the others
PEOPLE = {
    "ana": ("analyst",),
    "cy": ("approver",),
    "di": ("approver",),
    "olga": ("operator",),
}
ACTIONS = {"approve": "approved", "promote": "promoted", "roll-back": "asked to roll back to"}


@dataclass(frozen=True)
class Shot:
    person: str
    address: str
    version: int
    body: dict[str, str] | None = None

    @property
    def transition(self) -> str:
        return self.address.rpartition(":")[2]


def _filled(house: Installation) -> int:
    sensor_id, ana = house.sensor(), house.actor("ana")
    rows = [house.candidate(sensor_id, ana) for _ in range(FORMER + 1 + READY)]
    for row in rows[: FORMER + 1]:
        _submit(house, row)
        _sign(house, row)
        with open_writing(house.engine) as session:
            version = session.get_known(ParameterSet, row.id).version
            approvals.promote(session, house.actor("olga"), row.id, version)
    return sensor_id


def _submit(house: Installation, row: ParameterSet) -> None:
    with open_writing(house.engine) as session:
        approvals.submit(session, house.actor("ana"), house.blobs, row.id, "It moved.", row.version)


def _sign(house: Installation, row: ParameterSet) -> None:
    with open_writing(house.engine) as session:
        request = lists.list_newest(session, Approval, set=row.id)[0]
        words = (
            approvals.Decision("APPROVE", "I approve."),
            proved(session, house.actor("cy"), PASSWORD),
            request.version,
        )
        approvals.sign(session, house.actor("cy"), request.id, *words)


def _readied(house: Installation, sensor_id: int, signed: int) -> None:
    for row in _sets(house, sensor_id, "CANDIDATE"):
        _submit(house, row)
    missing = signed - len(_sets(house, sensor_id, "APPROVED"))
    for row in _sets(house, sensor_id, "SUBMITTED")[: max(missing, 0)]:
        _sign(house, row)


def _sets(house: Installation, sensor_id: int, state: str) -> Sequence[ParameterSet]:
    with open_reading(house.engine) as session:
        return lists.list_newest(session, ParameterSet, sensor=sensor_id, state=state)


def _shots(house: Installation, sensor_id: int, rng: np.random.Generator) -> list[Shot]:
    with open_reading(house.engine) as session:
        waiting = lists.list_newest(session, Approval, state="OPEN")
    signed = [
        Shot(person, f"/api/v1/approvals/{request.id}:approve", request.version, WORDS)
        for request in waiting
        for person in ("cy", "di")
    ]
    promoted = [
        Shot("olga", f"/api/v1/parameter-sets/{row.id}:promote", row.version)
        for row in _sets(house, sensor_id, "APPROVED")
        for _ in range(2)
    ]
    back = [
        Shot(person, f"/api/v1/parameter-sets/{row.id}:roll-back", row.version, {"reason": "It drifts."})
        for row in _sets(house, sensor_id, "SUPERSEDED")
        for person in ("ana", "olga")
    ]
    shots = promoted + back + signed
    return [shots[int(number)] for number in rng.permutation(AT_ONCE) % len(shots)]


def _fire(house: Installation, shots: list[Shot]) -> list[tuple[Shot, httpx.Response]]:
    gate = threading.Barrier(len(shots))
    answers: list[tuple[Shot, httpx.Response]] = []

    def send(shot: Shot) -> None:
        with house.client(shot.person) as client:
            client.get("/healthz")  # the connection stands before the start
            gate.wait()
            answers.append((shot, client.post(shot.address, json=shot.body, headers=tag(shot.version))))

    threads = [threading.Thread(target=send, args=(shot,)) for shot in shots]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    return answers


@contextmanager
def _watched(house: Installation, sensor_id: int) -> Iterator[list[int]]:
    counts: list[int] = []
    over = threading.Event()
    query = sa.select(sa.func.count()).select_from(ParameterSet)
    query = query.where(ParameterSet.sensor_id == sensor_id, ParameterSet.ground_state == "BASELINE")

    def look() -> None:
        while not over.wait(0.005):
            with open_reading(house.engine) as session:
                counts.append(session.scalar(query) or 0)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield counts
    finally:
        over.set()
        thread.join()


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.full)])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/store.sqlite3"
    return request.getfixturevalue("postgresql").url.render_as_string(hide_password=False)


def test_fifty_at_once_leave_one_baseline_and_one_chain(
    database_url: str, tmp_path: Path, example_run: ExampleRun, catalogue: Catalogue
) -> None:
    settings = settings_in(tmp_path / "data", database_url=database_url)
    house = Installation(settings, example_run, PEOPLE)
    sensor_id, rng = _filled(house), np.random.default_rng(20260114)
    answers: list[tuple[Shot, httpx.Response]] = []
    with serving(settings, catalogue) as (address, _):
        house.address = address
        for name in PEOPLE:
            house.client(name).close()
        with _watched(house, sensor_id) as counts:
            for signed in SIGNED:
                _readied(house, sensor_id, signed)
                answers += _fire(house, _shots(house, sensor_id, rng))
    assert len(answers) == AT_ONCE * len(SIGNED)
    assert set(counts) == {1}
    accepted = [(shot, answer) for shot, answer in answers if answer.is_success]
    refused = [answer for _, answer in answers if not answer.is_success]
    assert {shot.transition for shot, _ in accepted} == ACTIONS.keys()  # each kind won at least once
    assert {answer.status_code for answer in refused} <= {409, 412}
    assert all(answer.json()["detail"] for answer in refused)
    _is_on_record(house, sensor_id, accepted)
    house.engine.dispose()


def _is_on_record(house: Installation, sensor_id: int, accepted: list[tuple[Shot, httpx.Response]]) -> None:
    with open_reading(house.engine) as session:
        assert audit.verify(session).ok
        sets = lists.list_newest(session, ParameterSet, sensor=sensor_id)
        assert [row.ground_state for row in sets].count("BASELINE") == 1
        records = session.execute(sa.select(AuditRecord.request_id, AuditRecord.action, AuditRecord.object)).all()
        signatures, promotions = (
            session.scalar(sa.select(sa.func.count()).select_from(table)) for table in (Signature, Promotion)
        )
    done = {tuple(record) for record in records}
    for shot, answer in accepted:
        subject = shot.address.removeprefix("/api/v1/").rpartition(":")[0]
        assert (answer.headers["X-Request-ID"], ACTIONS[shot.transition], subject) in done
    actions = Counter(action for _, action, subject in done if "approvals/" in subject or action == "promoted")
    assert (signatures, promotions) == (actions["approved"], actions["promoted"] + 1)  # one is the ground calibration
