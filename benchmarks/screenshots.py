"""Every picture of pages that the documentation shows, made from the product as it is: `python -m benchmarks.screenshots`.

    overview                        the demonstration, once its fleet is calibrated and something waits
    single-sign-on                  its log-in page, with a stand-in for an identity provider
    message                         what an approver who came by single sign-on was sent by mail, to a stand-in for a mail server
    trace                           a run from the click to the result, as a stand-in for a collector was told of it
    metrics                         panels of `monitoring/dashboard.json`, of what a real Prometheus answers, where one is installed
    first-calibration-proposal      a fresh installation: a sensor proposed from images of a simulated night
    first-calibration-set           the same images as a telemetry set
    first-calibration-run           its calibration

The walk is that of `docs/first-calibration.md`. The night has clouds, trails and hot pixels, and is the same every time. Pictures
go to `docs/`, or to the folder of `--out`; needs Chromium, as the browser tests do.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import click
import httpx
import numpy as np
import plotly.graph_objects as go
from astropy.io import fits
from playwright.sync_api import Page, sync_playwright
from plotly.subplots import make_subplots

from benchmarks.identity_provider import CLIENT_ID, CLIENT_SECRET, providing
from benchmarks.images import HARD, SITE, make_night
from benchmarks.receivers import collecting_spans, receiving_mail
from benchmarks.servers import COMMAND, Service, default_environment, free_port, serving, variables, wait_until
from boresight.settings import read_settings
from boresight.simulation.images import simulate_images
from boresight.sky.catalogue import load_catalogue

DOCS = Path(__file__).parents[1] / "docs"
OVERVIEW, LOG_IN, MESSAGE, TRACE, METRICS = "overview", "single-sign-on", "message", "trace", "metrics"
PROPOSAL, DATA, RUN = (
    "first-calibration-proposal",
    "first-calibration-set",
    "first-calibration-run",
)
NAMES = (OVERVIEW, LOG_IN, MESSAGE, TRACE, METRICS, PROPOSAL, DATA, RUN)
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1280, "height": 800}
FRAMES, PROPOSED_FROM, SEED = 12, 4, 5
PATIENCE_MS = 600_000
SETTLE_MS = 1500
NAME, PASSWORD = "ada", "kestrel over the moor 41"
DASHBOARD = Path(__file__).parents[1] / "monitoring" / "dashboard.json"
PANELS = ("Alarms", "Drift", "Runs that wait or compute", "Runs that end", "Workers", "Time to answer")
CALLBACK = "/login/single-sign-on/callback"


def write_night(folder: Path) -> list[Path]:
    """Write the images of a simulated night as FITS files."""
    catalogue = load_catalogue(read_settings().catalogue_folder)
    files = []
    for image in simulate_images(make_night(FRAMES), HARD, np.random.default_rng(SEED), catalogue):
        header = fits.Header()
        header["DATE-OBS"] = str(image.time_utc - np.timedelta64(250, "ms"))
        header["EXPTIME"], header["EGAIN"] = 0.5, HARD.gain_e_per_dn
        files.append(folder / f"night-{image.frame:02d}.fits")
        fits.writeto(files[-1], image.dn, header)
    return files


@contextmanager
def browsing() -> Iterator[Callable[[], Page]]:
    """Start a browser; yields what opens a page for a person."""
    program = next(filter(None, map(shutil.which, BROWSERS)), "/usr/lib/chromium/chromium-headless-shell")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])

        def open_page() -> Page:
            page = browser.new_context(viewport=SIZE, color_scheme="dark", reduced_motion="reduce").new_page()  # type: ignore[arg-type]  # its own type of a size
            page.set_default_timeout(PATIENCE_MS)
            return page

        yield open_page
        browser.close()


def log_in(page: Page, address: str, name: str, password: str) -> Page:
    """Log in by name and password."""
    page.goto(f"{address}/login")
    page.get_by_label("Name").fill(name)
    page.get_by_label("Password").fill(password)
    page.locator("main button").first.click()
    page.wait_for_url(lambda url: "/login" not in url)
    return page


def shoot_fleet(folder: Path, shoot: Callable[[Page, str], None]) -> None:
    """Take the demonstration, with what a site connects it to: provider, mail, traces, Prometheus."""
    with providing() as provider, receiving_mail() as (mail_port, _), collecting_spans() as (collector, spans):
        port = free_port()
        address = f"http://127.0.0.1:{port}"
        provider.redirect_uri = f"{address}{CALLBACK}"
        provider.person = {"sub": "s-1", "preferred_username": "sam", "name": "Sam Signer", "groups": ["/approvers"]}
        connected = {
            "public_url": address,
            "oidc_issuer": provider.issuer,
            "oidc_client_id": CLIENT_ID,
            "oidc_client_secret": CLIENT_SECRET,
            "oidc_roles": "/approvers=approver",
            "oidc_label": "Log in with the mission's account",
            "mail_server": f"mailto://127.0.0.1:{mail_port}?from=boresight@mission.example&mode=insecure",
            "webhooks_local": 1,
            "otlp_endpoint": collector,
        }
        environment = {**default_environment(), **variables(data_folder=folder / "data", port=port, **connected)}
        demonstration = Service(["demo"], folder, environment)
        try:
            wait_until(lambda: _answers(address))
            with watching(folder, address) as prometheus, browsing() as open_page:
                approver = open_page()
                approver.goto(f"{address}/login")
                shoot(approver, LOG_IN)
                subscribe(approver, address)
                page = log_in(open_page(), address, "analyst", "analyst-of-the-fleet")
                wait_until(lambda: _list(page, "alarms?kind=DRIFT") and _list(page, "approvals?state=OPEN"))
                page.goto(address)
                shoot(page, OVERVIEW)
                run_id = click_a_run(page, address)
                wait_until(
                    lambda: {one.name for one in find_trace(spans, run_id)} >= {"run", "compute", "store result"}
                )
                draw_trace(find_trace(spans, run_id), approver)
                shoot(approver, TRACE)
                if prometheus is not None:
                    draw_metrics(prometheus, approver)
                    shoot(approver, METRICS)
                approver.goto(f"{address}/preferences/messages/1")
                wait_until(lambda: approver.reload() and approver.get_by_text("DELIVERED").count())
                shoot(approver, MESSAGE)
        finally:
            demonstration.stop()


def subscribe(page: Page, address: str) -> None:
    """Come by single sign-on, and be told by mail of what waits for a signature."""
    page.get_by_role("link", name="Log in with the mission's account").click()
    page.wait_for_url(lambda url: "/login" not in url)
    page.goto(f"{address}/preferences/messages")
    page.locator("#address").fill("sam@mission.example")
    for box in page.locator("form [name=kinds]").all():
        box.uncheck()
    page.get_by_label("A request is waiting for my signature").check()
    page.get_by_role("button", name="Add the address").click()
    page.wait_for_load_state("networkidle")


def click_a_run(page: Page, address: str) -> int:
    """Queue a run from its form, and return its number once it has succeeded."""
    page.goto(f"{address}/telemetry/1")
    page.get_by_role("link", name="New run").first.click()
    page.get_by_role("button", name="Queue run").click()
    page.wait_for_url(re.compile(r"/runs/\d+$"))
    number = int(page.url.rpartition("/")[2])
    wait_until(lambda: page.request.get(f"{address}/api/v1/runs/{number}").json()["state"] == "SUCCEEDED")
    return number


def find_trace(spans: Sequence[tuple[str, Any]], run_id: int) -> list[Any]:
    """Return the spans of a run's trace, by the time at which they begin."""
    traces = {
        span.trace_id for _, span in [*spans]
        if any(one.key == "boresight.run_id" and one.value.int_value == run_id for one in span.attributes)
    }  # fmt: skip
    return sorted((span for _, span in [*spans] if span.trace_id in traces), key=lambda one: one.start_time_unix_nano)


def draw_trace(spans: Sequence[Any], page: Page) -> None:
    """Draw the spans as a viewer of traces does: a bar for each, under what it belongs to."""
    begin_ns = spans[0].start_time_unix_nano
    bars = go.Bar(
        y=[f"{place + 1}  {span.name}" for place, span in enumerate(spans)],
        base=[(span.start_time_unix_nano - begin_ns) / 1e9 for span in spans],
        x=[(span.end_time_unix_nano - span.start_time_unix_nano) / 1e9 for span in spans],
        text=[f"{(span.end_time_unix_nano - span.start_time_unix_nano) / 1e6:,.0f} ms" for span in spans],
        orientation="h", textposition="outside", cliponaxis=False,
    )  # fmt: skip
    figure = go.Figure(bars)
    figure.update_yaxes(autorange="reversed", automargin=True)
    figure.update_xaxes(title="seconds since the click", rangemode="tozero")
    _show(figure, f"Trace {spans[0].trace_id.hex()}", page)


@contextmanager
def watching(folder: Path, address: str) -> Iterator[httpx.Client | None]:
    """Have a real Prometheus scrape the server every second, where one is installed."""
    if shutil.which("prometheus") is None:
        click.echo(f"{METRICS}.png is not taken: Prometheus is not installed here.")
        yield None
        return
    target = {"targets": [address.removeprefix("http://")]}
    asked = {"scrape_configs": [{"job_name": "boresight", "scrape_interval": "1s", "static_configs": [target]}]}
    (folder / "prometheus.yml").write_text(json.dumps(asked))
    port = free_port()
    words = [
        f"--web.listen-address=127.0.0.1:{port}",
        f"--config.file={folder}/prometheus.yml",
        f"--storage.tsdb.path={folder}/metrics",
    ]
    service = Service(words, folder, default_environment(), "prometheus.log", command=["prometheus"])
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=30, trust_env=False) as client:
            yield client
    finally:
        service.stop()


def draw_metrics(prometheus: httpx.Client, page: Page) -> None:
    """Draw panels of the dashboard from what Prometheus answers to their expressions."""
    panels = {panel["title"]: panel for panel in json.loads(DASHBOARD.read_text())["panels"] if "targets" in panel}
    figure = make_subplots(rows=3, cols=2, subplot_titles=PANELS, vertical_spacing=0.12)
    end = time.time()
    for place, title in enumerate(PANELS):
        row, column = divmod(place, 2)
        for target in panels[title]["targets"]:
            expression = target["expr"].replace("$__rate_interval", "1m")
            asked = {"query": expression, "start": end - 600, "end": end, "step": 5}
            for series in prometheus.get("/query_range", params=asked).raise_for_status().json()["data"]["result"]:
                times, values = zip(*series["values"], strict=True)
                labels = [one for key, one in series["metric"].items() if key not in {"__name__", "instance", "job"}]
                said = " ".join(labels) or target.get("legendFormat", title)
                figure.add_scatter(
                    x=[datetime.fromtimestamp(one, UTC) for one in times], y=[float(one) for one in values],
                    text=[""] * (len(times) - 1) + [said if float(values[-1]) else ""], mode="lines+text",
                    textposition="bottom left",
                    row=row + 1, col=column + 1,
                )  # fmt: skip
        unit = panels[title].get("fieldConfig", {}).get("defaults", {}).get("unit", "short")
        figure.update_yaxes(title="" if unit in {"short", "none"} else unit, row=row + 1, col=column + 1)
    _show(figure, "monitoring/dashboard.json, drawn from Prometheus", page)


def _show(figure: go.Figure, title: str, page: Page) -> None:
    """Show a figure as the whole page."""
    figure.update_layout(
        title=title, template="plotly_dark", width=SIZE["width"], height=SIZE["height"], showlegend=False, font_size=13
    )
    page.goto("about:blank")
    page.set_content(figure.to_html(include_plotlyjs=True).replace("<body>", '<body style="margin: 0">'))


def _answers(address: str) -> bool:
    with suppress(httpx.TransportError):
        return httpx.get(f"{address}/readyz", timeout=10, trust_env=False).is_success
    return False


def _list(page: Page, noun: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = page.request.get(urljoin(page.url, f"/api/v1/{noun}")).json()["items"]
    return found


def shoot_first_calibration(folder: Path, shoot: Callable[[Page, str], None]) -> None:
    """Walk from images to a calibration on a fresh installation."""
    (folder / "night").mkdir()
    images = write_night(folder / "night")
    environment = {**default_environment(), **variables(data_folder=folder / "data", workers=1)}
    words = [*COMMAND, "user", "add", NAME, "--role", "analyst", "--printed-name", "Ada Analyst", "--password-stdin"]
    subprocess.run(words, input=f"{PASSWORD}\n", env=environment, text=True, check=True, capture_output=True)
    with serving(folder / "data", workers=1) as server, browsing() as open_page:
        page = log_in(open_page(), server.address, NAME, PASSWORD)
        page.goto(f"{server.address}/sensors")
        page.locator("details.stars summary").click()
        form = page.get_by_role("form", name="Propose a sensor from stars")
        form.locator("input[type=file]").set_input_files([str(image) for image in images[:PROPOSED_FROM]])
        form.locator("[name=pixel_pitch_um]").fill("3.75")
        form.get_by_role("button", name="Solve and fill in the form").click()
        page.locator("summary", has_text="On the ground: site and air").click()
        for name, value in SITE.items():
            page.locator(f"#new-{name}").fill(str(value))
        page.get_by_role("button", name="Make the sensor file").click()
        page.wait_for_load_state("networkidle")
        shoot(page, PROPOSAL)
        page.get_by_role("button", name="Register").click()
        page.wait_for_url("**/sensors/1*")
        page.goto(f"{server.address}/telemetry")
        page.locator("#sensor_id").select_option("1")
        page.locator("#file").set_input_files([str(image) for image in images])
        page.get_by_role("button", name="Upload and check").click()
        page.wait_for_url("**/telemetry/1*")
        shoot(page, DATA)
        page.get_by_role("link", name="New run").first.click()
        page.get_by_role("button", name="Queue run").click()
        wait_until(lambda: any(run["state"] == "SUCCEEDED" for run in _list(page, "runs")))
        page.goto(f"{server.address}/runs/1")
        shoot(page, RUN)


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=DOCS, help="Folder of the pictures.")
@click.option("--only", type=click.Choice(NAMES), multiple=True, help="Take these alone; a walk is gone as a whole.")
def main(out: Path, only: tuple[str, ...]) -> None:
    """Take every picture of pages that the documentation shows."""
    wanted = set(only or NAMES)
    out.mkdir(parents=True, exist_ok=True)

    def shoot(page: Page, name: str) -> None:
        if name in wanted:
            page.wait_for_load_state("networkidle")
            page.wait_for_timeout(SETTLE_MS)
            page.evaluate("scrollTo(0, 0)")
            page.screenshot(path=out / f"{name}.png")
            click.echo(f"{name}.png")

    for walk, names in (
        (shoot_first_calibration, {PROPOSAL, DATA, RUN}),
        (shoot_fleet, {OVERVIEW, LOG_IN, MESSAGE, TRACE, METRICS}),
    ):
        if wanted & names:
            with tempfile.TemporaryDirectory() as folder:
                walk(Path(folder), shoot)


if __name__ == "__main__":
    main()
