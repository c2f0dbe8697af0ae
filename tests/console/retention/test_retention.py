"""Retention: files go once nothing needs them, everything that rests on them keeps them, and what went can be brought back."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.console.alignments.tables import Alignment
from boresight.console.approvals.tables import GateProfile, GateReport
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.jobs.maintenance import Maintenance
from boresight.console.jobs.retention_thread import RetentionThread
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.retention import service
from boresight.console.runs.tables import ArchivedRun, JointSet, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, ForbiddenError, NotFoundError
from boresight.platform.actors import COMMAND_LINE, SYSTEM, SessionLimits
from boresight.platform.audit import log as audit
from boresight.platform.blobs import files
from boresight.platform.blobs.store import register_blob
from boresight.platform.blobs.tables import Blob
from boresight.platform.db import backup as backups
from boresight.platform.db.sessions import open_reading, open_writing
from tests.refusals import has_code
from tests.stores import triggers_aside

OLD = "2020-01-01T00:00:00.000000Z"
DAYS = 30.0


@pytest.fixture
def world(engine, blobs, finished_run):
    """Old sets 1 to 3 of a sensor: the first with an archived run, the others with none; the third is the newest."""
    return World(engine, blobs, finished_run)


class World:
    def __init__(self, engine: Any, blobs: Any, finished_run: Any) -> None:
        self.engine, self.blobs = engine, blobs
        with open_writing(engine) as session:
            self.run_id = finished_run(session).id
            first = session.get_one(TelemetrySet, session.get_one(Run, self.run_id).telemetry_set_id)
            first.uploaded_utc = OLD
            run = session.get_one(Run, self.run_id)
            run.ended_utc = OLD
            self.first = first.id
            self.second, self.newest = (self._add(session, first, text) for text in ("second", "newest"))
            session.add(ArchivedRun(run_id=self.run_id, archived_utc=OLD))
            audit.append(session, COMMAND_LINE, "brought in", "telemetry-sets")

    def _add(self, session: Any, like: TelemetrySet, text: str, **changed: Any) -> int:
        sha256 = self.blobs.put(text.encode())
        register_blob(session, self.blobs, sha256, "text/csv")
        values = {
            "sensor_id": like.sensor_id, "name": text, "purpose": "calibration", "original_sha256": sha256, "frames": 1,
            "table_sha256": sha256, "stars": 1, "quality": {}, "uploaded_utc": OLD,
        }  # fmt: skip
        return session.put(TelemetrySet(**{**values, **changed})).id

    def going(self, days: float = DAYS) -> set[int]:
        with open_reading(self.engine) as session:
            return {one.row.id for one in service.preview(session, days).going}

    def reason(self, set_id: int) -> str | None:
        with open_reading(self.engine) as session:
            return next(one.reason for one in service.preview(session, DAYS).sets if one.row.id == set_id)

    def remove(self, set_id: int) -> int:
        return service.remove(self.engine, self.blobs, COMMAND_LINE, set_id, DAYS)

    def file(self, set_id: int) -> Any:
        with open_reading(self.engine) as session:
            return self.blobs.locate(session.get_one(TelemetrySet, set_id).original_sha256)


def test_what_nothing_needs_goes_and_everything_else_of_it_stays(world):
    assert world.going() == {world.first, world.second}
    assert world.going(days=20_000) == set()
    assert "newest" in world.reason(world.newest)
    with open_reading(world.engine) as session:
        before = session.get_one(Run, world.run_id).result_sha256
    assert world.remove(world.second) == len(b"second")
    assert not world.file(world.second).exists()
    with open_reading(world.engine) as session:
        row = session.get_one(TelemetrySet, world.second)
        assert None not in {row.removed_utc, row.archived_utc}
        record = audit.find_last_change(session, f"telemetry-sets/{row.id}")
        assert (record.action, record.after["files"]) == ("removed the files", [row.original_sha256])
        report = audit.verify(session, None, world.blobs)
        assert report.ok, report.sentence
        assert files.count_bytes(session) > 0
        assert service.preview(session, DAYS).removed == 1
    assert world.blobs.path(before).exists()
    with pytest.raises(ConflictError):
        world.remove(world.second)


def _need_by_set(session: Any, world: World) -> None:
    audit.append(session, COMMAND_LINE, "needed", "runs")
    parameter_sets.create_from_run(session, COMMAND_LINE, world.blobs, world.run_id)


def _add_run(session: Any, world: World, **changed: Any) -> int:
    like = session.get_one(Run, world.run_id)
    names = ("sensor_id", "telemetry_set_id", "method", "settings", "sensor_document", "launched_utc", "result_sha256")
    values = {name: getattr(like, name) for name in names}
    values |= {"telemetry_set_id": world.newest, "state": "SUCCEEDED", "ended_utc": OLD}
    audit.append(session, COMMAND_LINE, "needed", "runs")
    return session.put(Run(**{**values, **changed})).id


def _need_by_joint(session: Any, world: World) -> None:
    session.put(JointSet(run_id=_add_run(session, world), telemetry_set_id=world.first))


def _need_by_alignment(session: Any, world: World) -> None:
    sides = {"sensor_a_id": 1, "sensor_b_id": 1, "run_a_id": world.run_id, "run_b_id": world.run_id}
    session.put(Alignment(**sides, options={}, created_utc=OLD, state="QUEUED"))
    audit.append(session, COMMAND_LINE, "needed", "runs")


def _need_by_gate(session: Any, world: World) -> None:
    other = parameter_sets.create_from_run(session, COMMAND_LINE, world.blobs, _add_run(session, world))
    profile = session.put(GateProfile(sensor_id=1, number=9, document={}, sha256="0" * 64, reason="x", created_utc=OLD))
    table = session.get_one(TelemetrySet, world.first).table_sha256
    document = {"held_out": {"name": "x", "sha256": table}}
    given = {"verdict": "PASS", "sha256": "0" * 64, "created_utc": OLD}
    session.put(GateReport(parameter_set_id=other.id, gate_profile_id=profile.id, document=document, **given))


def _need_by_decision(session: Any, world: World) -> None:
    policy = session.put(
        IngestPolicy(
            sensor_id=1, number=1, document={}, sha256="0", reason="x", created_utc=OLD, state="OFF", version=1
        )
    )
    told = {"source": "REST", "file_name": "x", "size_bytes": 1, "received_utc": OLD, "sentence": "", "evidence": {}}
    session.put(
        IngestDecision(sensor_id=1, policy_id=policy.id, telemetry_set_id=world.first, state="ASKED", version=1, **told)
    )
    audit.append(session, COMMAND_LINE, "needed", "runs")


def _need_by_use(session: Any, world: World) -> None:
    session.get_one(TelemetrySet, world.first).purpose = "validation"
    audit.append(session, COMMAND_LINE, "needed", "runs")


NEEDS = {
    "a parameter set": _need_by_set,
    "a run that waits": lambda session, world: _add_run(
        session, world, telemetry_set_id=world.first, state="QUEUED", result_sha256=None, ended_utc=None
    ),
    "a run with a result": lambda session, world: _add_run(session, world, telemetry_set_id=world.first),
    "a run that held it out": lambda session, world: _add_run(session, world, validation_set_id=world.first),
    "a joint run": _need_by_joint,
    "a run that started from its run": lambda session, world: _add_run(session, world, prior_run_id=world.run_id),
    "a run of which the way led here twice": lambda session, world: _add_run(
        session, world, prior_run_id=_add_run(session, world, prior_run_id=world.run_id, result_sha256=None)
    ),
    "a run that ended lately": lambda session, world: _add_run(
        session,
        world,
        telemetry_set_id=world.first,
        state="FAILED",
        result_sha256=None,
        ended_utc="2999-01-01T00:00:00.000000Z",
    ),
    "an alignment": _need_by_alignment,
    "a gate report": _need_by_gate,
    "an open decision": _need_by_decision,
    "gates to come": _need_by_use,
}


@pytest.mark.parametrize("need", NEEDS)
def test_whatever_needs_a_set_keeps_its_files(world, need):
    with open_writing(world.engine) as session:
        NEEDS[need](session, world)
    assert world.going() == {world.second}, world.reason(world.first)
    assert world.reason(world.first)
    with pytest.raises(ConflictError, match="are kept"):
        world.remove(world.first)
    assert world.file(world.first).exists()


def _add_sensor(session: Any) -> int:
    like = session.get_one(Sensor, 1)
    names = [column.name for column in Sensor.__table__.columns if column.name not in {"id", "name"}]
    return session.put(Sensor(name="another", **{name: getattr(like, name) for name in names})).id


def test_a_file_that_another_set_names_stays_until_that_goes_too(world):
    with open_writing(world.engine) as session:
        second = session.get_one(TelemetrySet, world.second)
        audit.append(session, COMMAND_LINE, "uploaded", "telemetry-sets")
        newest = session.get_one(TelemetrySet, world.newest)
        shared = {"original_sha256": newest.original_sha256, "table_sha256": second.table_sha256}
        twin = world._add(session, second, "twin", **shared, sensor_id=_add_sensor(session), archived_utc=OLD)
    assert world.remove(world.second) == 0
    assert world.file(world.second).exists()
    assert world.remove(twin) == len(b"second")
    assert not world.file(world.second).exists()
    assert world.file(world.newest).exists()


def test_a_killed_server_s_removal_is_finished_and_bytes_that_came_back_are_not_touched(world, monkeypatch):
    monkeypatch.setattr(service, "discard", lambda *_: None)
    world.remove(world.second)
    monkeypatch.undo()
    assert world.file(world.second).exists()
    thread = RetentionThread(world.engine, world.blobs, DAYS, lambda: None)
    with open_writing(world.engine) as session:
        sha256 = session.get_one(TelemetrySet, world.second).original_sha256
        register_blob(session, world.blobs, world.blobs.put(b"second"), "text/csv")  # uploaded again
        audit.append(session, COMMAND_LINE, "uploaded", "telemetry-sets")
    thread.sweep()
    assert world.blobs.locate(sha256).exists()
    with open_writing(world.engine) as session:
        session.get_one(Blob, sha256).removed_utc = service.utc_now()
    thread.sweep()
    assert not world.blobs.locate(sha256).exists()


def test_the_thread_follows_the_policy_and_a_backup_of_what_is_left_is_whole(world, tmp_path):
    RetentionThread(world.engine, world.blobs, DAYS, lambda: None).work()
    assert [world.file(number).exists() for number in (world.first, world.second, world.newest)] == [False, False, True]
    world.blobs.find_removed = lambda sha256: OLD if sha256 == world.file(world.first).name else None
    with pytest.raises(NotFoundError, match="2020-01-01", check=has_code("removed-by-retention")):
        world.blobs.path(world.file(world.first).name)
    maintenance = Maintenance(world.engine, SessionLimits(3600, 3600), world.blobs)
    maintenance.suspect(world.file(world.first).name)
    maintenance.read_files()
    with open_reading(world.engine) as session:
        assert maintenance._check_installation(session)["blobs/FILES"] is None
        head = audit.head(session)
    url = world.engine.url.render_as_string(hide_password=False)
    taken = backups.write_backup(url, world.blobs, head, tmp_path / "all.zip")
    assert taken.missing == ()
    found = backups.try_restore(tmp_path / "all.zip", tmp_path)
    assert found.is_ok, found.sentence


def test_a_file_that_is_only_called_removed_is_found(world):
    with world.engine.begin() as connection, triggers_aside(connection):
        words = "UPDATE blobs SET removed_utc = :at WHERE sha256 = :sha256"
        connection.execute(sa.text(words), {"at": OLD, "sha256": world.file(world.newest).name})
    world.file(world.newest).unlink()
    with open_reading(world.engine) as session:
        report = audit.verify(session, None, world.blobs)
    assert not report.ok
    assert f"telemetry-sets/{world.newest}" in report.bad_files[0]


def test_only_administrators_remove(world, people):
    with pytest.raises(ForbiddenError):
        service.remove(world.engine, world.blobs, people["ana"], world.second, DAYS)
    assert world.remove(world.second)
    assert dataclasses.replace(SYSTEM).name == "system"


def test_bytes_that_are_uploaded_again_bring_a_set_back_and_its_page_says_what_is_gone(house):
    sensor_id, set_id = house.ready_sensor()
    engine, blobs = house.app.state.engine, house.app.state.blobs
    visitor = house.person("victor")
    with open_writing(engine) as session:
        row = session.get_one(TelemetrySet, set_id)
        row.removed_utc = row.archived_utc = OLD
        gone = files.mark_removed(session, [row.original_sha256, row.table_sha256])
        audit.append(session, SYSTEM, "removed the files", f"telemetry-sets/{set_id}")
    service.discard(engine, blobs, [sha256 for sha256, _ in gone])
    if not gone:  # another sensor's set of the same session holds the same bytes
        pytest.skip("the files are shared")
    answer = visitor.get(f"/api/v1/telemetry-sets/{set_id}/file")
    assert (answer.status_code, "under the retention policy" in answer.text) == (404, True)
    assert "files removed" in visitor.get(f"/telemetry/{set_id}").text
    again = house.upload(house.person("ada"), sensor_id)
    assert (again.json()["id"], again.json()["removed_utc"], again.json()["archived_utc"]) == (set_id, None, None)
    assert visitor.get(f"/api/v1/telemetry-sets/{set_id}/file").content == house.telemetry_csv
    with open_reading(engine) as session:
        assert audit.verify(session, None, blobs).ok


def test_the_page_shows_what_would_go_and_why_the_rest_stays(house):
    house.ready_sensor()
    page = house.person("adele").get("/retention", params={"days": 1})
    assert page.status_code == 200
    assert "It was uploaded or used within 1 days." in page.text
    assert house.person("adele").get("/retention", params={"days": 0}).status_code == 422
