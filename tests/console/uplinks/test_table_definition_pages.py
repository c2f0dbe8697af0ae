"""The page of a sensor's table: the bytes are shown before they are flown, and what was typed is never lost."""

import html
import json
import re

import pytest

from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.pages.table_definition import written_as_text
from boresight.platform.db.sessions import open_reading
from boresight.uplink.table_definition import plain_definition

ADDRESS = "/sensors/1/table-definition"
EXAMPLE = plain_definition("inverted_wang")


def _typed(page):
    return html.unescape(re.search(r'<textarea id="document"[^>]*>(.*?)</textarea>', page, re.DOTALL)[1])


def _in_force(site):
    with open_reading(site.engine) as session:
        return table_definitions.definition_in_force(session, 1)


@pytest.fixture
def defined(site):
    answer = site.visitor("ada").post(
        ADDRESS, document=written_as_text(EXAMPLE), reason="First.", action="set", number="0"
    )
    assert answer.status_code == 303, answer.text
    return site


def test_without_a_definition_the_page_says_so_and_offers_an_example(site, read):
    visitor = site.visitor("ada")
    assert "no bytes to load" in read(visitor.get(ADDRESS))
    page = visitor.get(f"{ADDRESS}?example=1")
    assert json.loads(_typed(page)) == EXAMPLE
    assert "not in force" in read(page).lower()


def test_the_layout_has_offset_type_value_and_bytes(defined, read):
    page = read(defined.visitor("victor").get(ADDRESS))
    assert "F_M f_m 0 float32, big" in page
    assert "CRC CRC-16/CCITT-FALSE 34 uint16, big" in page


def test_a_definition_is_tried_without_being_set(site, read):
    visitor = site.visitor("victor")
    text = written_as_text(EXAMPLE | {"byte_order": "little"})
    answer = visitor.post(ADDRESS, document=text, action="try")
    assert "F_M f_m 0 float32, little" in read(answer.text)
    assert _in_force(site) is None


def test_a_refused_definition_stays_in_the_form_with_every_fault(site):
    wrong = written_as_text(EXAMPLE | {"length_bytes": 20, "lengt": 3})
    answer = site.visitor("ada").post(ADDRESS, document=wrong, action="set", reason="x", number="0")
    assert answer.status_code == 422
    assert _typed(answer.text).strip() == wrong.strip()


def test_what_is_no_json_is_refused_with_its_line(site):
    answer = site.visitor("ada").post(ADDRESS, document="{\n,", action="try")
    assert answer.status_code == 422


def test_a_viewer_may_try_and_the_server_refuses_the_form(site):
    visitor = site.visitor("victor")
    assert 'id="set-blocked"' in visitor.get(ADDRESS)
    answer = visitor.post(ADDRESS, document=written_as_text(EXAMPLE), action="set", reason="x", number="0")
    assert answer.status_code == 403
    assert _in_force(site) is None


def test_who_lost_the_race_is_told_and_keeps_what_was_typed(defined):
    text = written_as_text(EXAMPLE | {"fill": 255})
    answer = defined.visitor("ada").post(ADDRESS, document=text, action="set", reason="x", number="0")
    assert answer.status_code == 412
    assert json.loads(_typed(answer.text))["fill"] == 255


def test_every_version_is_listed_with_its_reason(defined, read):
    text = written_as_text(EXAMPLE | {"flight_software_version": "2.0"})
    defined.visitor("adele").post(ADDRESS, document=text, action="set", reason="New <software>.", number="1")
    page = read(defined.visitor("victor").get(ADDRESS)).split("Versions of the definition")[1]
    assert "2.0 New <software>." in page
    assert "1.0.0 First." in page


def test_the_text_of_a_definition_reads_back_as_the_definition():
    document = {"fields": [{"name": "A"}], "table_id": "x"}
    assert json.loads(written_as_text(document)) == document
    assert json.loads(written_as_text(EXAMPLE)) == EXAMPLE


def test_an_unknown_sensor_is_not_found(site):
    assert site.visitor("victor").send("GET", "/sensors/99/table-definition").status_code == 404
