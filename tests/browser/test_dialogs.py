"""Every dialog of an act fits its window with the act in sight, hides no field, keeps the focus, and says what follows."""

import json
import re
from contextlib import contextmanager

import pytest
from playwright.sync_api import expect

from boresight.console.ingest.tables import ANSWERS
from tests.browser.people import get_password
from tests.browser.window import GLANCE, PHONE, TABLET, Window
from tests.browser.work import make_set, queue, register_with_table, sent_table, sign, submit, upload
from tests.console.access.authenticators import enrol_app
from tests.console.alignments.pairs import aligned_well, submitted
from tests.console.approvals.gates import blocked
from tests.console.change_proposals.proposals import proposed
from tests.console.ingest.decisions import draft, in_force, step, with_alternatives
from tests.console.uplinks.routes import hand_over

pytestmark = pytest.mark.browser

NAME = "DIALOG-1"
OLD, NEW = f"PS-{NAME}-0", f"PS-{NAME}-1"
WRONG = """dialog => {
    const said = [], box = dialog.getBoundingClientRect();
    const last = [...dialog.querySelectorAll(".actions")].at(-1);
    dialog.scrollTop = 0;
    const foot = last.getBoundingClientRect();
    if (box.left < 0 || box.top < 0 || box.right > innerWidth + 1 || box.bottom > innerHeight + 1) said.push("outside the window");
    if (dialog.scrollWidth > dialog.clientWidth + 1) said.push("leads sideways");
    if (foot.top < box.top || foot.bottom > box.bottom + 1) said.push("its act is out of sight");
    if (!dialog.contains(document.activeElement)) said.push("the focus is outside");
    for (const field of dialog.querySelectorAll("input:not([type=hidden]), textarea, select")) {
        if (!field.checkVisibility() || field.disabled) continue;
        field.blur(); // what has the focus already is not scrolled to
        field.focus();
        const own = field.getBoundingClientRect();
        const seen = document.elementFromPoint(own.left + own.width / 2, own.top + own.height / 2);
        if (seen !== field && !field.contains(seen) || own.bottom > foot.top + 1) said.push(`${field.name} is covered`);
    }
    dialog.scrollTop = 0;
    return said;
}"""


def holds(window, name, *, named=(OLD, NEW)):
    """Hold that a dialog of the page fits in every width, says what it is about, and gives the focus back."""
    page = window.page
    dialog, opener = page.locator(f"#{name}"), page.locator(f"[data-act][popovertarget={name}]")
    for size in (PHONE, TABLET, GLANCE):
        page.set_viewport_size(size)
        expect(opener).to_have_count(1)
        opener.scroll_into_view_if_needed()
        opener.click()
        expect(dialog).to_be_visible()
        window.settle()
        assert dialog.evaluate(WRONG) == [], f"{name} at {size['width']} px"
        window.keep(f"dialog-{name}-{size['width']}", whole=False)
        for words in named:
            expect(dialog).to_contain_text(words)
        expect(dialog).to_contain_text("cannot be undone", ignore_case=True)
        page.keyboard.press("Escape")
        expect(dialog).to_be_hidden()
        expect(opener).to_be_focused()


def changes(window, name):
    """Hold that a dialog lists parameters, those that change most first."""
    rows = window.page.locator(f"#{name} tbody tr")
    worth = [abs(float(row.locator("td").last.inner_text().replace("−", "-"))) for row in rows.all()]
    assert worth
    assert worth == sorted(worth, reverse=True)


@pytest.fixture(scope="module")
def made(people, files):
    """A set of a sensor of its own, whose loading turns the attitude; its number."""
    with people.seat("analyst") as window:
        sensor = register_with_table(window, json.loads((files / "sensor.json").read_text()) | {"name": NAME})
        data = upload(window, sensor, files / "calibration.csv")
        window.open(f"/runs/new?set={data}")
        run = queue(window, "For dialogs")
        expect(window.page.locator("#stations [aria-current=step]")).to_contain_text("create", timeout=60_000)
        return make_set(window, run)


@pytest.fixture(scope="module")
def asked(people, made):
    with people.seat("analyst") as window:
        window.open(f"/parameter-sets/{made}")
        return submit(window, "To look at dialogs.")


@pytest.fixture(scope="module")
def approved(people, made, asked):
    with people.seat("analyst") as window:
        window.open(f"/parameter-sets/{made}")
        holds(window, "withdraw", named=(NEW,))
    with people.seat("approver") as window:
        window.open(f"/approvals/{asked}")
        for reason in window.page.locator("#sign .reason").all():
            reason.fill("Known, and small.")
        window.page.locator("#password").fill(get_password("approver"))
        for name in ("approve", "refuse"):
            holds(window, name, named=(NAME, OLD, NEW))
            changes(window, name)
        sign(window, "Approve", get_password("approver"))
        expect(window.page.get_by_role("heading", level=1)).to_contain_text("Approved")
    return made


@pytest.fixture(scope="module")
def baseline(people, approved):
    with people.seat("operator") as window:
        window.open(f"/parameter-sets/{approved}")
        holds(window, "promote", named=(NAME, OLD, NEW))
        changes(window, "promote")
        window.page.locator("[data-act][popovertarget=promote]").click()
        dialog = window.page.get_by_role("dialog")
        dialog.get_by_label("Reason").fill("Now.")
        dialog.get_by_label("Your password").fill(get_password("operator"))
        dialog.get_by_role("button", name="Promote").click()
        expect(window.page.locator(".two-states")).to_contain_text("BASELINE")
    return approved


def test_the_dialogs_on_the_ground(people, baseline):
    with people.seat("analyst") as window:
        before = window.read(f"/api/v1/parameter-sets/{baseline}")["sensor_id"]
        sets = window.read(f"/api/v1/parameter-sets?sensor_id={before}")["items"]
        window.open(f"/parameter-sets/{min(one['id'] for one in sets)}")
        holds(window, "roll-back", named=(NAME, NEW, OLD))
        changes(window, "roll-back")


def confirm(window, effect, **typed):
    dialog = window.page.get_by_role("dialog")
    for label, text in typed.items():
        dialog.get_by_label(re.compile(label.replace("_", " "))).first.fill(text)
    dialog.get_by_role("button", name=re.compile(f"^{effect}")).click()


def test_the_dialogs_on_the_way_to_the_spacecraft(people, baseline):
    with people.seat("operator") as window:
        page = window.page
        window.open(f"/parameter-sets/{baseline}/uplink")
        page.locator("#stations").get_by_role("button", name="Export").click()
        holds(window, "record-sent", named=(NAME, OLD, NEW, "not send anything"))
        page.locator("[data-act][popovertarget=record-sent]").click()
        confirm(window, "Record SENT: package", Source="Pass 1")
        for name in ("record-loaded", "record-mismatch", "record-unknown"):
            holds(window, name, named=(NAME, OLD, NEW))
            changes(window, name)
        page.locator("[data-act][popovertarget=record-loaded]").click()
        expect(page.get_by_role("dialog").locator("button[name=c_sd]")).to_have_count(3)  # the press is the answer
        confirm(window, "Record LOADED: C_SD not yet", Source="Pass 1")
        holds(window, "c-sd", named=(NAME, NEW))
        holds(window, "compare", named=(NAME, OLD, NEW))
        table = {"name": "dump.bin", "mimeType": "application/octet-stream", "buffer": sent_table(window, baseline)}
        page.get_by_label("Dump of the table").set_input_files(table)
        confirm(window, "Compare", Source="Pass 1")
        holds(window, "activate", named=(NAME, OLD, NEW, "C_SD is not recorded as loaded"))


@pytest.mark.parametrize(("address", "opener"), [("/users", "Disable")])
def test_the_dialogs_of_people(people, address, opener):
    with people.seat("administrator") as window:
        window.open(address)
        first = window.page.locator("[data-act]", has_text=re.compile(f"^{opener}")).first
        holds(window, first.get_attribute("popovertarget"), named=())


HOOK = {"label": "To look at", "url": "https://mission.invalid/hooks", "actions": ["backups.*"]}


@pytest.mark.full
def test_the_dialog_that_disables_a_webhook(people):
    with people.seat("administrator") as window:
        window.open("/webhooks")
        token = window.page.locator("input[name=csrf_token]").first.input_value()
        made = window.page.request.post("/api/v1/webhooks", data=HOOK, headers={"X-CSRF-Token": token})
        assert made.ok, made.text()
        window.open(f"/webhooks/{made.json()['id']}")
        for name in ("disable", "renew-secret"):
            holds(window, name, named=(HOOK["label"], HOOK["url"]))


@contextmanager
def seat(browser, house, client):
    """Sit at a window of somebody who is logged in at the house, where each state is made over REST and nothing is computed."""
    context = browser.new_context(base_url=house.address, viewport=GLANCE, reduced_motion="reduce")
    context.add_cookies([{"name": one.name, "value": one.value, "url": house.address} for one in client.cookies.jar])
    window = Window(context)
    yield window
    complaints = window.leave()
    context.close()
    assert not complaints, complaints


def _waiver(house):
    row = blocked(house)
    return f"/parameter-sets/{row['id']}/gates", ["waive-gate-dialog"], [row["name"]]


def _hand_over(house):
    _, made = hand_over(house)
    row = house.person("olga").get(f"/api/v1/parameter-sets/{made['parameter_set_id']}").json()
    return f"/parameter-sets/{row['id']}/uplink", ["hand-over-yamcs"], [row["name"], "Nothing is commanded"]


def _address(house):
    new = {"address": "ada@mission.invalid", "label": "Desk of Ada"}
    made = house.person("ada").post("/api/v1/message-addresses", json=new)
    assert made.status_code == 201, made.text
    return f"/preferences/messages/{made.json()['id']}", ["remove"], [new["label"]]


def _key(house):
    house.key("ada", "runs")
    newest = house.person("ada").get("/api/v1/api-keys").json()["items"][0]
    return "/users", [f"revoke-{newest['id']}"], [newest["label"]]


def _draft(house):
    row = step(house, draft(house, house.new_sensor()["id"]), "rehearse")
    return _policy(house, row, "enable", "switch-off")


def _policy(house, row, *steps):
    sensor = house.person("ada").get(f"/api/v1/sensors/{row['sensor_id']}").json()
    return f"/sensors/{sensor['id']}/ingest", [f"step-{name}" for name in steps], [sensor["name"]]


def _decision(house):
    row = with_alternatives(house)
    sensor = house.person("ada").get(f"/api/v1/sensors/{row['sensor_id']}").json()
    return f"/ingest/{row['id']}", [f"answer-{place}" for place in range(1, len(ANSWERS) + 1)], [sensor["name"]]


def _to_submit(house):
    row = aligned_well(house)
    return f"/alignments/{row['id']}", ["submit"], [f"Submit alignment {row['id']}"]


def _request(*names):
    def make(house):
        row = submitted(house)
        return f"/alignment-requests/{row['id']}", names, []

    return make


def _proposal(*names):
    def make(house):
        row = proposed(house)
        sensor = house.person("ada").get(f"/api/v1/sensors/{row['sensor_id']}").json()
        return f"/change-proposals/{row['id']}", names, [sensor["name"]]

    return make


def _change(page):
    def make(house):
        sensor = house.new_sensor()
        return f"/sensors/{sensor['id']}/{page}", ["set-change"], [sensor["name"], "version 1"]

    return make


OTHERS = {
    "a waiver": ("ada", _waiver),
    "a hand-over": ("olga", _hand_over),
    "an address of messages": ("ada", _address),
    "a key": ("adele", _key),
    "a policy that is a draft": ("adele", _draft),
    "a policy in force": ("olga", lambda house: _policy(house, in_force(house), "pause", "switch-off")),
    "a policy that is paused": (
        "ada",
        lambda house: _policy(house, step(house, in_force(house), "pause", reason="x"), "resume"),
    ),
    "a decision on telemetry": ("ada", _decision),
    "an alignment": ("ada", _to_submit),
    "an alignment that waits": ("alan", _request("approve", "refuse")),
    "an alignment that is taken back": ("ada", _request("withdraw")),
    "a proposal": ("adele", _proposal("confirm", "refuse")),
    "a proposal that is taken back": ("ada", _proposal("withdraw")),
    "limits": ("adele", _change("gates")),
    "a layout": ("ada", _change("table-definition")),
}


COUNT_SUBMISSIONS = "document.addEventListener('submit', () => window.submissions++, true), (window.submissions = 0)"


def test_enter_in_a_field_of_a_record_sends_nothing_and_leaves_its_dialog_open(browser, house):
    place, _, _ = _hand_over(house)
    with seat(browser, house, house.person("olga")) as window:
        window.open(f"{place}#record-sent")
        window.page.evaluate(COUNT_SUBMISSIONS)
        dialog = window.page.get_by_role("dialog")
        expect(dialog.locator("button[name=package_id]")).to_have_count(2)
        dialog.get_by_label("Source").fill("Pass 1")
        dialog.get_by_label("Source").press("Enter")
        expect(dialog.get_by_label("Source")).to_have_value("Pass 1")
        assert window.page.evaluate("window.submissions") == 0
        dialog.get_by_role("button", name="Record SENT: package").click()
        expect(window.page.locator(".two-states small + *").last).to_have_text("SENT")


@pytest.mark.full
@pytest.mark.parametrize("what", OTHERS)
def test_the_dialogs_of_other_acts(browser, house, what):
    name, make = OTHERS[what]
    place, dialogs, named = make(house)
    with seat(browser, house, house.person(name)) as window:
        window.open(place)
        for reason in window.page.locator("main textarea[name=reason]:visible").all():
            reason.fill("To look at.")  # a dialog inside a form opens when the form is complete
        for dialog in dialogs:
            holds(window, dialog, named=named)


@pytest.mark.full
def test_the_dialogs_of_second_factors(browser, house):
    name, user_id = house.new_person("analyst")
    client = house.log_in(name)
    enrol_app(client)
    with seat(browser, house, client) as window:
        window.open("/second-factor")
        for opener in window.page.locator("[data-act]").all():
            holds(window, opener.get_attribute("popovertarget"), named=())
    with seat(browser, house, house.person("adele")) as window:
        window.open("/users")
        holds(window, f"reset-factor-{user_id}", named=(name.title(),))
