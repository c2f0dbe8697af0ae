"""Every page: nobody is kept out and nothing complains; with `--full` in every theme and width, and no key changes anything."""

import pytest
from playwright.sync_api import expect

from boresight.console.runs.pages.run import PARTS
from boresight.figures import CHAPTERS
from tests.browser.test_dialogs import seat
from tests.browser.window import BROKEN, CUT, CUT_OFF, PHONE, WRITES
from tests.effort import effort, few_of

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
    "campaigns": "/campaigns",
    "campaign-launch": "/campaigns/new",
    "presets": "/presets",
    "import-profiles": "/import-profiles?from=openc3",
    "run-batch": "/runs/{batch}",
    **{f"run-{part}": f"/runs/{{filter}}?part={part}" for part in PARTS},
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
    "audit-record": "/audit/1",
    "alarms": "/alarms",
    "trend": "/sensors/{sensor}/trend",
    "plan": "/sensors/{sensor}/plan",
    "webhooks": "/webhooks",
    "alignments": "/alignments",
    "new-alignment": "/alignments/new",
    "change-proposals": "/change-proposals?show=all",
    "administration": "/administration",
    "backups": "/backups",
    "retention": "/retention",
    "glossary": "/help/glossary",
    "saved-views": "/saved-views",
    "messages": "/preferences/messages",
    "settings": "/help/settings",
    "no-such-page": "/runs/999999",
    "forbidden": "/",
}
VISITORS = {"log-in": None} | dict.fromkeys(("users", "webhooks", "administration"), "administrator")
REFUSED = {"no-such-page": 404, "forbidden": 403}  # a browser complains of these
HERE = (  # others are like one of these, or drawn at length by a test of their own
    "log-in", "overview", "sensor", "telemetry-set", "runs", "launch", "run-result", "run-record", "parameter-set", "approval",
    "uplink-steps", "users", "alarms", "forbidden",
)  # fmt: skip
OUTSIDE_ITS_ROW = """() => [...document.querySelectorAll("tr > *")].filter(cell => {
    const [own, row] = [cell.getBoundingClientRect(), cell.parentElement.getBoundingClientRect()];
    return own.width && (own.top < row.top - 1 || (cell.rowSpan === 1 && own.bottom > row.bottom + 1)
        || own.left < row.left - 1 || own.right > row.right + 1);
}).map(cell => cell.textContent.trim())"""
LONG_NAME = "Wolfeschlegelsteinhausenbergerdorffwelchevoralternwarengewis"


def visit(window, name, numbers):
    address = ADDRESSES[name].format(**numbers)
    (window.begins_high if name.removeprefix("run-") in PARTS else window.open)(address)
    if name == "forbidden":
        window.page.locator("form[action='/logout'] input").evaluate("token => { token.value = 'of another log-in'; }")
        window.page.get_by_role("button", name="Log out").click()
        expect(window.page.locator("main")).to_contain_text("reload the page")
    window.figures_drawn()


def stands_under_the_verdict(window, part):
    expect(window.page.locator("#parts [aria-current]")).to_contain_text(PARTS[part].title)
    expect(window.page.locator("#verdict")).to_contain_text("converged")
    drawn = window.page.locator("plot-figure:not([small])").evaluate_all(
        "all => all.map(one => one.closest('section').id)"
    )
    offered = {f"figure-{one.name}" for chapter in PARTS[part].chapters for one in CHAPTERS[chapter]}
    of_few = {"figure-shadow", "figure-smoothed"}  # asked for by few runs
    assert set(drawn) | of_few == offered | of_few
    assert window.page.locator(".small-view").count() == (4 if part == "result" else 0)


#: Gives every sensor of the list of runs a name, as a renewed part would have it.
NAME_SENSORS = """name => {
    const place = document.querySelector("table.runs").parentElement;
    const renewed = place.cloneNode(true);
    for (const link of renewed.querySelectorAll("td a[href^='/sensors/']")) link.textContent = name;
    place.replaceWith(renewed);
}"""


@pytest.mark.parametrize("name", few_of([*HERE, *(name for name in ADDRESSES if name not in HERE)], len(HERE)))
def test_a_page_keeps_nobody_out_fits_its_window_and_sends_nothing_by_keys(people, numbers, name):
    with people.seat(VISITORS.get(name, "analyst")) as window:
        window.wear(name)
        visit(window, name, numbers)
        assert window.page.evaluate(OUTSIDE_ITS_ROW) == [], "a cell of a table lies outside its row"
        if (part := name.removeprefix("run-")) in PARTS:
            stands_under_the_verdict(window, part)
        window.holds_in_themes_and_widths(name)
        window.holds_in_widths(name)
        if effort(False, True):
            window.sends_nothing_by_keys()
        if name != "log-in":  # which changes nothing of others
            assert window.page.evaluate(WRITES), "every page has at least the button that logs out"
            assert window.page.evaluate(CUT_OFF) == [], "a button that writes is alive while the server is gone"
        if name in REFUSED:
            window.forgive(f"status of {REFUSED[name]}")


@pytest.mark.parametrize("width", [390, 1280])
def test_a_long_name_of_a_sensor_is_parted_between_its_words_and_leaves_the_list_of_runs_in_sight(
    people, numbers, width
):
    with people.seat("analyst") as window:
        window.page.set_viewport_size({"width": width, "height": 900})
        window.open(ADDRESSES["runs"].format(**numbers))
        window.page.evaluate(NAME_SENSORS, "As inverted_wang_decentred")
        window.settle()
        assert window.page.evaluate(CUT) == []
        assert window.page.evaluate(BROKEN) == []
        assert window.page.evaluate("document.querySelector('table.runs').dataset.fit === 'cards'") == (width == 390)


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


def test_times_in_local_form_lead_no_telemetry_set_sideways_on_a_phone(browser, house):
    client = house.log_in(house.new_person("analyst")[0])
    local = {"value": {"form": "local", "zone": "America/Argentina/Buenos_Aires"}}
    assert client.post("/api/v1/preferences/times:set", json=local).is_success
    _, set_id = house.ready_sensor()
    with seat(browser, house, client) as window:
        window.page.set_viewport_size(PHONE)
        window.open(f"/telemetry/{set_id}")
        assert window.page.locator("dl.facts time").count() > 0
        window.settle()
        assert window.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
