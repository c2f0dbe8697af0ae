"""Proposed changes over REST: 202 where a second person is asked for, and only that person puts them into force."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from tests.console.change_proposals.proposals import TIGHT
from tests.served import House


@pytest.fixture
def asking(house: House) -> Iterator[House]:
    state = house.app.state
    before = state.policy
    state.policy = replace(before, second_person=True)
    yield house
    state.policy = before


def test_limits_are_proposed_with_202_and_confirmed_by_nobody_but_another(asking: House) -> None:
    sensor_id, adele = asking.new_sensor()["id"], asking.person("adele")
    address = f"/api/v1/sensors/{sensor_id}/gate-profiles"
    made = adele.post(address, json={**TIGHT, "reason": "Corners matter."}, headers={"If-Match": '"v0"'})
    assert made.status_code == 202, made.text
    row, where = made.json(), made.headers["Location"]
    assert where == f"/api/v1/change-proposals/{row['id']}"
    assert (row["state"], row["kind"], made.headers["ETag"]) == ("OPEN", "gate-profile", '"v1"')
    (changed,) = row["differences"]
    assert (changed["place"], changed["after"]) == ("gates[coverage].limit", 0.25)
    assert changed["before"] != 0.25
    assert adele.get(address).json()["items"][0]["number"] == 0
    seen = {"If-Match": made.headers["ETag"]}
    assert adele.post(f"{where}:confirm", json={}, headers=seen).status_code == 403
    assert asking.person("ada").post(f"{where}:confirm", headers=seen).status_code == 403
    assert asking.key("adele", "sensors").post(f"{where}:confirm", headers=seen).status_code == 403
    assert adele.post(f"{where}:confirm").status_code == 428
    listed = adele.get("/api/v1/change-proposals", params={"sensor_id": sensor_id, "state": "OPEN"}).json()["items"]
    assert [one["id"] for one in listed] == [row["id"]]
    ended = adele.post(f"{where}:withdraw", headers=seen).json()
    assert (ended["state"], ended["closed_by"]) == ("WITHDRAWN", row["proposed_by"])
    assert adele.post(f"{where}:withdraw", headers={"If-Match": '"v2"'}).status_code == 409


def test_a_layout_that_an_analyst_proposed_is_in_force_once_an_administrator_confirmed_it(asking: House) -> None:
    from tests.console.operations import GOOD  # noqa: PLC0415 - it makes a server when it is imported

    _, options = GOOD["set_table_definition"](asking)
    sensor_id = options.pop("sensor_id")
    address = f"/api/v1/sensors/{sensor_id}/table-definitions"
    made = asking.person("ada").post(address, **options)
    assert made.status_code == 202, made.text
    assert asking.person("ada").get(address).json()["items"] == []
    where, seen = made.headers["Location"], {"If-Match": made.headers["ETag"]}
    done = asking.person("adele").post(f"{where}:confirm", json={"comment": "Seen."}, headers=seen)
    assert (done.status_code, done.json()["number"], done.json()["comment"]) == (200, 1, "Seen.")
    assert asking.person("ada").get(address).json()["items"][0]["number"] == 1
    assert asking.person("adele").post(f"{where}:confirm", headers=seen).status_code == 412
