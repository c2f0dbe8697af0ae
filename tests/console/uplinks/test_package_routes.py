"""Uplink packages over REST: prepared by a key, the same for everyone, refused for another spacecraft."""

import hashlib
import io
import zipfile
from typing import Any

import httpx

from tests.console.operations import GOOD
from tests.served import House


def _baseline(house: House) -> tuple[int, int]:
    sensor = house.new_sensor()["id"]
    found = house.person("ada").get("/api/v1/parameter-sets", params={"sensor_id": sensor}).json()["items"]
    return sensor, found[0]["id"]


def _export(client: httpx.Client, set_id: int, **said: Any) -> httpx.Response:
    return client.post(f"/api/v1/parameter-sets/{set_id}:export", json=said)


def test_the_content_is_the_zip_of_the_hash_that_the_entry_names(house: House) -> None:
    made = _export(house.person("olga"), _baseline(house)[1]).json()
    answer = house.person("victor").get(f"/api/v1/packages/{made['id']}/content")
    assert answer.headers["content-type"] == "application/zip"
    assert answer.headers["etag"] == f'"{made["sha256"]}"'
    assert f"{made['sha256'][:12]}.zip" in answer.headers["content-disposition"]
    assert hashlib.sha256(answer.content).hexdigest() == made["sha256"]
    assert "MANIFEST.json" in zipfile.ZipFile(io.BytesIO(answer.content)).namelist()


def test_whoever_exports_the_same_set_gets_the_same_package(house: House) -> None:
    set_id = _baseline(house)[1]
    first, again = (_export(house.person(name), set_id).json() for name in ("olga", "ada"))
    assert again == first


def test_a_key_with_the_scope_prepares_a_package_and_one_without_does_not(house: House) -> None:
    set_id, owner = _baseline(house)[1], house.person("olga")
    answers = []
    for scopes in (["uplinks"], ["runs"]):
        made = owner.post("/api/v1/api-keys", json={"label": "nightly", "scopes": scopes}).json()
        client = house.anybody()
        client.headers["Authorization"] = f"Bearer {made['secret']}"
        answers.append(_export(client, set_id).status_code)
    assert answers == [201, 403]


def test_who_only_approves_does_not_export(house: House) -> None:
    answer = _export(house.person("alan"), _baseline(house)[1])
    assert answer.status_code == 403
    assert "operator or analyst" in answer.json()["detail"]


def test_a_package_for_other_flight_software_is_refused_with_both_versions(house: House) -> None:
    who, options = GOOD["set_table_definition"](house)
    sensor = options.pop("sensor_id")
    assert house.person(who).post(f"/api/v1/sensors/{sensor}/table-definitions", **options).status_code == 201
    rows = house.person("ada").get("/api/v1/parameter-sets", params={"sensor_id": sensor}).json()["items"]
    refused = _export(house.person("olga"), rows[0]["id"], flight_software_version="2")
    assert refused.status_code == 409
    assert "is for flight software version 1, not for flight software version 2" in refused.json()["detail"]
    assert _export(house.person("olga"), rows[0]["id"], flight_software_version="1", table_id="T").status_code == 201


def test_the_tag_of_the_definitions_is_the_number_in_force(house: House) -> None:
    who, options = GOOD["set_table_definition"](house)
    address = f"/api/v1/sensors/{options.pop('sensor_id')}/table-definitions"
    client = house.person(who)
    before = client.get(address).headers["etag"]
    client.post(address, **options)
    assert (before, client.get(address).headers["etag"]) == ('"v0"', '"v1"')
