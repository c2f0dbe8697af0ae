"""Idempotency: the same request twice has one effect and one answer."""

import uuid

import pytest

from boresight.platform.audit.tables import IdempotentResponse
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.served import House


@pytest.fixture
def once() -> dict[str, str]:
    return {"Idempotency-Key": uuid.uuid4().hex}


def test_the_same_request_again_gets_the_same_answer_and_has_no_second_effect(
    house: House, once: dict[str, str]
) -> None:
    client, document = house.person("ada"), house.sensor_file()
    first = client.post("/api/v1/sensors", json=document, headers=once)
    second = client.post("/api/v1/sensors", json=document, headers=once)
    assert (first.status_code, second.status_code) == (201, 201)
    assert second.json() == first.json()
    assert second.headers["location"] == first.headers["location"]
    assert second.headers["etag"] == first.headers["etag"]
    assert second.headers["idempotent-replayed"] == "true"
    assert "idempotent-replayed" not in first.headers


def test_without_the_key_the_second_request_is_judged_by_itself(house: House) -> None:
    client, document = house.person("ada"), house.sensor_file()
    assert client.post("/api/v1/sensors", json=document).status_code == 201
    assert client.post("/api/v1/sensors", json=document).status_code == 409


def test_another_body_under_the_same_key_is_refused(house: House, once: dict[str, str]) -> None:
    client = house.person("ada")
    assert client.post("/api/v1/sensors", json=house.sensor_file(), headers=once).status_code == 201
    refused = client.post("/api/v1/sensors", json=house.sensor_file(), headers=once)
    assert refused.status_code == 422
    assert "another request" in refused.json()["detail"]


def test_another_address_under_the_same_key_is_refused(house: House, once: dict[str, str]) -> None:
    client = house.person("ada")
    runs = [client.get(f"/api/v1/runs/{house.launched()['id']}") for _ in range(2)]
    answers = [client.post(f"{run.url.path}:cancel", headers={**once, "If-Match": run.headers["etag"]}) for run in runs]
    assert [answer.status_code for answer in answers] == [200, 422]


def test_one_persons_key_is_not_anothers(house: House, once: dict[str, str]) -> None:
    first = house.person("ada").post("/api/v1/sensors", json=house.sensor_file(), headers=once)
    second = house.person("bo").post("/api/v1/sensors", json=house.sensor_file(), headers=once)
    assert (first.status_code, second.status_code) == (201, 201)


def test_a_refusal_is_not_remembered(house: House, once: dict[str, str]) -> None:
    client, document = house.person("ada"), house.sensor_file()
    refused = client.post("/api/v1/sensors", json={**document, "parity": 7}, headers=once)
    assert refused.status_code == 422
    assert client.post("/api/v1/sensors", json=document, headers=once).status_code == 201


def test_a_key_is_forgotten_after_a_day(house: House, once: dict[str, str]) -> None:
    client = house.person("ada")
    assert client.post("/api/v1/sensors", json=house.sensor_file(), headers=once).status_code == 201
    yesterday = utc_after(-25 * 3600.0)
    with open_writing(house.app.state.engine) as session:
        session.get_one(IdempotentResponse, (once["Idempotency-Key"], "ada session")).created_utc = yesterday
    assert client.post("/api/v1/sensors", json=house.sensor_file(), headers=once).status_code == 201


def test_what_is_older_than_a_day_is_deleted_when_an_answer_is_stored_and_nothing_younger(house: House) -> None:
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


def test_a_transition_repeated_under_its_key_is_not_stale(house: House, once: dict[str, str]) -> None:
    client, row = house.person("ada"), house.candidate()
    headers = {**once, "If-Match": f'"v{row["version"]}"'}
    address = f"/api/v1/parameter-sets/{row['id']}:submit"
    first = client.post(address, json={"reason": "It moved."}, headers=headers)
    second = client.post(address, json={"reason": "It moved."}, headers=headers)
    assert (first.status_code, second.status_code) == (201, 201)
    assert second.json()["id"] == first.json()["id"]


def test_an_upload_repeated_under_its_key_is_one_set_and_another_file_is_refused(
    house: House, once: dict[str, str]
) -> None:
    client, sensor = house.person("ada"), house.new_sensor()
    first = house.upload(client, sensor["id"], headers=once)
    second = house.upload(client, sensor["id"], headers=once)
    assert second.headers["idempotent-replayed"] == "true"
    assert second.json() == first.json()
    other = b"\n".join(house.telemetry_csv.splitlines()[:-5]) + b"\n"
    assert house.upload(client, sensor["id"], other, headers=once).status_code == 422


def test_a_dry_run_takes_no_key(house: House, once: dict[str, str]) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id}
    client = house.person("ada")
    assert client.post("/api/v1/runs?validate_only=true", json=order, headers=once).status_code == 200
    assert client.post("/api/v1/runs", json=order, headers=once).status_code == 202
