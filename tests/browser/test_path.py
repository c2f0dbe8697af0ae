"""From telemetry to a set that is active on board: few presses, all but those of logging in counted, and always a next step."""

import json
import re

import pytest
from playwright.sync_api import expect

from tests.browser.people import get_password
from tests.browser.work import look_at_views, register_with_table, sent_table

pytestmark = pytest.mark.browser
MOST_PRESSES = 20


class Presses:
    """A person at a page, whose presses are counted: buttons, links, ticks, choices from a list and of files; typing is none."""

    def __init__(self, window):
        self.window, self.page, self.count = window, window.page, 0

    def press(self, kind, name, within=None):
        (within or self.page).get_by_role(kind, name=re.compile(name)).first.click()
        self.count += 1

    def choose(self, field, file):
        """Open the chooser of files and take one."""
        with self.page.expect_file_chooser() as chosen:
            field.click()
        self.count += 1
        chosen.value.set_files(file)

    def next(self, label):
        """Press the button of the bar's next step."""
        button = self.page.locator("#stations .next-act :is(a, button)")
        expect(button).to_have_text(re.compile(f"^{label}"))
        button.click()
        self.count += 1

    def confirm(self, label, **typed):
        asked = self.page.locator("dialog[open]")
        for name, text in typed.items():
            asked.get_by_label(re.compile(name.replace("_", " "))).first.fill(text)
        self.press("button", f"^{label}", asked)


@pytest.fixture(scope="module")
def sensor(people, files):
    """A sensor with a table on board and no baseline but its own."""
    with people.seat("analyst") as window:
        return register_with_table(window, json.loads((files / "sensor.json").read_text()) | {"name": "PATH-1"})


def submit_a_set(people, sensor, files):
    with people.seat("analyst") as window:
        at = Presses(window)
        window.open("/")
        at.press("link", "Upload telemetry of PATH-1", window.page.locator("#fleet"))
        expect(window.page.locator("#sensor_id")).to_have_value(str(sensor))
        at.choose(window.page.get_by_label("Telemetry file"), files / "calibration.csv")
        at.press("button", "Upload and check")
        at.press("button", "^Queue run with it")
        window.page.wait_for_url(re.compile(r"/runs/\d+$"))
        expect(window.page.locator("#stations [aria-current=step]")).to_contain_text("create", timeout=60_000)
        window.shoot("path-1-run")
        at.next("Create parameter set")
        window.page.wait_for_url(re.compile(r"/parameter-sets/\d+$"))
        made = window.page.url
        window.shoot("path-2-set")
        expect(window.page.get_by_label("Reason")).to_be_focused()
        window.page.keyboard.type("The pass of tonight.")
        at.press("button", "^Submit")
        window.page.wait_for_url(re.compile(r"/approvals/\d+$"))
        return at.count, made


def sign_it(people):
    with people.seat("approver") as window:
        at = Presses(window)
        window.open("/")
        at.press("link", "^(Sign|Review)", window.page.locator("main"))
        expect(window.page.locator("[data-view]:not([open])")).to_have_count(0)
        window.figures_drawn()
        look_at_views(window)
        for reason in window.page.locator("#sign .reason").all():
            reason.fill("Known, and small.")
        window.page.locator("#password").fill(get_password("approver"))
        at.press("button", "^Approve", window.page.locator("#sign"))
        at.press("button", "^Approve", window.page.locator("dialog[open]"))
        window.page.wait_for_url(re.compile(r"/signatures/\d+"))
        window.shoot("path-3-signed")
        return at.count


def take_it_on_board(people, made):
    with people.seat("operator") as window:
        at = Presses(window)
        window.open("/")
        at.press("link", "^Promote", window.page.locator("main"))
        at.confirm("Promote", Reason="The pass of tonight.", Your_password=get_password("operator"))
        with window.page.expect_download() as package:
            at.next("Export")
        assert package.value.suggested_filename.endswith(".zip")
        window.page.wait_for_url(re.compile(r"/uplink$"))
        at.next("Record SENT")
        for key in ("Escape", "Enter"):  # the link has the focus again, and opens the dialog again
            window.page.keyboard.press(key)
        at.confirm("Record SENT: package", Source="Pass 4711")
        at.next("Record LOADED")
        if (said := window.page.locator("dialog[open] input[name=c_sd_said]")).count():
            said.fill("Pass 4712, TC 9")
        at.confirm("Record LOADED", Source="Pass 4712")
        expect(window.page.locator("#stations [aria-current=step]")).to_contain_text("read back")
        table = sent_table(window, made.rpartition("/")[2])
        dump = {"name": "dump.bin", "mimeType": "application/octet-stream", "buffer": table}
        at.choose(window.page.get_by_label("Dump of the table"), dump)
        at.confirm("Compare", Source="Pass 4712")
        at.next("Sign ACTIVE")
        at.confirm("Sign", Source="Pass 4713", What_your_signature="I saw it.", Your_password=get_password("operator"))
        expect(window.page.locator("#stations li").last).to_contain_text("Active: done")
        window.shoot("path-4-active")
        return at.count, window.page.locator("#stations .next-act").inner_text()


@pytest.fixture(scope="module")
def path(people, sensor, files):
    submitted, made = submit_a_set(people, sensor, files)
    signed = sign_it(people)
    flown, end = take_it_on_board(people, made)
    return {"analyst": submitted, "approver": signed, "operator": flown}, end


@pytest.mark.full
def test_a_set_is_on_board_after_at_most_twenty_presses(path):
    presses, _ = path
    assert sum(presses.values()) <= MOST_PRESSES, presses


@pytest.mark.full
def test_at_the_end_nothing_is_left_to_do(path):
    assert "no further step" in path[1]
