"""The system's theme until one is chosen, and paper: a request, a run and its report are complete on A4."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser.people import get_password
from tests.browser.window import BROKEN
from tests.effort import few_of

pytestmark = pytest.mark.browser

PRINTED = [
    "/approvals/{request}",
    "/runs/{batch}",
    "/api/v1/runs/{batch}/report",
    "/parameter-sets/{parameters}",
    "/parameter-sets/{parameters}/uplink",
    "/audit",
]
A4_PT, SHEET_PX = (595.3, 841.9), 688  # what 14 mm of margin leave at 96 px an inch
OUTSIDE = """() => [...document.querySelectorAll("body *")].filter(one => {
    const place = one.getBoundingClientRect();
    return place.width && place.right > innerWidth + 1 && !one.closest("svg, .sr, .skip, caption");
}).map(one => one.outerHTML.slice(0, 80))"""
FOLDED = """() => [...document.querySelectorAll("details:not([open], [data-figure-table], [data-view], :has(plot-figure))")]
    .filter(one => one.checkVisibility() && one.offsetHeight <= one.querySelector("summary").offsetHeight + 2)
    .map(one => one.outerHTML.slice(0, 80))"""


def test_the_theme_is_the_system_s_until_one_is_chosen(people):
    with people.seat() as window:  # a browser of its own: others keep a theme, and may be hidden
        window.open("/login")
        for asked, shown in (({"color_scheme": "light"}, "light"), ({"color_scheme": "dark"}, "dark")):
            window.page.emulate_media(**asked)
            window.page.wait_for_function("theme => document.documentElement.dataset.theme === theme", arg=shown)
        window.page.emulate_media(contrast="more")
        window.page.wait_for_function("() => document.documentElement.dataset.theme === 'contrast'")
        window.page.emulate_media(contrast="no-preference")
        window.enter("analyst", get_password("analyst"))
        window.page.wait_for_url("**/")
        window.use_theme("light")
        window.open("/runs")
        assert window.page.evaluate("document.documentElement.dataset.theme") == "light"


UNDRAWN = """() => [...document.querySelectorAll("plot-figure")].filter(one =>
    one.checkVisibility() && !one.querySelector(".js-plotly-plot .main-svg")).length"""
PRINT_COUNTS = f"() => {{ window.print = () => {{ window.missing = ({UNDRAWN})(); }}; }}"


@pytest.mark.parametrize("by", ["Control+p", "button"])
def test_every_figure_is_drawn_before_the_page_is_printed(people, numbers, by):
    with people.seat("analyst", new=True) as window:
        window.open("/runs/{batch}?part=evidence".format(**numbers))
        assert window.page.evaluate(UNDRAWN) > 0
        window.page.evaluate(PRINT_COUNTS)
        if by == "button":
            window.page.get_by_role("button", name="Print this page").click()
        else:
            window.page.keyboard.press(by)
        window.page.wait_for_function("() => window.missing !== undefined")
        assert window.page.evaluate("window.missing") == 0
        expect(window.page.locator("#print-page")).to_be_enabled()


def test_a_figure_that_was_not_drawn_says_so_on_paper_only(people, numbers):
    with people.seat("analyst", new=True) as window:
        window.leave_figures_out()
        window.open("/runs/{batch}?part=evidence".format(**numbers))
        waiting = window.page.locator("plot-figure[data-state=loading]:visible")
        before = waiting.first.locator(".figure-words").inner_text()
        window.page.evaluate("dispatchEvent(new Event('beforeprint'))")
        on_paper = waiting.first.locator(".figure-words").inner_text()
        assert "Print this page" in on_paper
        window.page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert waiting.first.locator(".figure-words").inner_text() == before


def test_a_drawing_that_fails_keeps_nobody_from_printing(people):
    with people.seat("analyst", new=True) as window:
        window.open("/preferences")
        window.page.evaluate(f"({PRINT_COUNTS})()")
        fails = "event => event.detail.push(Promise.reject(new Error('no drawing')))"
        window.page.evaluate(f"() => document.addEventListener('boresight:print', {fails})")
        window.page.get_by_role("button", name="Print this page").click()
        window.page.wait_for_function("() => window.missing === 0")
        expect(window.page.locator("#print-page")).to_be_enabled()


def test_a_figure_that_came_after_the_printing_is_drawn_for_the_screen(people, numbers):
    with people.seat("analyst", new=True) as window:
        held = []
        window.page.route("**/figures/*", lambda route: held.append(route))  # noqa: PLW0108 - playwright marks what it is given
        window.open("/runs/{batch}?part=evidence".format(**numbers))
        window.page.evaluate("() => { document.dispatchEvent(new CustomEvent('boresight:print', { detail: [] })); }")
        window.page.wait_for_timeout(1000)
        window.page.evaluate("() => { dispatchEvent(new Event('afterprint')); }")
        for route in held:
            route.continue_()
        window.page.unroute("**/figures/*")
        window.figures_drawn()
        window.settle()
        misfits = """() => [...document.querySelectorAll("plot-figure .figure-canvas")].filter(one => one.checkVisibility()
            && one.clientWidth >= 260 && one.querySelector(".main-svg").getAttribute("width") != one.clientWidth).length"""
        assert held
        assert window.page.evaluate(misfits) == 0


@pytest.mark.parametrize("address", few_of(PRINTED, 1))
def test_paper_cuts_nothing_off_and_folds_nothing_in(people, numbers, address):
    with people.seat("analyst", new=True) as window:
        if address.startswith("/api"):  # is downloaded, so no page's policy lies over its own
            window.page.set_content(window.page.request.get(address.format(**numbers)).text())
        else:
            window.open(address.format(**numbers))
            window.figures_drawn()
        window.page.emulate_media(media="print")
        window.page.set_viewport_size({"width": SHEET_PX, "height": 1000})
        window.page.evaluate("dispatchEvent(new Event('beforeprint'))")  # by which a report draws its figures for paper
        window.settle()
        assert window.page.evaluate(OUTSIDE) == []
        assert window.page.evaluate(FOLDED) == []
        assert window.page.evaluate(BROKEN) == []
        sheets = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)", window.page.pdf(prefer_css_page_size=True))
        assert sheets
        assert all(tuple(map(float, sheet)) == pytest.approx(A4_PT, abs=1.0) for sheet in sheets)
