"""Campaigns: one setting over many sensors, counted, stopped and launched again as one, a thousand sensors in one transaction."""

import re
import time

import pytest
import sqlalchemy as sa

from boresight.console.campaigns import service as campaigns
from boresight.console.campaigns.service import MemberRequest, make_result_line
from boresight.console.campaigns.tables import CampaignRun
from boresight.console.runs import service as runs
from boresight.console.runs.tables import Run, RunEvent
from boresight.console.telemetry import service as telemetry_sets
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.conftest import SENSOR
from tests.console.fleet.fleets import add_fleet, add_sets
from tests.refusals import has_code

BATCH = {"method": "batch"}


@pytest.fixture
def fleet(engine, people, blobs):  # noqa: ARG001 - people are made in a transaction of their own, before this one begins
    with open_writing(engine) as session:
        return add_fleet(session, blobs, SENSOR, 3)


@pytest.fixture
def session(engine, fleet):  # noqa: ARG001 - the fleet is made in a transaction of its own
    with open_writing(engine) as session:
        yield session


@pytest.fixture
def launch(session, people):
    def launch(members=None, settings=BATCH, label="after eclipse", actor="ana", **options):
        return campaigns.launch_campaign(session, people[actor], label, settings, members, **options)

    return launch


def _end(session, people, run_id, state, **columns):
    row = session.get_one(Run, run_id)
    row.state = state
    for name, value in columns.items():
        setattr(row, name, value)
    session.flush()
    audit.append(session, people["ana"], "ended", f"runs/{run_id}")


def test_every_sensor_gets_a_run_on_its_newest_sets_and_one_without_telemetry_the_cause(session, blobs, fleet, launch):
    add_sets(session, blobs, fleet[:1])
    row = launch()
    standings = {one.sensor_id: one for one in campaigns.list_results(session, row.id)}
    assert set(standings) == {1, *fleet}
    assert standings[1].run_id is None
    assert standings[1].refusal.startswith("ST16-1 ")
    newest = max(
        known.id for known in telemetry_sets.list_telemetry_sets(session, sensor_id=fleet[0], purpose="calibration")
    )
    assert standings[fleet[0]].telemetry_set_id == newest
    for sensor_id in fleet:
        run = runs.get_run(session, standings[sensor_id].run_id)
        assert (run.state, run.label, run.settings["linearisations"]) == ("QUEUED", "after eclipse", 6)
        assert run.validation_set_id is not None
        assert [event.message for event in runs.list_log_lines(session, run.id)] == ["QUEUED"]


def test_sets_can_be_named_and_validation_left_out(session, fleet, launch):
    calibration = telemetry_sets.list_telemetry_sets(session, sensor_id=fleet[1], purpose="validation")[0]
    row = launch([MemberRequest(fleet[0], validation_set_id=None), MemberRequest(fleet[1], calibration.id, None)])
    first, second = campaigns.list_results(session, row.id)
    assert first.validation_set_id is None
    assert second.telemetry_set_id == calibration.id


def test_a_set_of_another_sensor_is_that_sensors_cause_and_not_the_campaigns(session, fleet, launch):
    other = telemetry_sets.list_telemetry_sets(session, sensor_id=fleet[1], purpose="calibration")[0]
    row = launch([MemberRequest(fleet[0], other.id), MemberRequest(fleet[1])])
    first, second = campaigns.list_results(session, row.id)
    assert "another sensor" in first.refusal
    assert second.state == "QUEUED"


def test_a_dry_run_says_what_it_would_be_and_queues_nothing(session, launch):
    said = launch(validate_only=True, preset="drift-tracking", settings={"process_noise_sigma": 0.1})
    assert (said["sensors"], said["runs"], said["preset"]) == (4, 3, "Drift tracking")
    assert said["settings"]["process_noise_sigma"] == 0.1
    assert said["predicted_s"] > 0
    assert [one["sensor"] for one in said["refused"]] == ["ST16-1"]
    assert session.query(Run).count() == session.query(CampaignRun).count() == 0


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"label": " "}, RefusedInputError, "Give the campaign a label"),
        ({"label": "l" * 201}, RefusedInputError, "shorten it to 200"),
        ({"members": []}, RefusedInputError, "at least one sensor"),
        ({"members": [MemberRequest(1), MemberRequest(1)]}, RefusedInputError, "contains a sensor twice"),
        ({"members": [MemberRequest(99)]}, NotFoundError, "There is no sensor 99"),
        (
            {"members": [MemberRequest(n) for n in range(1001)]},
            RefusedInputError,
            "at most 1000 sensors; 1001 were chosen",
        ),
        (
            {"members": [MemberRequest(1)]},
            RefusedInputError,
            "No run can be launched for any sensor of the campaign. ST16-1 has no calibration",
        ),
        ({"settings": {"method": "magic"}}, RefusedInputError, "choose from batch"),
        ({"preset": "magic"}, NotFoundError, "There is no preset"),
        ({"actor": "eve"}, ForbiddenError, "requires the role analyst"),
    ],
)
def test_what_is_no_campaign_is_refused(launch, given, error, said):
    with pytest.raises(error, match=said):
        launch(**given)


def test_states_are_counted_and_the_campaign_has_one_word_and_one_fraction(session, people, launch):
    row = launch()
    first, second, third = (one.run_id for one in campaigns.list_results(session, row.id) if one.run_id)
    view = campaigns.read_campaign(session, row.id)
    assert (view.sensors, view.ended, view.failed, view.state) == (4, 1, 1, "UNDER WAY")
    assert view.fraction == 0.25
    _end(session, people, first, "SUCCEEDED")
    _end(session, people, second, "FAILED", reason="No stars.")
    _end(session, people, third, "SUCCEEDED")
    view = campaigns.list_campaigns(session)[0]
    assert (view.counts["SUCCEEDED"], view.counts["FAILED"], view.counts["NOT LAUNCHED"]) == (2, 1, 1)
    assert (view.fraction, view.state) == (1.0, "ENDED")


def test_a_campaign_whose_every_run_succeeded_says_so(session, people, fleet, launch):
    row = launch([MemberRequest(number) for number in fleet])
    for one in campaigns.list_results(session, row.id):
        summary = {"level": "normal", "rms_final_arc_rad": 1e-5, "weak_directions": 1}
        _end(session, people, one.run_id, "SUCCEEDED", summary=summary)
    assert campaigns.read_campaign(session, row.id).state == "SUCCEEDED"
    line = make_result_line(campaigns.list_results(session, row.id)[0])
    expected = {"state": "SUCCEEDED", "rms_initial_arc_rad": None, **summary}
    assert {name: line[name] for name in expected} == expected


def test_cancelling_stops_what_waits_and_what_computes_and_leaves_what_ended(session, people, launch):
    row = launch()
    first, second, third = (one.run_id for one in campaigns.list_results(session, row.id) if one.run_id)
    _end(session, people, first, "SUCCEEDED")
    _end(session, people, second, "RUNNING")
    campaigns.cancel_campaign(session, people["ana"], row.id, "wrong settings")
    states = {one.run_id: (one.state, one.reason) for one in campaigns.list_results(session, row.id)}
    assert states[first] == ("SUCCEEDED", None)
    assert states[second][0] == "CANCELLING"
    assert states[third][0] == "CANCELLED"
    assert re.search(f"campaign {row.id} .* Ana: wrong settings", states[third][1])
    assert campaigns.read_campaign(session, row.id).state == "CANCELLING"
    _end(session, people, second, "CANCELLED")
    assert campaigns.read_campaign(session, row.id).state == "CANCELLED"
    assert audit.find_last_change(session, f"runs/{third}").action == "cancelled"
    with pytest.raises(ConflictError, check=has_code("nothing-to-cancel")):
        campaigns.cancel_campaign(session, people["ana"], row.id)


def test_the_failed_are_launched_again_and_the_newest_run_of_each_counts(session, people, blobs, launch):
    row = launch()
    first, second, third = (one for one in campaigns.list_results(session, row.id) if one.run_id)
    _end(session, people, first.run_id, "SUCCEEDED")
    _end(session, people, second.run_id, "FAILED", reason="No stars.")
    _end(session, people, third.run_id, "LOST", reason="Gone.")
    add_sets(session, blobs, [1], ("calibration",))
    campaigns.relaunch_failed(session, people["ana"], row.id)
    after = {one.sensor_id: one for one in campaigns.list_results(session, row.id)}
    assert len(after) == 4
    assert after[first.sensor_id].run_id == first.run_id
    for former in (second, third):
        again = after[former.sensor_id]
        assert again.state == "QUEUED"
        assert again.run_id > former.run_id
        assert (again.telemetry_set_id, again.validation_set_id) == (former.telemetry_set_id, former.validation_set_id)
    assert after[1].state == "QUEUED"
    assert campaigns.read_campaign(session, row.id).sensors == 4
    assert runs.get_run(session, second.run_id).state == "FAILED"
    with pytest.raises(ConflictError, check=has_code("nothing-to-relaunch")):
        campaigns.relaunch_failed(session, people["ana"], row.id)


@pytest.mark.parametrize("move", [campaigns.cancel_campaign, campaigns.relaunch_failed])
def test_only_an_analyst_stops_and_launches_again(session, people, launch, move):
    row = launch()
    for name in ("eve", "cy", "dee", "root"):
        with pytest.raises(ForbiddenError, match="analyst", check=has_code("role-missing")):
            move(session, people[name], row.id)
    with pytest.raises(NotFoundError, match="campaign 99"):
        move(session, people["ana"], 99)


@pytest.mark.full
def test_a_thousand_sensors_are_one_transaction_of_few_statements_with_every_run_on_record(engine, people, blobs):
    with open_writing(engine) as session:
        add_fleet(session, blobs, SENSOR, 1000 - 1)
    counted = []
    sa.event.listen(engine, "before_cursor_execute", lambda *args: counted.append(args[2]))
    began = time.perf_counter()
    with open_writing(engine) as session:
        row = campaigns.launch_campaign(session, people["ana"], "the whole fleet", BATCH)
    launched_s, launching = time.perf_counter() - began, len(counted)
    with open_reading(engine) as session:
        counted.clear()
        view = campaigns.list_campaigns(session)[0]
        standings = campaigns.list_results(session, row.id)
        read = len(counted)
        assert session.scalar(sa.select(sa.func.count()).select_from(RunEvent)) == 999
        rows_of = session.scalars(sa.select(AuditRecord.rows).where(AuditRecord.rows.is_not(None))).all()

    assert (view.sensors, view.counts["QUEUED"], len(standings)) == (1000, 999, 1000)
    assert launching < 100
    assert read <= 5
    assert launched_s < 10
    assert (
        max(map(len, rows_of[-5:])) <= 402
    )  # two hundred runs, their places, the campaign, and the newest line of the log
    with open_writing(engine) as session:
        counted.clear()
        campaigns.cancel_campaign(session, people["ana"], row.id)
    assert len(counted) < 40
    with open_reading(engine) as session:
        assert campaigns.read_campaign(session, row.id).counts["CANCELLED"] == 999
        assert audit.verify(session).ok
