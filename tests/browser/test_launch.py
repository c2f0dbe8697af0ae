"""Launching: presets and campaigns, the rarer choices by keyboard, singular values, and a sensor of a fleet that no menu holds."""

import os
import re

import pytest
from playwright.sync_api import expect

from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.db.sessions import open_engine, open_writing
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.browser.installation import Installation
from tests.browser.people import PRINTED_NAMES, People, get_password
from tests.browser.work import ends_as, queue
from tests.console.fleet.fleets import add_fleet
from tests.stores import url_in

pytestmark = pytest.mark.browser


@pytest.mark.full
def test_a_preset_keeps_what_was_typed_and_its_campaign_is_followed_to_its_end(people, telemetry):
    with people.seat("analyst") as window:
        page, dry_run = window.page, window.page.locator("[data-dry-run]")
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page.get_by_label("Label").fill("first pass")
        page.get_by_role("button", name="Quick look").click()
        expect(page).to_have_url(re.compile(f"set={telemetry['calibration']}.*preset=quick-look"))
        expect(page.get_by_label("Label")).to_have_value("first pass")
        expect(dry_run).to_contain_text("8 parameters, ")
        expect(page.get_by_role("table", name=re.compile("^Predicted sigma"))).to_contain_text("b4_per_m4")
        page.get_by_role("radio", name=re.compile("^Square-root filter")).check()
        expect(page).to_have_url(re.compile(r"preset=quick-look.*method=sqrf"))
        expect(page.get_by_role("region", name="Changed from Quick look")).to_contain_text("Square-root filter")
        window.shoot("60-launch-forecast")
        assert window.barriers() == []

        page.get_by_role("link", name="Many sensors at once").click()
        page.get_by_label("Label").fill("the whole fleet")
        expect(dry_run).to_contain_text(re.compile(r"(\d+) of \1 sensors"))
        window.shoot("61-campaign-launch")
        assert window.barriers() == []
        page.get_by_role("button", name="Queue campaign").click()
        page.wait_for_url(re.compile(r"/campaigns/\d+$"))
        page.evaluate("() => { window.unbroken = true; }")
        expect(page.locator("[data-campaign='ended']")).to_contain_text(re.compile(r"(\d+) of \1 ended"))
        assert page.evaluate("window.unbroken"), "the page was loaded again"
        expect(page.get_by_role("progressbar")).to_have_attribute("value", "1.0")
        expect(page.get_by_role("table", name=re.compile("^RMS of arcs"))).to_contain_text("SUCCEEDED")
        window.holds_in_themes_and_widths("campaign")


@pytest.mark.full
def test_more_options_are_opened_and_chosen_by_keyboard_alone(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page = window.page
        expect(page.get_by_label("Loss")).to_be_hidden()
        page.get_by_text("More options").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_label("Loss")).to_be_visible()
        page.get_by_label("Loss").focus()
        page.keyboard.press("H")
        expect(page.get_by_label("Loss")).to_have_value("huber")
        expect(page.locator("[data-dry-run]")).to_contain_text("robust huber")
        for theme in ("dark", "light"):
            window.use_theme(theme)
            window.fits()
            assert window.barriers() == []
        window.use_theme("dark")


def test_options_of_another_method_are_switched_off(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={telemetry['calibration']}")
        page = window.page
        page.get_by_text("More options").click()
        expect(page.get_by_label("Loss")).to_be_enabled()
        expect(page.get_by_label("Forgetting factor")).to_be_disabled()
        page.get_by_role("radio", name=re.compile("^Unscented filter")).check()
        expect(page.get_by_label("Loss")).to_be_disabled()
        page.get_by_label("Forgetting factor").fill("0.98")
        expect(page.locator("[data-dry-run]")).to_contain_text("forgetting_factor 0.98")
        assert window.barriers() == []


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


@pytest.mark.full
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


@pytest.mark.full
def test_the_panel_of_methods_sets_both_beside_the_batch_on_one_set(people, batch_run, svd_run, angular_run):
    with people.seat("analyst") as window:
        window.open(f"/compare?runs={batch_run},{svd_run},{angular_run}")
        table = window.page.get_by_role("region", name="Methods of the runs")
        for title in ("Batch", "Singular values", "All angular distances"):
            expect(find_row(table, "Method")).to_contain_text(title)
        shown = {name: find_row(table, name).locator("td.num").all_inner_texts() for name in CHOSEN_BY}
        assert all(len(texts) == 3 and all(re.search(r"\d", text) for text in texts) for texts in shown.values()), shown
        assert all(0.9 < first_number(text) < 1.5 for text in shown["Claimed error"]), shown
        assert all(first_number(text) > 0 for text in shown["Cost"]), shown
        assert [text.split()[-1] for text in shown["Converged after"]] == ["iterations", "frames", "frames"]


def find_row(table, name):
    return table.locator("tbody tr").filter(has=table.page.get_by_role("rowheader", name=name, exact=True))


def first_number(text):
    return float(re.search(r"\d[\d.]*", text)[0])


@pytest.fixture(scope="module")
def analyst(tmp_path_factory, pytestconfig, browser):
    kernels = os.environ.get("NUMBA_CACHE_DIR") or str(pytestconfig.cache.mkdir("kernels"))
    made = Installation(tmp_path_factory.mktemp("large"), kernels)
    printed = ("--printed-name", PRINTED_NAMES["analyst"], "--password-stdin")
    made.command("user", "add", "analyst", "--role", "analyst", *printed, typed=get_password("analyst"))
    engine = open_engine(url_in(made.folder / "data"))
    with open_writing(engine) as session:
        add_fleet(session, FolderBlobStore(made.folder / "data" / "blobs"), sensor_document(st16_sensor(1)), 250)
    engine.dispose()
    made.start()
    with People(made, browser).seat("analyst") as window:
        yield window
    made.stop()


@pytest.mark.full
def test_a_sensor_of_a_large_fleet_is_found_and_chosen_and_what_was_typed_stays(analyst):
    page = analyst.page
    sensor, label = page.get_by_label("Sensor", exact=True), page.get_by_label("Label")
    analyst.open("/runs/new")
    expect(sensor.locator("option:checked")).to_have_text("ST-0000")
    label.fill("after eclipse")
    page.get_by_label("Find a sensor").fill("st-0249")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("find=st-0249.*sensor=250"))
    expect(sensor.locator("option:checked")).to_have_text("ST-0249")
    expect(label).to_have_value("after eclipse")
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0249 · calibration")
    expect(page.locator("[data-parameters-of]")).to_have_count(1)
    analyst.fits()
    assert analyst.barriers() == []
    page.get_by_label("Find a sensor").fill("")
    page.get_by_role("main").get_by_role("button", name="Find").click()
    expect(page.locator("#sensor_id option")).to_have_count(201)
    sensor.select_option(label="ST-0007")
    expect(page).to_have_url(re.compile("sensor=8"))
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0007 · calibration")
    expect(label).to_have_value("after eclipse")
    page.go_back()
    expect(sensor.locator("option:checked")).to_have_text("ST-0249")
    expect(page.get_by_label("Calibration set").locator("option:checked")).to_contain_text("ST-0249 · calibration")
