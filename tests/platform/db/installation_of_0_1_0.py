"""Fills a data folder with what an installation of version 0.1.0 holds, by the code of 0.1.0 itself.

Run with PYTHONPATH naming a checkout's `backend` of the commit `RELEASED` in tests/platform/db/released.py::

    python tests/platform/db/installation_of_0_1_0.py DATA --runs 1000 --records 10000

One sensor with two telemetry sets; one run is computed and its result, with another time, is that of every other; one in ten has
failed, one is queued; one set went the whole way to the uplink, one was refused, one waits. The rest of the records are of
passwords. Everything is written by the services of 0.1.0, as people did it.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import orjson

from boresight.calibration.calibrate import calibrate
from boresight.calibration.settings import CalibrationSettings
from boresight.services import approvals, audit, demonstration, parameter_sets, runs, uplinks, users
from boresight.services.actors import Actor
from boresight.sky.catalogue import load_catalogue
from boresight.store import runs as run_rows
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Engine, migrate, open_engine, reading, writing
from boresight.workers.summary import summary_of

PASSWORDS = {one.name: one.password for one in demonstration.LOG_INS}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--records", type=int, default=200)
    given = parser.parse_args()
    given.data.mkdir(parents=True)
    engine = open_engine(f"sqlite:///{given.data}/boresight.sqlite3")
    migrate(engine)
    blobs = BlobStore(given.data / "blobs")
    analyst = demonstration._make_people(engine)
    people = {"analyst": analyst, **{name: _person(engine, name) for name in PASSWORDS if name != "analyst"}}
    catalogue = load_catalogue(given.data.parent / "catalogue")
    fleet = demonstration._Fleet(engine, blobs, catalogue, analyst)
    sensor_id = fleet.sensor_id(1)
    _shorten()
    fleet.add_sets(sensor_id, 1)
    result = _compute(engine, blobs, sensor_id, catalogue)
    _end_runs(engine, blobs, analyst, sensor_id, result, given.runs)
    _bring_sets(engine, blobs, people)
    _fill(engine, people, given.records)
    with reading(engine) as session:
        found = audit.verify(session)
        print(found.records, found.sentence)  # noqa: T201 - whoever runs it reads it
    engine.dispose()  # the last connection folds the write-ahead log into the file


def _person(engine: Engine, name: str) -> Actor:
    with reading(engine) as session:
        row = next(one for one in users.list_users(session) if one.name == name)
        return Actor(row.id, row.name, row.printed_name, frozenset(row.roles), "session")


def _shorten() -> None:
    """Let the sets be of few frames: an installation of 0.1.0 is wanted, not a calibration."""
    import dataclasses  # noqa: PLC0415 - beside what it is for

    for name in ("calibration_scenario", "validation_scenario"):
        whole = getattr(demonstration, name)
        setattr(demonstration, name, lambda number, whole=whole: dataclasses.replace(whole(number), frames=30))


def _compute(engine: Engine, blobs: BlobStore, sensor_id: int, catalogue: object) -> dict[str, object]:
    from boresight.services import sensors, telemetry_sets  # noqa: PLC0415 - beside what they are for
    from boresight.telemetry.sensors import parse_sensor  # noqa: PLC0415 - as above

    with reading(engine) as session:
        sensor = parse_sensor(sensors.get_sensor(session, sensor_id).document)
        telemetry = telemetry_sets.load_telemetry(session, blobs, 1)
    return calibrate(telemetry, sensor, catalogue, CalibrationSettings(method="batch"))


def _end_runs(
    engine: Engine, blobs: BlobStore, analyst: Actor, sensor_id: int, result: dict[str, object], count: int
) -> None:
    for number in range(1, count + 1):
        content = orjson.dumps({**result, "timing_s": {"total": number / 1000}})
        with writing(engine) as session:
            label = f"Pass {number}"
            run = runs.launch(session, analyst, sensor_id, 1, {"method": "batch"}, validation_set_id=2, label=label)
            if number == count:
                continue  # it waits
            (claimed,) = run_rows.claim(session, "host/1", 30.0, 1, [run.id])
            if number % 10 == 0:
                run_rows.finish(session, run.id, claimed.attempt, "FAILED", "The telemetry file was cut off.")
                continue
            sha256 = blobs.put(content)
            summary = summary_of(orjson.loads(content))
            run_rows.finish(session, run.id, claimed.attempt, "SUCCEEDED", None, sha256, summary, len(content))


def _bring_sets(engine: Engine, blobs: BlobStore, people: dict[str, Actor]) -> None:
    def say(**given: object) -> None:
        with writing(engine) as session:
            approvals.sign(
                session, people["approver"], password=PASSWORDS["approver"], comment="Seen.", seen_version=1, **given
            )

    for run_id in (1, 2, 3):
        with writing(engine) as session:
            row = parameter_sets.create_from_run(session, people["analyst"], blobs, run_id)
            asked = parameter_sets.submit(session, people["analyst"], row.id, "It moved.", row.version)
            set_id, approval_id = row.id, asked.id
        if run_id == 1:
            say(approval_id=approval_id, decision="APPROVE", meaning="I approve this set for baseline.")
            with writing(engine) as session:
                row = parameter_sets.get_parameter_set(session, set_id)
                parameter_sets.promote(session, people["operator"], set_id, row.version)
            with writing(engine) as session:
                for state in ("SENT", "LOADED"):
                    uplinks.record(session, people["operator"], set_id, state, "pass 4711")
        elif run_id == 2:
            say(approval_id=approval_id, decision="REFUSE", meaning="I refuse this set.")


def _fill(engine: Engine, people: dict[str, Actor], records: int) -> None:
    """Append records until there are so many, as they were made of each change of roles."""
    with reading(engine) as session:
        missing = records - audit.verify(session).records
    viewer = people["viewer"]
    roles = itertools.cycle((["viewer", "operator"], ["viewer"]))
    for _ in range(0, missing, 100):
        with writing(engine) as session:
            for _ in range(min(missing, 100)):
                users.change_roles(session, people["administrator"], viewer.user_id, next(roles))
        missing -= 100


main()
