"""Every picture of pages that the documentation shows, made from the product as it is: `python -m benchmarks.screenshots`.

    overview                        the demonstration, once its fleet is calibrated and something waits
    first-calibration-proposal      a fresh installation: a sensor proposed from images of a simulated night
    first-calibration-set           the same images as a telemetry set
    first-calibration-run           its calibration

The walk is that of `docs/first-calibration.md`. The night has clouds, trails and hot pixels, and is the same every time. Pictures
go to `docs/`, or to the folder of `--out`; needs Chromium, as the browser tests do.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import click
import httpx
import numpy as np
from astropy.io import fits
from playwright.sync_api import Page, sync_playwright

from benchmarks.images import HARD, SITE, make_night
from benchmarks.servers import COMMAND, Service, default_environment, free_port, serving, variables, wait_until
from boresight.settings import read_settings
from boresight.simulation.images import simulate_images
from boresight.sky.catalogue import load_catalogue

DOCS = Path(__file__).parents[1] / "docs"
OVERVIEW, PROPOSAL, DATA, RUN = (
    "overview",
    "first-calibration-proposal",
    "first-calibration-set",
    "first-calibration-run",
)
NAMES = (OVERVIEW, PROPOSAL, DATA, RUN)
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1280, "height": 800}
FRAMES, PROPOSED_FROM, SEED = 12, 4, 5
PATIENCE_MS = 600_000
SETTLE_MS = 1500
NAME, PASSWORD = "ada", "kestrel over the moor 41"


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
def seat(address: str, name: str, password: str) -> Iterator[Page]:
    """Open a browser and log in."""
    program = next(filter(None, map(shutil.which, BROWSERS)), "/usr/lib/chromium/chromium-headless-shell")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_context(viewport=SIZE, color_scheme="dark", reduced_motion="reduce").new_page()  # type: ignore[arg-type]  # its own type of a size
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{address}/login")
        page.get_by_label("Name").fill(name)
        page.get_by_label("Password").fill(password)
        page.locator("main button").first.click()
        page.wait_for_url(lambda url: "/login" not in url)
        yield page
        browser.close()


def shoot_fleet(folder: Path, shoot: Callable[[Page, str], None]) -> None:
    """Take the overview of the demonstration once a set waits for a signature and the drift has raised its alarm."""
    environment = {**default_environment(), **variables(data_folder=folder, port=free_port())}
    address = f"http://127.0.0.1:{environment['BORESIGHT_PORT']}"
    demonstration = Service(["demo"], folder, environment)
    try:
        wait_until(lambda: _answers(address))
        with seat(address, "analyst", "analyst-of-the-fleet") as page:
            wait_until(lambda: _list(page, "alarms?kind=DRIFT") and _list(page, "approvals?state=OPEN"))
            page.goto(address)
            shoot(page, OVERVIEW)
    finally:
        demonstration.stop()


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
    with serving(folder / "data", workers=1) as server, seat(server.address, NAME, PASSWORD) as page:
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

    for walk, names in ((shoot_first_calibration, {PROPOSAL, DATA, RUN}), (shoot_fleet, {OVERVIEW})):
        if wanted & names:
            with tempfile.TemporaryDirectory() as folder:
                walk(Path(folder), shoot)


if __name__ == "__main__":
    main()
