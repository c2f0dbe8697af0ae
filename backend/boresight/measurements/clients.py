"""A crowd at the server: 200 clients on the list of runs, and 500 that follow the feed and must miss nothing.

The server is `boresight serve` at its default settings on 10,000 runs; the clients are a process of their own on the same machine.
Each has a credential of its own: half of those that ask the REST API have a log-in, half a key. A closed loop (every client asks
again as soon as it is answered) is harsher than people are: with n clients and a median of t it asks n / t times a second.
The paced crowd asks once a second and client. The last crowds ask while a run is launched every half a second, which the server's
worker computes: what they ask for changes under their hands. How long it takes until each client had its first answer, with
every connection, credential and page still cold, is told by itself.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import httpx
import orjson

from boresight.measurements.feed import measure_feed
from boresight.measurements.full_store import Filled, fill
from boresight.measurements.serving import Served, allow_open_files, serving

LIST = "/api/v1/runs"
PAGE = "/runs"
MEDIAN_LIMIT_MS = 60.0
PACE_S = 1.0
LAUNCH_EVERY_S = 0.5
CROWDS = ("list", "list_unchanged", "list_paced", "page", "page_paced", "list_while_writing", "page_while_writing")


def measure(
    report: Callable[[float, str], None],
    *,
    runs: int = 10_000,
    clients: int = 200,
    seconds: float = 8.0,
    listeners: int = 500,
    changes: int = 150,
) -> dict[str, Any]:
    """Measure the server under a crowd.

    Parameters
    ----------
    runs
        Rows in the list.
    clients
        How many ask at once.
    seconds
        How long each crowd is timed, its warm-up not counted.
    listeners
        How many follow the feed at once.
    changes
        Runs launched and cancelled before them, four events each.
    """
    allow_open_files()
    with tempfile.TemporaryDirectory(prefix="boresight-clients-", ignore_cleanup_errors=True) as place:
        folder = Path(place)
        report(0.0, f"a store of {runs:,} runs")
        filled = fill(folder, runs, clients)
        with serving(folder) as served:
            found = _lists(report, served, filled, seconds)
        report(0.8, f"{listeners} listeners, {4 * changes} events")
        found["feed"] = measure_feed(folder, filled, listeners, changes)
    return {"runs": runs, "clients": clients, "seconds": seconds, **found, "limits": _limits(found)}


def _lists(
    report: Callable[[float, str], None],
    served: Served,
    filled: Filled,
    seconds: float,
) -> dict[str, Any]:
    """Measure the list of runs, for programs and for people."""
    log_ins, half = filled.log_ins, len(filled.keys) // 2
    mixed = [*filled.keys[:half], *log_ins[half:]]
    crowds: dict[str, tuple[str, Sequence[Mapping[str, str]], dict[str, Any]]] = {
        "list": (LIST, mixed, {}),
        "list_unchanged": (LIST, mixed, {"validate": True}),
        "list_paced": (LIST, mixed, {"pause_s": PACE_S}),
        "page": (PAGE, log_ins, {}),
        "page_paced": (PAGE, log_ins, {"pause_s": PACE_S}),
        "list_while_writing": (LIST, mixed, {}),
        "page_while_writing": (PAGE, log_ins, {}),
    }
    found = {}
    for number, (name, (path, headers, others)) in enumerate(crowds.items()):
        report(0.1 + 0.7 * number / len(crowds), f"{len(headers)} clients, {name.replace('_', ' ')}")
        wish = {
            "port": served.port,
            "paths": [path],
            "headers": headers,
            "seconds": seconds,
            "pause_s": 0.0,
            "validate": False,
        }
        before_s = served.processor_s()
        is_written = name.endswith("while_writing")
        writing: AbstractContextManager[list[int]] = _writing(served, filled) if is_written else nullcontext([])
        with writing as launched:
            found[name] = in_a_process("crowd", wish | others)
        if launched:
            found[name]["launches"] = len(launched)
        used_s = served.processor_s() - before_s
        found[name]["server_us_per_request"] = 1e6 * used_s / max(1, found[name]["asked"])
    return found


@contextmanager
def _writing(served: Served, filled: Filled) -> Iterator[list[int]]:
    """Launch a run every half a second, from a thread; yields the numbers of those launched so far."""
    launched, over = list[int](), threading.Event()
    order = {
        "sensor_id": filled.sensor_id,
        "telemetry_set_id": filled.telemetry_set_id,
        "settings": {"method": "batch"},
    }

    def launch() -> None:
        with httpx.Client(
            base_url=f"http://127.0.0.1:{served.port}", headers=dict(filled.keys[0]), timeout=60
        ) as maker:
            while not over.wait(LAUNCH_EVERY_S):
                launched.append(maker.post(LIST, json=order).raise_for_status().json()["id"])

    writer = threading.Thread(target=launch, name="boresight-launches")
    writer.start()
    try:
        yield launched
    finally:
        over.set()
        writer.join()


def in_a_process(module: str, wish: Mapping[str, Any]) -> dict[str, Any]:
    """Let a module of this package do what is wished in a process of its own."""
    words = [sys.executable, "-m", f"boresight.measurements.{module}"]
    done = subprocess.run(words, input=orjson.dumps(wish), stdout=subprocess.PIPE, check=True)  # noqa: S603 - our own words
    answer: dict[str, Any] = orjson.loads(done.stdout)
    return answer


def _limits(found: Mapping[str, Any]) -> dict[str, Any]:
    """Hold what was found against what is promised."""
    failures = sum(found[name]["failures"] for name in CROWDS)
    return {
        "list_median": _at_most(MEDIAN_LIMIT_MS, found["list"]["median_ms"], "ms"),
        "page_median": _at_most(MEDIAN_LIMIT_MS, found["page"]["median_ms"], "ms"),
        "failures": _at_most(0, failures, "requests"),
        "events_lost": _at_most(0, found["feed"]["lost"], "events"),
        "events_twice_or_out_of_order": _at_most(0, found["feed"]["twice"] + found["feed"]["out_of_order"], "events"),
    }


def _at_most(limit: float, measured: float | None, unit: str) -> dict[str, Any]:
    """Hold a figure against a limit; one that there is none of does not keep it."""
    return {"limit": limit, "measured": measured, "kept": measured is not None and measured <= limit, "unit": unit}
