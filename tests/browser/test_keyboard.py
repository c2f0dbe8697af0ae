"""The keyboard alone is enough, what has the focus can be seen, and nothing that happens meanwhile takes it away."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser.people import password_of
from tests.browser.work import choose_filter, ends_as, queue

pytestmark = pytest.mark.browser

MOST_TABS = 60
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
        keyboard.type(password_of("analyst"))
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
        window.page.route("**/static/shared/clock.js", hold_in(held))
        window.page.goto("/runs", wait_until="commit")
        expect(window.page.get_by_role("link", name=f"#{batch_run}", exact=True)).to_be_visible()
        for key in ("Tab", "Enter", "Tab"):
            window.page.keyboard.press(key)
        first = window.page.get_by_role("link", name="CSV", exact=True)
        expect(first).to_be_focused()
        held[0].continue_()
        window.page.wait_for_load_state()
        window.settle()
        expect(first).to_be_focused()


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
        window.page.get_by_label("Object").focus()
        window.page.keyboard.type(f"g{letter}")
        expect(window.page.get_by_label("Object")).to_have_value(f"g{letter}")
        window.settle()
        assert left == []
