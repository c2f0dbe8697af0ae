"""A crowd at the server, listeners that must miss nothing, and the pages of large fleets (parts `clients` and `fleet`).

**Clients.** The server is `boresight serve` at its default settings on 10,000 runs; the clients are a process of their own on the
same machine (`crowd`). Each has a credential of its own: half of those that ask the REST API have a log-in, half a key. A closed
loop (every client asks again as soon as it is answered) is harsher than people are: with n clients and a median of t it asks n / t
times a second. The paced crowd asks once a second and client. The last crowds ask while a run is launched every half a second,
which the server's worker computes: what they ask for changes under their hands. How long it takes until each client had its first
answer, with every connection, credential and page still cold, is told by itself.

**Feed.** Nothing computes behind the server, so that what happens is what the measurement does: it launches runs over the REST API
and cancels them again, which writes two lines of a log and two audit records for each. One listener in ten follows one run only,
one in ten leaves over and over and comes back with `Last-Event-ID`. What there was to hear is read from the store.

**Fleet.** Each fleet is a store of its own. Every sensor has a ground calibration, a set and runs that have ended. A person asks
for each page in turn, and before each time something is committed, so that no answer is cached: what is timed is a page made
again. How long the very first page takes is told by itself: the server has just been started, and its watch judges the drift of
every sensor.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import httpx
import orjson

from benchmarks import ROOT, Report, held
from benchmarks.servers import Server, allow_open_files, serving
from benchmarks.stores import Filled, add_sensors, fill, opened
from boresight.console import list_queries as lists
from boresight.console.runs import queries as run_events
from boresight.platform.actors import SYSTEM
from boresight.platform.audit.log import append
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Engine, open_reading, open_writing

LIST, PAGE, FEED = "/api/v1/runs", "/runs", "/api/v1/events"
MEDIAN_LIMIT_MS = 60.0
PACE_S = 1.0
LAUNCH_EVERY_S = 0.5
CROWDS: dict[str, tuple[str, dict[str, Any]]] = {
    "list": (LIST, {}),
    "list_unchanged": (LIST, {"validate": True}),
    "list_paced": (LIST, {"pause_s": PACE_S}),
    "page": (PAGE, {}),
    "page_paced": (PAGE, {"pause_s": PACE_S}),
    "list_while_writing": (LIST, {}),
    "page_while_writing": (PAGE, {}),
}
WAIT_S = 60.0
ONE_IN = 10
LEAVES_AFTER = 37  # events
FLEET_PAGES = (
    "/", "/sensors", "/sensors?status=standby", "/sensors?sort=-sets", "/sensors/1", "/telemetry", "/runs", "/runs/new",
    "/campaigns/new", "/parameter-sets", "/approvals", "/uplink", "/alarms", "/api/v1/sensors",
)  # fmt: skip


def measure(
    report: Report,
    *,
    runs: int = 10_000,
    clients: int = 200,
    seconds: float = 8.0,
    listeners: int = 500,
    changes: int = 150,
) -> dict[str, Any]:
    """Let each crowd of clients ask for so long before a list of so many runs, then let listeners follow the feed.

    `changes` runs are launched and cancelled before the listeners, four events each.
    """
    allow_open_files()
    found: dict[str, Any] = {"runs": runs, "clients": clients, "seconds": seconds}
    with tempfile.TemporaryDirectory(prefix="boresight-clients-", ignore_cleanup_errors=True) as place:
        folder = Path(place)
        report(0.0, f"a store of {runs:,} runs")
        filled = fill(folder, runs, clients)
        with serving(folder) as server:
            for number, name in enumerate(CROWDS):
                report(0.1 + 0.7 * number / len(CROWDS), f"{clients} clients, {name.replace('_', ' ')}")
                found[name] = _asked(name, server, filled, seconds)
        report(0.8, f"{listeners} listeners, {4 * changes} events")
        with serving(folder, workers=0) as server, opened(folder) as engine, _client(server, filled.keys[0]) as maker:
            feed = found["feed"] = _heard(server.port, maker, engine, filled, listeners, changes)
    failures = sum(found[name]["failures"] for name in CROWDS)
    return found | {
        "limits": {
            "list_median": held(MEDIAN_LIMIT_MS, found["list"]["median_ms"], "ms"),
            "page_median": held(MEDIAN_LIMIT_MS, found["page"]["median_ms"], "ms"),
            "failures": held(0, failures, "requests"),
            "events_lost": held(0, feed["lost"], "events"),
            "events_twice_or_out_of_order": held(0, feed["twice"] + feed["out_of_order"], "events"),
        }
    }


def _client(server: Server, headers: Mapping[str, str], timeout_s: float = 60.0) -> httpx.Client:
    return httpx.Client(base_url=server.address, headers=dict(headers), timeout=timeout_s)


def _process(act: str) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "benchmarks.crowd", act]
    return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT)


def _tell(process: subprocess.Popen[bytes], document: Mapping[str, Any]) -> dict[str, Any]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(orjson.dumps(document) + b"\n")
    process.stdin.flush()
    answer: dict[str, Any] = orjson.loads(process.stdout.readline())
    return answer


def _asked(name: str, server: Server, filled: Filled, seconds: float) -> dict[str, Any]:
    """Let one crowd ask for the list of runs, as programs or as people."""
    (path, others), half = CROWDS[name], len(filled.keys) // 2
    headers = filled.log_ins if path == PAGE else [*filled.keys[:half], *filled.log_ins[half:]]
    wish = {
        "port": server.port,
        "paths": [path],
        "headers": headers,
        "seconds": seconds,
        "pause_s": 0.0,
        "validate": False,
    }
    is_written = name.endswith("while_writing")
    writer: AbstractContextManager[list[int]] = _writing(server, filled) if is_written else nullcontext([])
    before_s = server.processor_s()
    with writer as launched, _process("ask") as crowd:
        found = _tell(crowd, wish | others)
    found |= {"launches": len(launched)} if launched else {}
    used_s = server.processor_s() - before_s
    return found | {"server_us_per_request": 1e6 * used_s / max(1, found["asked"])}


@contextmanager
def _writing(server: Server, filled: Filled) -> Iterator[list[int]]:
    """Launch a run every half a second, from a thread; yields the numbers of those launched so far."""
    launched, over = list[int](), threading.Event()

    def launch() -> None:
        with _client(server, filled.keys[0]) as maker:
            while not over.wait(LAUNCH_EVERY_S):
                launched.append(maker.post(LIST, json=filled.order).raise_for_status().json()["id"])

    writer = threading.Thread(target=launch, name="boresight-launches")
    writer.start()
    try:
        yield launched
    finally:
        over.set()
        writer.join()


def _heard(port: int, maker: httpx.Client, engine: Engine, filled: Filled, listeners: int, runs: int) -> dict[str, Any]:
    """Let runs be launched and cancelled before an audience, and ask it what it heard."""
    credentials, launched = [*filled.keys, *filled.log_ins], [maker.post(LIST, json=filled.order).raise_for_status()]
    followed = launched[0].json()["id"]
    audience = [
        {
            "path": f"{FEED}?run={followed}" if number % ONE_IN == 1 else FEED,
            "headers": credentials[number % len(credentials)],
            "group": int(number % ONE_IN == 1),
            "leaves": LEAVES_AFTER if number % ONE_IN == 0 else 0,
        }
        for number in range(listeners)
    ]
    with _process("listen") as heard:
        listening = _tell(heard, {"port": port, "listeners": audience})
        with open_reading(engine) as session:
            newest = lists.list_newest(session, AuditRecord, limit=1)[0].id
            before = run_events.read_newest_event_id(session), newest
        began_s = time.perf_counter()
        for number in range(runs + 1):
            run = launched[0] if number == 0 else maker.post(LIST, json=filled.order).raise_for_status()
            cancel = f"{LIST}/{run.json()['id']}:cancel"
            maker.post(cancel, headers={"If-Match": run.headers["ETag"]}).raise_for_status()
        took_s = time.perf_counter() - began_s
        groups = [_happened(engine, before, None), _happened(engine, before, followed)]
        found = _tell(heard, {"groups": groups, "wait_s": WAIT_S})
    events = sum(map(len, groups[0].values()))
    return {"listeners": listeners, "events": events, "events_per_s": events / took_s, **listening, **found}


def _happened(engine: Engine, before: tuple[int, int], run_id: int | None) -> dict[str, Sequence[int]]:
    """Return the numbers of everything since, or of what concerns one run."""
    with open_reading(engine) as session:
        lines = run_events.list_events_after(session, before[0], limit=1_000_000)
        records = lists.list_newest(session, AuditRecord, object=None if run_id is None else f"runs/{run_id}")
        return {
            "run": [line.id for line in lines if run_id in {None, line.run_id}],
            "audit": [record.id for record in reversed(records) if record.id > before[1]],
        }


def measure_fleet(
    report: Report, *, sensors: tuple[int, ...] = (10, 1_000, 10_000), runs_each: int = 2, looks: int = 5
) -> dict[str, Any]:
    """Measure the pages of fleets of so many sensors, each page looked at so often."""
    fleets: dict[str, Any] = {}
    for turn, size in enumerate(sensors):
        report(turn / len(sensors), f"a fleet of {size:,}")
        with tempfile.TemporaryDirectory(prefix="boresight-fleet-", ignore_cleanup_errors=True) as place:
            folder = Path(place)
            filled = fill(folder, runs_each, 1)
            add_sensors(folder, filled, size, runs_each)
            with (
                serving(folder) as server,
                opened(folder) as engine,
                _client(server, filled.log_ins[0], 300.0) as person,
            ):
                first_s = _seconds(person, "/")[0]
                fleets[str(size)] = {
                    "first_page_s": first_s,
                    "pages": {path: _looked_at(person, engine, path, looks) for path in FLEET_PAGES},
                }
    return {"sensors": list(sensors), "runs_each": runs_each, "looks": looks, "fleets": fleets, "limits": {}}


def _looked_at(person: httpx.Client, engine: Engine, path: str, looks: int) -> dict[str, float]:
    """Ask for a page so often, something being committed before each time."""
    found = []
    for _ in range(looks):
        with open_writing(engine) as session:
            append(session, SYSTEM, "looked", "sensors", None, None)
        found.append(_seconds(person, path))
    seconds = [one[0] for one in found]
    return {
        "median_ms": 1e3 * statistics.median(seconds),
        "longest_ms": 1e3 * max(seconds),
        "kb": found[-1][1] / 1e3,
    }


def _seconds(person: httpx.Client, path: str) -> tuple[float, int]:
    began_s = time.perf_counter()
    answer = person.get(path).raise_for_status()
    return time.perf_counter() - began_s, len(answer.content)
