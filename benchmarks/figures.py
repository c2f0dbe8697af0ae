"""Figures and pages of long runs: time and size of every figure over REST, against the same figure unthinned.

    python benchmarks/figures.py --frames 100000 --runs 200 --overlaid 20 --browser --json figures.json

A simulated set of `--frames` frames is calibrated by the square-root filter. Its result, with noise of each run's own, becomes the
result of `--overlaid` runs in a store of `--runs` runs, and a server of its own is started on it. Every figure is asked for alone
and with all the others over it: *first* has to be read and drawn, *again* comes from what was drawn last, *304* is the answer to a
browser that has it already.

The peer is the same figure unthinned. A result keeps at most 1,000 points of a history, so for the peer the history is drawn out to
one point an update; figure and peer are drawn in turn in this process, and the table has their ratios.

With `--browser` pages are opened in Chromium: *interactive* is from the last byte of the server's answer until a click would be
answered for the first time, *blocked* the longest time in the
8 seconds after that during which one would not be, while figures are drawn.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np
import orjson
from playwright.sync_api import sync_playwright
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.calibration.calibrate import calibrate
from boresight.calibration.settings import CalibrationSettings
from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.thinning import thinning
from boresight.services import parameter_sets, users
from boresight.services.actors import COMMAND_LINE
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.store.blobs import BlobStore, register_blob
from boresight.store.sessions import migrate, open_engine, utc_now, writing
from boresight.store.tables import Run, Sensor, TelemetrySet
from boresight.telemetry.sensors import sensor_document
from boresight.workers.summary import summary_of

PASSWORD = "a password of the benchmark"  # noqa: S105 - of a store that lives as long as this program
ENDPOINT_MS, PAYLOAD_BYTES, INTERACTIVE_MS = 100.0, 500_000, 1000.0
PEERS = ("convergence", "rms", "innovations", "methods")
REPEATS, LOOKED_AT_S = 5, 8
WATCH = """() => {
    window.watched = { free: null, blocked: 0 };
    new PerformanceObserver(list => { for (const task of list.getEntries()) if (watched.free !== null)
        watched.blocked = Math.max(watched.blocked, task.duration); }).observe({ type: "longtask", buffered: false });
    addEventListener("DOMContentLoaded", () => setTimeout(() => {
        watched.free = performance.now() - performance.getEntriesByType("navigation")[0].responseEnd; }));
}"""


def with_noise(result, rng):
    """The result of another run: parameters and their history moved by one sigma's noise."""
    moved = copy.deepcopy(result)
    step = {name: rng.normal() * (sigma or 0.0) for name, sigma in result["sigma"].items()}
    moved["parameters"] = {name: value + step[name] for name, value in result["parameters"].items()}
    steps = np.array(list(step.values()))
    moved["history"]["parameters"] = (np.array(result["history"]["parameters"]) + steps).tolist()
    for key in ("tail_rms_rad", "aggregate_rms_rad"):
        values = np.array(result["history"][key], dtype=float)
        moved["history"][key] = (values * (1 + 1e-3 * rng.normal(size=len(values)))).tolist()
    return moved


def drawn_out(result, updates, rng):
    """The result with a history of so many updates, between its own points."""
    whole, history = dict(result), result["history"]
    place = np.linspace(0, len(history["frame"]) - 1, updates)
    near = place.astype(int)
    long = {key: np.array(values, dtype=float)[near] for key, values in history.items() if key != "time_utc" and values}
    long["frame"] = np.interp(place, np.arange(len(history["frame"])), history["frame"])
    long["nis"] = rng.chisquare(long["nis_dof"])
    whole["history"] = {key: values.tolist() for key, values in long.items()} | {"time_utc": None}
    series = result["trust"]["nis_over_time"]
    bounds = {key: [series[key][0]] * updates for key in ("lower", "upper")}
    values = {"frame": long["frame"].tolist(), "nis_per_dof": (long["nis"] / long["nis_dof"]).tolist(), **bounds}
    whole["trust"] = {**result["trust"], "nis_over_time": {**series, **values}}
    return whole


def calibrated(scenario, settings, folder, options):
    """The calibration of a simulated set, or the one that was given."""
    if options.calibration:
        return orjson.loads(options.calibration.read_bytes())
    catalogue, frames = load_catalogue(folder / "catalogue"), {**vars(scenario), "frames": options.frames}
    telemetry = simulate(type(scenario)(**frames), np.random.default_rng(1), catalogue)
    document = calibrate(telemetry, scenario.sensor, catalogue, settings)
    return orjson.loads(orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY))


def furnish(folder, options):
    """Make the store; returns the result that all runs come from."""
    scenario, settings = calibration_scenario(1), CalibrationSettings(method="sqrf", match="given")
    result = calibrated(scenario, settings, folder, options)
    engine, blobs, rng = (
        open_engine(f"sqlite:///{folder / 'data' / 'boresight.sqlite3'}"),
        BlobStore(folder / "data" / "blobs"),
        np.random.default_rng(2),
    )
    migrate(engine)
    results = [with_noise(result, rng) for _ in range(options.overlaid)]
    with writing(engine) as session:
        users.create_user(session, COMMAND_LINE, name="ada", printed_name="Ada", password=PASSWORD, roles=("analyst",))
        sensor = Sensor(
            name=scenario.sensor.name, document=sensor_document(scenario.sensor), created_utc=utc_now(), simulated=1
        )
        session.add(sensor)
        session.flush()
        parameter_sets.create_ground_calibration(session, COMMAND_LINE, sensor, scenario.sensor)
        table = blobs.put(b"the table itself is not needed")
        register_blob(session, blobs, table, "application/octet-stream")
        made = TelemetrySet(
            sensor_id=sensor.id, name="TS-1", purpose="calibration", original_sha256=table, table_sha256=table,
            frames=options.frames, stars=result["stars"], quality={"exposures": result["exposures"], "warnings": []},
            uploaded_utc=utc_now(),
        )  # fmt: skip
        session.add(made)
        session.flush()
        addresses = [blobs.put(orjson.dumps(one)) for one in results]
        for sha256 in addresses:
            register_blob(session, blobs, sha256, "application/json")
        for number in range(options.runs):
            place = number % options.overlaid
            session.add(
                Run(
                    sensor_id=sensor.id,
                    telemetry_set_id=made.id,
                    method="sqrf",
                    settings=settings.document(),
                    sensor_document=sensor.document,
                    label=f"run {number + 1}",
                    state="SUCCEEDED",
                    launched_utc=utc_now(),
                    started_utc=utc_now(),
                    ended_utc=utc_now(),
                    launched_by=1,
                    result_sha256=addresses[place],
                    summary=summary_of(results[place]),
                )
            )
    engine.dispose()
    return result


class Server:
    """A server of its own on the store."""

    def __init__(self, folder):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        named = {"DATA_FOLDER": str(folder / "data"), "PORT": str(port), "WORKERS": "0", "MODE": "SIM"}
        environment = os.environ | {f"BORESIGHT_{name}": value for name, value in named.items()}
        self.address = f"http://127.0.0.1:{port}"
        self.process = subprocess.Popen([sys.executable, "-m", "boresight", "serve"], env=environment)
        self.client = httpx.Client(base_url=self.address, timeout=120, headers={"Accept-Encoding": "gzip"})
        for _ in range(600):
            try:
                if self.client.get("/healthz").status_code == httpx.codes.OK:
                    break
            except httpx.TransportError:
                time.sleep(0.1)
        self.client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()

    def get(self, path, **headers):
        """The answer, and the milliseconds it took."""
        begun = time.perf_counter()
        answer = self.client.get(path, headers=headers)
        took = 1e3 * (time.perf_counter() - begun)
        assert answer.status_code in {200, 304}, answer.text
        return answer, took

    def memory_mb(self):
        """The most memory the server has held so far."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1e3

    def stop(self):
        """End it."""
        self.process.terminate()
        self.process.wait(30)


def endpoints(server, options):
    """Time and size of every figure, alone and overlaid."""
    others = ",".join(str(number) for number in range(2, options.overlaid + 1))
    rows = {}
    for runs, query in ((1, ""), (options.overlaid, f"?compare={others}")):
        for name in track(FIGURES, f"{runs} runs", console=Console(stderr=True)):
            path = f"/api/v1/runs/1/figures/{name}{query}"
            first, first_ms = server.get(path)
            again = statistics.median(server.get(path)[1] for _ in range(REPEATS))
            kept = statistics.median(
                server.get(path, **{"If-None-Match": first.headers["etag"]})[1] for _ in range(REPEATS)
            )
            rows[f"{name} x {runs}"] = {
                "first_ms": first_ms, "again_ms": again, "not_modified_ms": kept, "bytes": len(first.content),
            }  # fmt: skip
    return rows


def peers(result, options):
    """Ratios of the same figures unthinned over thinned, both drawn here in turn from one point an update."""
    rows, rng = {}, np.random.default_rng(3)
    for runs, updates in ((1, options.frames), (options.overlaid, options.frames // options.overlaid)):
        traces = [Trace(f"Run {k}", drawn_out(result, updates, rng)) for k in range(runs)]
        for name in track(PEERS, f"unthinned, {runs} runs", console=Console(stderr=True)):
            times, sizes = {True: [], False: []}, {}
            for _ in range(3):
                for whole in (False, True):
                    begun = time.perf_counter()
                    with thinning(whole=whole):
                        sizes[whole] = len(figure_json(FIGURES[name].draw(traces)))
                    times[whole].append(1e3 * (time.perf_counter() - begun))
            thinned, unthinned = min(times[False]), min(times[True])
            rows[f"{name} x {runs}"] = {
                "updates": updates, "ms": thinned, "unthinned_ms": unthinned, "time_ratio": unthinned / thinned,
                "bytes": sizes[False], "unthinned_bytes": sizes[True], "size_ratio": sizes[True] / sizes[False],
            }  # fmt: skip
    return rows


def pages(server, options):
    """Milliseconds until each page answers a click, and the longest time that it then does not."""
    chosen = ",".join(str(number) for number in range(1, options.overlaid + 1))
    named = {
        "overview": "/", "runs": "/runs", "run": "/runs/1", "convergence": "/runs/1?part=convergence",
        "compare": f"/compare?runs={chosen}", "compare, band": f"/compare?runs={chosen}&overlay=band",
        "compare, tables": f"/compare?runs={chosen}&overlay=table",
    }  # fmt: skip
    rows, chromium = {}, next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        context = browser.new_context(base_url=server.address, viewport={"width": 1280, "height": 800})
        context.add_init_script(f"({WATCH})()")
        cookies = [{"name": c.name, "value": c.value, "url": server.address} for c in server.client.cookies.jar]
        context.add_cookies(cookies)
        for name, address in named.items():
            page = context.new_page()
            page.goto(address, wait_until="domcontentloaded")
            page.wait_for_function("() => watched.free !== null")
            page.wait_for_timeout(1e3 * LOOKED_AT_S)
            entry = "performance.getEntriesByType('navigation')[0]"
            rows[name] = {
                "server_ms": page.evaluate(f"{entry}.responseEnd - {entry}.requestStart"),
                "interactive_ms": page.evaluate("watched.free"),
                "blocked_ms": page.evaluate("watched.blocked"),
            }
            page.close()
        browser.close()
    return rows


def show(title, rows):
    """Print a table of measured numbers, and return them."""
    table = Table(title=title)
    keys = list(next(iter(rows.values())))
    for column in ("what", *keys):
        table.add_column(column, justify="left" if column == "what" else "right")
    for name, row in rows.items():
        table.add_row(name, *(f"{row[key]:,.1f}" if isinstance(row[key], float) else f"{row[key]:,}" for key in keys))
    Console(width=160).print(table)
    return rows


def judged(report):
    """Whether each promise is kept, in numbers."""
    figures = report["endpoints"].values()
    found = {
        "median_first_ms": statistics.median(row["first_ms"] for row in figures),
        "median_again_ms": statistics.median(row["again_ms"] for row in figures),
        "largest_bytes": max(row["bytes"] for row in figures),
    }
    kept = found["median_first_ms"] < ENDPOINT_MS and found["largest_bytes"] < PAYLOAD_BYTES
    if report["pages"]:
        found["slowest_interactive_ms"] = max(row["interactive_ms"] for row in report["pages"].values())
        kept = kept and found["slowest_interactive_ms"] < INTERACTIVE_MS
    return {**found, "kept": kept}


def main(arguments=None):
    """Make the store, measure, print, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--overlaid", type=int, default=20)
    parser.add_argument(
        "--calibration", type=Path, help="JSON of boresight calibrate --method sqrf, in place of making one"
    )
    parser.add_argument("--browser", action="store_true", help="open pages in Chromium too")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        result = furnish(folder, options)
        server = Server(folder)
        try:
            report = {"frames": options.frames, "runs": options.runs, "overlaid": options.overlaid}
            report["endpoints"] = show("Figures over REST", endpoints(server, options))
            report["pages"] = show("Pages", pages(server, options)) if options.browser else {}
            report["server_peak_mb"] = server.memory_mb()
        finally:
            server.stop()
        report["peers"] = show("Unthinned over thinned", peers(result, options))
    report["judged"] = judged(report)
    Console(width=160).print(report["judged"], f"server at most {report['server_peak_mb']:.0f} MB")
    if options.json:
        options.json.write_text(json.dumps(report, indent=2))
    return 0 if report["judged"]["kept"] else 1


if __name__ == "__main__":
    sys.exit(main())
