"""What every page has around its content, and refusals as pages."""

import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from urllib.parse import quote

import pytest

from boresight.console.fleet.tables import Sensor
from boresight.console.pages.frame import (
    FLASH_COOKIE,
    NAVIGATION,
    REST,
    FleetStatusCache,
    find_worst_status,
    read_fleet_status,
)
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import open_writing

PAGES = ("/sensors", "/sensors/1", "/telemetry", "/audit", "/users")


@pytest.mark.parametrize("path", PAGES)
def test_a_page_has_its_landmarks_one_heading_and_no_inline_script(site, path):
    page = site.visitor("ada").get(path)
    for landmark in ('<header class="top">', 'aria-label="Main"', '<main id="content"', "<footer", 'class="skip"'):
        assert landmark in page
    assert page.count("<h1") == 1
    assert all("src=" in tag for tag in re.findall(r"<script[^>]*>", page))
    assert " style=" not in page
    assert "SIM</span>" in page


@pytest.mark.parametrize("path", PAGES)
def test_every_table_has_a_caption_and_every_control_a_label(site, path):
    page = site.visitor("adele").get(path)
    assert page.count("<table") == page.count("<caption")
    labelled = set(re.findall(r'<label[^>]* for="([^"]+)"', page))
    outside = re.sub(r"<label\b.*?</label>", "", page, flags=re.DOTALL)
    for control in re.findall(r"<(?:input|select|textarea)\b[^>]*>", outside):
        named = re.search(r'\bid="([^"]+)"', control)
        assert 'type="hidden"' in control or (named and named[1] in labelled), control


def test_the_navigation_marks_where_one_is(site):
    page = site.visitor("ada").get("/sensors/1")
    assert re.search(r'href="/sensors"[^>]*aria-current="page"', page)
    assert page.count("aria-current") == 1
    assert len({entry.key for entry in NAVIGATION}) == len(NAVIGATION)


def test_the_bar_tells_who_acts_and_what_the_fleet_is_at(site):
    page = site.visitor("ada").get("/audit")
    assert "Ada Analyst" in page
    assert "analyst" in page
    assert "status-caution" in page[: page.index("<main")]


def test_a_flash_is_shown_once_and_escaped(site):
    visitor = site.visitor("ada")
    visitor.cookies.set(FLASH_COOKIE, quote(json.dumps(["normal", "<b>done</b>"])), domain="test.local")
    first = visitor.get("/audit")
    assert "&lt;b&gt;done&lt;/b&gt;" in first
    assert "done" not in visitor.get("/audit")


@pytest.mark.parametrize("value", ["nonsense", quote('["red","x"]'), quote("[1]"), quote('{"a":1}')])
def test_a_flash_that_cannot_be_read_is_no_flash(site, value):
    visitor = site.visitor("ada")
    visitor.cookies.set(FLASH_COOKIE, value, domain="test.local")
    assert visitor.send("GET", "/audit").status_code == 200


def test_a_page_that_does_not_exist_says_what_to_do_inside_the_frame(site, read):
    answer = site.visitor("ada").send("GET", "/nothing", headers={"accept": "text/html"})
    assert answer.status_code == 404
    assert "There is no page at this address." in read(answer.text)
    assert answer.headers["x-request-id"] in answer.text
    assert "Ada Analyst" in answer.text


def test_a_thing_that_does_not_exist_is_named(site, read):
    answer = site.visitor("ada").send("GET", "/sensors/99", headers={"accept": "text/html"})
    assert answer.status_code == 404
    assert "There is no sensor 99." in read(answer.text)


def test_nobody_is_sent_to_the_log_in_and_back(site):
    visitor = site.visitor("ada")
    visitor.cookies.clear()
    answer = visitor.send("GET", "/sensors/1?at=x", headers={"accept": "text/html"})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/login?next=%2Fsensors%2F1%3Fat%3Dx"


def test_a_form_without_the_token_of_this_log_in_is_refused(site, read):
    answer = site.visitor("ada").send(
        "POST", "/sensors", data={"document": "{}", "csrf_token": "another"}, headers={"accept": "text/html"}
    )
    assert answer.status_code == 403
    assert "reload the page" in read(answer.text)


def test_a_frame_stands_where_the_store_cannot_be_read(site, monkeypatch):
    visitor = site.visitor("ada")

    def broken(_session):
        raise OSError("disk I/O error")

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", broken)
    page = visitor.get("/audit")
    assert "The store could not be read." in page
    assert "disk I/O" not in page


def test_the_frame_has_read_the_store_before_the_page_holds_a_connection(site, monkeypatch):
    held = []

    def watched(session):
        held.append(site.engine.pool.checkedout())
        return read_fleet_status(session)

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", watched)
    monkeypatch.setattr("boresight.console.pages.frame.HELD_S", 0.0)
    for path in PAGES:
        site.visitor("ada").get(path)
    assert held == [0] * len(PAGES)


def test_the_top_bar_looks_at_the_fleet_once_for_many_pages_and_again_after_any_commit(site, monkeypatch):
    looks = []

    def watched(session):
        looks.append(site.engine)
        return read_fleet_status(session)

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", watched)
    visitor = site.visitor("ada")
    visitor.get("/audit")
    del looks[:]
    for _ in range(5):
        visitor.get("/audit")
    assert looks == []
    with open_writing(site.engine) as session:
        session.get_one(Sensor, 1).name = "ST-RENAMED"
        audit.append(session, COMMAND_LINE, "renamed", "sensors/1")
    assert "ST-RENAMED" in visitor.get("/audit")
    assert len(looks) == 1


@pytest.mark.parametrize(("large", "looks"), [(1, 3), (0, 1)], ids=["small", "large"])
def test_a_look_at_a_large_fleet_is_followed_by_a_rest_whatever_is_committed(site, monkeypatch, large, looks):
    clock, asked = [100.0], []

    def look(_session):
        asked.append(1)
        clock[0] += 2.0
        return (find_worst_status([]), 0, 0)

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", look)
    monkeypatch.setattr("boresight.console.pages.frame.LARGE", large)  # there is one sensor
    monkeypatch.setattr("boresight.console.pages.frame.time", SimpleNamespace(monotonic=lambda: clock[0]))
    memory = FleetStatusCache(site.engine, DataVersionReader(site.engine))
    for _ in range(3):
        memory.standing(clock[0])
        with open_writing(site.engine) as session:
            audit.append(session, COMMAND_LINE, "did", "things/1")
    assert len(asked) == looks
    clock[0] += REST * 2.0
    memory.standing(clock[0])
    assert len(asked) == looks + 1


def test_a_look_answers_who_asked_before_it_began_whatever_is_committed_after_it(site, monkeypatch):
    clock, asked = [100.0], []

    def look(_session):
        asked.append(1)
        return (find_worst_status([]), 0, 0)

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", look)
    monkeypatch.setattr("boresight.console.pages.frame.time", SimpleNamespace(monotonic=lambda: clock[0]))
    memory = FleetStatusCache(site.engine, DataVersionReader(site.engine))
    memory.standing(99.0)
    with open_writing(site.engine) as session:
        audit.append(session, COMMAND_LINE, "did", "things/1")
    memory.standing(99.5)
    assert len(asked) == 1
    memory.standing(100.5)
    assert len(asked) == 2


def test_one_page_looks_at_the_fleet_for_all_that_ask_meanwhile(site, monkeypatch):
    asked, go = [], threading.Event()

    def look(_session):
        asked.append(1)
        go.wait(5)
        return (find_worst_status([]), 0, 0)

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", look)
    memory = FleetStatusCache(site.engine, DataVersionReader(site.engine))
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(memory.standing, time.monotonic()) for _ in range(4)]
        go.set()
        assert len({future.result() for future in found}) == 1
    assert len(asked) == 1
