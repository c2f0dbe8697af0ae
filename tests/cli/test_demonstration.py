"""The demonstration fills a store once, through the ordinary services, and never a second time."""

import time

import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.cli.demonstration import LOG_INS, create_demonstration
from boresight.console.access import users
from boresight.console.access.tables import ROLES
from boresight.console.fleet import queries as sensor_queries
from boresight.console.runs import service as runs
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import table_definitions
from boresight.platform.audit import log as audit
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import migrate, open_engine, open_reading, open_writing
from boresight.simulation.sensors import st16_truth
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.working_table import WorkingTable
from tests.passwords import proved
from tests.stores import url_in


class Demonstration:
    """A store filled once, and what was said meanwhile."""

    def __init__(self, folder):
        self.engine = open_engine(url_in(folder))
        self.blobs = FolderBlobStore(folder / "blobs")
        self.catalogue = load_catalogue(folder)
        self.said = []
        migrate(self.engine)

    def create(self):
        """Make the demonstration, or what is missing of it."""
        return create_demonstration(self.engine, self.blobs, self.catalogue, self.said.append)

    def content(self):
        """Return everything the demonstration makes, as the services list it."""
        with open_reading(self.engine) as session:
            return {
                "people": [(user.name, user.password_hash, user.roles) for user in users.list_users(session)],
                "sensors": [(row.id, row.name, row.version) for row in sensor_queries.sensors(session)],
                "sets": [
                    (row.id, row.original_sha256)
                    for row in telemetry_sets.list_telemetry_sets(session, archived=True, limit=500)
                ],
                "runs": [(row.id, row.state, row.method) for row in runs.list_runs(session)],
                "audit": audit.head(session),
            }


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    demonstration = Demonstration(tmp_path_factory.mktemp("demonstration"))
    started_s = time.perf_counter()
    demonstration.log_ins = demonstration.create()
    demonstration.took_s = time.perf_counter() - started_s
    return demonstration


def test_the_demonstration_is_made_in_under_ten_seconds(filled):
    assert filled.took_s < 10.0


def test_every_role_has_a_person_who_can_log_in_with_the_printed_password(filled):
    assert {role for person in filled.log_ins for role in person.roles} == set(ROLES)
    for person in filled.log_ins:
        with open_writing(filled.engine) as session:
            actor = users.authenticate(session, proved(session, person.name, person.password))
        assert actor.roles == set(person.roles)


def test_six_simulated_sensors_carry_their_truth(filled):
    with open_reading(filled.engine) as session:
        fleet = sensor_queries.sensors(session)
    assert [row.name for row in fleet] == [f"ST16-{number}" for number in range(1, 7)]
    for number, row in enumerate(fleet, start=1):
        assert row.simulated
        names = CAMERA_MODELS[row.document["camera_model"]].parameter_names
        assert [row.truth[name] for name in names] == st16_truth(number).tolist()


def test_every_sensor_has_a_calibration_and_a_shorter_validation_set_that_read_back(filled):
    with open_reading(filled.engine) as session:
        for sensor in sensor_queries.sensors(session):
            found = telemetry_sets.list_telemetry_sets(session, sensor_id=sensor.id)
            assert {row.purpose: row.frames for row in found} == {"calibration": 200, "validation": 80}
        assert len(WorkingTable(filled.blobs.path(found[0].table_sha256))) == found[0].stars


def test_every_sensor_has_a_batch_and_a_filter_run_queued_with_validation_and_a_label(filled):
    with open_reading(filled.engine) as session:
        for sensor in sensor_queries.sensors(session):
            queued = runs.list_runs(session, sensor_id=sensor.id)
            assert sorted(run.method for run in queued) == ["batch", "sqrf"]
            assert all(run.state == "QUEUED" and run.label and run.validation_set_id for run in queued)


def test_batch_runs_are_queued_before_the_filters_that_take_longer(filled):
    with open_reading(filled.engine) as session:
        methods = [run.method for run in reversed(runs.list_runs(session))]
    assert methods == ["batch"] * 6 + ["sqrf"] * 6


def test_one_filter_runs_for_a_minute_and_the_others_together_no_longer(filled):
    with open_reading(filled.engine) as session:
        filters = runs.list_runs(session, method="sqrf")
    lasts_s = sorted(200 / run.settings["replay_frames_per_s"] for run in filters)
    assert 40 <= lasts_s[-1] <= 60
    assert sum(lasts_s[:-1]) <= lasts_s[-1]


def test_the_audit_log_tells_who_made_what_and_holds_together(filled):
    with open_reading(filled.engine) as session:
        records = audit.list_records(session, limit=500)
        assert audit.verify(session).ok
    made = {(record.actor, record.action) for record in records}
    assert {("Ada Analyst", "registered"), ("Ada Analyst", "uploaded"), ("Ada Analyst", "launched")} <= made
    assert {record.credential for record in records} == {"command line"}


def test_making_it_again_changes_nothing_and_gives_the_same_log_ins(filled):
    before = filled.content()
    already = len(filled.said)
    assert filled.create() == list(LOG_INS)
    assert filled.content() == before
    assert not any("queued" in sentence for sentence in filled.said[already:])
    assert sum("its batch run is there already" in sentence for sentence in filled.said[already:]) == 6


def test_archived_sets_and_edited_people_are_left_as_they_are(tmp_path):
    demonstration = Demonstration(tmp_path)
    demonstration.create()
    with open_writing(demonstration.engine) as session:
        analyst = users.authenticate(session, proved(session, "analyst", LOG_INS[0].password))
        administrator = users.authenticate(session, proved(session, "administrator", LOG_INS[3].password))
        for row in telemetry_sets.list_telemetry_sets(session, purpose="calibration"):
            telemetry_sets.archive_telemetry_set(session, analyst, row.id)
        viewer = next(user for user in users.list_users(session) if user.name == "viewer")
        users.disable_user(session, administrator, viewer.id)
    before = demonstration.content()
    demonstration.create()
    assert demonstration.content() == before


def test_a_demonstration_that_was_interrupted_is_completed(tmp_path, monkeypatch):
    demonstration = Demonstration(tmp_path)
    with monkeypatch.context() as interruption:
        interruption.setattr(runs, "launch", lambda *_, **__: pytest.fail("interrupted"))
        with pytest.raises(pytest.fail.Exception):
            demonstration.create()
    assert demonstration.content()["runs"] == []
    demonstration.create()
    content = demonstration.content()
    assert (len(content["people"]), len(content["sensors"]), len(content["sets"]), len(content["runs"])) == (
        5,
        6,
        12,
        12,
    )


def test_each_step_is_reported(filled):
    assert sum("telemetry" in sentence for sentence in filled.said[:9]) == 6
    assert sum("its batch run is queued" in sentence for sentence in filled.said[:9]) == 6
    assert "ready after" in filled.said[8]


def test_every_tracker_has_a_table_so_that_its_package_can_be_read_back(filled):
    with open_reading(filled.engine) as session:
        tables = [table_definitions.definition_in_force(session, row.id) for row in sensor_queries.sensors(session)]
    assert len(tables) == 6
    assert all(table is not None and table.number == 1 for table in tables)
