"""Gates over REST: limits with a version, a report that is made once, waivers in person, and what a blocked set may not do."""

from tests.console.approvals.gates import TIGHT, a_waiver, blocked, tight_profile
from tests.served import PASSWORD, House


def test_limits_are_set_from_the_version_that_was_seen_and_listed_newest_first(house: House) -> None:
    sensor = house.new_sensor()
    address, adele = f"/api/v1/sensors/{sensor['id']}/gate-profiles", house.person("adele")
    first = adele.get(address)
    assert (first.headers["etag"], len(first.json()["items"])) == ('"v0"', 1)
    body = {"gates": [TIGHT], "reason": "To be tried."}
    made = adele.post(address, json=body, headers={"If-Match": first.headers["etag"]})
    assert (made.status_code, made.headers["etag"]) == (201, '"v1"')
    again = adele.post(address, json=body, headers={"If-Match": '"v0"'})
    assert again.status_code == 412
    assert "Adele set it" in again.json()["detail"]
    listed = house.person("victor").get(address)
    assert [item["number"] for item in listed.json()["items"]] == [1, 0]
    assert listed.headers["etag"] == '"v1"'


def test_a_limit_that_makes_no_sense_is_refused_with_gate_and_key(house: House) -> None:
    sensor = house.new_sensor()
    body = {"gates": [{"name": "coverage", "limit": 2}], "reason": "More."}
    address, headers = f"/api/v1/sensors/{sensor['id']}/gate-profiles", {"If-Match": '"v0"'}
    answer = house.person("adele").post(address, json=body, headers=headers)
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith("coverage: limit is 2; give a number from 0 to 1")


def test_limits_are_tried_without_being_set(house: House) -> None:
    row = house.candidate()
    address = f"/api/v1/sensors/{row['sensor_id']}/gate-profiles"
    tried = house.person("victor").post(f"{address}:dry-run", json={"gates": [TIGHT]}).json()["items"]
    assert [(one["parameter_set"], one["blocking"], one["blocking_now"]) for one in tried] == [
        (row["name"], [TIGHT["name"]], [])
    ]
    assert len(house.person("victor").get(address).json()["items"]) == 1


def test_a_set_is_assessed_by_a_key_and_the_report_is_read_by_anybody(house: House) -> None:
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


def test_a_blocked_set_may_be_submitted_and_is_neither_approved_nor_waived_by_a_key(house: House) -> None:
    row = blocked(house)
    address, headers = f"/api/v1/parameter-sets/{row['id']}", {"If-Match": f'"v{row["version"]}"'}
    request = house.person("ada").post(f"{address}:submit", json={"reason": "It moved."}, headers=headers)
    assert request.status_code == 201, request.text
    refused = house.sign("alan", request.json())
    assert refused.status_code == 409
    assert "stopped by its gates: parameter-shift (FAIL)" in refused.json()["detail"]
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


def test_a_waived_set_needs_two_approvals(house: House) -> None:
    row = blocked(house)
    address, headers = f"/api/v1/parameter-sets/{row['id']}", {"If-Match": f'"v{row["version"]}"'}
    assert house.person("ada").post(f"{address}:waive", json=a_waiver(), headers=headers).status_code == 201
    headers = {"If-Match": house.person("ada").get(address).headers["etag"]}
    request = house.person("ada").post(f"{address}:submit", json={"reason": "It moved."}, headers=headers).json()
    assert request["needed"] == 2
    assert house.sign("alan", request).status_code == 200
    assert house.person("ada").get(f"/api/v1/approvals/{request['id']}").json()["state"] == "OPEN"


def test_the_same_waiver_under_one_key_is_made_once_and_its_password_is_kept_nowhere(house: House) -> None:
    row = blocked(house)
    address = f"/api/v1/parameter-sets/{row['id']}:waive"
    headers = {"If-Match": f'"v{row["version"]}"', "Idempotency-Key": f"waive-{row['id']}"}
    first, again = (house.person("ada").post(address, json=a_waiver(expires_utc=when), headers=headers)
                    for when in [a_waiver()["expires_utc"]] * 2)  # fmt: skip
    assert (first.status_code, again.headers["idempotent-replayed"]) == (201, "true")
    assert first.json() == again.json()
    assert PASSWORD not in first.text


def test_limits_that_move_make_the_report_and_the_request_stale(house: House) -> None:
    request = house.submitted()
    address = f"/api/v1/parameter-sets/{request['parameter_set_id']}"
    row = house.person("ada").get(address).json()
    assert house.person("ada").get(f"{address}/gate-report").status_code == 200
    tight_profile(house, row["sensor_id"])
    assert house.person("ada").get(f"/api/v1/approvals/{request['id']}").json()["state"] == "STALE"
    moved = house.person("ada").get(f"{address}/gate-report")
    assert (moved.status_code, moved.json()["holds"]) == (200, False)


def test_the_report_that_a_signature_is_bound_to_is_read_by_its_hash_after_the_promotion(house: House) -> None:
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
