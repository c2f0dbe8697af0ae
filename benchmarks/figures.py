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
from playwright.sync_api import sync_playwright
from rich.console import Console
from rich.progress import track
from rich.table import Table

from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.thinning import thinning
from long_runs import PASSWORD, drawn_out, furnish

ENDPOINT_MS, PAYLOAD_BYTES, INTERACTIVE_MS = 100.0, 500_000, 1000.0
PEERS = ("convergence", "rms", "innovations", "methods")
REPEATS, LOOKED_AT_S, READY_POLL_S = 5, 8, 0.1
WATCH = """() => {
    window.watched = { free: null, blocked: 0 };
    new PerformanceObserver(list => { for (const task of list.getEntries()) if (watched.free !== null)
        watched.blocked = Math.max(watched.blocked, task.duration); }).observe({ type: "longtask", buffered: false });
    addEventListener("DOMContentLoaded", () => setTimeout(() => {
        watched.free = performance.now() - performance.getEntriesByType("navigation")[0].responseEnd; }));
}"""


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
        for _ in range(3000):
            try:
                if self.client.get("/healthz").status_code == httpx.codes.OK:
                    break
            except httpx.TransportError:
                time.sleep(READY_POLL_S)
        self.client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).raise_for_status()

    def get(self, path, **headers):
        """The answer, and the milliseconds it took."""
        begun = time.perf_counter()
        answer = self.client.get(path, headers=headers)
        took = 1e3 * (time.perf_counter() - begun)
        assert answer.status_code in {200, 304}, answer.text
        return answer, took

    def cpu_ms(self):
        """The processor time that the server has used so far, in ticks of 10 ms: it does not wait for other programs."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return 1e3 * (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

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
            begun_ms = server.cpu_ms()
            first, first_ms = server.get(path)
            cpu_ms = server.cpu_ms() - begun_ms
            again = statistics.median(server.get(path)[1] for _ in range(REPEATS))
            kept = statistics.median(
                server.get(path, **{"If-None-Match": first.headers["etag"]})[1] for _ in range(REPEATS)
            )
            rows[f"{name} x {runs}"] = {
                "first_ms": first_ms, "first_cpu_ms": cpu_ms, "again_ms": again, "not_modified_ms": kept,
                "bytes": len(first.content),
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
        "median_first_cpu_ms": statistics.median(row["first_cpu_ms"] for row in figures),
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
