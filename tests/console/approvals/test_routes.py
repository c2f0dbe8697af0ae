"""From candidate to baseline over REST: two people, versions, and what a key may never do."""

import hashlib
from typing import Any

import orjson
import pytest

from boresight.platform.audit.queries import response_under
from boresight.platform.db.sessions import open_reading
from tests.served import PASSWORD, House


def _tag(row: dict[str, Any]) -> dict[str, str]:
    return {"If-Match": f'"v{row["version"]}"'}


def test_a_set_goes_from_candidate_to_baseline_and_the_one_before_is_superseded(house: House) -> None:
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


def test_the_same_run_gives_the_same_candidate(house: House) -> None:
    run_id = house.finished()
    first, second = (house.person("ada").post("/api/v1/parameter-sets", json={"run_id": run_id}) for _ in range(2))
    assert first.json()["id"] == second.json()["id"]
    assert first.json()["name"].startswith("PS-")


def test_a_run_that_did_not_end_well_makes_no_set(house: House) -> None:
    answer = house.person("ada").post("/api/v1/parameter-sets", json={"run_id": house.launched()["id"]})
    assert answer.status_code == 409


def test_whoever_submitted_cannot_sign(house: House) -> None:
    refused = house.sign("bo", house.submitted(submitter="bo"))
    assert refused.status_code == 403
    assert "You submitted this set" in refused.json()["detail"]


def test_whoever_launched_the_run_cannot_sign(house: House) -> None:
    refused = house.sign("bo", house.submitted(launcher="bo"))
    assert refused.status_code == 403
    assert "You launched run" in refused.json()["detail"]


def test_an_administrator_cannot_sign(house: House) -> None:
    refused = house.sign("adele", house.submitted())
    assert refused.status_code == 403
    assert "administrator cannot sign" in refused.json()["detail"]


@pytest.mark.parametrize("decision", ["approve", "refuse"])
def test_a_key_of_an_approver_cannot_sign(house: House, decision: str) -> None:
    approval = house.submitted()
    every_scope = ("sensors", "telemetry-sets", "runs", "parameter-sets", "uplinks")
    answer = house.key("alan", *every_scope).post(
        f"/api/v1/approvals/{approval['id']}:{decision}",
        json={"meaning": "I approve.", "password": PASSWORD, "comment": "Seen."},
        headers=_tag(approval),
    )
    assert answer.status_code == 403
    assert "Only a person who is logged in may sign" in answer.json()["detail"]


def test_a_signature_sent_again_with_its_key_gets_the_first_answer_and_keeps_no_password(house: House) -> None:
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
        kept = response_under(session, "sign-once", "alan session")
        assert kept is not None
        assert kept.request_sha256 == hashlib.sha256(f"POST {address}?\n".encode() + bare).hexdigest()


def test_a_signature_needs_the_password_again(house: House) -> None:
    refused = house.sign("alan", house.submitted(), password="not the password")
    assert refused.status_code == 401


def test_a_password_that_is_only_tried_counts_all_the_same(house: House) -> None:
    approval, name = house.submitted(), "alan"
    address, body = f"/api/v1/approvals/{approval['id']}:approve", {"meaning": "x", "password": "not the password"}
    before = _failures(house, name)
    answer = house.person(name).post(address, params={"validate_only": "true"}, json=body, headers=_tag(approval))
    assert (answer.status_code, _failures(house, name)) == (401, before + 1)


def _failures(house: House, name: str) -> int:
    counts = house.app.state.passwords._limiter._counts
    return sum(count.failures for key, count in counts.items() if isinstance(key, tuple) and key[0] == name)


def test_a_refusal_needs_a_comment_and_blocks(house: House) -> None:
    approval = house.submitted()
    assert house.sign("alan", approval, "refuse", comment=" ").status_code == 422
    assert house.sign("alan", approval, "refuse", comment="Too few frames.").json()["state"] == "REJECTED"
    row = house.person("ada").get(f"/api/v1/parameter-sets/{approval['parameter_set_id']}").json()
    assert row["ground_state"] == "REJECTED"


def test_what_is_not_approved_is_not_promoted(house: House) -> None:
    row = house.candidate()
    answer = house.person("olga").post(f"/api/v1/parameter-sets/{row['id']}:promote", headers=_tag(row))
    assert answer.status_code == 409


def test_a_second_submitter_from_the_same_version_is_told_who_was_first(house: House) -> None:
    row, address = house.candidate(), "/api/v1/parameter-sets/{id}:submit"
    first = house.person("ada").post(address.format(**row), json={"reason": "It moved."}, headers=_tag(row))
    second = house.person("bo").post(address.format(**row), json={"reason": "It moved."}, headers=_tag(row))
    assert (first.status_code, second.status_code) == (201, 412)
    assert "Ada submitted it" in second.json()["detail"]


def test_a_submission_sent_again_with_its_key_opens_one_request(house: House) -> None:
    row, headers = house.candidate(), {"Idempotency-Key": "submit-once"}
    address = f"/api/v1/parameter-sets/{row['id']}:submit"
    first, again = (
        house.person("ada").post(address, json={"reason": "It moved."}, headers={**_tag(row), **headers})
        for _ in range(2)
    )
    assert (first.status_code, again.status_code) == (201, 201)
    assert again.json() == first.json()
    assert again.headers["idempotent-replayed"] == "true"


def test_a_request_binds_the_report_of_its_gates_and_says_until_when_it_waits(house: House) -> None:
    approval = house.submitted()
    assert approval["bound"]["gate_report_sha256"]
    assert approval["bound"]["profile_sha256"]
    assert (approval["kind"], approval["needed"]) == ("PROMOTION", 1)
    assert approval["expires_utc"] > approval["submitted_utc"]


@pytest.mark.parametrize("tag", ["v1", "1", "*", '"v-1"', '""', '"vx"'])
def test_a_tag_that_is_no_version_matches_nothing(house: House, tag: str) -> None:
    row = house.candidate()
    answer = house.person("ada").post(
        f"/api/v1/parameter-sets/{row['id']}:submit", json={"reason": "x"}, headers={"If-Match": tag}
    )
    assert answer.status_code == 412


def test_the_etag_of_a_read_is_what_the_transition_takes(house: House) -> None:
    row = house.candidate()
    read = house.person("ada").get(f"/api/v1/parameter-sets/{row['id']}")
    answer = house.person("ada").post(
        f"/api/v1/parameter-sets/{row['id']}:submit", json={"reason": "x"}, headers={"If-Match": read.headers["etag"]}
    )
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/api/v1/approvals/{answer.json()['id']}"


def test_what_was_baseline_at_a_time_is_one_question(house: House) -> None:
    sensor = house.new_sensor()
    client = house.person("victor")
    address = f"/api/v1/sensors/{sensor['id']}/history"
    before = client.get(address, params={"at": "2001-01-01T00:00:00Z"}).json()
    after = client.get(address, params={"at": "2099-01-01T00:00:00Z"}).json()
    assert before["baseline"] is None
    assert after["baseline"]["name"] == f"PS-{sensor['name']}-0"
    assert client.get(address, params={"at": "yesterday"}).status_code == 422


def test_every_step_is_in_the_audit_log_with_its_request(house: House) -> None:
    approval = house.submitted()
    house.sign("alan", approval)
    found = (
        house.person("victor").get("/api/v1/audit", params={"object": f"approvals/{approval['id']}"}).json()["items"]
    )
    assert [record["action"] for record in found] == ["approved", "opened"]
    assert [record["actor"] for record in found] == ["Alan", "Ada"]
    assert all(record["request_id"] for record in found)
    assert PASSWORD not in str(found)


def test_the_chain_verifies_and_knows_a_head_it_never_had(house: House) -> None:
    client = house.person("victor")
    good = client.get("/api/v1/audit/verification").json()
    assert good["ok"]
    assert client.get("/api/v1/audit/verification", params={"expected_head": good["head"]}).json()["ok"]
    assert not client.get("/api/v1/audit/verification", params={"expected_head": "ab" * 32}).json()["ok"]
