"""The keyboard alone is enough, and what has the focus can be seen."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.browser.people import password_of

pytestmark = pytest.mark.browser

MOST_TABS = 60
FOCUSED = """() => {
    const one = document.activeElement;
    const style = getComputedStyle(one);
    return { name: (one.textContent || "").trim(), ring: style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0 };
}"""


def tab_to(window, name: str) -> None:
    """Press Tab until the focus is on what is called so; on the way everything focused is outlined."""
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
        tab_to(window, f"#{batch_run}")
        keyboard.press("Enter")
        expect(window.page.get_by_role("heading", name=f"Run #{batch_run}")).to_be_visible()


def test_the_keys_g_and_a_letter_go_to_a_page_and_never_while_typing(people):
    with people.seat("analyst") as window:
        window.open("/")
        expect(window.page.locator("#keys-open")).to_be_visible()
        letter = window.page.get_by_role("navigation").get_by_role("link", name="Audit").get_attribute("data-key")
        window.page.keyboard.press("g")
        window.page.keyboard.press(letter)
        window.page.wait_for_url("**/audit")
        window.page.get_by_label("Object").focus()
        window.page.keyboard.type(f"g{letter}")
        expect(window.page.get_by_label("Object")).to_have_value(f"g{letter}")
