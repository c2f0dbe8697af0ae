"""New telemetry over REST: who may send, draft, enable, answer and resume; what is refused on record; what runs away is stopped."""

import pytest

from boresight.console.approvals import service as approvals
from boresight.console.ingest import policies, service
from boresight.errors import ForbiddenError
from boresight.platform.actors import INGEST
from boresight.platform.db.sessions import open_writing
from tests.console.ingest.decisions import (
    asked,
    days_from_now,
    draft,
    in_force,
    received,
    recent_csv,
    send,
    step,
    versioned,
)


def _policy(house, row):
    return house.person("victor").get(f"/api/v1/ingest-policies/{row['id']}").json()


def _decisions(house, sensor_id):
    answer = house.person("victor").get("/api/v1/ingest-decisions", params={"sensor_id": sensor_id})
    return answer.json()["items"]


def _alarm(house, sensor_id):
    found = house.person("ada").get("/api/v1/alarms", params={"sensor_id": sensor_id, "kind": "INGEST"})
    return [one["active"] for one in found.json()["items"]]


def test_telemetry_is_sent_by_a_key_with_the_scope_and_calibrated_by_the_service(house):
    policy = in_force(house)
    sensor_id = policy["sensor_id"]
    assert send(house, sensor_id, client=house.person("victor")).status_code == 403
    assert send(house, sensor_id, client=house.key("ada", "runs")).status_code == 403
    answer = send(house, sensor_id, client=house.key("ada", "telemetry-sets"))
    row = answer.json()
    assert (answer.status_code, row["state"], row["source"]) == (202, "CALIBRATING", "REST")
    assert answer.headers["location"] == f"/api/v1/ingest-decisions/{row['id']}"
    run = house.person("victor").get(f"/api/v1/runs/{row['run_id']}").json()
    assert (run["state"], run["launched_by"], run["telemetry_set_id"]) == ("QUEUED", None, row["telemetry_set_id"])
    again = send(house, sensor_id)
    assert again.json()["id"] == row["id"]
    assert len(_decisions(house, sensor_id)) == 1


def test_without_a_policy_in_force_nothing_is_taken_in(house):
    sensor_id = house.new_sensor()["id"]
    draft(house, sensor_id)
    assert send(house, sensor_id).status_code == 409
    assert _decisions(house, sensor_id) == []


def test_a_policy_holds_only_after_a_dry_run_and_by_an_administrator_in_person(house):
    row = draft(house, house.new_sensor()["id"])
    address, adele = f"/api/v1/ingest-policies/{row['id']}:enable", house.person("adele")
    assert adele.post(address, headers=versioned(row)).status_code == 409
    row = step(house, row, "rehearse")
    assert row["rehearsal"]["sets"] == 0
    assert house.person("ada").post(address, headers=versioned(row)).status_code == 403
    assert house.key("adele", "telemetry-sets").post(address, headers=versioned(row)).status_code == 403
    assert adele.post(address, headers=versioned({"version": 1})).status_code == 412
    row = step(house, row, "enable", "adele")
    newer = step(house, step(house, draft(house, row["sensor_id"], confirmations=2), "rehearse"), "enable", "adele")
    assert (_policy(house, row)["state"], newer["state"], newer["number"]) == ("OFF", "ACTIVE", 2)
    assert (
        house.person("victor").post("/api/v1/ingest-policies", json={"sensor_id": 1, "reason": "x"}).status_code == 403
    )
    bad = {"sensor_id": row["sensor_id"], "rules": {"preset": "nobody's"}, "reason": "x"}
    assert house.person("ada").post("/api/v1/ingest-policies", json=bad).status_code == 404


def test_one_file_too_many_stops_the_policy_with_an_alarm_until_a_person_resumes_it(house):
    policy = in_force(house, sets_per_day=1)
    sensor_id = policy["sensor_id"]
    assert send(house, sensor_id).status_code == 202
    more = recent_csv(house, -9)
    assert send(house, sensor_id, more, params={"validate_only": "true"}).status_code == 409
    assert _policy(house, policy)["state"] == "ACTIVE"  # a dry run stops nothing
    assert send(house, sensor_id, more).status_code == 409
    found = _policy(house, policy)
    assert (found["state"], found["pause_code"]) == ("PAUSED", "TOO MANY SETS")
    assert _alarm(house, sensor_id) == [True]
    assert send(house, sensor_id, more).status_code == 409
    refused = house.key("ada", "telemetry-sets").post(
        f"/api/v1/ingest-policies/{policy['id']}:resume", json={"reason": "x"}, headers=versioned(found)
    )
    assert refused.status_code == 403
    step(house, found, "resume", reason="The backlog of a week.")
    assert _alarm(house, sensor_id) == [False]
    assert send(house, sensor_id, more).status_code == 202


@pytest.mark.parametrize("days", [3, -500])
def test_times_that_cannot_be_are_refused_on_record_and_stop_the_policy(house, days):
    policy = in_force(house)
    answer = send(house, policy["sensor_id"], recent_csv(house, days))
    assert (answer.status_code, answer.json()["state"]) == (202, "REFUSED")
    assert days_from_now(days).decode() in answer.json()["sentence"]
    assert _policy(house, policy)["pause_code"] == "BAD CLOCK"
    assert answer.json()["telemetry_set_id"] is None


def test_the_stars_of_another_sensor_are_refused_on_record_and_stop_the_policy(house):
    own = house.new_sensor()
    document = house.sensor_file()
    other = {**document, "initial": {**document["initial"], "f_m": 1.25 * document["initial"]["f_m"]}}
    sensor_id = house.person("ada").post("/api/v1/sensors", json=other).json()["id"]
    policy = in_force(house, sensor_id)
    answer = send(house, sensor_id)
    assert answer.status_code == 422, own
    found = _policy(house, policy)
    assert (found["state"], found["pause_code"]) == ("PAUSED", "WRONG SENSOR")
    assert [one["state"] for one in _decisions(house, sensor_id)] == ["REFUSED"]


def test_failures_in_a_row_stop_the_policy_and_a_dry_run_leaves_no_trace(house):
    policy = in_force(house, failures_in_row=2)
    sensor_id = policy["sensor_id"]
    assert send(house, sensor_id, b"frame\n?", params={"validate_only": "true"}).status_code == 422
    assert _decisions(house, sensor_id) == []
    for content in (b"frame\n1", b"frame\n2"):
        assert _policy(house, policy)["state"] == "ACTIVE"
        assert send(house, sensor_id, content).status_code == 422
    assert _policy(house, policy)["pause_code"] == "FAILURES"
    assert [one["state"] for one in _decisions(house, sensor_id)] == ["REFUSED", "REFUSED"]


def test_only_an_analyst_in_person_answers_and_submitting_makes_them_the_first_of_two(house):
    row = asked(house)
    address, body = f"/api/v1/ingest-decisions/{row['id']}:answer", {"answer": "SUBMIT", "reason": "It moved."}
    for client in (house.key("ada", "parameter-sets", "telemetry-sets"), house.person("alan"), house.person("adele")):
        assert client.post(address, json=body, headers=versioned(row)).status_code == 403
    assert house.person("bo").post(address, json={**body, "reason": " "}, headers=versioned(row)).status_code == 422
    said = house.person("bo").post(address, json=body, headers=versioned(row)).json()
    request = house.person("bo").get(f"/api/v1/approvals/{said['approval_id']}").json()
    assert (said["state"], request["state"]) == ("ANSWERED", "OPEN")
    assert house.sign("bo", request).status_code == 403  # an approver too, and the first of the two
    assert house.sign("alan", request).status_code == 200
    again = house.person("bo").post(address, json=body, headers={"If-Match": f'"v{said["version"]}"'})
    assert again.status_code == 409


def test_the_service_itself_can_neither_submit_nor_sign_nor_promote_nor_enable(house):
    row, policy = asked(house), in_force(house)
    given = service.DecisionAnswer("SUBMIT", "x")
    with open_writing(house.app.state.engine) as session:
        blobs, number = house.app.state.blobs, row["parameter_set_id"]
        for attempt in (
            lambda: approvals.submit(session, INGEST, blobs, number, "x", 1),
            lambda: approvals.promote(session, INGEST, number, 1),
            lambda: service.answer(session, INGEST, blobs, row["id"], given, row["version"]),
            lambda: policies.enable(session, INGEST, policy["id"], policy["version"]),
            lambda: policies.resume(session, INGEST, policy["id"], "x", policy["version"]),
        ):
            with pytest.raises(ForbiddenError):
                attempt()
        assert approvals.find_signatory(session, INGEST) is None


def test_a_decision_is_read_with_its_file_and_listed_by_state(house):
    row = received(house)
    found = house.person("victor").get("/api/v1/ingest-decisions", params={"state": "CALIBRATING"}).json()["items"]
    assert row["id"] in [one["id"] for one in found]
    assert (row["file_name"], row["size_bytes"]) == ("pass.csv", len(recent_csv(house)))
