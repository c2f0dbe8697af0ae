"""The demonstration: what is there at once, what its people did when its runs had ended, and what a second start changes."""

import math
import time
from datetime import datetime

import pytest

from benchmarks.servers import wait_until
from boresight.cameras import CAMERA_MODELS
from boresight.cli.demonstration import DRIFTING_NUMBER, LOG_INS, continue_demonstration, create_demonstration
from boresight.console import list_queries as lists
from boresight.console.access import users
from boresight.console.access.tables import ROLES
from boresight.console.alarms import service as alarms
from boresight.console.approvals import service as approvals
from boresight.console.approvals.tables import Approval
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet.trend import judge_drift, read_trend
from boresight.console.ingest import service as ingest
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.parameter_sets import queries as parameter_set_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.tables import TERMINAL_RUN_STATES
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.tables import Package, Uplink
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.sessions import migrate, open_engine, open_reading, open_writing
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_truth
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.working_table import WorkingTable
from boresight.workers.dispatcher import RunDispatcher
from tests.passwords import proved
from tests.stores import environment_in


class Demonstration:
    """A store filled once, and what was said meanwhile."""

    def __init__(self, folder):
        named = {"BORESIGHT_DATA_FOLDER": str(folder), "BORESIGHT_WORKERS": "1"}
        self.settings = read_settings(named | environment_in(folder))
        self.engine = open_engine(self.settings.database_url)
        self.blobs = open_blobs(self.settings.blob_location)
        self.catalogue = load_catalogue(self.settings.catalogue_folder)
        self.said = []
        migrate(self.engine)

    def create(self, **choices):
        """Make the demonstration, or what is missing of it."""
        return create_demonstration(self.engine, self.blobs, self.catalogue, self.said.append, **choices)

    def go_on(self):
        """Have its people go on, as often as they can."""
        return continue_demonstration(self.engine, self.blobs, self.catalogue, self.said.append)

    def has_ended(self):
        with open_reading(self.engine) as session:
            return all(run.state in TERMINAL_RUN_STATES for run in runs.list_runs(session))

    def sensor(self, session, number):
        return sensor_queries.find_sensor(session, f"ST16-{number}")

    def content(self):
        """Return everything the demonstration makes, as the services list it."""
        with open_reading(self.engine) as session:
            return {
                "people": [(user.name, user.password_hash, user.roles) for user in users.list_users(session)],
                "sensors": [(row.id, row.name, row.version) for row in sensor_queries.list_sensors(session)],
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
    started_s = time.process_time()
    demonstration.log_ins = demonstration.create()
    demonstration.took_s = time.process_time() - started_s
    return demonstration


@pytest.mark.full
def test_the_demonstration_is_made_in_under_ten_seconds_of_one_processor(filled):
    assert filled.took_s < 10.0


def test_every_role_has_a_person_who_can_log_in_with_the_printed_password(filled):
    assert {role for person in filled.log_ins for role in person.roles} == set(ROLES)
    for person in filled.log_ins:
        with open_writing(filled.engine) as session:
            actor = users.authenticate(session, proved(session, person.name, person.password))
        assert actor.roles == set(person.roles)


def test_six_simulated_sensors_carry_their_truth_but_the_one_whose_truth_changes_with_time(filled):
    with open_reading(filled.engine) as session:
        fleet = sensor_queries.list_sensors(session)
    assert [row.name for row in fleet] == [f"ST16-{number}" for number in range(1, 7)]
    for number, row in enumerate(fleet, start=1):
        assert row.simulated
        names = CAMERA_MODELS[row.document["camera_model"]].parameter_names
        if number == DRIFTING_NUMBER:
            assert row.truth is None
        else:
            assert [row.truth[name] for name in names] == st16_truth(number).tolist()


def test_every_sensor_has_a_calibration_and_a_shorter_validation_set_that_read_back(filled):
    with open_reading(filled.engine) as session:
        for sensor in sensor_queries.list_sensors(session):
            found = telemetry_sets.list_telemetry_sets(session, sensor_id=sensor.id)
            assert {"calibration", "validation"} == {row.purpose for row in found}
            for row in found:
                assert row.frames < 200 if row.purpose == "validation" or "without" in row.name else row.frames >= 200
        assert len(WorkingTable(filled.blobs.path(found[0].table_sha256))) == found[0].stars


def test_every_sensor_has_a_batch_and_a_filter_run_queued_with_validation_and_a_label(filled):
    with open_reading(filled.engine) as session:
        for sensor in sensor_queries.list_sensors(session):
            queued = runs.list_runs(session, sensor_id=sensor.id)
            assert all(run.state == "QUEUED" and run.label for run in queued)
            assert {"batch", "sqrf"} == {run.method for run in queued if run.validation_set_id}


def test_two_filters_run_on_for_ten_minutes_and_wait_for_the_batch_runs_alone(filled):
    with open_reading(filled.engine) as session:
        queued = runs.list_runs(session)[::-1]
        rates = [run.settings.get("replay_frames_per_s") or 0.0 for run in queued]
        lasts_s = [
            session.get_known(TelemetrySet, run.telemetry_set_id).frames / pace
            for run, pace in zip(queued, rates, strict=True)
            if pace
        ]
    assert lasts_s == [600.0, 600.0]
    assert [run.method for run in queued[:8]] == ["batch"] * 6 + ["sqrf"] * 2
    assert all(rates[6:8])


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
    assert sum("batch run already in the store" in sentence for sentence in filled.said[already:]) == 6


@pytest.mark.full
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


@pytest.mark.full
def test_a_demonstration_that_was_interrupted_is_completed(tmp_path, monkeypatch):
    demonstration = Demonstration(tmp_path)
    with monkeypatch.context() as interruption:
        interruption.setattr(runs, "launch", lambda *_, **__: pytest.fail("interrupted"))
        with pytest.raises(pytest.fail.Exception):
            demonstration.create()
    assert demonstration.content()["runs"] == []
    demonstration.create()
    content = demonstration.content()
    assert [len(content[what]) for what in ("people", "sensors", "sets", "runs")] == [5, 6, 15, 14]


def test_each_step_is_reported(filled):
    assert sum("telemetry" in sentence for sentence in filled.said[:9]) == 6
    assert sum("batch run queued" in sentence for sentence in filled.said[:9]) == 6
    assert "ready after" in filled.said[8]


def test_every_tracker_has_a_table_so_that_its_package_can_be_read_back(filled):
    with open_reading(filled.engine) as session:
        tables = [
            table_definitions.find_definition_in_force(session, row.id) for row in sensor_queries.list_sensors(session)
        ]
    assert len(tables) == 6
    assert all(table is not None and table.number == 1 for table in tables)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The demonstration with all its runs computed, no filter of ten minutes among them, and its people at an end."""
    demonstration = Demonstration(tmp_path_factory.mktemp("told"))
    demonstration.create(watched=0)
    dispatcher = RunDispatcher(demonstration.engine, demonstration.settings)
    dispatcher.start()
    try:
        people = demonstration.go_on()
        wait_until(lambda: next(people, "at an end") == "at an end" and demonstration.has_ended(), 300.0, 0.1)
    finally:
        dispatcher.stop()
    assert not [sentence for sentence in demonstration.said if "left out" in sentence]
    return demonstration


@pytest.mark.full
def test_one_set_waits_for_a_signature_that_the_approver_may_give(told):
    with open_reading(told.engine) as session:
        (request,) = lists.list_newest(session, Approval, state="OPEN")
        row = session.get_known(ParameterSet, request.parameter_set_id)
        assert (row.name, row.ground_state) == ("PS-ST16-2-1", "SUBMITTED")
        (signer,) = approvals.list_request_signers(session, request.id)
    assert (signer.user.name, signer.refusal) == ("approver", None)


@pytest.mark.full
def test_one_set_is_sent_and_nothing_was_read_back(told):
    with open_reading(told.engine) as session:
        row = parameter_set_rows.find_baseline(session, told.sensor(session, 3).id)
        assert (row.name, row.ground_state, row.onboard_state) == ("PS-ST16-3-1", "BASELINE", "SENT")
        (record,) = lists.list_newest(session, Uplink, set=row.id)
        assert session.get_known(Package, record.evidence["package"]["id"]).parameter_set_id == row.id


@pytest.mark.full
def test_a_year_of_passes_since_the_baseline_raised_a_drift_alarm(told):
    with open_reading(told.engine) as session:
        sensor = told.sensor(session, 4)
        found = read_trend(session, sensor.id)
        drift = judge_drift(found)
        (alarm,) = alarms.list_alarms(session)
    counted = found.independent
    assert (alarm.kind, alarm.sensor_id, alarm.active) == ("DRIFT", sensor.id, 1)
    assert (drift.verdict, drift.largest[0], drift.counted) == ("DRIFT", "f_m", 28)
    assert drift.holds.rejects
    assert drift.slope.rejects
    days = (datetime.fromisoformat(counted[-1].at_utc) - datetime.fromisoformat(counted[0].at_utc)).days
    assert 360 <= days <= 370
    slope = drift.line.slope_per_d[drift.names.index("f_m")]
    sigma = math.sqrt(drift.line.slope_covariance[drift.names.index("f_m"), drift.names.index("f_m")])
    assert abs(slope + 3.5e-8) < 4 * sigma < 2e-8


@pytest.mark.full
def test_a_new_pass_of_two_sensors_is_judged_by_policies_that_were_rehearsed(told):
    with open_reading(told.engine) as session:
        found = {row.sensor_id: row for row in lists.list_newest(session, IngestDecision)}
        states = {number: ingest.examine(session, row.id).judgement.state for number, row in found.items()}
        rehearsed = lists.list_newest(session, IngestPolicy, sensor=told.sensor(session, 4).id)[0].rehearsal
    assert states == {3: "WITHIN FORECAST", 4: "ASKED"}
    assert rehearsed["sets"] > 20
    assert 1 <= rehearsed["asked"] < rehearsed["sets"]


@pytest.mark.full
def test_one_run_failed_and_says_why(told):
    with open_reading(told.engine) as session:
        (run,) = runs.list_runs(session, state="FAILED")
        assert run.sensor_id == told.sensor(session, 6).id
    assert "add a time_utc column" in run.reason


@pytest.mark.full
def test_what_the_people_did_is_on_record_and_holds_together(told):
    with open_reading(told.engine) as session:
        assert audit.verify(session).ok
        made = {(record.actor, record.action) for record in audit.list_records(session, limit=5000)}
    assert {("Ada Analyst", "submitted"), ("Alan Approver", "approved"), ("Olga Operator", "promoted")} <= made
    assert ("Olga Operator", "recorded SENT for") in made


@pytest.mark.full
def test_a_second_start_finds_everything_done(told):
    before = told.content()
    told.create(watched=0)
    assert set(told.go_on()) == {None}
    assert told.content() == before


@pytest.mark.full
def test_a_filter_that_was_watched_to_its_end_is_followed_by_another(told):
    told.create(watched=1)
    with open_reading(told.engine) as session:
        (run,) = runs.list_runs(session, state="QUEUED")
    assert (run.sensor_id, run.settings["replay_frames_per_s"]) == (1, 1.0)
