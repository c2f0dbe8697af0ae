"""The console's pages of a fleet of ten sensors, a thousand and ten thousand: how long each takes, and how long it is.

Each fleet is a store of its own behind `boresight serve` at its default settings. Every sensor has a ground calibration, a set and
runs that have ended. A person asks for each page in turn, and before each time something is committed, so that no answer stands
ready: what is timed is a page made anew. How long the very first page takes is told by itself: the server has just been started,
and its watch judges the drift of every sensor for the first time.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx

from boresight.measurements import Report
from boresight.measurements.full_store import Filled, add_sensors, fill, settings_in
from boresight.measurements.serving import Served, serving
from boresight.services import audit
from boresight.services.actors import SYSTEM
from boresight.store.sessions import open_engine, writing

PAGES = (
    "/", "/sensors", "/sensors?status=standby", "/sensors?sort=-sets", "/sensors/1", "/telemetry", "/runs", "/runs/new",
    "/campaigns/new", "/parameter-sets", "/approvals", "/uplink", "/alarms", "/api/v1/sensors",
)  # fmt: skip


def measure(
    report: Report, *, sensors: tuple[int, ...] = (10, 1_000, 10_000), runs_each: int = 2, looks: int = 5
) -> dict[str, Any]:
    """Measure the pages of fleets.

    Parameters
    ----------
    report
        Told the fraction done and what is measured next.
    sensors
        How many each fleet has.
    runs_each
        Runs of every sensor.
    looks
        How often each page is asked for.
    """
    fleets = {}
    for turn, size in enumerate(sensors):
        report(turn / len(sensors), f"a fleet of {size:,}")
        with tempfile.TemporaryDirectory(prefix="boresight-fleet-", ignore_cleanup_errors=True) as place:
            folder = Path(place)
            filled = fill(folder, runs_each, 1)
            add_sensors(folder, filled, size, runs_each)
            with serving(folder) as served:
                fleets[str(size)] = _looked_at(folder, served, filled, looks)
    return {"sensors": list(sensors), "runs_each": runs_each, "looks": looks, "fleets": fleets, "limits": {}}


def _looked_at(folder: Path, served: Served, filled: Filled, looks: int) -> dict[str, Any]:
    """Ask for every page of one fleet."""
    engine = open_engine(settings_in(folder).database_url)
    address = f"http://127.0.0.1:{served.port}"
    try:
        with httpx.Client(base_url=address, headers=dict(filled.log_ins[0]), timeout=300) as person:
            first_s = _seconds(person, "/")[0]
            pages = {}
            for path in PAGES:
                found = []
                for _ in range(looks):
                    with writing(engine) as session:
                        audit.append(session, SYSTEM, "looked", "sensors", None, None)
                    found.append(_seconds(person, path))
                seconds = [one[0] for one in found]
                pages[path] = {
                    "median_ms": 1e3 * statistics.median(seconds),
                    "longest_ms": 1e3 * max(seconds),
                    "kb": found[-1][1] / 1e3,
                }
    finally:
        engine.dispose()
    return {"first_page_s": first_s, "pages": pages}


def _seconds(person: httpx.Client, path: str) -> tuple[float, int]:
    """Return how long a page took, and its bytes before they are compressed."""
    began_s = time.perf_counter()
    answer = person.get(path).raise_for_status()
    return time.perf_counter() - began_s, len(answer.content)
