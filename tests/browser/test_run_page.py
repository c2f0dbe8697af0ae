"""A run's page: it grows from events, steps through frames, keeps its views in the address, and draws the result's numbers."""

import itertools
import json
import re

import numpy as np
import pytest
from playwright.sync_api import expect

from boresight.cameras import CAMERA_MODELS
from boresight.console.runs.pages.run import PARTS
from boresight.figures import CHAPTERS
from tests.browser.window import GLANCE, PHONE
from tests.browser.work import choose_filter, ends_as, queue, upload
from tests.effort import effort, few_of

pytestmark = pytest.mark.browser


FROM_EVENTS = 1e-5


def test_curves_grow_from_the_events_without_the_figure_being_fetched_again(watched):
    pairs = itertools.pairwise(zip(watched.lengths, watched.fetched, strict=True))
    assert any(longer > shorter and later == earlier for (shorter, earlier), (longer, later) in pairs)


def test_what_was_drawn_from_events_is_what_the_server_draws(watched):
    compared = 0
    for drawn, whole in zip(watched.drawn, watched.fetched_anew, strict=True):
        half = len(drawn["x"]) // 2 if drawn["fill"] == "toself" else len(drawn["x"])
        expected = dict(zip(whole["x"], whole["y"], strict=True)) if half == len(drawn["x"]) else None
        if expected is None:  # of an outline the upper edge comes first
            expected = dict(zip(whole["x"][: len(whole["x"]) // 2], whole["y"], strict=False))
        for x, y in zip(drawn["x"][:half], drawn["y"][:half], strict=True):
            if x in expected and y is not None and len(drawn["x"]) > 2:
                assert y == pytest.approx(expected[x], rel=FROM_EVENTS, abs=1e-4, nan_ok=True)
                compared += 1
    assert compared > 10 * max(watched.lengths)


def test_a_running_filter_says_its_pace_what_is_left_and_when_it_was_last_heard_of(watched):
    said = watched.said[-1]
    assert re.search(r"\d+\.\d frames/s, about \d.* left", said)
    assert re.search(r"last event \d+\Ws ago", said)


def test_the_log_follows_and_a_stop_keeps_its_reason(watched):
    assert re.search(r"\d+ %: frame \d+: \d+ of 100 frames", watched.log)
    assert "Cancelled by Ada Analyst: Seen enough." in watched.at_the_end
    assert "PARTIAL: It had reached" in watched.at_the_end


def test_the_log_stays_where_somebody_reads_and_rests_while_it_is_paused(watched):
    assert watched.scrolled_px == 0
    assert watched.paused_lines[0] == watched.paused_lines[1]


LINES = "#figure-convergence .cursor-line:not([hidden])"
TAIL = "() => document.querySelector('#figure-rms .js-plotly-plot')._fullLayout.shapes[0].x0"
AXIS = "() => document.querySelector('#figure-convergence .js-plotly-plot')._fullLayout.yaxis10.type"
IS_UNCOVERED = """() => {
    const tab = document.querySelector("#parts [aria-current]"), box = tab.getBoundingClientRect();
    return tab.contains(document.elementFromPoint(box.left + 8, box.top + box.height / 2));
}"""


@pytest.fixture(scope="module")
def window(people, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{sequential_run}")
        yield window


def test_the_pointer_over_one_chart_marks_the_same_place_in_all_that_share_its_axis(window, sequential_run):
    window.open(f"/runs/{sequential_run}?part=convergence")
    window.figures_drawn()
    expect(window.page.locator(LINES)).to_have_count(0)
    window.figure("rms").locator(".nsewdrag").hover(position={"x": 200, "y": 150})
    expect(window.page.locator(LINES)).to_have_count(10)
    window.page.locator("h1").hover()
    expect(window.page.locator(LINES)).to_have_count(0)


@pytest.mark.full
def test_scale_and_tail_are_in_the_address_so_that_a_second_person_sees_the_same(window, people, sequential_run):
    window.open(f"/runs/{sequential_run}?part=convergence")
    window.figures_drawn()
    assert window.page.evaluate(AXIS) == "log"
    window.page.get_by_label("Cost and step").select_option("linear")
    window.page.get_by_role("form", name="View of the history").get_by_role("button", name="Show").click()
    window.page.wait_for_url("**scale=linear**")
    window.figures_drawn()
    assert window.page.evaluate(AXIS) == "linear"
    window.page.get_by_label("Tail from frame").fill("60")
    window.page.get_by_role("form", name="View of the history").get_by_role("button", name="Show").click()
    window.page.wait_for_url("**tail_from=60**")
    with people.seat("approver") as second:
        second.open(window.page.url)
        expect(second.page.locator("#errors")).to_contain_text("frame 60 to 99")
        second.figures_drawn()
        assert second.page.evaluate(TAIL) == 60


DOUBLE_CLICK_MS = 400  # a press so soon after the last one would be a double click
RANGES = """name => { const drawn = document.querySelector(`#figure-${name} .js-plotly-plot`)._fullLayout;
    return [...drawn.xaxis.range, ...drawn.yaxis.range]; }"""


def test_zoom_and_cursor_are_in_the_address_so_that_a_copied_link_opens_the_same_view(window, people, sequential_run):
    window.open(f"/runs/{sequential_run}?part=convergence#errors")
    window.figures_drawn()
    assert window.page.url.endswith("#errors")
    chart, mouse = window.figure("rms").locator(".nsewdrag").first, window.page.mouse
    chart.evaluate("drawing => drawing.scrollIntoView({ block: 'center' })")  # clear of the bar that stays in sight
    window.figures_drawn()
    box = chart.bounding_box()
    mouse.move(box["x"] + 60, box["y"] + 20)
    mouse.down()
    mouse.move(box["x"] + 260, box["y"] + 90, steps=4)
    mouse.up()
    window.page.wait_for_url(re.compile("#zoom.run-.*-rms=x_"))
    window.figures_drawn()
    window.page.wait_for_timeout(DOUBLE_CLICK_MS)
    chart.click(position={"x": 100, "y": 50})
    window.page.wait_for_url(re.compile("&at=frame_"))
    window.page.locator("h1").hover()
    expect(window.page.locator(LINES)).to_have_count(10)
    zoomed = window.page.evaluate(RANGES, "rms")
    with people.seat("approver") as second:
        second.open(window.page.url)
        second.figures_drawn()
        expect(second.page.locator(LINES)).to_have_count(10)
        assert second.page.evaluate(RANGES, "rms") == pytest.approx(zoomed, rel=1e-5)
        second.page.keyboard.press("Escape")
        expect(second.page.locator(LINES)).to_have_count(0)
        second.figure("rms").locator(".nsewdrag").first.dblclick()
        second.page.wait_for_url(re.compile("part=convergence$"))


def test_the_runs_beside_are_one_step_away_in_the_same_part(window, batch_run, sequential_run):
    window.open(f"/runs/{sequential_run}?part=record")
    window.page.locator("a[rel=prev]").click()
    window.page.wait_for_url(re.compile(rf"/runs/(?!{sequential_run}\b)\d+\?part=record"))
    assert int(re.search(r"/runs/(\d+)", window.page.url)[1]) >= batch_run


def test_a_figure_that_fails_says_so_and_comes_back_on_retry(window, sequential_run):
    window.page.route("**/figures/rms?*", lambda route: route.abort())
    window.page.route("**/figures/rms", lambda route: route.abort())
    window.open(f"/runs/{sequential_run}?part=convergence")
    panel = window.figure("rms")
    expect(panel.locator("plot-figure")).to_have_attribute("data-state", "error")
    window.page.unroute_all(behavior="ignoreErrors")
    panel.get_by_role("button", name="Retry").click()
    expect(panel.locator("plot-figure")).to_have_attribute("data-state", "ready")
    window.forgive("ERR_FAILED")


def test_a_frame_is_stepped_through_scaled_and_found_again_by_its_address(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}?part=evidence&frame=5&scale=100")
        page = window.page
        heading, drawing = page.get_by_role("heading", level=2, name="Frame"), page.locator(".frame-drawing")
        expect(heading).to_have_text("Frame 5")

        page.locator("[data-frame-link=next]").click()
        expect(heading).to_have_text("Frame 6")
        expect(page.locator("[data-frame-link=next]")).to_be_focused()
        drawing.focus()
        page.keyboard.press("ArrowRight")
        expect(heading).to_have_text("Frame 7")
        expect(drawing).to_be_focused()
        assert page.url.endswith("frame=7&scale=100")

        page.get_by_label("Scale").select_option("500")
        assert page.url.endswith("frame=7&scale=500")
        frame = window.read(f"/api/v1/runs/{batch_run}/frames/7")
        star = next(star for star in frame["exposures"][0]["stars"] if star["new"])
        line = page.locator(f"g[data-star='{star['row']}'] line.new")
        drawn = [float(line.get_attribute(name)) for name in ("x1", "y1", "x2", "y2")]
        d_row, d_col = star["new"]["d_px"]
        assert drawn[2:] == pytest.approx([drawn[0] + 500 * d_col, drawn[1] + 500 * d_row])

        page.locator(f"table.frame-stars tr[data-star='{star['row']}']").hover()
        expect(page.locator(f"g[data-star='{star['row']}']")).to_have_class("star used is-shown")
        page.go_back()
        expect(heading).to_have_text("Frame 6")
        page.get_by_label("Frame", exact=True).fill("4000")
        page.keyboard.press("Enter")
        expect(page.get_by_text("The telemetry has no frame 4000")).to_be_visible()
        assert window.complaints == []


ONE_A_SECOND, FIFTY_A_SECOND = 1.0, 50.0
LONGEST_EVIDENCE_PX = 3600  # at 1280 px, with what is for research folded away
MOST_LINES_PX = 45  # two lines
SINGLE = 1e-6  # figures travel in single precision


def open_part(window, run_id, part):
    window.open(f"/runs/{run_id}")
    window.page.get_by_role("navigation", name="Parts of this run").get_by_role("link", name=part).click()
    window.page.wait_for_url(f"**/runs/{run_id}?part={part.lower()}")
    window.figures_drawn()


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
        open_part(window, batch_run, "Evidence")
        window.page.locator("#stars-one-by-one summary").click()
        yield window


def test_the_page_can_be_read_before_its_figures_are_drawn(people, batch_run):
    with people.seat("analyst") as window:
        window.page.route("**/figures/*", lambda _: None)  # no figure ever arrives
        window.open(f"/runs/{batch_run}?part=evidence")
        expect(window.page.get_by_role("heading", name="Examination")).to_be_visible()
        window.page.locator("#stars-one-by-one summary").click()
        expect(window.page.get_by_role("table", name="Residuals of each star")).to_be_visible()
        window.page.unroute_all(behavior="ignoreErrors")


QUIET_MS = 60_000  # of a page that nobody touches, in which it draws what is out of sight


@pytest.mark.full
def test_figures_far_below_are_drawn_without_being_scrolled_to_and_folded_ones_when_they_are_unfolded(
    people, batch_run
):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}?part=evidence")
        expect(window.page.locator("plot-figure[data-state=loading]:visible")).to_have_count(0, timeout=QUIET_MS)
        assert window.page.evaluate("scrollY") == 0
        assert window.page.evaluate("document.documentElement.scrollHeight") <= LONGEST_EVIDENCE_PX
        for figure in CHAPTERS["trust"]:
            drawn = window.figure(figure.name).locator(".js-plotly-plot")
            expect(drawn).to_have_count(0 if figure.advanced else 1)
        window.unfold()
        for figure in CHAPTERS["trust"]:
            expect(window.figure(figure.name).locator(".js-plotly-plot, [data-state=empty]")).to_have_count(1)


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
        open_part(window, batch_run, "Evidence")
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
        open_part(window, batch_run, "Evidence")
        for name in ("Given", "Kept", "Removed", "Added", "Matched"):
            told = window.page.locator(f"#matches dl.verdict dt:text-is('{name}') + dd b").inner_text()
            assert int(re.sub(r"\D", "", told)) == matching[name.lower()]
        assert window.drawn("matching")[0]["y"] == [cycle["matched"] for cycle in matching["cycles"]]


@pytest.mark.full
def test_trust_appears_by_itself_when_the_run_that_is_watched_ends(people, batch_run):
    with people.seat("analyst") as window:
        before, run_id = (
            clone(window, batch_run, pace, label)
            for pace, label in ((ONE_A_SECOND, "Has the only worker"), (FIFTY_A_SECOND, "Watched for its trust"))
        )
        for part in list(PARTS)[: effort(1, len(PARTS))]:
            window.begins_high(f"/runs/{run_id}?part={part}")
            expect(window.page.locator("#run-head")).to_contain_text("QUEUED")
        open_part(window, run_id, "Evidence")
        examination = window.page.locator("#examination")
        expect(examination).to_contain_text("No examination")
        window.send(f"/runs/{before}/cancel", {})
        ends_as(window, "SUCCEEDED")
        expect(examination.locator("plot-figure")).to_have_count(len(CHAPTERS["trust"]))
        window.figures_drawn()
        assert len(window.drawn("efficiency")[0]["y"]) == len(window.result(run_id)["free"])
        expect(window.page.locator("#parts")).to_contain_text("warning")


SLOW = {"method": "sqrf", "replay_frames_per_s": 1.0}
ENDS = {"cancelled": "CANCELLED", "failed": "FAILED"}
LAUNCHED = (
    "joint",
    "cancelled",
    "queued",
    "failed",
    *(name for name in CAMERA_MODELS if name != "inverted_wang"),
    "real sky",
)


def launch(window, sensor_id, set_id, label, **more):
    window.open("/runs")
    token = window.page.locator("input[name=csrf_token]").first.input_value()
    asked = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "batch"}, "label": label} | more
    answer = window.page.request.post("/api/v1/runs", data=asked, headers={"X-CSRF-Token": token})
    assert answer.ok, answer.text()
    return answer.json()["id"]


def register(window, document):
    window.open("/sensors")
    window.page.get_by_label("Sensor file (JSON)").fill(json.dumps(document))
    window.page.get_by_role("button", name="Register").click()
    window.page.wait_for_url("**/sensors/*")
    return int(window.page.url.rpartition("/")[2])


def describe_camera(installation, files, model):
    """A sensor file of the simulated optics in another camera model."""
    known, path = json.loads((files / "sensor.json").read_text()), installation.folder / f"{model}.json"
    detector = known["detector"]
    installation.command(
        *("sensor", "new", "--rows", str(detector["rows"]), "--columns", str(detector["columns"]), "--model", model),
        *(
            "--pixel-pitch-um",
            str(1e6 * detector["pixel_pitch_m"]),
            "--focal-length-mm",
            str(1e3 * known["initial"]["f_m"]),
        ),
        *("--out", str(path)),
    )
    kept = {name: known[name] for name in ("parity", "centroid_sigma_px", "magnitude_limit", "readout", "declared")}
    return json.loads(path.read_text()) | kept | {"name": f"As {model}"}


@pytest.fixture
def launched(request, people, installation, files, sensor_id, telemetry):
    """A run that is joint, queued, failed, cancelled, of real stars, or of a camera model."""
    name = request.param
    with people.seat("analyst") as window:
        if name == "joint":
            run_id = launch(window, sensor_id, telemetry["calibration"], name, joint_set_ids=[telemetry["validation"]])
        elif name == "queued":
            before = launch(window, sensor_id, telemetry["calibration"], "Has the only worker", settings=SLOW)
            run_id = launch(window, sensor_id, telemetry["calibration"], name)
        elif name == "failed":
            lines = (files / "calibration.csv").read_text().splitlines(keepends=True)
            (files / "lost.csv").write_text("".join(lines[:-1]))
            set_id = upload(window, sensor_id, files / "lost.csv")
            table = installation.blob(window.read(f"/api/v1/telemetry-sets/{set_id}")["table_sha256"])
            content = table.read_bytes()
            table.unlink()
            run_id = launch(window, sensor_id, set_id, name)
        elif name == "cancelled":
            run_id = launch(window, sensor_id, telemetry["calibration"], name, settings=SLOW)
            window.open(f"/runs/{run_id}")
            window.send(f"/runs/{run_id}/cancel", {})
        elif name == "real sky":
            real_sky = request.getfixturevalue("real_sky")
            own = register(window, json.loads((real_sky / "esa.sensor.json").read_text()))
            run_id = launch(window, own, upload(window, own, real_sky / "esa-5-frames.csv"), name)
        else:
            own = register(window, describe_camera(installation, files, name))
            run_id = launch(window, own, upload(window, own, files / "calibration.csv"), name)
        window.open(f"/runs/{run_id}")
        if name == "queued":
            expect(window.page.locator("#run-head")).to_contain_text("QUEUED")
        else:
            ends_as(window, ENDS.get(name, "SUCCEEDED"))
        if name == "failed":
            table.write_bytes(content)  # the audit log verifies every file, also for the tests that follow
        yield window, run_id
        if name == "queued":
            for one in (run_id, before):
                window.send(f"/runs/{one}/cancel", {})


@pytest.mark.parametrize("launched", few_of(LAUNCHED, 2), indirect=True)
def test_every_part_of_every_kind_of_run_begins_high_and_its_worst_warning_is_read_whole(launched):
    window, run_id = launched
    for part in PARTS:
        window.begins_high(f"/runs/{run_id}?part={part}")
        worst = window.page.locator("#verdict .worst")
        if worst.count():
            assert worst.evaluate(
                "one => one.scrollWidth <= one.clientWidth && getComputedStyle(one).textOverflow === 'clip'"
            )
            assert worst.evaluate("one => one.getBoundingClientRect().height") <= MOST_LINES_PX


@pytest.mark.parametrize("run", ["batch", "filter"])
def test_every_part_of_a_promoted_run_and_of_a_filter_begins_high(people, numbers, run):
    with people.seat("analyst") as window:
        for part in PARTS:
            window.begins_high(f"/runs/{numbers[run]}?part={part}")


def test_the_parts_stay_in_sight_and_a_view_opens_its_large_figure(window, sequential_run):
    window.page.set_viewport_size({"width": 1280, "height": 720})
    window.open(f"/runs/{sequential_run}")
    window.page.get_by_role("link", name="Radial difference").click()
    window.page.wait_for_url("**?part=distortion#figure-radial")
    window.figures_drawn()
    for size in (GLANCE, PHONE):
        window.page.set_viewport_size(size)
        window.page.evaluate("scrollTo(0, 900)")
        expect(window.page.locator("#parts [aria-current]")).to_be_in_viewport()
        assert window.page.evaluate(IS_UNCOVERED), f"at {size['width']} px"
