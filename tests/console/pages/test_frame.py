"""What every page has around its content, and refusals as pages."""

from __future__ import annotations

import dataclasses
import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import hypothesis
import pytest
from fastapi.routing import APIRoute
from hypothesis import strategies as st
from starlette.exceptions import HTTPException
from starlette.requests import Request

from boresight.console import pages
from boresight.console.approvals.tables import APPROVAL_STATES
from boresight.console.fleet.pages.sensors import EXAMPLE
from boresight.console.fleet.tables import Sensor
from boresight.console.pages import rendering
from boresight.console.pages.formats import LEVEL_OF_STATE, LEVELS, get_level, worst
from boresight.console.pages.frame import (
    FLASH_COOKIE,
    NAVIGATION,
    REST,
    UNREAD,
    FleetStatusCache,
    find_worst_status,
    read_fleet_status,
)
from boresight.console.pages.rendering import GREATEST_NUMBER, problem_page
from boresight.console.parameter_sets.tables import GROUND_STATES, ONBOARD_STATES
from boresight.console.runs.tables import RUN_STATES
from boresight.errors import (
    FactorEnrolmentDueError,
    OverloadedError,
    PasswordDueError,
    TooManyAttemptsError,
    UnauthenticatedError,
)
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.data_version import DataVersionReader
from boresight.platform.db.sessions import migrate, open_writing
from boresight.platform.web.problems import KINDS
from boresight.verdicts.verdict import LEVEL_OF_STATUS
from tests.effort import effort
from tests.passwords import add_person
from tests.sites import codes
from tests.stores import url_in

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
    menu, _, content = site.visitor("ada").get("/sensors/1").partition("<main")
    assert re.search(r'href="/sensors"[^>]*aria-current="page"', menu)
    assert menu.count("aria-current") == 1
    assert re.findall(r'href="([^"]*)" aria-current="page"', content) == ["/sensors/1"]
    lines = [line for group in NAVIGATION for line in group.lines]
    assert len({line.key for line in lines}) == len(lines)


def test_the_bar_tells_who_acts_and_what_the_fleet_is_at(site):
    page = site.visitor("ada").get("/audit")
    assert "Ada Analyst" in page
    assert "analyst" in page
    assert "status-caution" in page[: page.index("<main")]


def test_a_flash_is_shown_once_and_escaped(site):
    visitor = site.visitor("ada")
    visitor.cookies.set(FLASH_COOKIE, quote(json.dumps(["normal", "<b>done</b>", "done"])), domain="test.local")
    first = visitor.get("/audit")
    assert "&lt;b&gt;done&lt;/b&gt;" in first
    assert codes(first) == ["done"]
    assert "done" not in visitor.get("/audit")
    for unreadable in ("nonsense", quote('["red","x"]'), quote("[1]"), quote('{"a":1}'), quote('["normal","x"]')):
        visitor.cookies.set(FLASH_COOKIE, unreadable, domain="test.local")
        assert visitor.send("GET", "/audit").status_code == 200


def test_a_page_that_does_not_exist_says_what_to_do_inside_the_frame(site, read):
    answer = site.visitor("ada").send("GET", "/nothing", headers={"accept": "text/html"})
    assert answer.status_code == 404
    assert rendering.SENTENCE[404] in read(answer.text)
    assert answer.headers["x-request-id"] in answer.text
    assert "Ada Analyst" in answer.text
    answer = site.visitor("ada").send("GET", "/sensors/99", headers={"accept": "text/html"})
    assert answer.status_code == 404
    assert "sensor 99" in read(answer.text)


def test_nobody_is_sent_to_the_log_in_and_back(site):
    visitor = site.visitor("ada")
    visitor.cookies.clear()
    answer = visitor.send("GET", "/sensors/1?at=x", headers={"accept": "text/html"})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/login?next=%2Fsensors%2F1%3Fat%3Dx"


def test_a_form_without_the_token_of_this_log_in_is_refused(site):
    answer = site.visitor("ada").send(
        "POST", "/sensors", data={"document": "{}", "csrf_token": "another"}, headers={"accept": "text/html"}
    )
    assert answer.status_code == 403
    assert codes(answer.text) == ["csrf-token"]


def test_a_frame_stands_where_the_store_cannot_be_read(site, monkeypatch):
    visitor = site.visitor("ada")

    def broken(_session):
        raise OSError("disk I/O error")

    monkeypatch.setattr("boresight.console.pages.frame.read_fleet_status", broken)
    page = visitor.get("/audit")
    assert UNREAD.sentence in page
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


def test_every_state_of_the_store_has_a_level_and_the_worst_is_shown():
    states = {*RUN_STATES, *GROUND_STATES, *ONBOARD_STATES, *APPROVAL_STATES}
    assert {LEVEL_OF_STATE[state] for state in states} <= set(LEVELS)
    assert {get_level(state) for state in ("CANCELLED", "REJECTED", "WITHDRAWN", "SUPERSEDED")} == {"off"}  # no alarm
    assert {status: get_level(status) for status in LEVEL_OF_STATUS} == LEVEL_OF_STATUS
    assert [state for state, level in LEVEL_OF_STATE.items() if level == "critical"] == ["MISMATCH"]
    assert (get_level("caution"), get_level("CAUTION"), get_level("never heard")) == ("caution", "caution", "off")
    assert (worst(["SUCCEEDED", "MISMATCH", "FAILED"]), worst([])) == ("critical", "off")


def test_the_fleet_stands_as_its_worst_sensor_and_names_it():
    levels = {"A": "normal", "B": "serious", "C": "serious"}
    tiles = [SimpleNamespace(name=name, status=status, sentence=f"It is {status}.") for name, status in levels.items()]
    standing = find_worst_status(tiles)
    assert (standing.level, standing.word) == ("serious", "SERIOUS")
    assert standing.sentence == "B: It is serious. 1 more like this."
    assert find_worst_status([]).word == "NO SENSORS"


@pytest.fixture
def bare(site, tmp_path):
    folder = tmp_path / "bare"
    settings = dataclasses.replace(site.settings, data_folder=folder, database_url=url_in(folder))
    bare = type(site)(settings)
    migrate(bare.engine)
    with open_writing(bare.engine) as session:
        roles = ["analyst", "operator", "administrator"]
        add_person(session, "ada", *roles, printed_name="Ada Analyst")
    bare.app.state.workers = None
    yield bare
    bare.engine.dispose()


@pytest.mark.parametrize(
    ("path", "sentences"),
    [
        ("/", ["No sensors yet.", "Register a sensor"]),
        ("/sensors", ["No sensors yet.", "Start with the example"]),
        ("/telemetry", ["No telemetry yet.", "Register the sensor first"]),
        ("/users", ["No API keys."]),
        ("/runs", ["No runs yet."]),
        ("/approvals", []),
        ("/parameter-sets", []),
        ("/audit", ["CHAIN INTACT"]),
    ],
)
def test_an_empty_page_says_what_to_do_next(bare, read, path, sentences):
    page = bare.visitor("ada").get(path)
    for sentence in sentences:
        assert sentence in read(page)
    assert "NO SENSORS" in page.split("<main")[0]


SENTENCE = "This is what happened."
LOG_IN = {  # they lead to a page where something can be done
    kind for kind in KINDS if issubclass(kind, UnauthenticatedError | PasswordDueError | FactorEnrolmentDueError)
}
WAITS = {OverloadedError, TooManyAttemptsError}  # they say how long to wait
ERRORS = [
    *(kind(SENTENCE, 3) if kind in WAITS else kind(SENTENCE) for kind in KINDS if kind not in LOG_IN),
    *(HTTPException(status, SENTENCE) for status in (400, 405, 415, 503)),
    ZeroDivisionError("a secret"),
]


@pytest.mark.parametrize(
    "error", ERRORS, ids=lambda error: f"{type(error).__name__}-{getattr(error, 'status_code', '')}"
)
def test_every_refusal_says_what_happened_what_to_do_and_what_to_quote(site, read, error):
    scope = {"type": "http", "method": "POST", "path": "/runs", "headers": [], "query_string": b"", "app": site.app}
    request = Request(scope)
    request.state.actor, request.state.request_id = None, "request-4711"
    page = read(problem_page(request, error).body.decode())
    assert SENTENCE in page or isinstance(error, HTTPException | ZeroDivisionError)
    assert "a secret" not in page
    assert "request-4711" in page
    assert any(
        step in page
        for step in ("Go back", "Try again", "try again", "Read", "Split", "Wait", "Open", "Use the navigation")
    )


@pytest.mark.parametrize(
    ("path", "form", "giver"),
    [
        ("/telemetry/1/archive", {}, "Adele Administrator can give roles"),
        ("/sensors", {"document": EXAMPLE}, "An administrator can give it"),
    ],
)
def test_a_missing_role_is_named_with_who_can_give_it(site, read, path, form, giver):
    visitor = site.visitor("victor")
    token, page_wanted = {"csrf_token": visitor.csrf_token}, {"Accept": "text/html"}
    answer = visitor.send("POST", path, data={**form, **token}, headers=page_wanted)
    page = read(answer.text)
    assert answer.status_code == 403
    assert "role analyst" in page
    assert giver in page


HUGE = "99999999999999999999999"


@pytest.mark.parametrize("number", [HUGE, str(GREATEST_NUMBER + 1), str(GREATEST_NUMBER)])
@pytest.mark.parametrize("page", ["runs", "sensors", "telemetry", "parameter-sets", "approvals"])
def test_a_number_that_no_row_can_have_is_not_found(site, page, number):
    answer = site.visitor("victor").send("GET", f"/{page}/{number}", headers={"Accept": "text/html"})
    assert answer.status_code == 404
    assert "<main" in answer.text


@pytest.mark.parametrize(
    "address",
    [
        f"/runs/{HUGE}/log",
        f"/runs?sensor={HUGE}",
        f"/runs?before={HUGE}",
        f"/compare?runs=1,{HUGE}",
        f"/compare?runs=1,{'9' * 5000}",
        f"/telemetry?sensor={HUGE}",
    ],
)
def test_a_query_with_such_a_number_is_not_found(site, address):
    ada = site.visitor("ada")
    assert ada.send("GET", address, headers={"Accept": "text/html"}).status_code == 404
    assert ada.send("GET", f"/compare?runs={'0' * 40}1,2").status_code == 200  # leading zeros make none greater


NAMES = (
    "sensor", "sensor_id", "set", "data", "state", "method", "sort", "columns", "before", "runs", "reference", "clone", "preset",
    "since", "until", "at", "time", "object", "actor", "action", "verify", "frame", "worst", "scale", "part", "align", "overlay",
    "everything", "q", "find", "page", "next", "free-1", "kind", "purpose", "archived", "telemetry_set_id", "validation_set_id",
    "label", "model", "against", "form", "step", "days", "sha256",
)  # fmt: skip


ODD = st.sampled_from((
    "", "0", "1", "-1", "--1", "1,2", "1,1", ",", "9" * 19, "9" * 30, "9" * 5000, "nan", "inf", "1e400", "x", "é", "\ud7ff", "٣",
    "²", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "2026-11-21", "-run", "run", "state,run,x", "BASELINE",
    "FAILED", "batch", "trust", "summary", "time", "band", "a" * 3000, "%", "=1", "';--", "<b>", "\n", "\u202e",
))  # fmt: skip


QUERY = st.lists(st.tuples(st.sampled_from(NAMES), ODD), max_size=4)


def _paths() -> list[str]:
    routes = [route for module in pages.modules() for router in pages.routers(module) for route in router.routes]
    return sorted({route.path for route in routes if isinstance(route, APIRoute) and "GET" in route.methods})


PATHS = _paths()
assert len(PATHS) > 30


@pytest.fixture(scope="module")
def finished(house):
    return house.finished()


@pytest.mark.few(24)
@pytest.mark.usefixtures("finished")
@pytest.mark.parametrize("path", PATHS)
def test_no_page_ends_in_a_server_error_whatever_its_address_says(path, house):
    client = house.person("adele")

    @hypothesis.settings(max_examples=effort(2, 4), database=None, suppress_health_check=list(hypothesis.HealthCheck))
    @hypothesis.given(query=QUERY, number=st.sampled_from((1, 1, 1, 2, 10**30, "x")))
    def ask(query: list[Any], number: Any) -> None:
        address = re.sub(r"{[^}]+}", str(number), path)
        asked = "&".join(f"{name}={quote(value)}" for name, value in query)
        answer = client.get(f"{address}?{asked}", headers={"Accept": "text/html"})
        assert answer.status_code < 500, (address, query, answer.text[-500:])

    ask()
