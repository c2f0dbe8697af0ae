"""From candidate to baseline over REST: two people, versions, and what a key may never do."""

import hashlib
import re
from typing import Any

import orjson
import pytest

from boresight.platform.audit.queries import find_response
from boresight.platform.db.sessions import open_reading
from tests.console.approvals.gates import TIGHT, a_waiver, blocked, tight_profile
from tests.served import PASSWORD, House


def _tag(row: dict[str, Any]) -> dict[str, str]:
    return {"If-Match": f'"v{row["version"]}"'}


def test_a_set_goes_from_candidate_to_baseline_and_the_one_before_is_superseded(house):
    approval = house.submitted()
    signed = house.sign("alan", approval)
    assert signed.json()["state"] == "APPROVED"
    assert [signature["printed_name"] for signature in signed.json()["signatures"]] == ["Alan"]
    assert signed.json()["signatures"][0]["password_by"].startswith("given by Command line at ")
    olga = house.person("olga")
    address = f"/api/v1/parameter-sets/{approval['parameter_set_id']}"
    row = olga.get(address)
    promoted = olga.post(f"{address}:promote", headers={"If-Match": row.headers["etag"]})
    assert (promoted.status_code, promoted.json()["ground_state"]) == (200, "BASELINE")
    assert promoted.headers["etag"] == f'"v{promoted.json()["version"]}"'
    sets = olga.get("/api/v1/parameter-sets", params={"sensor_id": row.json()["sensor_id"]}).json()["items"]
    assert [found["ground_state"] for found in sets] == ["BASELINE", "SUPERSEDED"]


def test_the_same_run_gives_the_same_candidate(house):
    run_id = house.finished()
    first, second = (house.person("ada").post("/api/v1/parameter-sets", json={"run_id": run_id}) for _ in range(2))
    assert first.json()["id"] == second.json()["id"]
    assert first.json()["name"].startswith("PS-")


def test_a_run_that_did_not_end_well_makes_no_set(house):
    answer = house.person("ada").post("/api/v1/parameter-sets", json={"run_id": house.launched()["id"]})
    assert answer.status_code == 409


@pytest.mark.parametrize("decision", ["approve", "refuse"])
def test_a_key_of_an_approver_cannot_sign(house, decision):
    approval = house.submitted()
    every_scope = ("sensors", "telemetry-sets", "runs", "parameter-sets", "uplinks")
    answer = house.key("alan", *every_scope).post(
        f"/api/v1/approvals/{approval['id']}:{decision}",
        json={"meaning": "I approve.", "password": PASSWORD, "comment": "Seen."},
        headers=_tag(approval),
    )
    assert answer.status_code == 403
    assert answer.json()["code"] == "not-a-person"


def test_a_signature_sent_again_with_its_key_gets_the_first_answer_and_keeps_no_password(house):
    approval = house.submitted()
    body = {"meaning": "I approve.", "password": PASSWORD, "comment": "Seen."}
    address, headers = f"/api/v1/approvals/{approval['id']}:approve", {**_tag(approval), "Idempotency-Key": "sign-once"}
    first, again = (house.person("alan").post(address, json=body, headers=headers) for _ in range(2))
    assert (first.status_code, again.status_code) == (200, 200)
    assert again.json() == first.json()
    assert again.headers["idempotent-replayed"] == "true"
    other = house.person("alan").post(address, json={**body, "comment": "Other."}, headers=headers)
    assert other.status_code == 422
    bare = orjson.dumps({"meaning": "I approve.", "comment": "Seen."})
    with open_reading(house.app.state.engine) as session:
        kept = find_response(session, "sign-once", "alan session")
        assert kept.request_sha256 == hashlib.sha256(f"POST {address}?\n".encode() + bare).hexdigest()


def test_a_password_that_is_only_tried_counts_all_the_same(house):
    approval, name = house.submitted(), "alan"
    address, body = f"/api/v1/approvals/{approval['id']}:approve", {"meaning": "x", "password": "not the password"}
    before = _failures(house, name)
    answer = house.person(name).post(address, params={"validate_only": "true"}, json=body, headers=_tag(approval))
    assert (answer.status_code, _failures(house, name)) == (401, before + 1)


def _failures(house: House, name: str) -> int:
    counts = house.app.state.passwords._limiter._counts
    return sum(count.failures for key, count in counts.items() if isinstance(key, tuple) and key[0] == name)


def test_a_refusal_needs_a_comment_and_blocks(house):
    approval = house.submitted()
    assert house.sign("alan", approval, "refuse", comment=" ").status_code == 422
    assert house.sign("alan", approval, "refuse", comment="Too few frames.").json()["state"] == "REJECTED"
    row = house.person("ada").get(f"/api/v1/parameter-sets/{approval['parameter_set_id']}").json()
    assert row["ground_state"] == "REJECTED"


def test_a_second_submitter_from_the_same_version_is_told_who_was_first(house):
    row, address = house.candidate(), "/api/v1/parameter-sets/{id}:submit"
    first = house.person("ada").post(address.format(**row), json={"reason": "It moved."}, headers=_tag(row))
    second = house.person("bo").post(address.format(**row), json={"reason": "It moved."}, headers=_tag(row))
    assert (first.status_code, second.status_code) == (201, 412)
    assert second.json()["code"] == "changed-since-read"
    assert "Ada submitted" in second.json()["detail"]


def test_a_submission_sent_again_with_its_key_opens_one_request(house):
    row, headers = house.candidate(), {"Idempotency-Key": "submit-once"}
    address = f"/api/v1/parameter-sets/{row['id']}:submit"
    first, again = (
        house.person("ada").post(address, json={"reason": "It moved."}, headers={**_tag(row), **headers})
        for _ in range(2)
    )
    assert (first.status_code, again.status_code) == (201, 201)
    assert again.json() == first.json()
    assert again.headers["idempotent-replayed"] == "true"


def test_a_request_binds_the_report_of_its_gates_and_says_until_when_it_waits(house):
    approval = house.submitted()
    assert approval["bound"]["gate_report_sha256"]
    assert approval["bound"]["profile_sha256"]
    assert (approval["kind"], approval["needed"]) == ("PROMOTION", 1)
    assert approval["expires_utc"] > approval["submitted_utc"]


@pytest.mark.parametrize("tag", ["v1", "1", "*", '"v-1"', '""', '"vx"'])
def test_a_tag_that_is_no_version_matches_nothing(house, tag):
    row = house.candidate()
    answer = house.person("ada").post(
        f"/api/v1/parameter-sets/{row['id']}:submit", json={"reason": "x"}, headers={"If-Match": tag}
    )
    assert answer.status_code == 412


def test_the_etag_of_a_read_is_what_the_transition_takes(house):
    row = house.candidate()
    read = house.person("ada").get(f"/api/v1/parameter-sets/{row['id']}")
    answer = house.person("ada").post(
        f"/api/v1/parameter-sets/{row['id']}:submit", json={"reason": "x"}, headers={"If-Match": read.headers["etag"]}
    )
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/api/v1/approvals/{answer.json()['id']}"


def test_what_was_baseline_at_a_time_is_one_question(house):
    sensor = house.new_sensor()
    client = house.person("victor")
    address = f"/api/v1/sensors/{sensor['id']}/history"
    before = client.get(address, params={"at": "2001-01-01T00:00:00Z"}).json()
    after = client.get(address, params={"at": "2099-01-01T00:00:00Z"}).json()
    assert before["baseline"] is None
    assert after["baseline"]["name"] == f"PS-{sensor['name']}-0"
    assert client.get(address, params={"at": "yesterday"}).status_code == 422


def test_every_step_is_in_the_audit_log_with_its_request(house):
    approval = house.submitted()
    house.sign("alan", approval)
    found = (
        house.person("victor").get("/api/v1/audit", params={"object": f"approvals/{approval['id']}"}).json()["items"]
    )
    assert [record["action"] for record in found] == ["approved", "opened"]
    assert [record["actor"] for record in found] == ["Alan", "Ada"]
    assert all(record["request_id"] for record in found)
    assert PASSWORD not in str(found)


def test_the_chain_verifies_and_knows_a_head_it_never_had(house):
    client = house.person("victor")
    good = client.get("/api/v1/audit/verification").json()
    assert good["ok"]
    assert client.get("/api/v1/audit/verification", params={"expected_head": good["head"]}).json()["ok"]
    assert not client.get("/api/v1/audit/verification", params={"expected_head": "ab" * 32}).json()["ok"]


def test_limits_are_set_from_the_version_that_was_seen_and_listed_newest_first(house):
    sensor = house.new_sensor()
    address, adele = f"/api/v1/sensors/{sensor['id']}/gate-profiles", house.person("adele")
    first = adele.get(address)
    assert (first.headers["etag"], len(first.json()["items"])) == ('"v0"', 1)
    body = {"gates": [TIGHT], "reason": "To be tried."}
    made = adele.post(address, json=body, headers={"If-Match": first.headers["etag"]})
    assert (made.status_code, made.headers["etag"]) == (201, '"v1"')
    again = adele.post(address, json=body, headers={"If-Match": '"v0"'})
    assert again.status_code == 412
    assert again.json()["code"] == "changed-since-read"
    assert "Adele set" in again.json()["detail"]
    listed = house.person("victor").get(address)
    assert [item["number"] for item in listed.json()["items"]] == [1, 0]
    assert listed.headers["etag"] == '"v1"'


def test_a_limit_that_makes_no_sense_is_refused_with_gate_and_key(house):
    sensor = house.new_sensor()
    body = {"gates": [{"name": "coverage", "limit": 2}], "reason": "More."}
    address, headers = f"/api/v1/sensors/{sensor['id']}/gate-profiles", {"If-Match": '"v0"'}
    answer = house.person("adele").post(address, json=body, headers=headers)
    assert answer.status_code == 422
    assert re.match("coverage: limit .*2.* 0 to 1", answer.json()["detail"])


def test_limits_are_tried_without_being_set(house):
    row = house.candidate()
    address = f"/api/v1/sensors/{row['sensor_id']}/gate-profiles"
    tried = house.person("victor").post(f"{address}:dry-run", json={"gates": [TIGHT]}).json()["items"]
    assert [(one["parameter_set"], one["blocking"], one["blocking_now"]) for one in tried] == [
        (row["name"], [TIGHT["name"]], [])
    ]
    assert len(house.person("victor").get(address).json()["items"]) == 1


def test_a_set_is_assessed_by_a_key_and_the_report_is_read_by_anybody(house):
    row = house.candidate()
    address = f"/api/v1/parameter-sets/{row['id']}"
    none = house.person("victor").get(f"{address}/gate-report")
    assert (none.status_code, "POST :assess" in none.json()["detail"]) == (404, True)
    made = house.key("ada", "parameter-sets").post(f"{address}:assess")
    assert made.status_code == 201, made.text
    assert made.headers["location"] == f"{address}/gate-report"
    assert house.person("victor").get(made.headers["location"]).json() == made.json()
    assert house.person("alan").post(f"{address}:assess").json()["id"] == made.json()["id"]
    assert house.key("ada", "runs").post(f"{address}:assess").status_code == 403
    assert house.person("victor").post(f"{address}:assess").status_code == 403


def test_a_blocked_set_may_be_submitted_and_is_neither_approved_nor_waived_by_a_key(house):
    row = blocked(house)
    address, headers = f"/api/v1/parameter-sets/{row['id']}", {"If-Match": f'"v{row["version"]}"'}
    request = house.person("ada").post(f"{address}:submit", json={"reason": "It moved."}, headers=headers)
    assert request.status_code == 201, request.text
    refused = house.sign("alan", request.json())
    assert refused.status_code == 409
    assert refused.json()["code"] == "blocked-by-gates"
    assert "parameter-shift (FAIL)" in refused.json()["detail"]
    headers = {"If-Match": house.person("ada").get(address).headers["etag"]}
    by_key = house.key("ada", "parameter-sets").post(f"{address}:waive", json=a_waiver(), headers=headers)
    assert by_key.status_code == 403
    waived = house.person("ada").post(f"{address}:waive", json=a_waiver(), headers=headers)
    assert waived.status_code == 201, waived.text
    assert house.person("ada").get(f"/api/v1/approvals/{request.json()['id']}").json()["state"] == "STALE"
    report = house.person("victor").get(f"{address}/gate-report").json()
    assert (report["blocking"], report["waived"]) == ([], ["parameter-shift"])
    assert report["words"].endswith("(1 gate waived)")
    assert report["waivers"] == [waived.json()]


def test_the_same_waiver_under_one_key_is_made_once_and_its_password_is_kept_nowhere(house):
    row = blocked(house)
    address = f"/api/v1/parameter-sets/{row['id']}:waive"
    headers = {"If-Match": f'"v{row["version"]}"', "Idempotency-Key": f"waive-{row['id']}"}
    first, again = (house.person("ada").post(address, json=a_waiver(expires_utc=when), headers=headers)
                    for when in [a_waiver()["expires_utc"]] * 2)  # fmt: skip
    assert (first.status_code, again.headers["idempotent-replayed"]) == (201, "true")
    assert first.json() == again.json()
    assert PASSWORD not in first.text


def test_limits_that_move_make_the_report_and_the_request_stale(house):
    request = house.submitted()
    address = f"/api/v1/parameter-sets/{request['parameter_set_id']}"
    row = house.person("ada").get(address).json()
    assert house.person("ada").get(f"{address}/gate-report").status_code == 200
    tight_profile(house, row["sensor_id"])
    assert house.person("ada").get(f"/api/v1/approvals/{request['id']}").json()["state"] == "STALE"
    moved = house.person("ada").get(f"{address}/gate-report")
    assert (moved.status_code, moved.json()["holds"]) == (200, False)


def test_the_report_that_a_signature_is_bound_to_is_read_by_its_hash_after_the_promotion(house):
    row = house.approved()
    address, headers = f"/api/v1/parameter-sets/{row['id']}", {"If-Match": f'"v{row["version"]}"'}
    assert house.person("olga").post(f"{address}:promote", headers=headers).status_code == 200
    listed = house.person("victor").get("/api/v1/approvals", params={"sensor_id": row["sensor_id"]}).json()["items"]
    bound = listed[0]["bound"]["gate_report_sha256"]
    assert house.person("ada").post(f"{address}:assess").json()["sha256"] != bound
    found = house.key("ada", "runs").get(f"{address}/gate-report", params={"sha256": bound})
    assert (found.status_code, found.json()["sha256"], found.json()["holds"]) == (200, bound, False)
    newest = house.person("victor").get(f"{address}/gate-report").json()
    assert (newest["sha256"] != bound, newest["holds"]) == (True, True)
    for hash_, status in (("0" * 64, 404), ("bound", 422)):
        assert house.person("ada").get(f"{address}/gate-report", params={"sha256": hash_}).status_code == status
