"""Comparing runs: a second person sees the same by its address, and no figure is drawn over and over."""

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


TABLES = ("Runs compared", "Parameters of the runs", "Settings and results of the runs")


def seen(window):
    tables = [window.page.get_by_role("region", name=name).inner_text() for name in TABLES]
    chosen = [window.page.locator(f"select[name={name}]").input_value() for name in ("reference", "align", "overlay")]
    axis = window.figure("rms").locator(".js-plotly-plot").evaluate("figure => figure.layout.xaxis.title.text")
    return tables, chosen, axis


@pytest.mark.full
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


MOST_AGAIN = 3  # once, and again when the room is known
CHANGES = """async () => {
    const changes = async (place, data, layout) => {
        let count = 0;
        const observer = new MutationObserver(records => { count += records.length; });
        observer.observe(place, {subtree: true, childList: true, attributes: true});
        await Plotly.newPlot(place, data, layout);
        count += observer.takeRecords().length;
        observer.disconnect();
        return count;
    };
    const found = {};
    for (const place of document.querySelectorAll(".js-plotly-plot")) {
        const { data, layout } = place;
        const axes = Object.keys(place._fullLayout).filter(name => /^[xy]axis/.test(name));
        const bare = structuredClone(layout);
        for (const name of axes) bare[name] = {...bare[name], automargin: false};
        const once = await changes(place, data, bare);
        found[place.closest("[id]").id] = await changes(place, data, structuredClone(layout)) / once;
    }
    return found;
}"""


@pytest.mark.full
def test_no_figure_is_drawn_over_and_over_until_its_labels_have_room(people, batch_run, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/compare?runs={batch_run},{sequential_run}")
        window.unfold()
        again = window.page.evaluate(CHANGES)
    assert len(again) > 20
    assert {name: times for name, times in again.items() if times > MOST_AGAIN} == {}


WIDEN = """columns => {
    for (const table of document.querySelectorAll("table[data-pinned]")) {
        const wide = table.cloneNode(true);
        for (const row of wide.rows) for (let k = row.cells.length; k < columns; k += 1)
            row.append(row.cells[row.cells.length - 1].cloneNode(true));
        table.replaceWith(wide);
    }
}"""
SCROLLED = """() => [...document.querySelectorAll("table[data-pinned]")].map(table => {
    const place = table.parentElement;
    place.scrollLeft = 1e4;
    const box = place.getBoundingClientRect(), first = table.rows[1].cells[0].getBoundingClientRect();
    const reference = table.querySelector("td.reference").getBoundingClientRect();
    return {fit: table.dataset.fit, scrolled: place.scrollLeft > 0, first: first.left - box.left,
            beside: reference.left - first.right, beyond: Math.max(0, reference.right - box.right)};
})"""
COLUMNS = 12  # a name, a unit and ten runs


@pytest.mark.full
def test_of_many_runs_what_is_compared_and_the_reference_stay_in_sight_while_the_others_are_scrolled(
    people, batch_run, sequential_run
):
    with people.seat("analyst") as window:
        window.leave_figures_out()
        window.open(f"/compare?runs={batch_run},{sequential_run}&overlay=table&all=1")
        window.page.evaluate(WIDEN, COLUMNS)
        for width in (1280, 1920):
            window.page.set_viewport_size({"width": width, "height": 900})
            window.settle()
            window.fits()
            found = window.page.evaluate(SCROLLED)
            assert len(found) >= 3
            assert "cards" not in {one["fit"] for one in found}
            pinned = [one for one in found if one["scrolled"]]
            assert width > 1280 or pinned
            for one in pinned:
                assert one["fit"] == "pinned"
                assert (one["first"], one["beyond"]) == pytest.approx((0, 0), abs=2)
                assert one["beside"] >= -2, "the reference lies under what is compared"
        window.page.set_viewport_size({"width": 390, "height": 844})
        window.settle()
        window.fits()
        found = window.page.evaluate(SCROLLED)
        assert not any(one["scrolled"] for one in found)
