"""Proposed changes over REST: 202 where a second person is asked for, and only that person puts them into force."""

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest

from boresight.console.approvals import gate_profiles
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.approvals.test_pages import EDITOR, fields
from tests.console.change_proposals.proposals import TIGHT
from tests.passwords import add_person
from tests.served import House
from tests.sites import PEOPLE, codes


@pytest.fixture
def asking(house) -> Iterator[House]:
    state = house.app.state
    before = state.policy
    state.policy = replace(before, second_person=True)
    yield house
    state.policy = before


def test_limits_are_proposed_with_202_and_confirmed_by_nobody_but_another(asking):
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


def test_a_layout_that_an_analyst_proposed_is_in_force_once_an_administrator_confirmed_it(asking):
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


REASON = "Corners matter."


@pytest.fixture
def asking_site(site, monkeypatch):
    site.app.state.policy = replace(site.app.state.policy, second_person=True)
    monkeypatch.setitem(PEOPLE, "agnes", ("administrator",))  # the next number is hers
    with open_writing(site.engine) as session:
        add_person(session, "agnes", "administrator")
    return site


def _proposed(site) -> str:
    visitor = site.visitor("adele")
    typed = fields(visitor.get(EDITOR)) | {"coverage.limit": "0.25", "action": "set", "reason": REASON}
    answer = visitor.post(EDITOR, **typed)
    assert answer.status_code == 303
    return answer.headers["location"]


def _in_force(site) -> int:
    with open_reading(site.engine) as session:
        return gate_profiles.get_profile_in_force(session, 1).number


def test_what_was_proposed_waits_on_every_page_that_it_touches_until_another_confirms_it(asking_site, read):
    assert "Propose version 1" in read(asking_site.visitor("adele").get(EDITOR))
    page = _proposed(asking_site)
    assert re.fullmatch(r"/change-proposals/\d+", page)
    others = read(asking_site.visitor("agnes").get(page))
    assert "gates[coverage].limit" in others
    assert "0.25" in others
    for name, place in (("adele", EDITOR), ("agnes", "/change-proposals"), ("agnes", "/")):
        assert f'href="{page}"' in asking_site.visitor(name).get(place)
    assert _in_force(asking_site) == 0
    answer = asking_site.visitor("agnes").post(f"{page}/decide", version="1", action="confirm")
    assert answer.status_code == 303
    assert _in_force(asking_site) == 1
    assert f'href="{page}"' in asking_site.visitor("adele").get(EDITOR)  # beside the version that it became
    assert codes(asking_site.visitor("adele").get("/change-proposals")) == ["no-proposal"]
    assert "CONFIRMED" in read(asking_site.visitor("adele").get("/change-proposals?show=all"))


def test_who_may_not_decide_is_told_why_the_proposer_takes_it_back_and_another_refuses_it_with_a_comment(
    asking_site, read
):
    page = _proposed(asking_site)
    assert 'id="decide-blocked"' in asking_site.visitor("ada").get(page)
    assert asking_site.visitor("ada").post(f"{page}/decide", version="1", action="confirm").status_code == 403
    assert asking_site.visitor("adele").post(f"{page}/decide", version="1", action="withdraw").status_code == 303
    assert "WITHDRAWN" in read(asking_site.visitor("adele").get(page))
    page, agnes = _proposed(asking_site), asking_site.visitor("agnes")
    unsaid = agnes.post(f"{page}/decide", version="1", action="refuse")
    assert (unsaid.status_code, re.findall(r'<dialog id="(\w+)"[^>]* open>', unsaid.text)) == (422, ["refuse"])
    agnes.post(f"{page}/decide", version="1", action="refuse", comment="Not before the eclipse.")
    words = read(asking_site.visitor("adele").get(page))
    assert "REFUSED" in words
    assert "Not before the eclipse." in words
    assert _in_force(asking_site) == 0
