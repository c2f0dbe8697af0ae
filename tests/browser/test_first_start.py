"""From an empty installation to a new baseline: each person's part, on the pages, with the numbers that REST gives."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser.conftest import LOOKS
from tests.browser.people import PRINTED_NAMES
from tests.browser.work import choose_upload
from tests.sites import as_shown

pytestmark = pytest.mark.browser

SINGLE = 1e-6  # figures are sent in single precision
CHANGE_UNITS = {"f_m": 1e3, "b4_per_m4": 1e-8, "a1_rad": 1e3, "a2_rad": 1e3}
SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")


def number(text: str) -> float:
    digits, _, power = re.sub(r"\s", "", text).translate(SUPERSCRIPTS).partition("·10")
    return float(digits) * 10.0 ** int(power or 0)


def change(result, history, name):
    place = list(result["parameters"]).index(name)
    unit = CHANGE_UNITS.get(name, 1.0)
    value, sigma = (np.array([row[place] for row in history[key]]) for key in ("parameters", "sigma"))
    return (value - result["initial"][name]) * unit, 3 * sigma * unit


@pytest.fixture(scope="module")
def batch_page(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}")
        yield window


@pytest.fixture(scope="module")
def filter_page(people, sequential_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{sequential_run}")
        yield window


def test_the_administrator_made_on_the_command_line_gives_everybody_a_role(people):
    with people.seat("administrator") as window:
        window.open("/users")
        for name in ("administrator", "analyst", "approver", "operator"):
            expect(window.page.get_by_label(f"{PRINTED_NAMES[name]}: {name}")).to_be_checked()


def test_an_upload_shows_how_far_it_is_and_the_same_bytes_are_the_same_set(people, sensor_id, telemetry, files):
    with people.seat("analyst") as window:
        choose_upload(window, sensor_id, files / "calibration.csv")
        window.slow_down(50_000)
        window.page.get_by_role("button", name="Upload and check").click()
        progress = window.page.locator("#upload-progress")
        expect(progress).to_contain_text(re.compile(r"0\.[1-9] of 0\.\d MB sent"))
        assert 0 < progress.locator("progress").evaluate("bar => bar.value") < 1
        window.shoot("08-uploading")
        window.slow_down(-1)
        window.page.wait_for_url(f"**/telemetry/{telemetry['calibration']}")


def test_the_quality_report_comes_before_any_run_and_counts_as_rest_does(people, telemetry):
    with people.seat("analyst") as window:
        known = window.read(f"/api/v1/telemetry-sets/{telemetry['calibration']}")
        window.open(f"/telemetry/{telemetry['calibration']}")
        for name, key in (("Frames", "frames"), ("Detections", "stars"), ("Usable stars", "usable")):
            measure = window.page.locator(".measure", has=window.page.get_by_text(name, exact=True)).locator("b")
            assert number(measure.inner_text()) == known["quality"][key]
        for finding in known["quality"]["findings"]:
            expect(window.page.get_by_role("region", name="Findings", exact=True)).to_contain_text(
                as_shown(finding["sentence"])
            )


def test_the_launch_form_says_what_would_run_before_it_is_queued(people, batch_run, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?clone={batch_run}")
        before = window.read("/api/v1/runs?limit=200")["items"]
        window.page.get_by_role("checkbox", name="f_m").uncheck()
        told = window.page.locator("[data-dry-run]")
        expect(told).to_contain_text("7: m0_px, n0_px")
        stars = window.read(f"/api/v1/telemetry-sets/{telemetry['calibration']}")["stars"]
        assert number(told.locator("dt:text-is('Stars') + dd").inner_text()) == stars
        assert window.read("/api/v1/runs?limit=200")["items"] == before


def test_a_batch_run_shows_its_parameters_with_sigmas_and_a_verdict(batch_page, batch_run):
    result = batch_page.result(batch_run)
    batch_page.open(f"/runs/{batch_run}")
    expect(batch_page.page.locator("#verdict")).to_contain_text("converged")
    rows = batch_page.page.locator("#parameters tbody tr")
    scales = {"f_m": 1e3, "a1_rad": 1e3, "a2_rad": 1e3}
    for place, (name, value) in enumerate(result["parameters"].items()):
        cells = rows.nth(place).locator("td").all_inner_texts()
        sigma = result["sigma"][name] * scales.get(name, 1.0)
        assert number(cells[0]) == pytest.approx(result["initial"][name] * scales.get(name, 1.0), abs=0.05 * sigma)
        assert number(cells[1]) == pytest.approx(value * scales.get(name, 1.0), abs=0.05 * sigma)
        assert number(cells[3]) == pytest.approx(sigma, rel=0.05)


def test_a_filter_is_drawn_while_it_computes_and_its_curve_grows(people, watched, sequential_run):
    lengths = watched.lengths
    assert lengths == sorted(set(lengths))
    assert len(lengths) == LOOKS
    assert all("RUNNING" in said for said in watched.said)
    assert "PARTIAL" in watched.said[-1]
    assert "Cancel run" in watched.said[-1]
    with people.seat("analyst") as window:
        assert lengths[-1] <= len(window.result(sequential_run)["history"]["frame"])


def test_convergence_shows_every_parameter_with_its_three_sigma_bounds(
    batch_page, filter_page, batch_run, sequential_run
):
    for window, run_id, key, axis in (
        (batch_page, batch_run, "trace", "iteration"),
        (filter_page, sequential_run, "history", "frame"),
    ):
        result = window.result(run_id)
        window.open(f"/runs/{run_id}?part=convergence")
        drawn = window.drawn("convergence")
        for place, name in enumerate(result["parameters"]):
            band, line = drawn[2 * place : 2 * place + 2]
            value, reach = change(result, result[key], name)
            scale = np.abs(value).max()
            assert line["x"] == result[key][axis]
            assert line["y"] == pytest.approx(value, rel=SINGLE, abs=SINGLE * scale)
            bounds = np.concatenate([value + reach, (value - reach)[::-1]])
            assert sorted(band["y"]) == pytest.approx(sorted(bounds), rel=SINGLE, abs=2 * SINGLE * scale)


def test_tail_and_aggregate_rms_are_those_of_the_result(filter_page, sequential_run):
    history = filter_page.result(sequential_run)["history"]
    filter_page.open(f"/runs/{sequential_run}?part=convergence")
    by_word = {one["name"].rpartition(" · ")[2]: one for one in reversed(filter_page.drawn("rms"))}
    for word in ("tail", "aggregate"):
        assert by_word[word]["x"] == history["frame"]
        assert by_word[word]["y"] == pytest.approx(1e6 * np.array(history[f"{word}_rms_rad"]), rel=SINGLE)


def test_the_radial_difference_is_that_of_the_result_with_its_band(batch_page, batch_run):
    radial = batch_page.result(batch_run)["radial"]
    batch_page.open(f"/runs/{batch_run}?part=distortion")
    line, band, counts = batch_page.drawn("radial")[:3]
    difference, sigma = np.array(radial["difference_px"]), np.array(radial["sigma_px"])
    assert line["x"] == pytest.approx(radial["radius_px"], rel=SINGLE)
    assert line["y"] == pytest.approx(difference, rel=SINGLE)
    assert max(band["y"]) == pytest.approx(3 * sigma.max(), rel=SINGLE)
    assert counts["y"][:-1] == radial["counts"]["stars"]


def test_observability_shows_the_singular_values_and_their_directions(batch_page, batch_run):
    seen = batch_page.result(batch_run)["observability"]
    batch_page.open(f"/runs/{batch_run}?part=observability")
    bars, *others = batch_page.drawn("observability")
    (directions,) = [trace for trace in others if trace.get("z")]
    assert bars["y"] == pytest.approx(seen["singular_values"], rel=SINGLE)
    shares = np.abs(np.array(seen["right_singular_vectors"]).T)
    assert np.abs(directions["z"]) == pytest.approx(shares, abs=SINGLE)
    expect(batch_page.figure("observability")).to_contain_text("Weakest direction")


def test_two_runs_lie_over_each_other_and_only_what_differs_is_listed(people, batch_run, sequential_run):
    with people.seat("analyst") as window:
        window.open("/runs")
        for run_id in (batch_run, sequential_run):
            window.page.get_by_label(f"Select run {run_id}", exact=True).check()
        window.shoot("09-runs-chosen", wide=True)
        expect(window.page.locator("td .status-normal", has_text="converged")).not_to_have_count(0)
        window.page.get_by_role("button", name="Compare 2 runs").click()
        window.page.wait_for_url("**/compare?runs=*")
        differing = window.page.get_by_role("table", name="Settings and results of the runs")
        expect(differing).to_contain_text("Square-root filter")
        expect(differing).not_to_contain_text("calibration.csv")
        names = " ".join(one["name"] for one in window.drawn("convergence"))
        assert "All frames at once" in names
        assert "As frames come down" in names


def test_a_signed_set_that_an_operator_promotes_is_the_sensors_baseline(people, promoted, sensor_id):
    with people.seat("analyst") as window:
        made = window.read(f"/api/v1/parameter-sets/{promoted.set_id}")
        assert made["ground_state"] == "BASELINE"
        window.open(f"/sensors/{sensor_id}")
        expect(window.page.get_by_role("region", name="Baseline", exact=True)).to_contain_text(made["name"])
        history = window.page.get_by_role("region", name="Parameter sets and baselines").get_by_role("row")
        expect(history.filter(has_text=made["name"])).to_contain_text("BASELINE")
        expect(history.filter(has_text="PS-ST16-1-0")).to_contain_text("SUPERSEDED")
        window.shoot("10-new-baseline", wide=True)


def test_the_audit_page_tells_it_all_and_its_chain_holds(people, promoted):
    with people.seat("analyst") as window:
        window.open(f"/audit?object=parameter-sets/{promoted.set_id}")
        table = window.page.get_by_role("table")
        for name in ("analyst", "operator"):
            expect(table).to_contain_text(PRINTED_NAMES[name])
        expect(table).to_contain_text("BASELINE")
        expect(window.page.get_by_text("CHAIN INTACT")).to_be_visible()
        window.shoot("11-audit", wide=True)
