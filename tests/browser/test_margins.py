"""Drawing a figure: once, or a few times until its labels have room, and not over and over."""

import pytest

pytestmark = pytest.mark.browser

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


def test_no_figure_is_drawn_over_and_over_until_its_labels_have_room(people, batch_run, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/compare?runs={batch_run},{sequential_run}")
        window.figures_drawn()
        again = window.page.evaluate(CHANGES)
    assert len(again) > 20
    assert {name: times for name, times in again.items() if times > MOST_AGAIN} == {}
