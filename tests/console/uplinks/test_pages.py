"""Uplink: the fleet on the ground and on board, and a set's steps to the spacecraft."""

import html
import json
import re
from dataclasses import replace
from html import unescape

import pytest
from sqlalchemy import select

from boresight.console import list_queries as lists
from boresight.console.fleet import timeline
from boresight.console.fleet.pages.sensors import EXAMPLE
from boresight.console.fleet.timeline import METHODS
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.uplinks import packages, table_definitions
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.pages import steps as uplink
from boresight.console.uplinks.pages.steps import list_package_members, make_uplink_line
from boresight.console.uplinks.pages.table_definition import written_as_text
from boresight.console.uplinks.queries import BOARD_WORDS
from boresight.console.uplinks.service import add_entry
from boresight.console.uplinks.stations import (
    TITLES,
    UPLINK_STATES,
    find_exported_package,
    lay_out,
    list_uplink_stations,
    make_workflow,
)
from boresight.console.uplinks.tables import Package, Uplink
from boresight.platform.actors import SYSTEM, Policy
from boresight.platform.db.sessions import open_reading, open_writing
from boresight.uplink.table_definition import plain_definition
from tests.console.uplinks.pages import advance, define, send_dump, table, version
from tests.console.uplinks.services import DOCUMENT
from tests.sites import PASSWORD, codes, text_of

LADDER = tuple(UPLINK_STATES.values())
STEPS = "/parameter-sets/1/uplink"


def _records(*states: str) -> list[Uplink]:
    return [
        Uplink(id=place, onboard_state=state, source="x", recorded_utc=f"2026-01-01T00:00:{place:02}Z", recorded_by=1)
        for place, state in enumerate(states)
    ][::-1]


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ((), ["next", "to come", "to come", "to come", "to come"]),
        (("SENT",), ["not on record", "done", "next", "to come", "to come"]),
        (("SENT", "LOADED", "MISMATCH"), ["not on record", "done", "done", "MISMATCH", "to come"]),
        (("SENT", "LOADED", "MISMATCH", "SENT"), ["not on record", "done", "next", "to come", "to come"]),
        (("SENT", "LOADED", "MISMATCH", "VERIFIED"), ["not on record", "done", "done", "done", "next"]),
        (("SENT", "UNKNOWN"), ["not on record", "done", "to come", "to come", "to come"]),
        (LADDER, ["not on record", "done", "done", "done", "done"]),
    ],
)
def test_the_ladder_shows_the_present_progress(states, words):
    stopped = bool(states) and states[-1] in {"MISMATCH", "UNKNOWN"}
    taken = list_uplink_stations(None, _records(*states), {1: "Olga Operator"}.get)
    assert [station.word for station in lay_out(taken, TITLES[5:], stopped=stopped)] == words


def test_a_step_stands_at_the_time_that_it_happened_not_when_it_was_typed():
    (sent,) = _records("SENT")
    sent.evidence = {"happened_utc": "2025-12-31T23:00:00Z"}
    station = list_uplink_stations(None, [sent], {1: "Olga Operator"}.get)[1]
    assert station.at_utc == "2025-12-31T23:00:00Z"


def test_while_a_run_is_on_its_way_the_first_station_says_so_and_none_is_next(site):
    known = site.add_run(state="RUNNING")
    with open_reading(site.engine) as session:
        run = session.get_known(Run, known)
        found = make_workflow(session, SYSTEM, Policy(), None, run).stations
    assert [station.level for station in found] == ["standby", *["off"] * 9]
    assert "running" in found[0].word


def test_the_exported_package_is_the_one_that_was_sent_and_before_that_the_newest():
    built = [Package(id=2), Package(id=1)]
    assert find_exported_package(built, []).id == 2
    assert find_exported_package([], []) is None
    records = _records("SENT", "LOADED")
    assert find_exported_package(built, records).id == 2
    records[1].evidence = {"package": {"id": 1, "sha256": "ab"}}
    assert find_exported_package(built, records).id == 1


def test_the_fleet_shows_ground_and_board_side_by_side_and_active_only_where_it_was_recorded(site, read):
    visitor = site.visitor("victor")
    page = read(visitor.get("/uplink"))
    assert re.search(r"NOT SENT .*PS-ST16-1-0 .*nothing recorded", page)
    assert "ACTIVE" not in page
    for address in ("/uplink", STEPS):
        assert text_of(visitor.get(address), "commands-nothing")
    advance(site, *LADDER)
    assert re.search(r"THE SAME .*PS-ST16-1-0 .*ACTIVE .*pass for ACTIVE signed", read(visitor.get("/uplink")))


@pytest.fixture
def fleet(site):
    visitor = site.visitor("ada")
    progresses = {
        "B-sent": ("SENT",),
        "C-mismatch": ("SENT", "MISMATCH"),
        "D-unknown": ("SENT", "UNKNOWN"),
        "E-loaded": LADDER[:2],
        "Z-not-sent": (),
    }
    for name, states in progresses.items():
        assert visitor.post("/sensors", document=EXAMPLE.replace("ST16-7", name)).status_code == 303
        with open_reading(site.engine) as session:
            (row,) = session.scalars(select(ParameterSet).where(ParameterSet.name == f"PS-{name}-0"))
        advance(site, *states, set_id=row.id)
    advance(site, *LADDER)
    return ["C-mismatch", "D-unknown", "B-sent", "E-loaded", "Z-not-sent", "ST16-1"]


def list_names(page):
    return re.findall(r'<th scope="row" class="nowrap"><a href="/sensors/\d+">([^<]*)</a>', page)


def test_the_fleet_is_ordered_and_narrowed_as_its_lines_say(site, fleet):
    visitor = site.visitor("victor")
    assert list_names(visitor.get("/uplink")) == fleet
    assert list_names(visitor.get("/uplink?q=-&status=SENT")) == ["B-sent"]
    assert list_names(visitor.get("/uplink?status=nonsense&page=nonsense&q=D")) == ["D-unknown", "E-loaded"]
    assert list_names(visitor.get("/uplink?q=nobody")) == []
    with open_reading(site.engine) as session:
        for word in BOARD_WORDS:
            for sensor in lists.read_page(session, "sensors", {"board": word}, "board", limit=50):
                assert make_uplink_line(timeline.get_state_at(session, sensor.id)).word == word
                fleet.remove(sensor.name)
    assert fleet == []


def test_a_large_fleet_comes_page_by_page(site, fleet, monkeypatch):
    monkeypatch.setattr(uplink, "BOARDS", replace(uplink.BOARDS, rows_a_page=2))
    visitor, address, seen = site.visitor("victor"), "/uplink", []
    while address:
        page = visitor.get(address)
        seen += list_names(page)
        following = re.search(r'<a href="([^"]*)" rel="next">', page)
        address = following and unescape(following[1])
    assert seen == fleet
    assert 'href="/uplink" rel="prev"' in page


def test_a_dump_with_a_flipped_bit_is_a_mismatch_that_the_page_names(site, read):
    define(site)
    advance(site, "SENT", "LOADED")
    visitor, sent = site.visitor("olga"), table(site)
    answer = send_dump(site, visitor, sent[:17] + bytes([sent[17] ^ 0x10]) + sent[18:])
    assert answer.status_code == 303
    page = visitor.get(STEPS)
    words = read(page)
    assert re.search(r"\b3 .* 17 \(mask 0x10\).* N0_PX", words)
    assert re.search(r"N0_PX 16 [\d.]+ [0-9A-F]{16} [-+.e\d]+ [0-9A-F]{16}", words)
    assert 'class="failed"' in page
    assert send_dump(site, visitor, sent).status_code == 303
    assert codes(visitor.get(STEPS))[:1] == ["read-back"]


def test_the_page_says_who_defines_the_table_and_that_a_typed_crc_verified_by_crc(site, read):
    advance(site, "SENT", "LOADED")
    visitor = site.visitor("olga")
    assert "no-table-definition" in codes(visitor.get(STEPS))
    define(site)
    answer = visitor.post(f"{STEPS}/read-back", crc=table(site)[64:66].hex(), source="TM 1", version=version(site))
    assert answer.status_code == 303
    page = visitor.get(STEPS)
    assert codes(page)[:1] == ["read-back"]
    assert METHODS["crc"] in read(page)


def test_a_signed_entry_makes_it_active_with_name_and_meaning(site, read):
    advance(site, "SENT", "LOADED", "VERIFIED")
    visitor = site.visitor("olga")
    page = visitor.get(STEPS)
    assert 'id="activate-blocked"' not in page
    assert [state for state in uplinks.NEXT if f'name="onboard_state" value="{state}"' in page] == [
        "SENT",
        "MISMATCH",
        "UNKNOWN",
    ]
    entry = {"source": "TM page 2", "meaning": "I saw it in telemetry.", "version": version(site)}
    wrong = visitor.post(f"{STEPS}/activate", password="guess", **entry)
    assert wrong.status_code == 401
    assert "TM page 2" in wrong.text
    assert "guess" not in wrong.text
    assert visitor.post(f"{STEPS}/activate", password=PASSWORD, **entry).status_code == 303
    assert re.search(r"Active done .*Olga Operator TM page 2 signed", read(visitor.get(STEPS)))


def test_what_was_verified_by_word_alone_is_to_be_read_back_before_it_is_signed(site):
    advance(site, "SENT", "LOADED")
    with open_writing(site.engine) as session:
        add_entry(session, site.actor("olga"), session.get_one(ParameterSet, 1), "VERIFIED", "pass 1")
    visitor = site.visitor("olga")
    assert "only by statement" in text_of(visitor.get(STEPS), "activate-blocked")


def test_loaded_is_not_offered_while_a_dump_stands_against_it(site):
    define(site)
    advance(site, "SENT", "LOADED")
    visitor, sent = site.visitor("olga"), table(site)
    send_dump(site, visitor, bytes([sent[0] ^ 1]) + sent[1:])
    advance(site, "UNKNOWN")
    assert 'name="onboard_state" value="LOADED"' not in visitor.get(STEPS)
    send_dump(site, visitor, sent)
    advance(site, "UNKNOWN")
    assert 'name="onboard_state" value="LOADED"' in visitor.get(STEPS)


def test_a_refused_step_says_why_in_place_and_keeps_what_was_typed(site):
    advance(site, "SENT")
    visitor = site.visitor("olga")
    stale = visitor.post(f"{STEPS}/record", onboard_state="LOADED", source="pass 9", version="1")
    assert stale.status_code == 412
    assert 'value="pass 9"' in stale.text
    assert visitor.post(f"{STEPS}/record", onboard_state="LOADED", source="pass 9").status_code == 422
    early = visitor.post(f"{STEPS}/record", onboard_state="ACTIVE", source="pass 9", version=version(site))
    assert early.status_code == 409


@pytest.mark.parametrize("name", ["victor", "ada", "alan", "adele"])
def test_who_is_no_operator_is_told_who_may_and_refused_by_the_server(site, name):
    advance(site, "SENT")
    visitor = site.visitor(name)
    page = visitor.get(STEPS)
    assert 'action="/parameter-sets/1/uplink/record"' not in page
    answer = visitor.post(f"{STEPS}/record", onboard_state="LOADED", source="x", version=version(site))
    assert answer.status_code == 403


def test_the_package_is_built_once_and_listed_with_hashes_and_the_way_back(site, read):
    define(site)
    visitor = site.visitor("olga")
    for _ in range(2):
        assert visitor.post(f"{STEPS}/package").status_code == 303
    words = read(visitor.get(STEPS))
    assert "Exported done" in words
    assert "Back-out PS-ST16-1-0" in words
    assert "SHA256SUMS" in words
    with open_reading(site.engine) as session:
        (package,) = lists.list_newest(session, Package)
        members = list_package_members(packages.read(session, site.blobs, package.id))
    assert {"MANIFEST.json", "parameters.json"} <= {member.name.rpartition("/")[2] for member in members}


def test_what_does_not_exist_has_neither_steps_nor_a_table_nor_a_timeline(site):
    for address in ("/parameter-sets/99/uplink", "/sensors/99/table-definition", "/sensors/99/timeline"):
        site.visitor("olga").get(address, status=404)


ADDRESS = "/sensors/1/table-definition"
LAYOUT = plain_definition("inverted_wang")


def _typed(page):
    return html.unescape(re.search(r'<textarea id="document"[^>]*>(.*?)</textarea>', page, re.DOTALL)[1])


def _in_force(site):
    with open_reading(site.engine) as session:
        return table_definitions.find_definition_in_force(session, 1)


@pytest.fixture
def defined(site):
    answer = site.visitor("ada").post(
        ADDRESS, document=written_as_text(LAYOUT), reason="First.", action="set", number="0"
    )
    assert answer.status_code == 303, answer.text
    return site


def test_without_a_definition_the_page_says_so_and_offers_an_example(site):
    visitor = site.visitor("ada")
    assert "no-table-definition" in codes(visitor.get(ADDRESS))
    page = visitor.get(f"{ADDRESS}?example=1")
    assert json.loads(_typed(page)) == LAYOUT
    assert 'id="not-in-force"' in page


def test_a_viewer_may_try_a_definition_and_set_none(site, read):
    visitor = site.visitor("victor")
    assert 'id="set-blocked"' in visitor.get(ADDRESS)
    text = written_as_text(LAYOUT | {"byte_order": "little"})
    answer = visitor.post(ADDRESS, document=text, action="try")
    assert "F_M f_m 0 float32, little" in read(answer.text)
    assert visitor.post(ADDRESS, document=text, action="set", reason="x", number="0").status_code == 403
    assert _in_force(site) is None


def test_a_refused_definition_stays_in_the_form(site):
    wrong = written_as_text(LAYOUT | {"length_bytes": 20, "lengt": 3})
    answer = site.visitor("ada").post(ADDRESS, document=wrong, action="set", reason="x", number="0")
    assert answer.status_code == 422
    assert _typed(answer.text).strip() == wrong.strip()
    assert site.visitor("ada").post(ADDRESS, document="{\n,", action="try").status_code == 422


def test_who_lost_the_race_is_told_and_keeps_what_was_typed(defined):
    text = written_as_text(LAYOUT | {"fill": 255})
    answer = defined.visitor("ada").post(ADDRESS, document=text, action="set", reason="x", number="0")
    assert answer.status_code == 412
    assert json.loads(_typed(answer.text))["fill"] == 255


def test_the_layout_has_offset_type_and_order_and_every_version_its_reason(defined, read):
    text = written_as_text(LAYOUT | {"flight_software_version": "2.0"})
    defined.visitor("adele").post(ADDRESS, document=text, action="set", reason="New <software>.", number="1")
    layout, page = read(defined.visitor("victor").get(ADDRESS)).split("Versions of the definition")
    assert "F_M f_m 0 float32, big" in layout
    assert "CRC CRC-16/CCITT-FALSE 34 uint16, big" in layout
    assert "2.0 New <software>." in page
    assert "1.0.0 First." in page


def test_the_text_of_a_definition_reads_back_as_the_definition():
    document = {"fields": [{"name": "A"}], "table_id": "x"}
    assert json.loads(written_as_text(document)) == document
    assert json.loads(written_as_text(LAYOUT)) == LAYOUT


def test_the_crc_to_expect_is_not_on_the_page_of_the_layout_while_a_read_back_is_awaited(site):
    visitor, address = site.visitor("olga"), "/sensors/1/table-definition"
    define(site)
    with open_reading(site.engine) as session:
        layout = table_definitions.lay_out(session, 1, DOCUMENT)
    told = layout.definition.crc.text(layout.decoded.crc)
    assert told in visitor.get(address)
    advance(site, "SENT", "LOADED")
    assert told not in visitor.get(address)
    advance(site, "VERIFIED")
    assert told in visitor.get(address)
