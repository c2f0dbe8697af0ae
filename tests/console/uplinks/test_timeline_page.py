"""A sensor's timeline: the answer for a time with who said so, and the events."""

import re
from urllib.parse import quote

from boresight.console.uplinks import service as uplinks
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from tests.console.uplinks.pages import climb, define

PAGE = "/sensors/1/timeline"


def test_the_answer_for_now_names_baseline_board_and_definition(site, read):
    define(site)
    climb(site, "SENT", "LOADED", "VERIFIED", "ACTIVE")
    words = read(site.visitor("victor").get(PAGE))
    assert "As of now" in words
    assert "Baseline PS-ST16-1-0, on board PS-ST16-1-0 ACTIVE: the same." in words
    assert re.search(r"Table definition 1 .*Ada Analyst: As flown\.", words)
    assert re.search(r"PS-ST16-1-0 ACTIVE .*Olga Operator pass for ACTIVE signed: I saw it\.", words)


def test_the_answer_for_a_time_is_of_that_time_and_in_the_address(site, read):
    climb(site, "SENT")
    between = utc_after(0.0)
    climb(site, "LOADED")
    page = site.visitor("victor").get(f"{PAGE}?at={quote(between)}")
    answer = read(page).split("What happened")[0]
    assert f"As of {between}" in answer
    assert ("SENT" in answer, "LOADED" in answer) == (True, False)
    assert f'value="{between}"' in page


def test_before_everything_nothing_is_claimed(site, read):
    words = read(site.visitor("victor").get(f"{PAGE}?at=2000-01-01T00:00Z"))
    assert "No baseline, on board no set known to be active." in words
    assert "Nothing had been recorded on board." in words


def test_what_is_no_time_is_refused_in_place_with_the_events_still_there(site, read):
    page = site.visitor("victor").get(f"{PAGE}?at=yesterday", status=422)
    assert "is no time; write it like 2026-11-21T03:04:05Z" in read(page)
    assert "ground calibration" in read(page)


def test_what_was_learned_later_is_shown_apart(site, read):
    with open_writing(site.engine) as session:
        uplinks.record(session, site.actor("olga"), 1, "SENT", "pass 7", happened=utc_after(-7200.0))
    words = read(site.visitor("victor").get(f"{PAGE}?at={quote(utc_after(-3600.0))}"))
    assert "Nobody could act on it then." in words
    assert "pass 7" in words.split("Learned later")[1]


def test_the_events_are_paged_and_keep_the_question(site, read):
    for _ in range(20):
        climb(site, "SENT", "UNKNOWN", "VERIFIED")
    at = quote(utc_after(0.0))
    visitor = site.visitor("victor")
    page = visitor.get(f"{PAGE}?at={at}")
    older = re.search(r'href="([^"]+before=\d+)"', page)[1].replace("&amp;", "&")
    assert "at=" in older
    assert "ground calibration" in read(visitor.get(older))
    assert "ground calibration" not in read(page).split("What happened")[1]


def test_a_source_that_is_markup_is_shown_as_text(site):
    with open_writing(site.engine) as session:
        uplinks.record(session, site.actor("olga"), 1, "SENT", "<script>alert(1)</script>")
    for address in (PAGE, "/uplink", "/parameter-sets/1/uplink"):
        page = site.visitor("victor").get(address)
        assert "<script>alert" not in page
        assert "&lt;script&gt;alert(1)" in page


def test_every_state_of_the_store_is_left_as_it_was_by_looking(site):
    climb(site, "SENT")
    with open_reading(site.engine) as session:
        before = [row.id for row in uplinks.list_uplinks(session)]
    for address in (PAGE, "/uplink", "/parameter-sets/1/uplink"):
        site.visitor("olga").get(address)
    with open_reading(site.engine) as session:
        assert [row.id for row in uplinks.list_uplinks(session)] == before


def test_a_sensor_that_does_not_exist_has_no_timeline(site):
    assert site.visitor("victor").send("GET", "/sensors/99/timeline").status_code == 404
