"""Idempotency: the same request twice has one effect and one answer."""

import uuid

import pytest

from boresight.platform.audit.tables import IdempotentResponse
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.served import House


@pytest.fixture
def once() -> dict[str, str]:
    return {"Idempotency-Key": uuid.uuid4().hex}


def test_the_same_request_again_gets_the_same_answer_and_has_no_second_effect(house, once):
    client, document = house.person("ada"), house.sensor_file()
    first = client.post("/api/v1/sensors", json=document, headers=once)
    second = client.post("/api/v1/sensors", json=document, headers=once)
    assert (first.status_code, second.status_code) == (201, 201)
    assert second.json() == first.json()
    assert second.headers["location"] == first.headers["location"]
    assert second.headers["etag"] == first.headers["etag"]
    assert second.headers["idempotent-replayed"] == "true"
    assert "idempotent-replayed" not in first.headers
    assert client.post("/api/v1/sensors", json=document).status_code == 409  # without the key it is judged by itself


def test_another_body_or_address_under_the_same_key_is_refused_but_of_another_person_or_day_it_is_another_key(
    house, once
):
    def post(name):
        return house.person(name).post("/api/v1/sensors", json=house.sensor_file(), headers=once)

    first, refused, other = post("ada"), post("ada"), post("bo")
    assert [answer.status_code for answer in (first, refused, other)] == [201, 422, 201]
    assert "another request" in refused.json()["detail"]
    run = house.person("ada").get(f"/api/v1/runs/{house.launched()['id']}")
    headers = {**once, "If-Match": run.headers["etag"]}
    assert house.person("ada").post(f"{run.url.path}:cancel", headers=headers).status_code == 422
    with open_writing(house.app.state.engine) as session:
        kept = session.get_one(IdempotentResponse, (once["Idempotency-Key"], "ada session"))
        kept.created_utc = utc_after(-25 * 3600.0)
    assert post("ada").status_code == 201


def test_a_refusal_is_not_remembered(house, once):
    client, document = house.person("ada"), house.sensor_file()
    refused = client.post("/api/v1/sensors", json={**document, "parity": 7}, headers=once)
    assert refused.status_code == 422
    assert client.post("/api/v1/sensors", json=document, headers=once).status_code == 201


def test_what_is_older_than_a_day_is_deleted_when_an_answer_is_stored_and_nothing_younger(house):
    old, young = uuid.uuid4().hex, uuid.uuid4().hex
    with open_writing(house.app.state.engine) as session:
        for key, hours in ((old, 24.1), (young, 23.9)):
            row = {
                "request_sha256": "",
                "status": 201,
                "headers": {},
                "body": {},
                "created_utc": utc_after(-3600 * hours),
            }
            session.add(IdempotentResponse(key=key, actor="nobody session", **row))
    client = house.person("ada")
    assert client.post("/api/v1/sensors", json=house.sensor_file()).status_code == 201
    assert _known(house, old)
    headers = {"Idempotency-Key": uuid.uuid4().hex}
    assert client.post("/api/v1/sensors", json=house.sensor_file(), headers=headers).status_code == 201
    assert not _known(house, old)
    assert _known(house, young)


def _known(house: House, key: str) -> bool:
    with open_reading(house.app.state.engine) as session:
        return session.get(IdempotentResponse, (key, "nobody session")) is not None


def test_a_transition_repeated_under_its_key_is_not_stale(house, once):
    client, row = house.person("ada"), house.candidate()
    headers = {**once, "If-Match": f'"v{row["version"]}"'}
    address = f"/api/v1/parameter-sets/{row['id']}:submit"
    first = client.post(address, json={"reason": "It moved."}, headers=headers)
    second = client.post(address, json={"reason": "It moved."}, headers=headers)
    assert (first.status_code, second.status_code) == (201, 201)
    assert second.json()["id"] == first.json()["id"]


def test_an_upload_repeated_under_its_key_is_one_set_and_another_file_is_refused(house, once):
    client, sensor = house.person("ada"), house.new_sensor()
    first = house.upload(client, sensor["id"], headers=once)
    second = house.upload(client, sensor["id"], headers=once)
    assert second.headers["idempotent-replayed"] == "true"
    assert second.json() == first.json()
    other = b"\n".join(house.telemetry_csv.splitlines()[:-5]) + b"\n"
    assert house.upload(client, sensor["id"], other, headers=once).status_code == 422


def test_a_dry_run_takes_no_key(house, once):
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    client = house.person("ada")
    assert client.post("/api/v1/runs?validate_only=true", json=order, headers=once).status_code == 200
    assert client.post("/api/v1/runs", json=order, headers=once).status_code == 202
