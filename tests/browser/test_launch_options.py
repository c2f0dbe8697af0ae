"""The rarer choices of a run, by keyboard: opened, filled in, checked, and in nobody's way."""

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


def test_more_options_are_opened_and_chosen_by_keyboard_alone(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page = window.page
        expect(page.get_by_label("Loss")).to_be_hidden()
        page.get_by_text("More options").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_label("Loss")).to_be_visible()
        page.get_by_label("Loss").focus()
        page.keyboard.press("H")
        expect(page.get_by_label("Loss")).to_have_value("huber")
        expect(page.locator("[data-dry-run]")).to_contain_text("robust huber")
        for theme in ("dark", "light"):
            window.use_theme(theme)
            window.fits()
            assert window.barriers() == []
        window.use_theme("dark")


def test_options_of_another_method_are_switched_off(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page = window.page
        page.get_by_text("More options").click()
        expect(page.get_by_label("Loss")).to_be_enabled()
        expect(page.get_by_label("Forgetting factor")).to_be_disabled()
        page.get_by_role("radio", name=re.compile("^Unscented filter")).check()
        expect(page.get_by_label("Loss")).to_be_disabled()
        page.get_by_label("Forgetting factor").fill("0.98")
        expect(page.locator("[data-dry-run]")).to_contain_text("forgetting_factor 0.98")
        assert window.barriers() == []
