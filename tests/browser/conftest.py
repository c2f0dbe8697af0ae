"""One installation and one Chromium for all files here, and the steps of the main job, each taken once."""

import os
import re
from dataclasses import dataclass, field

import pytest
from playwright.sync_api import expect, sync_playwright

from tests.browser.installation import Installation
from tests.browser.people import PRINTED_NAMES, People, get_password
from tests.browser.window import launch_chromium
from tests.browser.work import choose_filter, ends_as, look_at_views, make_set, queue, sign, submit, upload
from tests.served import house

__all__ = ["house"]

FRAMES = "100"
SLOW_FRAMES_PER_S, QUICK_FRAMES_PER_S = 2.0, 100.0
LOOKS = 3
MISS_A_LINE = """list => {
    list.lastElementChild.remove();
    list.style.maxHeight = "40px";
    list.scrollTop = 0;
    document.dispatchEvent(new CustomEvent("boresight:log", { detail: {} }));
    return list.children.length;
}"""
COUNT_LATER = "list => new Promise(done => setTimeout(() => done(list.children.length), 900))"
PURPOSES = ("calibration", "validation")


@dataclass
class Watched:
    """A run that was watched while it computed: look by look how many frames its convergence curve had, what the page said,
    and how often the figure had been fetched; what was drawn at the last look; its log, how far that was scrolled when lines came
    while its end was not in sight, how many it had before and after a pause; and what its page said at the end.
    """

    lengths: list[int] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    fetched: list[int] = field(default_factory=list)
    drawn: list[dict] = field(default_factory=list)
    fetched_anew: list[dict] = field(default_factory=list)
    log: str = ""
    scrolled_px: float = -1.0
    paused_lines: list[int] = field(default_factory=list)
    at_the_end: str = ""


@dataclass(frozen=True)
class Promoted:
    set_id: int
    request_id: int


@pytest.fixture(scope="package")
def installation(tmp_path_factory, pytestconfig):
    kernels = os.environ.get("NUMBA_CACHE_DIR") or str(pytestconfig.cache.mkdir("kernels"))
    made = Installation(tmp_path_factory.mktemp("browser"), kernels)
    name = "administrator"
    words = ("user", "add", name, "--role", name, "--printed-name", PRINTED_NAMES[name], "--password-stdin")
    made.command(*words, typed=get_password(name))
    made.start()
    yield made
    made.stop()


@pytest.fixture(scope="package")
def files(installation):
    folder = installation.folder / "files"
    installation.command("simulate", "st16-1", "--frames", FRAMES, "--out", str(folder))
    return folder


@pytest.fixture(scope="package")
def browser():
    with sync_playwright() as playwright:
        chromium = launch_chromium(playwright)
        yield chromium
        chromium.close()


@pytest.fixture(scope="package")
def people(installation, browser):
    made = People(installation, browser)
    with made.seat("administrator") as window:
        for name in ("analyst", "approver", "operator"):
            window.open("/users")
            form = window.page.get_by_role("region", name="Add a user")
            form.get_by_label("Log-in name").fill(name)
            form.get_by_label("Name printed").fill(PRINTED_NAMES[name])
            form.get_by_label("First password").fill(get_password(name))
            form.get_by_role("checkbox", name=name).check()
            form.get_by_role("checkbox", name="They must set their own password").uncheck()
            form.get_by_role("button", name="Add this user").click()
            expect(window.page.get_by_role("table", name="Users and their roles")).to_contain_text(PRINTED_NAMES[name])
    return made


@pytest.fixture(scope="package")
def sensor_id(people, files):
    with people.seat("analyst") as window:
        for page in ("", "sensors", "telemetry", "runs", "runs/new", "parameter-sets", "approvals"):
            window.open(f"/{page}")
            window.shoot(f"00-empty-{page.replace('/', '-') or 'overview'}")
        window.open("/sensors")
        window.page.get_by_label("or choose the file").set_input_files(files / "sensor.json")
        expect(window.page.get_by_label("Sensor file (JSON)")).to_have_value((files / "sensor.json").read_text())
        window.page.get_by_role("button", name="Register").click()
        window.page.wait_for_url("**/sensors/*")
        window.shoot("01-sensor-registered")
        return int(window.page.url.rpartition("/")[2])


@pytest.fixture(scope="package")
def telemetry(people, files, sensor_id):
    with people.seat("analyst") as window:
        return {purpose: upload(window, sensor_id, files / f"{purpose}.csv", purpose) for purpose in PURPOSES}


@pytest.fixture(scope="package")
def batch_run(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/telemetry/{telemetry['calibration']}")
        window.page.get_by_role("link", name="New run with it").click()
        run_id = queue(window, "All frames at once")
        ends_as(window, "SUCCEEDED")
        return run_id


@pytest.fixture(scope="package")
def watched(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}")
        window.page.get_by_role("link", name="Clone and edit").click()
        choose_filter(window, SLOW_FRAMES_PER_S)
        window.shoot("02-launch", wide=True)
        run_id = queue(window, "To be watched")
        seen, fetches = Watched(), []
        window.page.on(
            "request", lambda asked: fetches.append(asked.url) if "/figures/convergence" in asked.url else None
        )
        window.open(f"/runs/{run_id}?part=convergence")
        for _ in range(LOOKS):
            seen.lengths.append(window.grown("convergence", max(seen.lengths, default=0)))
            head, verdict = (window.page.locator(place) for place in ("#run-head", "#verdict summary"))
            seen.said.append(head.inner_text() + verdict.inner_text())
            seen.fetched.append(len(fetches))
        seen.drawn = window.drawn("convergence")
        window.shoot("03-running", wide=True)
        with window.page.expect_response("**/figures/convergence*"):
            window.figure("convergence").locator("plot-figure").dispatch_event("figure-refresh")
        window.grown("convergence", len(seen.drawn[1]["x"]))
        seen.fetched_anew = window.drawn("convergence")
        window.open(f"/runs/{run_id}?part=record")
        # with fewer lines its end is in sight wherever it is scrolled to
        expect(window.page.locator("log-tail")).to_contain_text(re.compile(r"\b1\d\s%:"))
        seen.log = window.page.locator("log-tail").inner_text()
        window.shoot("03-log")
        _read_log(window, seen)
        window.page.get_by_label("Why cancel it").fill("Seen enough.")
        window.page.get_by_role("button", name="Cancel run").click()
        ends_as(window, "CANCELLED")
        window.open(f"/runs/{run_id}")
        seen.at_the_end = window.page.locator("#what-happened").inner_text()
        return seen


def _read_log(window, seen):
    lines, newer = window.page.locator("log-tail .log"), window.page.locator("[data-newer]")
    pause = window.page.get_by_role("button", name="Pause")
    lines.evaluate(MISS_A_LINE)
    expect(newer).to_have_text(re.compile("newer line"))
    seen.scrolled_px = lines.evaluate("list => list.scrollTop")
    newer.click()
    pause.click()
    seen.paused_lines = [lines.evaluate(MISS_A_LINE), lines.evaluate(COUNT_LATER)]
    pause.click()
    expect(lines.locator("li").nth(seen.paused_lines[0])).to_be_visible()


@pytest.fixture(scope="package")
def sequential_run(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/new?clone={batch_run}")
        choose_filter(window, QUICK_FRAMES_PER_S)
        run_id = queue(window, "As frames come down")
        ends_as(window, "SUCCEEDED")
        return run_id


@pytest.fixture(scope="package")
def promoted(people, batch_run):
    with people.seat("analyst") as window:
        set_id = make_set(window, batch_run)
        window.shoot("04-candidate")
        request_id = submit(window, "Lower validation RMS than the ground calibration, on another orbit.")
        window.shoot("05-submitted")
    with people.seat("approver") as window:
        window.open(f"/approvals/{request_id}")
        window.page.get_by_role("button", name="Open the four views").click()
        window.figures_drawn()
        expect(window.page.locator("[data-view] [data-opened]", has_text="not opened")).not_to_have_count(0)
        look_at_views(window)
        expect(window.page.locator("[data-view] [data-opened]", has_text="not opened")).to_have_count(0)
        for reason in window.page.locator("#sign .reason").all():
            reason.fill("Known, and small.")
        expect(window.page.locator("[data-left]")).to_have_text("0 points open")
        window.shoot("06-to-sign", wide=True)
        sign(window, "Approve", get_password("approver"))
        expect(window.page.get_by_role("heading", level=1)).to_contain_text("Approved")
    with people.seat("operator") as window:
        window.open(f"/approvals/{request_id}")
        window.page.locator(".next-act").get_by_role("link", name="Promote").click()
        asked = window.page.get_by_role("dialog")
        asked.get_by_label("Reason").fill("The pass of tonight.")
        asked.get_by_label("Your password").fill(get_password("operator"))
        asked.get_by_role("button", name="Promote").click()
        window.page.wait_for_url(f"**/parameter-sets/{set_id}")
        window.shoot("07-promoted")
    return Promoted(set_id, request_id)


@pytest.fixture(scope="package")
def key(people):
    with people.seat("analyst") as window:
        window.open("/users")
        form = window.page.get_by_role("region", name="Create a key")
        form.get_by_label("Program that uses it").fill("Pass automation")
        form.get_by_role("checkbox", name="runs").check()
        form.get_by_role("button", name="Create the key").click()
        secret = window.page.locator(".secret code").inner_text()
        assert secret.startswith("bs_")
        return secret


@pytest.fixture(scope="package")
def numbers(sensor_id, telemetry, batch_run, sequential_run, promoted):
    return {
        "sensor": sensor_id,
        "set": telemetry["calibration"],
        "batch": batch_run,
        "filter": sequential_run,
        "parameters": promoted.set_id,
        "request": promoted.request_id,
    }
