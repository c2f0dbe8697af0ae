"""Figures in a browser: their numbers, those of a running run, those on paper."""

import math
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from boresight.console.runs.pages.run import PARTS
from boresight.figures.style.theme import TOKENS
from boresight.verdicts import numbers as server
from tests.browser.test_every_page import ADDRESSES, REFUSED, VISITORS
from tests.browser.test_gallery import INKS, WRITTEN, format_rgb
from tests.browser.window import GLANCE, OVERLAPS, PHONE
from tests.browser.work import choose_filter, ends_as, queue
from tests.effort import effort, few_of

pytestmark = pytest.mark.browser

VALUES = [
    sign * mantissa * 10.0**power for sign in (1, -1) for mantissa in (1.0, 2.34567, 9.99996) for power in range(-9, 12)
]
VALUES += [0.0, -0.0, math.nan]
AS_NUMBERS = """async ([forms, values]) => {
    const { count, formatter, number } = await import("/static/shared/numbers.js");
    const whole = values.filter(value => Number.isFinite(value)).map(Math.round);
    return { number: values.map(value => number(value, 4)), count: whole.map(count),
             forms: forms.map(form => values.map(value => formatter(form)(value))) };
}"""
PLAIN_MINUS = r"(?<![\w\d])-[\d.]|e[-+]?\d"


def test_the_page_writes_a_number_as_the_server_does(people):
    forms = {
        ".4g": lambda value: server.number(value, 4),
        "+.3g": lambda value: server.signed(value, 3),
        ".2f": lambda value: server.fixed(value, 2),
        ".1%": lambda value: server.percent(value, 1),
    }
    with people.seat("analyst") as window:
        window.open("/runs")
        written = window.page.evaluate(AS_NUMBERS, [list(forms), VALUES])
    assert written["number"] == [server.number(value, 4) for value in VALUES]
    assert written["count"] == [server.count(math.floor(value + 0.5)) for value in VALUES if math.isfinite(value)]
    for form, found in zip(forms, written["forms"], strict=True):
        assert found == [forms[form](value) for value in VALUES], form


@pytest.mark.parametrize(("part", "name"), [("convergence", "convergence"), ("distortion", "radial")])
def test_a_hover_has_the_numbers_of_the_tables(people, sequential_run, part, name):
    with people.seat("analyst") as window:
        window.open(f"/runs/{sequential_run}?part={part}")
        window.drawn(name)
        said = ""
        for share in (0.3, 0.5, 0.7, 0.9):
            drag = window.figure(name).locator(".nsewdrag").first
            box = drag.bounding_box()
            drag.hover(position={"x": share * box["width"], "y": box["height"] / 2}, force=True)
            expect(window.figure(name).locator(".hoverlayer text").first).to_be_visible()
            said += " ".join(window.figure(name).locator(".hoverlayer text").all_text_contents())
        assert not re.search(PLAIN_MINUS, said), said
        assert server.MINUS in said or "+" in said, said


def test_a_table_of_a_figure_has_them_too(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}?part=evidence")
        table = window.figure("two-halves").locator("details.figure-table")
        table.locator("summary").click()
        expect(table.locator("tbody tr").first).to_be_visible()
        said = " ".join(table.locator("td").all_text_contents())
        assert not re.search(PLAIN_MINUS, said), said
        assert re.search(r"·10[⁻⁰-⁹]+|\d\.\d", said), said


FRAMES_PER_S = 2.0
PLACE = re.compile(r"As of frame (\d+) of \d+, (just now|.+ ago)")
HIDE = """hidden => {
    Object.defineProperty(document, "hidden", {configurable: true, get: () => hidden});
    Object.defineProperty(document, "visibilityState", {configurable: true, get: () => hidden ? "hidden" : "visible"});
    document.dispatchEvent(new Event("visibilitychange"));
}"""
REACHED = """([figure, frame]) =>
    Number(/frame (\\d+) of/.exec(document.querySelector(`${figure} .figure-as-of`)?.textContent)?.[1]) >= frame"""


def frame_of(window, name):
    place = window.figure(name).locator(".figure-as-of")
    expect(place).to_have_text(PLACE)
    assert place.locator("time.age").count() == 1
    return int(PLACE.search(place.inner_text())[1])


@pytest.mark.full
def test_a_live_chart_says_its_frame_and_is_renewed_when_it_or_its_page_comes_into_sight(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?clone={batch_run}")
        choose_filter(window, FRAMES_PER_S)
        run_id = queue(window, "Scrolled to")
        window.open(f"/runs/{run_id}?part=convergence")
        window.grown("convergence", 4)
        first = frame_of(window, "convergence")
        window.figure("rms").scroll_into_view_if_needed()
        window.page.wait_for_function(REACHED, arg=["#figure-rms", first])
        bands = [trace["y"] for trace in window.drawn("rms") if trace["fill"] == "toself"]
        assert bands
        assert all(None not in band for band in bands)
        for part in list(PARTS)[: effort(1, len(PARTS))]:
            window.begins_high(f"/runs/{run_id}?part={part}")
            expect(window.page.locator("#run-head")).to_contain_text("RUNNING")
        window.open(f"/runs/{run_id}?part=convergence")
        window.figures_drawn()
        window.page.evaluate(HIDE, True)
        with window.page.expect_response(f"**/runs/{run_id}/figures/convergence*"):
            window.page.evaluate(HIDE, False)
        window.page.wait_for_function(REACHED, arg=["#figure-convergence", first + 1])
        window.send(f"/runs/{run_id}/cancel", {})
        ends_as(window, "CANCELLED")


WITH_FIGURES = (
    "approval",
    "run-convergence",
    "compare",
    "trend",
    *(f"run-{part}" for part in PARTS if part != "record"),
)
DRAWN = [*dict.fromkeys(WITH_FIGURES)]
FIGURE_WIDTHS = (1280, 390, 820, 2560)


def open_large(window):
    """Open a request's views, whose large figures take the places of the small ones."""
    window.page.locator("[data-open-views]").click()
    expect(window.page.locator("plot-figure[small]")).to_have_count(0)
    window.figures_drawn()


@pytest.mark.parametrize("name", few_of(DRAWN, 2))
def test_no_text_of_a_figure_lies_over_another_or_in_a_panel_or_is_cut_at_any_width(people, numbers, name):
    with people.seat("analyst") as window:
        for width in FIGURE_WIDTHS:
            window.page.set_viewport_size({"width": width, "height": 900})
            window.open(ADDRESSES[name].format(**numbers))
            window.unfold()
            assert window.overlaps() == [], f"at {width} px"
            if name == "approval":
                open_large(window)
                assert window.overlaps() == [], f"opened large at {width} px"
        window.page.set_viewport_size(PHONE)  # where a window becomes narrow its figures are laid out again
        window.page.wait_for_function(f"() => !({OVERLAPS})().length")


A4 = {"width": 718, "height": 1047}  # between margins of 10 mm
PRINTED = ["/runs/{batch}?part=observability", "/runs/{filter}?part=result", "/runs/{filter}?part=convergence"]
PRINTED += ["/runs/{batch}?part=distortion", "/runs/{batch}?part=evidence", "/sensors/{sensor}/trend"]
PRINTED += ["/compare?runs={batch},{filter}", "/approvals/{request}"]
WIDTHS = """() => [...document.querySelectorAll("plot-figure .main-svg:first-child")].filter(one => one.checkVisibility())
    .map(one => [one.getBoundingClientRect().width, one.closest("plot-figure").getBoundingClientRect().width])"""
BEFORE_PRINT = "dispatchEvent(new Event('beforeprint'))"  # as the print dialog does, before the page is laid out


@pytest.mark.parametrize("address", few_of(PRINTED, 1))
def test_figures_fit_a4_black_on_white_with_no_label_over_another(people, numbers, address):
    ink = format_rgb(TOKENS["light"]["ink-2"])
    with people.seat("analyst") as window:
        page = window.page
        window.open(address.format(**numbers))
        window.use_theme("contrast")
        window.figures_drawn()
        before = page.evaluate(WIDTHS)
        page.evaluate(BEFORE_PRINT)
        assert {width for width, _ in page.evaluate(WIDTHS)} <= {330, 680}
        assert page.evaluate(INKS) in ([], [ink])
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert page.evaluate(WIDTHS) == before
        page.set_viewport_size(A4)
        page.emulate_media(media="print")
        page.wait_for_function(WRITTEN, arg=ink)
        window.settle()
        assert window.overlaps() == []
        assert all(width <= place + 1 for width, place in page.evaluate(WIDTHS))
        assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 1
        page.emulate_media(media="screen")


# Of the page's main thread in processor time, so that a busy machine does not matter, as times of a loop, so that a slow one does
# not: on a machine of two slow cores the loop takes 0.08 s, and a page with the drawing library at hand has a second.
ANSWERS = Path(__file__).parents[2] / "artefacts" / "main-thread.csv"
LOOP = "() => { let sum = 0; for (let k = 0; k < 3e7; k += 1) sum += Math.sqrt(k % 7); return sum; }"
MOST_LOOPS = 12
IN_SIGHT_DRAWN = """() => document.readyState === "complete" && [...document.querySelectorAll("plot-figure")]
    .filter(one => one.checkVisibility() && one.getBoundingClientRect().top < innerHeight)
    .every(one => !["loading", undefined].includes(one.dataset.state))"""
# Figures that nobody scrolled to are left until the page was quiet, and hold up no key before: from here on it is interactive.
LAST_LONG_TASK = """() => new Promise(resolve => {
    const ends = list => list.getEntries().map(({startTime, duration}) => startTime + duration);
    new PerformanceObserver(list => resolve(Math.max(0, ...ends(list)))).observe({type: "longtask", buffered: true});
    setTimeout(resolve, 300, 0);
})"""
DRAWN_BELOW = """() => [...document.querySelectorAll("plot-figure[data-state=ready]")]
    .filter(one => one.getBoundingClientRect().top > innerHeight + 110).map(one => one.getAttribute("name"))"""
HEAVY = ("compare", "run-result", "run-convergence", "run-evidence", "overview")
FIRST = [name for name in ADDRESSES if name in HEAVY]
OTHERS = [name for name in ADDRESSES if name not in {*HEAVY, *VISITORS, *REFUSED}]


@pytest.fixture(scope="module")
def answers():
    """The seconds of each page's main thread, their loops, and the end of its last long task; with `--full` kept."""
    found = {}
    yield found
    if effort(0, 1) and found:
        ANSWERS.parent.mkdir(exist_ok=True)
        rows = [f"{name},{used_s:.2f},{loops:.1f},{end_s:.2f}\n" for name, (used_s, loops, end_s) in found.items()]
        ANSWERS.write_text("".join(rows))


def main_thread_s(link):
    return next(one["value"] for one in link.send("Performance.getMetrics")["metrics"] if one["name"] == "TaskDuration")


@pytest.mark.parametrize("name", few_of(FIRST + OTHERS, 2))
def test_a_page_can_be_used_after_a_second_of_its_main_thread(people, numbers, answers, name):
    with people.seat("analyst") as window:
        page = window.page
        link = page.context.new_cdp_session(page)
        link.send("Performance.enable", {"timeDomain": "threadTicks"})
        window.open(ADDRESSES["run-observability"].format(**numbers))  # the library is compiled once a visit
        window.figures_drawn()
        before = main_thread_s(link)
        page.evaluate(LOOP)
        loop_s = main_thread_s(link) - before
        page.set_viewport_size(GLANCE)
        window.open(ADDRESSES[name].format(**numbers))
        page.wait_for_function(IN_SIGHT_DRAWN)
        used_s = main_thread_s(link)
        assert page.evaluate(DRAWN_BELOW) == []
        link.detach()
        answers[name] = used_s, used_s / loop_s, page.evaluate(LAST_LONG_TASK) / 1000
        assert used_s <= MOST_LOOPS * loop_s, f"{used_s:.2f} s, {used_s / loop_s:.1f} loops of {loop_s:.3f} s"
