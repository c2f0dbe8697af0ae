"""A run that cannot succeed says so on its page, and a page whose server is gone does not pretend otherwise."""

import csv
import re
from collections import Counter

import pytest
from playwright.sync_api import expect

from boresight.console.runs.pages.run import PARTS
from tests.browser.test_dialogs import seat
from tests.browser.test_figures import HIDE
from tests.browser.window import WRITES
from tests.browser.work import choose_filter, ends_as, queue, upload
from tests.effort import effort

pytestmark = pytest.mark.browser

STARS = 3
WHY, LABEL = "The pass ends soon.", "Typed before the server went"
ONE_A_SECOND, TEN_A_SECOND = 1.0, 10.0
BACK = """() => document.dispatchEvent(
    new CustomEvent("boresight:link", { detail: { state: "live", sinceMs: Date.now() } }))"""
ALWAYS_LATE = "AbortSignal.timeout = () => AbortSignal.abort(new DOMException('late', 'TimeoutError'))"


@pytest.fixture(scope="module")
def sparse_set(people, sensor_id, files):
    with (files / "calibration.csv").open() as source:
        head, *rows = csv.reader(source)
    seen = Counter()
    kept = [row for row in rows if not seen.update([tuple(row[:2])]) and seen[tuple(row[:2])] <= STARS]
    path = files / "sparse.csv"
    with path.open("w", newline="") as target:
        csv.writer(target).writerows([head, *kept])
    with people.seat("analyst") as window:
        return upload(window, sensor_id, path)


@pytest.mark.full
def test_a_run_without_enough_stars_says_so_and_shows_no_number(people, sparse_set):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?set={sparse_set}")
        run_id = queue(window, "Three stars an exposure")
        ends_as(window, "SUCCEEDED")
        expect(window.page.locator("#verdict")).to_contain_text("too few stars")
        window.figures_drawn()
        window.shoot("40-too-few-stars")
        expect(window.page.locator("#parameters")).to_contain_text("not estimated")
        expect(window.page.get_by_role("button", name="Create parameter set")).to_have_count(0)
        expect(window.page.locator("#stations .next-act")).to_contain_text("too few stars")
        assert set(window.result(run_id)["sigma"].values()) == {None}


@pytest.mark.full
def test_a_run_whose_data_are_lost_fails_with_its_cause_and_what_to_try(people, installation, sparse_set):
    with people.seat("analyst") as window:
        known = window.read(f"/api/v1/telemetry-sets/{sparse_set}")
        table = installation.blob(known["table_sha256"])
        content = table.read_bytes()
        table.unlink()
        window.open(f"/runs/new?set={sparse_set}")
        run_id = queue(window, "Its data are gone")
        ends_as(window, "FAILED")
        table.write_bytes(content)  # the audit log verifies every file, also for the tests that follow
        reason = window.read(f"/api/v1/runs/{run_id}")["reason"]
        assert reason
        head = window.page.locator("#what-happened")
        expect(window.page.get_by_role("alert")).to_have_text(reason)
        expect(head).to_contain_text("clone this run and edit it")
        expect(head.get_by_role("list", name="Last lines of the log")).to_contain_text("RUNNING: attempt 1")
        expect(window.page.locator("#parameters")).to_contain_text(
            "No estimate: the run ended as FAILED before it had a result"
        )
        expect(window.page.get_by_role("button", name="Create parameter set")).to_have_count(0)
        expect(window.page.locator("plot-figure")).to_have_count(0)
        window.shoot("41-failed", wide=True)
        for part in list(PARTS)[: effort(1, len(PARTS))]:
            window.begins_high(f"/runs/{run_id}?part={part}")
        window.open(f"/runs/{run_id}")
        head.get_by_role("link", name="Whole log").click()
        window.page.get_by_role("link", name=re.compile("^Errors")).click()
        expect(window.page.get_by_role("listitem").filter(has_text=f"FAILED: {reason}")).to_be_visible()
        assert window.page.url.endswith("part=record&level=error#log")
        assert window.barriers() == []
        window.shoot("41-failed-log")
        window.page.locator("#verdict summary").click()
        window.page.locator("#verdict").get_by_role("link", name="Run it again").click()
        expect(window.page.get_by_label("Label")).to_have_value(re.compile("Its data are gone"))


@pytest.mark.full
def test_a_cancelled_run_says_who_stopped_it_and_keeps_no_result(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?clone={batch_run}")
        choose_filter(window, ONE_A_SECOND)
        run_id = queue(window, "To be stopped")
        expect(window.page.locator("#run-head")).to_contain_text("RUNNING")
        for part in PARTS:
            window.begins_high(f"/runs/{run_id}?part={part}")
        window.page.get_by_role("button", name="Cancel run").click()
        ends_as(window, "CANCELLED")
        for part in PARTS:
            window.begins_high(f"/runs/{run_id}?part={part}")
        window.open(f"/runs/{run_id}")
        expect(window.page.locator("#what-happened")).to_contain_text("Cancelled by Ada Analyst")
        expect(window.page.get_by_role("button", name="Cancel run")).to_have_count(0)
        expect(window.page.locator("#verdict")).to_contain_text("the run ended as CANCELLED before it had a result")
        expect(window.page.locator("plot-figure")).to_have_count(0)
        window.shoot("42-cancelled")
        assert window.read(f"/api/v1/runs/{run_id}")["result_sha256"] is None


def test_a_page_says_that_its_server_is_gone_holds_what_would_write_and_recovers_with_it(
    people, installation, sequential_run
):
    with people.seat("analyst") as window:
        form = window.page.context.new_page()
        form.goto(f"{installation.address}/runs/new?clone={sequential_run}")
        form.get_by_label("Label").fill(LABEL)
        expect(form.locator("#link-state")).to_have_text("LIVE")
        window.open(f"/runs/new?clone={sequential_run}")
        choose_filter(window, TEN_A_SECOND)
        run_id = queue(window, "Survives its server")
        window.open(f"/runs/{run_id}?part=convergence")
        link, age = window.page.locator("#link-state"), window.page.locator("[data-run-age]")
        expect(link).to_have_text("LIVE")
        expect(window.page.locator("#run-head")).to_contain_text("RUNNING")
        window.grown("convergence", 1)
        window.page.get_by_label("Why cancel it").fill(WHY)
        window.page.get_by_label("Why cancel it").blur()  # what is being typed in is not renewed
        assert window.page.evaluate(WRITES)
        installation.kill()
        try:
            expect(link).to_have_text("DISCONNECTED")
            expect(age).to_have_text(re.compile(r"^DISCONNECTED · last event \d+\Ws ago$"))
            window.shoot("43-disconnected")
            for page in (window.page, form):
                expect(page.locator("body")).to_have_attribute("data-link", "disconnected")
                expect(page.locator(".link-banner time")).to_be_visible()
                assert page.evaluate(WRITES) == []
            assert form.get_by_label("Label").input_value() == LABEL
        finally:
            installation.start()
        expect(link).to_have_text("LIVE")
        expect(age).to_have_text(re.compile("^last event"))
        expect(window.page.get_by_label("Why cancel it")).to_have_value(WHY)
        expect(form.locator(".link-banner")).to_have_count(0)
        expect(form.get_by_role("button", name="Queue run")).to_be_enabled()
        assert form.get_by_label("Label").input_value() == LABEL
        form.close()
        window.shoot("44-returned")
        ends_as(window, "SUCCEEDED")
        run, first = (window.read(f"/api/v1/runs/{number}") for number in (run_id, sequential_run))
        assert run["attempt"] > 1
        log = window.read(f"/api/v1/runs/{run_id}/log")["items"]
        assert [line["attempt"] for line in log if line["kind"] == "lost"] == [1]
        result = window.result(run_id)
        # the filter is handed on from call to call, as many as its pace makes, and each rounds once
        assert result["parameters"] == pytest.approx(window.result(sequential_run)["parameters"], rel=1e-10)
        assert run["summary"]["status"] == first["summary"]["status"]
        # the live figure stays until the drawing of the result comes in its place
        window.grown("convergence", len(result["history"]["frame"]) - 1)
        assert window.drawn("convergence")[1]["x"] == result["history"]["frame"]
        window.shoot("45-recovered")
        window.forgive("ERR_")


def test_a_busy_server_is_silent_and_not_gone_until_a_minute_has_passed(people):
    with people.seat("analyst", new=True) as window:
        window.page.clock.install()
        window.page.add_init_script(ALWAYS_LATE)
        window.open("/help/glossary")
        link = window.page.locator("#link-state")
        expect(link).to_have_attribute("data-state", "live")
        for seconds, state in ((10, "live"), (15, "stale"), (50, "disconnected")):
            window.page.clock.run_for(1000 * seconds)
            expect(link).to_have_attribute("data-state", state)


def test_a_figure_that_failed_while_the_server_was_away_is_drawn_when_the_link_is_back(browser, house):
    run_id = house.converged()
    with seat(browser, house, house.person("ada")) as window:
        page, figure = window.page, window.figure("convergence").locator("plot-figure")
        for failed in ("error", "stale"):
            page.route("**/figures/*", lambda route: route.abort())
            if failed == "error":
                window.open(f"/runs/{run_id}?part=convergence")
                expect(page.locator("#link-state")).to_have_text("LIVE")  # before this test tells it again
            else:
                figure.dispatch_event("figure-refresh")
            expect(figure).to_have_attribute("data-state", failed)
            page.unroute("**/figures/*")
            page.evaluate(BACK)
            expect(figure).to_have_attribute("data-state", "ready")
        window.forgive("ERR_")


def test_a_page_opened_in_the_background_holds_no_connection_until_it_is_looked_at(browser, house):
    with seat(browser, house, house.person("ada")) as window:
        streams = []
        window.page.on("request", lambda asked: streams.append(asked.url) if "/api/v1/events" in asked.url else None)
        window.page.add_init_script(f"({HIDE})(true)")
        window.open("/help/glossary")
        assert streams == []
        window.page.evaluate(HIDE, False)
        expect(window.page.locator("#link-state")).to_have_text("LIVE")
        assert len(streams) == 1


@pytest.mark.full
def test_a_run_queued_while_the_server_is_gone_stays_a_form_and_is_queued_when_it_is_back(people, telemetry):
    with people.seat("analyst") as window:
        page = window.page
        window.open(f"/runs/new?set={telemetry['calibration']}")
        expect(page.locator("#link-state")).to_have_text("LIVE")
        expect(page.locator("[data-dry-run]")).to_contain_text("8 parameters, ")
        page.get_by_label("Label").fill("typed before the link broke")
        expect(page).to_have_url(re.compile("label=typed"))  # the address follows the form
        address = page.url
        page.route("**/healthz", lambda route: route.abort())
        page.get_by_role("button", name="Queue run").click()
        expect(page.locator(".link-banner")).to_be_visible()
        page.locator("nav.side a").first.click(force=True)  # a link is held, too
        expect(page.locator(".link-banner")).to_be_focused()
        assert page.url == address
        assert page.evaluate(WRITES) == []
        page.get_by_label("Label").press("Enter")
        expect(page.get_by_label("Label")).to_have_value("typed before the link broke")
        page.unroute("**/healthz")
        expect(page.locator("#link-state")).to_have_text("LIVE")
        expect(page.get_by_label("Label")).to_have_value("typed before the link broke")
        page.get_by_role("button", name="Queue run").click()
        page.wait_for_url(re.compile(r"/runs/\d+$"))
        window.forgive("ERR_")
