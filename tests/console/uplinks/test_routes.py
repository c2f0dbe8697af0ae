"""On board over REST: read-backs as forms, the signed entry, what held at a time, the timeline page by page."""

import hashlib
import io
import re
import zipfile
from typing import Any

import httpx
import pytest

from boresight.platform.db.sessions import utc_after
from tests.console.operations import GOOD
from tests.console.uplinks import routes as onboard
from tests.served import PASSWORD, House


def _read_back(client: httpx.Client, row: dict[str, Any], **given: Any) -> httpx.Response:
    headers = {"If-Match": f'"v{row["version"]}"', **given.pop("headers", {})}
    return client.post(f"/api/v1/parameter-sets/{row['id']}:read-back", headers=headers, **given)


def _seen(house: House, row: dict[str, Any]) -> dict[str, Any]:
    return house.person("olga").get(f"/api/v1/parameter-sets/{row['id']}").json()


def test_a_flipped_bit_comes_back_named_and_its_dump_can_be_fetched(house):
    row = onboard.at(house, "SENT", "LOADED")
    table = onboard.table(house, row)
    damaged = table[:17] + bytes([table[17] ^ 0x10]) + table[18:]
    client = house.person("olga")
    made = _read_back(client, row, data={"source": "TM 1"}, files={"file": ("dump.bin", damaged)})
    assert made.status_code == 201, made.text
    body = made.json()
    assert (body["onboard_state"], body["method"]) == ("MISMATCH", "bytes")
    assert [(one["offset"], one["bits"]) for one in body["evidence"]["bytes"]] == [(17, [3])]
    assert client.get(made.headers["location"]).json() == body
    fetched = client.get(f"{made.headers['location']}/dump")
    assert (fetched.content, fetched.headers["etag"]) == (damaged, f'"{body["evidence"]["dump"]["sha256"]}"')
    again = _read_back(client, _seen(house, row), data={"source": "TM 2"}, files={"file": ("dump.bin", table)})
    assert again.json()["onboard_state"] == "VERIFIED"


def test_the_same_form_under_one_key_is_one_record_though_its_text_differs(house):
    row = onboard.at(house, "SENT", "LOADED")
    table = onboard.table(house, row)
    client, headers = house.person("olga"), {"Idempotency-Key": f"read-{row['id']}"}
    form = {"data": {"source": "TM 1"}, "files": {"file": ("dump.bin", table)}, "headers": headers}
    first, second = (_read_back(client, row, **form) for _ in range(2))
    assert first.request.headers["content-type"] != second.request.headers["content-type"]
    assert (second.json(), second.headers["idempotent-replayed"]) == (first.json(), "true")
    other = _read_back(client, row, data={"source": "TM 2"}, files=form["files"], headers=headers)
    assert other.status_code == 422


@pytest.mark.parametrize(
    ("given", "status", "says"),
    [
        ({"data": {"source": "x"}}, 422, "the dump or the CRC"),
        ({"data": {"source": "x", "crc": "1"}, "files": {"file": ("d", b"1")}}, 422, "the dump or the CRC"),
        ({"data": {"source": "x"}, "files": {"file": ("d", bytes(300_000))}}, 422, "over 200,000 bytes"),
        ({"data": {"source": "x"}, "files": {"file": ("d", bytes(1_100_000))}}, 413, "over 1,000,000 bytes"),
        ({"json": {"source": "x", "crc": "1"}}, 422, "the dump or the CRC"),
        ({"data": {f"field{n}": "x" for n in range(20)}, "files": {"file": ("d", b"1")}}, 400, "Too many fields"),
    ],
)
def test_what_is_no_read_back_is_refused(house, given, status, says):
    row = onboard.at(house, "SENT", "LOADED")
    answer = _read_back(house.person("olga"), row, **given)
    assert answer.status_code == status, answer.text
    assert says in answer.json()["detail"]


def test_a_key_reads_back_and_does_not_sign(house):
    row = onboard.at(house, "SENT", "LOADED")
    key, table = house.key("olga", "uplinks"), onboard.table(house, row)
    assert _read_back(key, row, data={"source": "TM 1"}, files={"file": ("d", table)}).status_code == 201
    row = _seen(house, row)
    entry = {"source": "TM 1", "meaning": "I saw it.", "password": PASSWORD}
    address, headers = f"/api/v1/parameter-sets/{row['id']}:activate", {"If-Match": f'"v{row["version"]}"'}
    refused = key.post(address, json=entry, headers=headers)
    assert (refused.status_code, "in" in refused.json()["detail"]) == (403, True)
    client = house.person("olga")
    signed = client.post(address, json=entry, headers=headers)
    assert (signed.status_code, signed.json()["printed_name"]) == (201, "Olga")


def _stated(client: httpx.Client, row: dict[str, Any], state: str, **given: Any) -> httpx.Response:
    step = {"parameter_set_id": row["id"], "onboard_state": state, "source": "TM 1", **given}
    return client.post("/api/v1/uplinks", json=step, headers={"If-Match": f'"v{row["version"]}"'})


def test_verified_and_active_are_nobodys_to_state(house):
    row = onboard.at(house, "SENT", "LOADED")
    key, olga = house.key("olga", "uplinks"), house.person("olga")
    asked = [(who, state) for who in (olga, key) for state in ("VERIFIED", "ACTIVE")]
    answers = [_stated(who, row, state) for who, state in asked]
    assert [answer.status_code for answer in answers] == [409, 409, 409, 403]
    doors = [":read-back", ":activate", ":read-back", "Only a person who is logged in"]
    assert all(door in answer.json()["detail"] for door, answer in zip(doors, answers, strict=True))
    assert _seen(house, row)["onboard_state"] == "LOADED"
    as_of = olga.get(f"/api/v1/sensors/{row['sensor_id']}/as-of").json()
    assert [known["record"]["onboard_state"] for known in as_of["on_board"]] == ["LOADED"]


def test_the_old_address_takes_the_signed_entry_of_a_person_and_of_no_key(house):
    row, signature = onboard.verified(house), {"meaning": "I saw it.", "password": PASSWORD}
    olga = house.person("olga")
    assert _stated(house.key("olga", "uplinks"), row, "ACTIVE", **signature).status_code == 403
    assert _stated(olga, row, "ACTIVE", **signature | {"password": "wrong"}).status_code == 401
    assert _stated(olga, row, "ACTIVE", password=PASSWORD).status_code == 422
    assert _stated(olga, row, "UNKNOWN", **signature).status_code == 422
    assert _seen(house, row)["onboard_state"] == "VERIFIED"
    made = _stated(olga, row, "ACTIVE", **signature)
    assert made.status_code == 201, made.text
    body = made.json()
    assert (body["onboard_state"], body["printed_name"], body["meaning"]) == ("ACTIVE", "Olga", "I saw it.")
    assert body["evidence"]["shown_sha256"]


def test_what_held_is_answered_for_any_time_and_the_old_address_still_answers(house):
    row = onboard.at(house, "SENT")
    between = utc_after(0.0)
    client, address = house.person("victor"), f"/api/v1/sensors/{row['sensor_id']}"
    operator = house.person("olga")
    step = {"parameter_set_id": row["id"], "onboard_state": "LOADED", "source": "Pass 2"}
    operator.post("/api/v1/uplinks", json=step, headers={"If-Match": f'"v{row["version"]}"'})
    then = client.get(f"{address}/as-of", params={"time": between}).json()
    now = client.get(f"{address}/as-of").json()
    states = [[known["record"]["onboard_state"] for known in answer["on_board"]] for answer in (then, now)]
    assert states == [["SENT"], ["LOADED"]]
    assert now["baseline"]["name"] == row["name"]
    assert now["sentence"].startswith(f"baseline {row['name']}; ")
    before = client.get(f"{address}/as-of", params={"time": "2000-01-01"}).json()
    assert (before["baseline"], before["promotion"], before["on_board"]) == (None, None, [])
    assert client.get(f"{address}/history", params={"at": between}).json()["baseline"]["id"] == row["id"]
    assert client.get(f"{address}/as-of", params={"time": "yesterday"}).status_code == 422


def test_the_timeline_is_read_page_by_page_and_its_cursor_is_of_one_sensor(house):
    row, other = onboard.at(house, "SENT", "LOADED", "UNKNOWN"), house.new_sensor()
    client, address = house.person("victor"), f"/api/v1/sensors/{row['sensor_id']}/timeline"
    whole = client.get(address).json()
    assert [event["state"] for event in whole["items"]] == ["UNKNOWN", "LOADED", "SENT", "BASELINE"]
    found, cursor = [], None
    while True:
        page = client.get(address, params={"limit": 1} | ({} if cursor is None else {"cursor": cursor})).json()
        found += page["items"]
        cursor = page["next"]
        if cursor is None:
            break
    assert found == whole["items"]
    first = client.get(address, params={"limit": 1}).json()["next"]
    foreign = client.get(f"/api/v1/sensors/{other['id']}/timeline", params={"cursor": first})
    assert foreign.status_code == 422


def _baseline(house: House) -> tuple[int, int]:
    row = onboard.at(house)
    return row["sensor_id"], row["id"]


def _export(client: httpx.Client, set_id: int, **said: Any) -> httpx.Response:
    return client.post(f"/api/v1/parameter-sets/{set_id}:export", json=said)


def test_the_content_is_the_zip_of_the_hash_that_the_entry_names_whoever_exports_it(house):
    set_id = _baseline(house)[1]
    made, again = (_export(house.person(name), set_id).json() for name in ("olga", "ada"))
    assert again == made
    answer = house.person("victor").get(f"/api/v1/packages/{made['id']}/content")
    assert answer.headers["content-type"] == "application/zip"
    assert answer.headers["etag"] == f'"{made["sha256"]}"'
    assert f"{made['sha256'][:12]}.zip" in answer.headers["content-disposition"]
    assert hashlib.sha256(answer.content).hexdigest() == made["sha256"]
    assert "MANIFEST.json" in zipfile.ZipFile(io.BytesIO(answer.content)).namelist()


def test_a_key_with_the_scope_prepares_a_package_and_neither_one_without_nor_an_approver_does(house):
    set_id = _baseline(house)[1]
    asked = [house.key("olga", "uplinks"), house.key("olga", "runs"), house.person("alan")]
    assert [_export(client, set_id).status_code for client in asked] == [201, 403, 403]


def test_a_package_for_other_flight_software_is_refused_with_both_versions(house):
    who, options = GOOD["set_table_definition"](house)
    sensor = options.pop("sensor_id")
    assert house.person(who).post(f"/api/v1/sensors/{sensor}/table-definitions", **options).status_code == 201
    rows = house.person("ada").get("/api/v1/parameter-sets", params={"sensor_id": sensor}).json()["items"]
    refused = _export(house.person("olga"), rows[0]["id"], flight_software_version="2")
    assert refused.status_code == 409
    assert refused.json()["code"] == "other-versions"
    assert re.search("version 1, not .* version 2", refused.json()["detail"])
    assert _export(house.person("olga"), rows[0]["id"], flight_software_version="1", table_id="T").status_code == 201


def test_the_tag_of_the_definitions_is_the_number_in_force(house):
    who, options = GOOD["set_table_definition"](house)
    address = f"/api/v1/sensors/{options.pop('sensor_id')}/table-definitions"
    client = house.person(who)
    before = client.get(address).headers["etag"]
    client.post(address, **options)
    assert (before, client.get(address).headers["etag"]) == ('"v0"', '"v1"')


def test_the_stations_of_a_set_are_told_with_the_step_of_whoever_reads(house):
    row = onboard.at(house, "SENT", "LOADED")
    address = f"/api/v1/parameter-sets/{row['id']}/workflow"
    told = house.person("olga").get(address).json()
    words = {one["title"]: one["word"] for one in told["stations"]}
    assert [words[title] for title in ("Promoted", "Sent", "Loaded", "Read back", "Active")] == [
        "done", "done", "done", "next", "to come",
    ]  # fmt: skip
    assert (told["next_step"]["role"], told["next_step"]["is_mine"]) == ("operator", True)
    assert house.person("victor").get(address).json()["next_step"]["is_mine"] is False
