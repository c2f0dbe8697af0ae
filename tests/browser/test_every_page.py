"""Every page, dark and light, at both widths: nothing keeps people out, nothing scrolls sideways, nothing complains."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

ADDRESSES = {
    "log-in": "/login",
    "overview": "/",
    "sensors": "/sensors",
    "sensor": "/sensors/{sensor}",
    "table-definition": "/sensors/{sensor}/table-definition?example=1",
    "telemetry": "/telemetry",
    "telemetry-set": "/telemetry/{set}",
    "runs": "/runs",
    "launch": "/runs/new",
    "run-batch": "/runs/{batch}",
    "run-filter": "/runs/{filter}",
    "compare": "/compare?runs={batch},{filter}",
    "parameter-sets": "/parameter-sets",
    "parameter-set": "/parameter-sets/{parameters}",
    "gates": "/sensors/{sensor}/gates",
    "set-gates": "/parameter-sets/{parameters}/gates",
    "approvals": "/approvals?show=all",
    "approval": "/approvals/{request}",
    "uplink": "/uplink",
    "uplink-steps": "/parameter-sets/{parameters}/uplink",
    "timeline": "/sensors/{sensor}/timeline",
    "users": "/users",
    "audit": "/audit",
    "no-such-page": "/runs/999999",
    "forbidden": "/",
}
VISITORS = {"log-in": None, "users": "administrator"}
LISTS = ("approvals", "timeline", "parameter-sets", "set-gates", "users", "audit")
CUT = """() => [...document.querySelectorAll(".scroll")]
    .filter(panel => panel.scrollWidth > panel.clientWidth).map(panel => panel.ariaLabel)"""
LONG_NAME = "Wolfeschlegelsteinhausenbergerdorffwelchevoralternwarengewis"


@pytest.fixture(scope="module")
def numbers(sensor_id, telemetry, batch_run, sequential_run, promoted):
    """The numbers of everything that has a page."""
    return {
        "sensor": sensor_id,
        "set": telemetry["calibration"],
        "batch": batch_run,
        "filter": sequential_run,
        "parameters": promoted.set_id,
        "request": promoted.request_id,
    }


def visit(window, name, numbers):
    """Open a page, its figures drawn."""
    window.open(ADDRESSES[name].format(**numbers))
    if name == "forbidden":
        window.page.locator("form[action='/logout'] input").evaluate("token => { token.value = 'of another log-in'; }")
        window.page.get_by_role("button", name="Log out").click()
        expect(window.page.locator("main")).to_contain_text("reload the page")
    window.figures_drawn()


@pytest.mark.parametrize("name", ADDRESSES)
def test_a_page_keeps_nobody_out_and_fits_its_window(people, numbers, name):
    with people.seat(VISITORS.get(name, "analyst")) as window:
        visit(window, name, numbers)
        window.holds_in_every_theme_and_width(name)
        if name in {"no-such-page", "forbidden"}:
            window.forgive("40[34]")


@pytest.mark.parametrize("name", LISTS)
def test_a_list_shows_what_can_be_done_with_its_rows_without_being_scrolled(people, numbers, name):
    with people.seat(VISITORS.get(name, "analyst")) as window:
        visit(window, name, numbers)
        assert window.page.evaluate(CUT) == []


def test_a_name_of_sixty_letters_and_a_long_label_cut_no_list(people):
    with people.seat("administrator") as window:
        window.open("/users")
        person = {"name": "w" * 30, "printed_name": LONG_NAME, "password": "of-sixty-letters", "roles": "analyst"}
        assert window.send("/users", person).ok
        assert window.send("/users/keys", {"label": f"The key of {LONG_NAME}", "days": "1"}).ok
        for address in ("/users", "/audit"):
            window.open(address)
            expect(window.page.locator("main")).to_contain_text(LONG_NAME)
            window.fits()
            assert window.page.evaluate(CUT) == [], address
