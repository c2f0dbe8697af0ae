"""A comparison sent to a second person as an address: both see the same runs, reference, axis and tables."""

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

TABLES = ("Runs compared", "Parameters of the runs", "Settings and results of the runs")


def seen(window):
    tables = [window.page.get_by_role("region", name=name).inner_text() for name in TABLES]
    chosen = [window.page.locator(f"select[name={name}]").input_value() for name in ("reference", "align", "overlay")]
    axis = window.figure("rms").locator(".js-plotly-plot").evaluate("figure => figure.layout.xaxis.title.text")
    return tables, chosen, axis


def test_a_second_person_sees_the_same_comparison_by_its_address(people, batch_run, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/compare?runs={batch_run},{sequential_run}&reference={sequential_run}&overlay=table")
        window.page.locator("select[name=align]").select_option("update")
        window.page.wait_for_url("**align=update**")
        window.page.keyboard.press("d")
        window.page.wait_for_url("**all=1**")
        window.page.locator("select[name=overlay]").select_option("lines")
        window.page.wait_for_url("**overlay=lines**")
        address = window.page.url
        window.figure("rms").scroll_into_view_if_needed()
        expect(window.figure("rms").locator("plot-figure")).to_have_attribute("data-state", "ready")
        mine = seen(window)
        assert mine[1] == [str(sequential_run), "update", "lines"]
        assert mine[2].startswith("update")
        assert "the same data" in mine[0][0]
    with people.seat("approver") as window:
        window.open(address)
        window.figure("rms").scroll_into_view_if_needed()
        expect(window.figure("rms").locator("plot-figure")).to_have_attribute("data-state", "ready")
        assert seen(window) == mine
        window.page.evaluate("scrollTo(0, 0)")
        window.shoot("comparison-shared")
