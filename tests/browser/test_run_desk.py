"""The review desk in a real browser: its views in the address, and the cursor its charts share."""

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

LINES = "#figure-convergence .cursor-line:not([hidden])"
AXIS = "() => document.querySelector('#figure-convergence .js-plotly-plot')._fullLayout.yaxis10.type"


@pytest.fixture(scope="module")
def desk(people, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{sequential_run}")
        yield window


def test_the_pointer_over_one_chart_marks_the_same_place_in_all_that_share_its_axis(desk, sequential_run):
    desk.open(f"/runs/{sequential_run}?part=convergence")
    desk.figures_drawn()
    expect(desk.page.locator(LINES)).to_have_count(0)
    desk.figure("methods").locator(".nsewdrag").hover(position={"x": 200, "y": 150})
    expect(desk.page.locator(LINES)).to_have_count(10)
    desk.page.locator("h1").hover()
    expect(desk.page.locator(LINES)).to_have_count(0)


def test_scale_and_tail_are_in_the_address_so_that_a_second_person_sees_the_same(desk, people, sequential_run):
    desk.open(f"/runs/{sequential_run}?part=convergence")
    desk.figures_drawn()
    assert desk.page.evaluate(AXIS) == "log"
    desk.page.get_by_label("Cost and step").select_option("linear")
    desk.page.get_by_role("form", name="View of the history").get_by_role("button", name="Show").click()
    desk.page.wait_for_url("**scale=linear**")
    desk.figures_drawn()
    assert desk.page.evaluate(AXIS) == "linear"
    desk.open(f"/runs/{sequential_run}?part=rms")
    desk.page.get_by_label("Tail from frame").fill("60")
    desk.page.get_by_role("form", name="View of the RMS").get_by_role("button", name="Show").click()
    desk.page.wait_for_url("**tail_from=60**")
    with people.seat("approver") as second:
        second.open(desk.page.url)
        expect(second.page.locator("#facts")).to_contain_text("frame 60 to 99")
        tails = [one for one in second.drawn("rms") if one["name"].endswith("· tail")]
        assert [min(one["x"]) for one in tails] == [min(tails[0]["x"]), 60]


def test_the_runs_beside_are_one_step_away_in_the_same_part(desk, batch_run, sequential_run):
    desk.open(f"/runs/{sequential_run}?part=provenance")
    desk.page.locator("a[rel=prev]").click()
    desk.page.wait_for_url(re.compile(rf"/runs/(?!{sequential_run}\b)\d+\?part=provenance"))
    assert int(re.search(r"/runs/(\d+)", desk.page.url)[1]) >= batch_run


def test_a_figure_that_fails_says_so_and_comes_back_on_retry(desk, sequential_run):
    desk.page.route("**/figures/rms?*", lambda route: route.abort())
    desk.page.route("**/figures/rms", lambda route: route.abort())
    desk.open(f"/runs/{sequential_run}?part=rms")
    panel = desk.figure("rms")
    expect(panel.locator("plot-figure")).to_have_attribute("data-state", "error")
    desk.page.unroute_all(behavior="ignoreErrors")
    panel.get_by_role("button", name="Retry").click()
    expect(panel.locator("plot-figure")).to_have_attribute("data-state", "ready")
    desk.forgive("ERR_FAILED")
