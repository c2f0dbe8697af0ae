"""From a preset to a campaign that ends before one's eyes: what was typed stays, the address holds the choice, one bar tells."""

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


def test_a_preset_keeps_what_was_typed_and_its_campaign_is_followed_to_its_end(people, telemetry):
    with people.seat("analyst") as window:
        page, dry_run = window.page, window.page.locator("[data-dry-run]")
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page.get_by_label("Label").fill("first pass")
        page.get_by_role("button", name="Quick look").click()
        expect(page).to_have_url(re.compile(f"set={telemetry['calibration']}.*preset=quick-look"))
        expect(page.get_by_label("Label")).to_have_value("first pass")
        expect(dry_run).to_contain_text("8 parameters, ")
        expect(page.get_by_role("table", name=re.compile("^Predicted sigma"))).to_contain_text("b4_per_m4")
        page.get_by_role("radio", name=re.compile("^Square-root filter")).check()
        expect(page).to_have_url(re.compile(r"preset=quick-look.*method=sqrf"))
        expect(page.locator("[data-changes]")).to_contain_text("Square-root filter")
        window.shoot("60-launch-forecast")
        assert window.barriers() == []

        page.get_by_role("link", name="Many sensors at once").click()
        page.get_by_label("Label").fill("the whole fleet")
        expect(dry_run).to_contain_text("1 of 1 sensors")
        window.shoot("61-campaign-launch")
        assert window.barriers() == []
        page.get_by_role("button", name="Queue campaign").click()
        page.wait_for_url(re.compile(r"/campaigns/\d+$"))
        page.evaluate("() => { window.unbroken = true; }")
        expect(page.locator("[data-campaign='ended']")).to_contain_text("1 of 1 ended")
        assert page.evaluate("window.unbroken"), "the page was loaded again"
        expect(page.get_by_role("progressbar")).to_have_attribute("value", "1.0")
        expect(page.get_by_role("table", name=re.compile("^RMS of arcs"))).to_contain_text("SUCCEEDED")
        window.holds_in_themes_and_widths("campaign")
