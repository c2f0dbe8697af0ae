"""The keyboard alone is enough, what has the focus can be seen, and nothing that happens meanwhile takes it away."""

import json
import re
from contextlib import suppress

import pytest
from playwright.sync_api import Error, expect

from tests.browser.people import get_password
from tests.browser.window import FORGET_THEME
from tests.browser.work import choose_filter, ends_as, queue

pytestmark = pytest.mark.browser


MOST_TABS = 90
ONE_A_SECOND = 1.0
FOCUSED = """() => {
    const one = document.activeElement;
    const style = getComputedStyle(one);
    return { name: (one.textContent || "").trim(), ring: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0 };
}"""


def tab_to(window, name: str) -> None:
    window.page.wait_for_load_state()
    for _ in range(MOST_TABS):
        window.page.keyboard.press("Tab")
        focused = window.page.evaluate(FOCUSED)
        assert focused["ring"], f"the focus on {focused['name']!r} cannot be seen"
        if re.fullmatch(name, focused["name"]):
            return
    pytest.fail(f"{name} was not reached in {MOST_TABS} steps")


def test_from_the_log_in_to_a_run_by_tab_and_enter(people, batch_run):
    with people.seat() as window:
        keyboard = window.page.keyboard
        window.open("/")
        expect(window.page.get_by_label("Log-in name")).to_be_focused()
        keyboard.type("analyst")
        keyboard.press("Tab")
        keyboard.type(get_password("analyst"))
        keyboard.press("Enter")
        expect(window.page.get_by_role("heading", name="Fleet")).to_be_visible()
        tab_to(window, "Skip to content")
        tab_to(window, "Runs")
        keyboard.press("Enter")
        expect(window.page.get_by_role("heading", name="Runs", exact=True)).to_be_visible()
        tab_to(window, "Skip to content")
        keyboard.press("Enter")
        expect(window.page.locator("#content")).to_be_focused()
        assert window.page.evaluate(FOCUSED)["ring"]
        tab_to(window, f"#{batch_run}")
        keyboard.press("Enter")
        expect(window.page.get_by_role("heading", name=f"Run #{batch_run}")).to_be_visible()


def hold_in(held):
    def hold(route):
        held.append(route)

    return hold


def test_who_skips_to_the_content_of_a_page_that_still_loads_is_not_thrown_back(people, batch_run):
    with people.seat("analyst") as window:
        held = []
        window.page.route("**/shared/clock.js", hold_in(held))
        window.page.goto("/runs", wait_until="commit")
        expect(window.page.get_by_role("link", name=f"#{batch_run}", exact=True)).to_be_visible()
        for key in ("Tab", "Enter", "Tab"):
            window.page.keyboard.press(key)
        first = window.page.locator("#content :focus")
        expect(first).to_have_count(1)
        name = first.evaluate("one => one.outerHTML")
        held[0].continue_()
        window.page.wait_for_load_state()
        window.settle()
        expect(first).to_have_count(1)
        assert first.evaluate("one => one.outerHTML") == name


@pytest.mark.full
def test_what_has_the_focus_keeps_it_when_its_part_of_the_page_is_renewed(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?clone={batch_run}")
        choose_filter(window, ONE_A_SECOND)
        run_id = queue(window, "Under the keyboard")
        head = window.page.locator("#run-head")
        expect(head).to_contain_text("RUNNING")
        cancel = head.get_by_role("button", name="Cancel run")
        cancel.focus()
        cancel.evaluate("old => { window.old = old; }")
        moved = (
            f"document.dispatchEvent(new CustomEvent('boresight:run', {{ detail: {{ run_id: {run_id}, state: '' }} }}))"
        )
        window.page.evaluate(moved)
        window.page.wait_for_function("() => !old.isConnected")
        expect(cancel).to_be_focused()
        window.page.keyboard.press("Enter")
        ends_as(window, "CANCELLED")


def test_the_keys_g_and_a_letter_go_to_a_page_and_never_while_typing(people):
    with people.seat("analyst") as window:
        window.open("/")
        expect(window.page.locator("#keys-open")).to_be_visible()
        letter = window.page.get_by_role("navigation").get_by_role("link", name="Audit").get_attribute("data-key")
        window.page.keyboard.press("g")
        window.page.keyboard.press(letter)
        window.page.wait_for_url("**/audit")
        expect(window.page.locator("#keys-open")).to_be_visible()
        left = []
        window.page.on("request", lambda request: request.is_navigation_request() and left.append(request.url))
        window.page.get_by_label("Object", exact=True).focus()
        window.page.keyboard.type(f"g{letter}")
        expect(window.page.get_by_label("Object", exact=True)).to_have_value(f"g{letter}")
        window.settle()
        assert left == []


TRIES, TRIED_MS = 6, 20_000
IS_FOCUSED = "place => document.activeElement.matches(place)"
NAME = "By keyboard"


def press(window, *keys):
    for key in keys:
        window.page.keyboard.press(key)


def tab_to_place(window, place):
    window.page.wait_for_load_state()
    for _ in range(MOST_TABS):
        press(window, "Tab")
        if window.page.evaluate(IS_FOCUSED, place):
            return
    pytest.fail(f"{place} was not reached in {MOST_TABS} steps")


def go(window, letter, heading):
    expect(window.page.locator("#keys-open")).to_be_visible()
    there = window.page.get_by_role("heading", name=heading, exact=True)
    for _ in range(TRIES):
        press(window, "g", letter)
        with suppress(Error):
            there.wait_for(timeout=TRIED_MS)
            break
    expect(there).to_be_visible()
    expect(window.page.locator("#keys-open")).to_be_visible()


def choose(window, path):
    for _ in range(TRIES):
        with suppress(Error):
            with window.page.expect_file_chooser(timeout=TRIED_MS) as chooser:
                press(window, "Enter")
            chooser.value.set_files(path)
            return
    pytest.fail("the field opens no dialog")


@pytest.mark.usefixtures("batch_run")
@pytest.mark.full
def test_a_sensor_its_telemetry_and_its_run_are_made_and_read_by_keys_alone(people, files):
    document = json.loads((files / "sensor.json").read_text()) | {"name": NAME}
    with people.seat() as window:
        keyboard = window.page.keyboard
        window.open("/login")
        expect(window.page.locator("#name")).to_be_focused()
        keyboard.type("analyst")
        press(window, "Tab")
        keyboard.type(get_password("analyst"))
        press(window, "Enter")
        window.page.wait_for_url("**/")

        go(window, "s", "Sensors")
        tab_to_place(window, "textarea[name=document]")
        press(window, "Control+a")
        keyboard.insert_text(json.dumps(document, indent=1))
        tab_to_place(window, "form[action='/sensors'] button")
        window.keep("keyboard-1-sensor")
        press(window, "Enter")
        window.page.wait_for_url(re.compile(r"/sensors/\d+$"))

        go(window, "t", "Telemetry")
        tab_to_place(window, "#sensor_id")
        keyboard.type(NAME)
        tab_to_place(window, "#file")
        choose(window, files / "calibration.csv")
        tab_to_place(window, "#upload-send")
        window.keep("keyboard-2-telemetry")
        press(window, "Enter")
        window.page.wait_for_url(re.compile(r"/telemetry/\d+$"))

        tab_to_place(window, "a[href^='/runs/new']")
        press(window, "Enter")
        window.page.wait_for_url(re.compile("/runs/new"))
        tab_to_place(window, "input[name=label]")
        keyboard.type("By keys alone")
        expect(window.page.locator("[data-dry-run] dl.facts")).to_be_visible()
        tab_to_place(window, "button[value=queue]")
        window.keep("keyboard-3-launch")
        press(window, "Enter")
        window.page.wait_for_url(re.compile(r"/runs/\d+$"))
        ends_as(window, "SUCCEEDED")

        press(window, "2")
        window.page.wait_for_url("**?part=convergence")
        window.figures_drawn()
        window.keep("keyboard-4-reading")
        made = int(re.search(r"/runs/(\d+)", window.page.url)[1])
        press(window, "[")
        window.page.wait_for_url(lambda url: int(re.search(r"/runs/(\d+)", url)[1]) < made)


@pytest.mark.usefixtures("batch_run", "sequential_run")
def test_rows_are_walked_chosen_compared_and_sought_by_keys(people):
    with people.seat("analyst") as window:
        window.open("/runs?state=SUCCEEDED")
        expect(window.page.locator("#keys-open")).to_be_visible()
        rows = window.page.locator("[data-list-body] tr")
        press(window, "j", "j", "k")
        expect(rows.nth(0).locator("th a")).to_be_focused()
        press(window, "x", "j", "Shift+X")
        expect(window.page.locator("[data-list-body] input:checked")).to_have_count(2)
        chosen = [rows.nth(place).locator("input").get_attribute("value") for place in (0, 1)]
        assert f"runs={','.join(chosen)}" in window.page.url
        window.page.set_viewport_size({"width": 1280, "height": 240})
        expect(window.page.locator("[data-compare]")).to_be_in_viewport()
        assert window.page.evaluate("scrollY + innerHeight < document.documentElement.scrollHeight")
        window.page.evaluate("document.dispatchEvent(new CustomEvent('boresight:run', { detail: {} }))")
        with window.page.expect_response("**/runs?state=SUCCEEDED*"):
            window.settle()
        window.settle()
        expect(rows.nth(1).locator("th a")).to_be_focused()
        press(window, "/")
        expect(window.page.get_by_role("searchbox", name="Label")).to_be_focused()
        window.page.keyboard.type("c")
        expect(window.page.get_by_role("searchbox", name="Label")).to_have_value("c")
        press(window, "Escape", "?")
        expect(window.page.get_by_role("dialog", name="Keys")).to_be_visible()
        window.keep("keyboard-5-keys", whole=False)
        expect(window.page.locator("[data-runs-batch] input[name=runs]")).to_have_value(",".join(chosen))
        press(window, "Escape", "c")
        window.page.wait_for_url(f"**/compare?runs={','.join(chosen)}*")


def test_keys_can_be_switched_off(people):
    with people.seat("analyst") as window:
        window.open("/")
        window.page.locator("#keys-open").click()
        window.page.get_by_label("Keys are on in this browser").uncheck()
        press(window, "Escape", "?")
        expect(window.page.get_by_role("dialog", name="Keys")).to_be_hidden()
        window.page.locator("#keys-open").click()
        window.page.get_by_label("Keys are on in this browser").check()


def test_ctrl_k_finds_a_run_and_a_page_and_leads_there(people, batch_run):
    with people.seat("analyst") as window:
        keyboard = window.page.keyboard
        window.open("/")
        expect(window.page.locator("#palette-open")).to_be_visible()  # its module listens
        keyboard.press("Control+k")
        keyboard.type(f"#{batch_run}")
        expect(window.page.get_by_role("option").first).to_contain_text(f"Run {batch_run}")
        assert window.barriers() == []
        keyboard.press("Enter")
        expect(window.page.get_by_role("heading", name=f"Run #{batch_run}")).to_be_visible()
        expect(window.page.locator("#palette-open")).to_be_visible()  # its module listens
        keyboard.press("Control+k")
        keyboard.type("audit")
        expect(window.page.get_by_role("option", name=re.compile("Audit"))).to_be_visible()
        keyboard.press("Escape")
        expect(window.page.get_by_role("dialog", name="Find")).to_be_hidden()


def test_ctrl_k_finds_a_setting_and_presses_what_only_shows_but_nothing_that_writes(people, sensor_id):
    with people.seat("analyst") as window:
        keyboard, option = window.page.keyboard, window.page.get_by_role("option")
        window.open(f"/sensors/{sensor_id}")
        expect(window.page.locator("#palette-open")).to_be_visible()  # its module listens
        keyboard.press("Control+k")
        keyboard.type("add note")
        expect(option.first).to_contain_text("Command")
        keyboard.press("Enter")
        expect(window.page.get_by_role("button", name="Add note")).to_be_focused()
        assert window.page.url.endswith(f"/sensors/{sensor_id}")
        keyboard.press("Control+k")
        keyboard.type("theme")
        theme = window.page.evaluate("document.documentElement.dataset.theme")
        keyboard.press("Enter")
        window.page.wait_for_function("was => document.documentElement.dataset.theme !== was", arg=theme)
        window.page.evaluate(FORGET_THEME)
        keyboard.press("Control+k")
        keyboard.type("session hours")
        expect(option.first).to_contain_text("BORESIGHT_SESSION_HOURS")
        assert window.barriers() == []
        keyboard.press("Enter")
        window.page.wait_for_url("**/help/settings#setting-session_hours")


def test_a_term_is_explained_at_its_focus_and_under_the_pointer_until_escape(people, sensor_id):
    with people.seat("analyst") as window:
        window.open(f"/sensors/{sensor_id}")
        expect(window.page.locator("#palette-open")).to_be_visible()  # every module is there
        term, tip = window.page.locator("h2 .term").first, window.page.get_by_role("tooltip")
        term.focus()
        expect(tip).to_have_text(term.get_attribute("data-meaning"))
        expect(term).to_have_accessible_description(term.get_attribute("data-meaning"))
        assert window.barriers(drawings=False) == []
        press(window, "Escape")
        expect(tip).to_be_hidden()
        other = window.page.locator("dt .term").first
        other.hover()
        expect(tip).to_have_text(other.get_attribute("data-meaning"))
        tip.hover()
        expect(tip).to_be_visible()
        window.page.mouse.move(0, 0)
        term.evaluate("term => term.blur()")
        expect(tip).to_be_hidden()


@pytest.mark.full
def test_a_star_and_a_saved_view_are_first_in_ctrl_k(people, sensor_id):
    with people.seat("analyst") as window:
        keyboard, option = window.page.keyboard, window.page.get_by_role("option")
        window.open(f"/sensors/{sensor_id}")
        star = window.page.get_by_role("button", name="Favourite")
        expect(star).to_have_attribute("aria-pressed", "false")
        star.click()
        expect(star).to_have_attribute("aria-pressed", "true")
        window.open("/runs?state=FAILED&sort=run")
        window.page.locator(".list-tools").get_by_role("button", name="Save view").click()
        dialog = window.page.get_by_role("dialog", name="Save this view")
        dialog.get_by_label("Name").fill("Failed ones")
        assert window.barriers() == []
        dialog.get_by_role("button", name="Save").click()
        expect(window.page.get_by_role("status").filter(has_text="Failed ones")).to_be_visible()
        assert window.page.url.endswith("/runs?state=FAILED&sort=run")
        window.open("/")
        expect(window.page.locator("#palette-open")).to_be_visible()  # its module listens
        keyboard.press("Control+k")
        expect(option.nth(0)).to_contain_text("Favourite")
        expect(option.nth(1)).to_contain_text("Failed ones")
        keyboard.type("failed ones")
        expect(option.first).to_contain_text("View")
        keyboard.press("Enter")
        window.page.wait_for_url("**/runs?state=FAILED&sort=run")
        window.open("/saved-views")
        assert window.barriers() == []
        for left in (1, 0):
            window.page.get_by_role("button", name="Remove").first.click()
            expect(window.page.locator("tbody tr")).to_have_count(left)
