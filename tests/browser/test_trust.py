"""The trust and matching parts of a run's page in a real browser: what is drawn, sorted and copied is the result's own."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from boresight.figures import CHAPTERS
from tests.browser.work import choose_filter, ends_as, queue

pytestmark = pytest.mark.browser

ONE_A_SECOND, FIFTY_A_SECOND = 1.0, 50.0
SINGLE = 1e-6  # figures travel in single precision


def open_part(window, run_id, part):
    window.open(f"/runs/{run_id}")
    window.page.get_by_role("navigation", name="Parts of this run").get_by_role("link", name=part).click()
    window.page.wait_for_url(f"**/runs/{run_id}?part={part.lower()}")


def clone(window, run_id, frames_per_s, label):
    window.open(f"/runs/new?clone={run_id}")
    choose_filter(window, frames_per_s)
    return queue(window, label)


@pytest.fixture(scope="module")
def result(people, batch_run):
    with people.seat("analyst") as window:
        return window.result(batch_run)


@pytest.fixture(scope="module")
def trust_page(people, batch_run):
    with people.seat("analyst") as window:
        open_part(window, batch_run, "Trust")
        yield window


def test_the_page_can_be_read_before_its_figures_are_drawn(people, batch_run):
    with people.seat("analyst") as window:
        window.page.route("**/figures/*", lambda _: None)  # no figure ever arrives
        window.open(f"/runs/{batch_run}?part=trust")
        expect(window.page.get_by_role("heading", name="Examination")).to_be_visible()
        expect(window.page.get_by_role("table", name="Residuals of each star")).to_be_visible()
        window.page.unroute_all(behavior="ignoreErrors")


def test_figures_far_below_are_drawn_without_being_scrolled_to(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}?part=trust")
        window.figures_drawn()
        assert window.page.evaluate("scrollY") == 0
        for figure in CHAPTERS["trust"]:
            expect(window.figure(figure.name)).to_have_count(1)


def test_the_charts_hold_the_numbers_of_the_result(trust_page, result):
    trust = result["trust"]
    map_drawn, bars = trust_page.drawn("two-halves")
    assert bars["y"] == pytest.approx(trust["two_halves"]["difference_in_sigma"], rel=SINGLE)
    assert np.array(map_drawn["z"], dtype=float) == pytest.approx(
        np.array(trust["two_halves"]["map"]["difference_arcsec"], dtype=float), rel=SINGLE, nan_ok=True
    )
    (ratios,) = trust_page.drawn("efficiency")
    assert ratios["y"] == pytest.approx(list(trust["efficiency"]["ratio"].values()), rel=SINGLE)


def test_the_whiteness_of_the_residuals_part_is_that_of_the_examination(people, batch_run, result):
    with people.seat("analyst") as window:
        open_part(window, batch_run, "Residuals")
        (correlations,) = window.drawn("whiteness")
        expected = result["trust"]["whiteness"]["autocorrelation"]
        assert correlations["y"] == pytest.approx(expected, rel=SINGLE, abs=SINGLE)


def test_a_heading_sorts_the_stars_and_a_second_press_turns_them_round(trust_page, result):
    table = trust_page.page.get_by_role("table", name="Residuals of each star")
    heading = table.get_by_role("columnheader", name="Sightings")
    seen = [star["sightings"] for star in result["trust"]["stars"]]
    for direction, expected in (("descending", sorted(seen, reverse=True)), ("ascending", sorted(seen))):
        heading.get_by_role("button").click()
        expect(heading).to_have_attribute("aria-sort", direction)
        cells = table.locator("tbody tr td:nth-child(3)").all_inner_texts()
        assert [int(re.sub(r"\D", "", cell)) for cell in cells] == expected


def test_every_suspect_is_marked_and_they_are_the_list_to_flag(trust_page, result):
    page = trust_page.page
    suspects = [str(star) for star in result["trust"]["suspects"]]
    table = page.get_by_role("table", name="Residuals of each star")
    marked = table.get_by_role("row").filter(has=page.locator(".status-caution"))
    assert sorted(marked.locator("th").all_inner_texts()) == sorted(suspects)
    expect(page.get_by_role("button", name="Copy the stars to flag")).to_have_count(1 if suspects else 0)


def test_the_matching_part_counts_what_the_result_counts(people, batch_run, result):
    with people.seat("analyst") as window:
        matching = result["matching"]
        open_part(window, batch_run, "Matching")
        for name in ("Given", "Kept", "Removed", "Added", "Matched"):
            told = window.page.locator(f"#matches dl.verdict dt:text-is('{name}') + dd b").inner_text()
            assert int(re.sub(r"\D", "", told)) == matching[name.lower()]
        assert window.drawn("matching")[0]["y"] == [cycle["matched"] for cycle in matching["cycles"]]


def test_trust_appears_by_itself_when_the_run_that_is_watched_ends(people, batch_run):
    with people.seat("analyst") as window:
        before, run_id = (
            clone(window, batch_run, pace, label)
            for pace, label in ((ONE_A_SECOND, "Has the only worker"), (FIFTY_A_SECOND, "Watched for its trust"))
        )
        open_part(window, run_id, "Trust")
        examination = window.page.locator("#examination")
        expect(examination).to_contain_text("No examination")
        window.send(f"/runs/{before}/cancel", {})
        ends_as(window, "SUCCEEDED")
        expect(examination.locator("plot-figure")).to_have_count(len(CHAPTERS["trust"]))
        window.figures_drawn()
        assert len(window.drawn("efficiency")[0]["y"]) == len(window.result(run_id)["free"])
        expect(window.page.locator("#parts")).to_contain_text("doubt")
