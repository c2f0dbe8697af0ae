"""The operator's part: a set on its way to the spacecraft and back, and a drift alarm seen, handled and over."""

import json
import re

import numpy as np
import pytest
from playwright.sync_api import expect

from boresight.console.alarms import rules
from boresight.console.fleet import service as sensors
from boresight.console.fleet.pages.sensors import EXAMPLE
from boresight.console.runs.tables import Run
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.db.sessions import open_engine, open_writing
from boresight.settings import read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.browser.people import PRINTED_NAMES, get_password
from tests.browser.work import register_with_table, sent_table
from tests.missions import add_run, add_set, make_baseline

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def sensor(people):
    with people.seat("analyst") as window:
        return register_with_table(window, json.loads(EXAMPLE.replace("ST16-7", "FLOWN-1")))


def record(window, state, source, *, is_early=False):
    """Record a step; early: the dialog is opened before its script runs, so as a popover."""
    if is_early:
        window.page.locator(f"#record-{state.lower()}").evaluate("dialog => dialog.showPopover()")
    else:
        window.page.locator("#stations").get_by_role("button", name=f"Record {state}").click()
    asked = window.page.get_by_role("dialog")
    asked.get_by_label("Source").fill(source)
    asked.get_by_role("button", name=state).first.click()
    expect(window.page.get_by_role("status").filter(has_text="Recorded: the set is")).to_be_visible()


def upload(window, dump, source):
    form = window.page.get_by_role("region", name="Read back")
    file = {"name": "dump.bin", "mimeType": "application/octet-stream", "buffer": dump}
    form.get_by_label("Dump of the table").set_input_files(file)
    asked = window.page.get_by_role("dialog")
    asked.get_by_label("Source").fill(source)
    asked.get_by_role("button", name="Compare and record").click()


def test_a_set_goes_from_export_to_active_through_a_dump_that_was_damaged(people, sensor):
    with people.seat("operator") as window:
        window.open("/uplink")
        window.page.get_by_role("link", name="Steps of PS-FLOWN-1-0").click()
        steps = window.page.url
        window.page.get_by_role("button", name=re.compile("^Build the package")).click()
        expect(window.page.get_by_role("status").filter(has_text="The package is built")).to_be_visible()
        ladder = window.page.locator(".ladder")
        expect(ladder.get_by_role("listitem").first).to_contain_text("done")
        record(window, "SENT", "Pass 4711, TC log line 88")
        record(window, "LOADED", "Pass 4711, TM 6", is_early=True)
        table = sent_table(window, steps.split("/")[-2])
        upload(window, table[:17] + bytes([table[17] ^ 0x10]) + table[18:], "Pass 4712, dump 1")
        found = window.page.get_by_role("region", name="What the last read-back found")
        expect(found).to_contain_text("bit 3 of byte 17 (mask 0x10), in N0_PX")
        expect(found.get_by_role("table", name="Fields that differ")).to_contain_text("N0_PX")
        assert window.barriers() == []
        window.shoot("30-mismatch", wide=True)
        window.open("/uplink")
        expect(window.page.get_by_role("row").nth(1)).to_contain_text("FLOWN-1 MISMATCH")
        window.shoot("31-uplink-mismatch")
        window.open(steps)
        upload(window, table, "Pass 4712, dump 2")
        expect(window.page.get_by_role("status").filter(has_text="byte for byte")).to_be_visible()
        window.page.locator("#stations").get_by_role("button", name="Sign ACTIVE").click()
        form = window.page.get_by_role("dialog")
        form.get_by_label("Source").fill("TM page STR-2")
        form.get_by_label("What your signature means").fill("I saw this table active in telemetry.")
        form.locator("#password").fill(get_password("operator"))
        window.shoot("32-to-sign-active")
        form.get_by_role("button", name=re.compile("^Sign")).click()
        expect(ladder.get_by_role("listitem").last).to_contain_text("Olga Operator")
        window.shoot("33-active", wide=True)
        window.open(f"/sensors/{sensor}/timeline")
        expect(window.page.locator(".standing-line")).to_contain_text("ACTIVE: the same")
        window.shoot("34-timeline", wide=True)
        then = window.page.get_by_role("row").filter(has_text="MISMATCH").get_by_role("link", name="Show")
        then.last.click()
        window.page.wait_for_url("**/timeline?at=*")
        expect(window.page.get_by_role("region", name=re.compile("^As of"))).to_contain_text("MISMATCH")
        assert window.barriers() == []


NUMBER = 5  # of the simulated sensors; the others here use the first


@pytest.fixture(scope="module")
def store(installation):
    engine = open_engine(read_settings(installation.environment).database_url)
    yield engine
    engine.dispose()


@pytest.fixture(scope="module")
def drifting(store, installation):
    blobs = open_blobs(read_settings(installation.environment).blob_location)
    rng = np.random.default_rng(4)
    with open_writing(store) as session:
        document = sensor_document(st16_sensor(NUMBER))
        sensor = sensors.register_sensor(session, COMMAND_LINE, document, simulated=True)
        for month in range(10):
            data = add_set(session, sensor.id, 30.0 * month, temperature_c=20 + 6 * np.sin(month), blobs=blobs)
            run = add_run(session, data, rng, 0.05 * month * np.eye(8)[0])
            if month == 2:
                make_baseline(session, run)
        rules.update_alarms(session, [sensor.id])
        return sensor.id


def recalibrated(store, sensor_id):
    with open_writing(store) as session:
        newest = session.query(Run).filter_by(sensor_id=sensor_id).order_by(Run.id.desc()).first()
        make_baseline(session, newest)
        rules.update_alarms(session, [sensor_id])


def test_a_drift_alarm_is_seen_handled_understood_and_over(people, store, drifting):
    with people.seat("operator") as window:
        window.open("/")
        row = window.page.get_by_role("table", name="Sensors").get_by_role("row", name=re.compile("ST16-5"))
        expect(row).to_contain_text("Drift detected: alarm")
        window.shoot("80-overview-drift", wide=True)
        window.page.locator("#live-mine li").filter(has_text="ST16-5 drifts").get_by_role("link").click()
        window.page.wait_for_url(re.compile(r"/alarms/\d+$"))
        address = re.sub(".*(/alarms/.*)", r"\1", window.page.url)
        window.holds_in_themes_and_widths("alarm")
        window.page.get_by_label("Assign to").select_option(label=PRINTED_NAMES["analyst"])
        window.page.get_by_role("button", name="Assign").click()
        window.page.get_by_label("Comment").fill("Seen on the night shift; the day shift recalibrates.")
        window.page.get_by_role("button", name="Acknowledge").click()
        expect(window.page.locator("#alarm-head .subtitle")).to_have_text("acknowledged, active")
        window.shoot("81-alarm-acknowledged")
    with people.seat("analyst") as window:
        window.open(f"/sensors/{drifting}/trend")
        expect(window.page.locator("#advice")).to_contain_text("Recalibrate: PS-ST16-5-1 is no longer valid.")
        window.figures_drawn()
        window.shoot("82-trend", wide=True)
        window.open("/alarms")
        expect(window.page.get_by_role("table")).to_contain_text(PRINTED_NAMES["analyst"])
        recalibrated(store, drifting)
        window.open(address)
        expect(window.page.locator("#alarm-head .subtitle")).to_have_text("closed")
        window.shoot("83-alarm-closed")


TICKS = "[...document.querySelectorAll('plot-figure .xaxislayer-above text')].map(tick => tick.textContent)"
HOVERED = "[...document.querySelectorAll('plot-figure .figure-canvas')].flatMap(it => it.data.flatMap(one => one.hovertext ?? []))"
#: Texts of the top bar that lie over each other.
OVER = """() => {
    const texts = [], walker = document.createTreeWalker(document.querySelector('.top'), NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
        if (!node.data.trim() || node.parentElement.closest('.sr, dialog') || !node.parentElement.checkVisibility()) continue;
        const range = document.createRange();
        range.selectNodeContents(node);
        texts.push([node.data.trim(), range.getBoundingClientRect()]);
    }
    return texts.flatMap(([name, a], at) => texts.slice(at + 1)
        .filter(([, b]) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1)
        .map(([other]) => `${name} / ${other}`));
}"""
LOOK_OF_FORM = {"iso": r"\d{4}-\d\d-\d\d", "day_of_year": r"\d{4}-\d{3}"}


@pytest.mark.full
def test_clock_and_time_axes_are_in_the_form_that_was_chosen(people, drifting):
    with people.seat("analyst") as window:
        for form in ("iso", "local", "day_of_year"):
            window.open("/preferences")
            window.page.locator("#zone").fill("Asia/Kathmandu")
            window.page.locator(f"#form-{form}").check()
            window.shoot(f"84-preferences-{form}")
            window.page.get_by_role("button", name="Save", exact=True).click()
            expect(window.page.locator("html")).to_have_attribute("data-times", form)
            window.open(f"/sensors/{drifting}/trend")
            window.figures_drawn()
            for width in (820, 1280, 1440):
                window.page.set_viewport_size({"width": width, "height": 720})
                assert window.page.evaluate(OVER) == []
            day = LOOK_OF_FORM.get(form, LOOK_OF_FORM["iso"])
            expect(window.page.locator("#clock")).to_have_text(re.compile(rf"^{day} "))
            ticks = window.page.evaluate(TICKS)
            assert ticks
            assert all(re.fullmatch(rf"({day})|\d\d:\d\d:\d\d({day})?", tick) for tick in ticks), ticks
            hovered = window.page.evaluate(HOVERED)
            assert bool(hovered) == (form == "local")
            assert all("+05:45)" in text for text in hovered)


@pytest.mark.full
def test_a_mention_leads_to_its_comment_though_the_gate_that_it_is_about_is_folded_away(people, numbers):
    about = {"kind": "gate", "name": "coverage", "text": "@approver is one corner empty?"}
    with people.seat("analyst") as window:
        window.open(f"/approvals/{numbers['request']}")
        assert window.send(f"/approvals/{numbers['request']}/threads", about).ok
    with people.seat("approver") as window:
        window.open("/")
        window.page.get_by_role("link", name=re.compile("^Answer")).click()
        expect(window.page.locator("blockquote", has_text="is one corner empty?")).to_be_in_viewport()
