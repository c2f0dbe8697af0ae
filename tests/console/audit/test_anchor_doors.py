"""Signing the head on request: by an administrator, on the page and over REST, once a head, and for everybody to see."""

import pytest

from boresight.platform.audit.signing import PublicKey, read_public_keys


def test_an_administrator_signs_the_head_on_the_page_and_everybody_sees_its_age(site):
    adele, victor = site.visitor("adele"), site.visitor("victor")
    assert "NOT ANCHORED" in victor.get("/audit")
    assert site.visitor("ada").post("/audit/anchors").status_code in {303, 403}
    assert "NOT ANCHORED" in victor.get("/audit")
    assert adele.post("/audit/anchors").headers["location"].startswith("/audit")
    page = victor.get("/audit")
    assert ">ANCHORED<" in page
    assert 'action="/audit/anchors"' in adele.get("/audit")
    assert 'action="/audit/anchors"' not in page


def test_over_rest_a_head_is_signed_once_and_verifies_with_the_published_key(house):
    adele, victor = house.person("adele"), house.person("victor")
    assert house.person("ada").post("/api/v1/audit/anchors").status_code == 403
    assert adele.post("/api/v1/audit/anchors?validate_only=true").status_code == 200
    made = adele.post("/api/v1/audit/anchors")
    assert (made.status_code, made.headers["Location"]) == (201, "/api/v1/audit/anchors")
    again = adele.post("/api/v1/audit/anchors").json()
    assert (again["id"], again["head"]) == (made.json()["id"], made.json()["head"])
    listed = victor.get("/api/v1/audit/anchors").json()["items"]
    assert listed[0] == made.json()
    keys = read_public_keys(victor.get("/api/v1/audit/keys").text, "the answer")
    assert PublicKey.decode(made.json()["public_key"]) in keys
    house.new_sensor()
    found = victor.get("/api/v1/audit/verification?blobs=false").json()
    assert (found["ok"], found["anchored_id"]) == (True, made.json()["record_id"])
    assert found["anchors"] >= 1
    assert found["records"] > found["anchored_id"]


@pytest.mark.parametrize("who", ["ada", "alan", "olga", "victor"])
def test_nobody_but_an_administrator_signs_a_head(house, who):
    assert house.person(who).post("/api/v1/audit/anchors").status_code == 403
