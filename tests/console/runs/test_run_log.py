"""The log tab: how grave a line is, the filter in the address, and the lines after a line."""

import re

import pytest

from boresight.console.runs.queries import Line, write_event
from boresight.console.runs.tables import RUN_STATES
from boresight.platform.db.sessions import open_writing

LINES = [
    (Line.moved("QUEUED"), "QUEUED", "info"),
    (Line.begun(1, "host/1"), "RUNNING: attempt 1 on host/1", "info"),
    (Line.log("10 %: frame 4: 4 of 40 frames", {"fraction": 0.1}), "10 %: frame 4: 4 of 40 frames", "info"),
    (Line.attempt_ended(1, "its server was stopped", is_lost=False), "Attempt 1: its server was stopped", "warning"),
    (Line.queued_again("its server was stopped"), "QUEUED: again, because its server was stopped", "warning"),
    (Line.attempt_ended(2, "its worker process died", is_lost=True), "Attempt 2: its worker process died", "error"),
    (Line.log("Traceback:\n  <b>1</b> / 0", level="error"), "Traceback:\n  <b>1</b> / 0", "error"),
    (Line.moved("CANCELLING", "Cancelled by Ada."), "CANCELLING: Cancelled by Ada.", "warning"),
    (Line.moved("FAILED", "given up"), "FAILED: given up", "error"),
]


@pytest.fixture
def run_id(site):
    made = site.add_run(state="FAILED", reason="given up")
    with open_writing(site.engine) as session:
        for line, *_ in LINES:
            write_event(session, made, 1, line)
    return made


def shown(page):
    return re.findall(r'<li data-line="\d+" data-level="(\w+)"', page)


@pytest.mark.parametrize(("line", "message", "level"), LINES)
def test_a_line_has_its_sentence_and_how_grave_it_is(line, message, level):
    assert (line.message, line.level) == (message, level)


def test_the_api_gives_what_a_line_says_as_fields_too(site, run_id):
    lines = site.visitor("victor").send("GET", f"/api/v1/runs/{run_id}/log").json()["items"]
    told = [(line["state"], line["cause"], line["level"], line["numbers"]) for line in lines]
    assert told == [(line.state, line.cause, line.level, line.numbers) for line, *_ in LINES]


@pytest.mark.parametrize("state", RUN_STATES)
def test_every_end_without_a_result_is_more_than_information(state):
    grave = Line.moved(state).level != "info"
    assert grave is (state in {"FAILED", "LOST", "CANCELLED", "CANCELLING"})


def test_the_filter_is_in_the_address_and_each_choice_says_how_many_lines_it_has(site, read, run_id):
    victor = site.visitor("victor")
    assert shown(victor.get(f"/runs/{run_id}?part=log")) == [level for *_, level in LINES]
    page = victor.get(f"/runs/{run_id}?part=log&level=error")
    assert shown(page) == ["error"] * 3
    assert "All lines 9 Warnings and errors 6 Errors 3" in " ".join(read(page).split())
    assert f'href="/runs/{run_id}/log" download' in page


def test_a_log_in_which_nothing_is_that_grave_says_so(site):
    page = site.visitor("victor").get("/runs/1?part=log&level=error")
    assert "<li" not in page.split('<ol class="log"')[1].split("</ol>")[0]


def test_a_level_that_is_none_is_refused(site, run_id):
    site.visitor("victor").get(f"/runs/{run_id}?part=log&level=loud", status=422)
    site.visitor("victor").get(f"/runs/{run_id}/log/lines?level=loud", status=422)


def test_a_page_that_follows_gets_only_the_lines_after_its_last(site, run_id):
    victor = site.visitor("victor")
    numbers = re.findall(r'data-line="(\d+)"', victor.get(f"/runs/{run_id}/log/lines"))
    later = victor.get(f"/runs/{run_id}/log/lines?after={numbers[5]}&level=warning")
    assert re.findall(r'data-line="(\d+)"', later) == numbers[6:]
    assert victor.get(f"/runs/{run_id}/log/lines?after={numbers[-1]}").strip() == ""


def test_what_a_log_says_is_text(site, run_id):
    page = site.visitor("victor").get(f"/runs/{run_id}/log/lines")
    assert "&lt;b&gt;1&lt;/b&gt; / 0" in page
