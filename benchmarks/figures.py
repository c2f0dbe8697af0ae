"""Figures and pages of long runs: time and size of every figure over REST, against the same figure unthinned.

    python -m benchmarks.figures --frames 100000 --runs 200 --overlaid 20 --browser --json figures.json

A simulated set of `--frames` frames is calibrated by the square-root filter. Its result, with noise of each run's own, becomes the
result of `--overlaid` runs in a store of `--runs` runs, and a server of its own is started on it. Every figure is asked for alone
and with all the others over it: *first* has to be read and drawn, *again* comes from what was drawn last, *304* is the answer to a
browser that has it already.

The peer is the same figure unthinned. A result keeps at most 1,000 points of a history, so for the peer the history is drawn out to
one point an update; figure and peer are drawn in turn in this process, and the table has their ratios.

With `--browser` pages are opened in Chromium: *interactive* is from the last byte of the server's answer until a click would be
answered for the first time, *blocked* the longest time in the 8 seconds after that during which one would not be.
"""

from __future__ import annotations

import copy
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np
import orjson
from rich.console import Console
from rich.progress import track

from benchmarks.accuracy import peak_rss_mb
from benchmarks.monte_carlo import make_table
from benchmarks.pages.drawings import chromium
from benchmarks.servers import Server, serving
from benchmarks.stores import fill, opened, settings_in
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.calibration.options import CalibrationSettings
from boresight.cli.output import json_option, write_json
from boresight.console.runs.tables import Run
from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.style.thinning import thinning
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.sensors import sensor_document
from boresight.verdicts.verdict import summarise_run

Rows = dict[str, dict[str, Any]]

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


def with_noise(result: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The result of another run: parameters and their history moved by one sigma's noise."""
    moved = copy.deepcopy(dict(result))
    step = {name: rng.normal() * (sigma or 0.0) for name, sigma in result["sigma"].items()}
    moved["parameters"] = {name: value + step[name] for name, value in result["parameters"].items()}
    moved["history"]["parameters"] = (np.array(result["history"]["parameters"]) + np.array([*step.values()])).tolist()
    for key in ("tail_rms_rad", "aggregate_rms_rad"):
        values = np.array(result["history"][key], dtype=float)
        moved["history"][key] = (values * (1 + 1e-3 * rng.normal(size=len(values)))).tolist()
    return moved


def drawn_out(result: Mapping[str, Any], updates: int, rng: np.random.Generator) -> dict[str, Any]:
    """The result with a history of so many updates, between its own points."""
    history = result["history"]
    place = np.linspace(0, len(history["frame"]) - 1, updates)
    near = place.astype(int)
    long = {key: np.array(values, dtype=float)[near] for key, values in history.items() if key != "time_utc" and values}
    long["frame"] = np.interp(place, np.arange(len(history["frame"])), history["frame"])
    long["nis"] = rng.chisquare(long["nis_dof"])
    series = result["trust"]["nis_over_time"]
    values = {key: [series[key][0]] * updates for key in ("lower", "upper")}
    values |= {"frame": long["frame"].tolist(), "nis_per_dof": (long["nis"] / long["nis_dof"]).tolist()}
    return {
        **result,
        "history": {key: found.tolist() for key, found in long.items()} | {"time_utc": None},
        "trust": {**result["trust"], "nis_over_time": {**series, **values}},
    }


def furnish(folder: Path, frames: int, runs: int, overlaid: int) -> tuple[dict[str, Any], Mapping[str, str]]:
    """Make a store of one real calibration and as many runs like it; returns the result that all come from, and a log-in."""
    scenario, settings = (
        replace(calibration_scenario(1), frames=frames),
        CalibrationSettings(method="sqrf", match="given"),
    )
    catalogue = load_catalogue(settings_in(folder).catalogue_folder)
    document = calibrate(simulate(scenario, np.random.default_rng(1), catalogue), scenario.sensor, catalogue, settings)
    result: dict[str, Any] = document.to_dict()
    blobs, rng, now = open_blobs(settings_in(folder).blob_location), np.random.default_rng(2), utc_now()
    results = [with_noise(result, rng) for _ in range(overlaid)]
    addresses = [blobs.put(orjson.dumps(one)) for one in results]
    filled = fill(folder, 0, 1)
    with opened(folder) as engine, open_writing(engine) as session:
        for sha256 in addresses:
            register_blob(session, blobs, sha256, "application/json")
        session.add_all(
            Run(
                sensor_id=filled.sensor_id, telemetry_set_id=filled.telemetry_set_id, method="sqrf", settings=settings.document(),
                sensor_document=sensor_document(scenario.sensor), label=f"run {number + 1}", state="SUCCEEDED", launched_utc=now,
                started_utc=now, ended_utc=now, result_sha256=addresses[number % overlaid],
                summary=to_plain(summarise_run(parse_calibration(results[number % overlaid]))),
            )
            for number in range(runs)
        )  # fmt: skip
        audit.append(session, SYSTEM, "imported", "runs", None, {"runs": runs})
    return result, filled.log_ins[0]


def endpoints(server: Server, client: httpx.Client, overlaid: int) -> Rows:
    """Time and size of every figure, alone and overlaid."""

    def asked(path: str, headers: Mapping[str, str] | None = None) -> tuple[httpx.Response, float]:
        begun = time.perf_counter()
        answer = client.get(path, headers=headers)
        took = 1e3 * (time.perf_counter() - begun)
        if answer.status_code not in {httpx.codes.OK, httpx.codes.NOT_MODIFIED}:
            answer.raise_for_status()
        return answer, took

    rows: Rows = {}
    for runs, query in ((1, ""), (overlaid, f"?compare={','.join(map(str, range(2, overlaid + 1)))}")):
        for name in track(FIGURES, f"{runs} runs", console=Console(stderr=True)):
            path = f"/api/v1/runs/1/figures/{name}{query}"
            begun_s = server.processor_s()
            first, first_ms = asked(path)
            cpu_ms, known = 1e3 * (server.processor_s() - begun_s), {"If-None-Match": first.headers["etag"]}
            again, kept = (statistics.median(asked(path, one)[1] for _ in range(REPEATS)) for one in (None, known))
            rows[f"{name} x {runs}"] = {
                "first_ms": first_ms, "first_cpu_ms": cpu_ms, "again_ms": again, "not_modified_ms": kept,
                "bytes": len(first.content),
            }  # fmt: skip
    return rows


def peers(result: Mapping[str, Any], frames: int, overlaid: int) -> Rows:
    """Ratios of the same figures unthinned over thinned, both drawn here in turn from one point an update."""
    rows: Rows = {}
    rng = np.random.default_rng(3)
    for runs, updates in ((1, frames), (overlaid, frames // overlaid)):
        traces = [Trace(f"Run {k}", parse_calibration(drawn_out(result, updates, rng))) for k in range(runs)]
        for name in track(PEERS, f"unthinned, {runs} runs", console=Console(stderr=True)):
            times: dict[bool, list[float]] = {True: [], False: []}
            sizes: dict[bool, int] = {}
            for _ in range(3):
                for whole, taken in times.items():
                    begun = time.perf_counter()
                    with thinning(whole=whole):
                        sizes[whole] = len(figure_json(FIGURES[name].draw(traces)))
                    taken.append(1e3 * (time.perf_counter() - begun))
            thinned, unthinned = min(times[False]), min(times[True])
            rows[f"{name} x {runs}"] = {
                "updates": updates, "ms": thinned, "unthinned_ms": unthinned, "time_ratio": unthinned / thinned,
                "bytes": sizes[False], "unthinned_bytes": sizes[True], "size_ratio": sizes[True] / sizes[False],
            }  # fmt: skip
    return rows


def pages(client: httpx.Client, overlaid: int) -> Rows:
    """Milliseconds until each page answers a click, and the longest time that it then does not."""
    compare = f"/compare?runs={','.join(map(str, range(1, overlaid + 1)))}"
    named = {
        "overview": "/", "runs": "/runs", "run": "/runs/1", "convergence": "/runs/1?part=convergence", "compare": compare,
        "compare, band": f"{compare}&overlay=band", "compare, tables": f"{compare}&overlay=table",
    }  # fmt: skip
    rows: Rows = {}
    with chromium() as browser:
        context = browser.new_context(base_url=str(client.base_url), viewport={"width": 1280, "height": 800})
        context.add_init_script(f"({WATCH})()")
        name, _, value = client.headers["Cookie"].partition("=")
        context.add_cookies([{"name": name, "value": value, "url": str(client.base_url)}])
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
    return rows


def show(title: str, rows: Rows) -> Rows:
    """Print a table of measured numbers, and return them."""
    table = make_table(title, "what", *next(iter(rows.values())))
    for name, row in rows.items():
        table.add_row(name, *(f"{value:,.1f}" if isinstance(value, float) else f"{value:,}" for value in row.values()))
    Console(width=160, stderr=True).print(table)
    return rows


def judged(report: Mapping[str, Any]) -> dict[str, Any]:
    """Whether each promise is kept, in numbers."""
    figures = report["endpoints"].values()
    found: dict[str, Any] = {
        f"median_{key}": statistics.median(row[key] for row in figures)
        for key in ("first_ms", "first_cpu_ms", "again_ms")
    }
    found["largest_bytes"] = max(row["bytes"] for row in figures)
    kept = found["median_first_ms"] < ENDPOINT_MS and found["largest_bytes"] < PAYLOAD_BYTES
    if report["pages"]:
        found["slowest_interactive_ms"] = max(row["interactive_ms"] for row in report["pages"].values())
        kept = kept and found["slowest_interactive_ms"] < INTERACTIVE_MS
    return {**found, "kept": kept}


@click.command(help=__doc__)
@click.option("--frames", default=100_000)
@click.option("--runs", default=200)
@click.option("--overlaid", default=20)
@click.option("--browser", is_flag=True, help="Open pages in Chromium too.")
@json_option
def main(*, frames: int, runs: int, overlaid: int, browser: bool, json_file: str | None) -> None:
    """Make the store, measure, print, and write the JSON."""
    report: dict[str, Any] = {"frames": frames, "runs": runs, "overlaid": overlaid}
    with tempfile.TemporaryDirectory() as name:
        result, log_in = furnish(Path(name), frames, runs, overlaid)
        with serving(Path(name), workers=0, mode="SIM") as server:
            headers = {"Accept-Encoding": "gzip", **log_in}
            with httpx.Client(base_url=server.address, timeout=120, headers=headers) as client:
                report["endpoints"] = show("Figures over REST", endpoints(server, client, overlaid))
                report["pages"] = show("Pages", pages(client, overlaid)) if browser else {}
            report["server_peak_mb"] = peak_rss_mb(server.pid)
    report["peers"] = show("Unthinned over thinned", peers(result, frames, overlaid))
    report["judged"] = judged(report)
    write_json(report, json_file or "-")
    sys.exit(not report["judged"]["kept"])


if __name__ == "__main__":
    main()
