"""Singular values and all angular distances: launched from the form, read on the run page, set beside a batch by the panel."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser.work import ends_as, queue

pytestmark = pytest.mark.browser

#: Rows of the panel of methods that an operator chooses by.
CHOSEN_BY = ("Claimed error", "Cost", "Converged after", "χ² / dof")


def launch(window, set_id, method, label, **choices):
    window.open(f"/runs/new?set={set_id}")
    window.page.get_by_text("More options").click()
    window.page.get_by_role("radio", name=re.compile(f"^{method}")).check()
    for name, value in choices.items():
        window.page.get_by_label(name.replace("_", " "), exact=True).select_option(value)
    window.fits()
    return queue(window, label)


@pytest.fixture(scope="module")
def svd_run(people, telemetry):
    with people.seat("analyst") as window:
        choices = {"Star_combinations": "4", "Singular_values": "2,3", "Update": "information"}
        run_id = launch(window, telemetry["calibration"], "Singular values", "By singular values", **choices)
        ends_as(window, "SUCCEEDED")
        return run_id


@pytest.fixture(scope="module")
def angular_run(people, telemetry):
    with people.seat("analyst") as window:
        run_id = launch(window, telemetry["calibration"], "All angular distances", "By all pairs", Update="information")
        ends_as(window, "SUCCEEDED")
        return run_id


def test_the_fields_of_singular_values_are_there_for_them_alone(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page = window.page
        page.get_by_text("More options").click()
        fields = [page.get_by_label(name, exact=True) for name in ("Star combinations", "Singular values", "Update")]
        for method, enabled in (
            ("Singular values", (1, 1, 1)),
            ("All angular distances", (0, 0, 1)),
            ("Batch", (0, 0, 0)),
        ):
            page.get_by_role("radio", name=re.compile(f"^{method}")).check()
            for field, able in zip(fields, enabled, strict=True):
                expect(field).to_be_enabled(enabled=bool(able))


def test_a_run_by_singular_values_says_what_was_chosen_and_shows_what_a_frame_determines(people, svd_run):
    with people.seat("analyst") as window:
        settings = window.result(svd_run)["inputs"]["settings"]
        assert (settings["star_model"], settings["singular_values"], settings["gain_form"]) == (
            4,
            [2, 3],
            "information",
        )
        window.open(f"/runs/{svd_run}?part=observability")
        expect(window.page.locator(".subtitle").first).to_contain_text("Singular values")
        names = {trace["name"] for trace in window.drawn("frame-observability")}
        assert {"Model 1", "Model 2", "Model 3", "Model 4"} <= names, names
        window.figures_drawn()
        window.fits()
        assert window.barriers() == []


def test_the_panel_of_methods_sets_both_beside_the_batch_on_one_set(people, batch_run, svd_run, angular_run):
    with people.seat("analyst") as window:
        window.open(f"/compare?runs={batch_run},{svd_run},{angular_run}")
        table = window.page.get_by_role("region", name="Methods of the runs")
        for title in ("Batch", "Singular values", "All angular distances"):
            expect(row_of(table, "Method")).to_contain_text(title)
        shown = {name: row_of(table, name).locator("td.num").all_inner_texts() for name in CHOSEN_BY}
        assert all(len(texts) == 3 and all(re.search(r"\d", text) for text in texts) for texts in shown.values()), shown
        assert all(0.9 < number(text) < 1.5 for text in shown["Claimed error"]), shown
        assert all(number(text) > 0 for text in shown["Cost"]), shown
        assert [text.split()[-1] for text in shown["Converged after"]] == ["iterations", "frames", "frames"]


def row_of(table, name):
    return table.locator("tbody tr").filter(has=table.page.get_by_role("rowheader", name=name, exact=True))


def number(text):
    return float(re.search(r"\d[\d.]*", text)[0])
