"""What waits for a person stands in the tab, and a browser that was asked to tells what has come."""

import json
import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

NOTIFICATIONS = """() => {
    window.told = [];
    window.Notification = class {
        static permission = "default";
        static async requestPermission() { return (this.permission = "granted"); }
        constructor(title, { body, tag }) { told.push([body, tag]); }
    };
}"""
AUDITED = "document.dispatchEvent(new CustomEvent('boresight:audit', { detail: {} }))"


def action(number):
    return {
        "level": "standby",
        "sentence": f"Set {number} waits.",
        "address": f"/approvals/{number}",
        "label": "Review",
    }


@pytest.mark.full
def test_the_tab_counts_what_waits_and_what_has_come_is_told_once_where_it_was_asked_for(people):
    with people.seat("approver") as window:
        waiting = [action(1), action(2)]

        def answer(route):
            route.fulfill(body=json.dumps({"count": len(waiting), "first": waiting}), content_type="application/json")

        window.page.route("**/waiting", answer)
        window.open("/audit")
        expect(window.page).to_have_title("(2) Audit · Boresight")
        expect(window.page.locator("link[rel=icon]")).to_have_attribute("href", re.compile("^data:image/svg"))
        window.page.evaluate(NOTIFICATIONS)
        opener = window.page.get_by_role("button", name="Notify me here")
        opener.click()
        expect(opener).to_have_attribute("aria-pressed", "true")
        for number, count in ((3, 3), (3, 3)):
            waiting[2:] = [action(number)]
            window.page.evaluate(AUDITED)
            with window.page.expect_response("**/waiting"):
                pass
            expect(window.page).to_have_title(f"({count}) Audit · Boresight")
        window.settle()
        assert window.page.evaluate("told") == [["Set 3 waits.", "/approvals/3"]]
        waiting.clear()
        window.page.evaluate(AUDITED)
        expect(window.page).to_have_title("Audit · Boresight")
        expect(window.page.locator("link[rel=icon]")).to_have_attribute("href", re.compile(r"mark\.svg$"))
        window.page.evaluate("localStorage.removeItem('boresight-notify')")
