"""The event feed before an audience: runs are launched and cancelled, and everybody must hear of each change once, in order.

Nothing computes behind the server, so that what happens is what the measurement does: it launches runs over the REST API and
cancels them again, which writes two lines of a log and two audit records for each. One listener in ten follows one run only, one in
ten leaves over and over and comes back with `Last-Event-ID`. What there was to hear is read from the store.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import httpx
import orjson

from boresight.measurements.full_store import Filled, settings_in
from boresight.measurements.serving import serving
from boresight.store import audit, run_events
from boresight.store.audit import Sought
from boresight.store.sessions import Engine, open_engine, reading

FEED = "/api/v1/events"
RUNS = "/api/v1/runs"
WAIT_S = 60.0
ONE_IN = 10
LEAVES_AFTER = 37  # events


def measure_feed(folder: Path, filled: Filled, listeners: int, runs: int) -> dict[str, Any]:
    """Let so many listen while so many runs are launched and cancelled."""
    with serving(folder, workers="0") as served:
        maker = httpx.Client(base_url=f"http://127.0.0.1:{served.port}", headers=dict(filled.keys[0]), timeout=60)
        engine = open_engine(settings_in(folder).database_url)
        try:
            return _before_an_audience(served.port, maker, engine, filled, listeners, runs)
        finally:
            maker.close()
            engine.dispose()


def _before_an_audience(
    port: int, maker: httpx.Client, engine: Engine, filled: Filled, listeners: int, runs: int
) -> dict[str, Any]:
    """Let things happen before an audience, and ask it what it heard."""
    followed = _launch(maker, filled)
    words = [sys.executable, "-m", "boresight.measurements.audience"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as heard:  # noqa: S603 - our own words
        listening = _ask(heard, {"port": port, "listeners": _listeners(filled, listeners, followed["id"])})
        before = _newest(engine)
        began_s = time.perf_counter()
        _cancel(maker, followed)
        for _ in range(runs):
            _cancel(maker, _launch(maker, filled))
        took_s = time.perf_counter() - began_s
        groups = [_happened(engine, before, None), _happened(engine, before, followed["id"])]
        found = _ask(heard, {"groups": groups, "wait_s": WAIT_S})
    events = sum(map(len, groups[0].values()))
    return {"listeners": listeners, "events": events, "events_per_s": events / took_s, **listening, **found}


def _listeners(filled: Filled, count: int, followed: int) -> list[dict[str, Any]]:
    """Say who listens to what."""
    credentials = [*filled.keys, *filled.log_ins]
    made = []
    for number in range(count):
        of_one = number % ONE_IN == 1
        made.append(
            {
                "path": f"{FEED}?run={followed}" if of_one else FEED,
                "headers": credentials[number % len(credentials)],
                "group": int(of_one),
                "leaves": LEAVES_AFTER if number % ONE_IN == 0 else 0,
            }
        )
    return made


def _ask(process: subprocess.Popen[bytes], document: Mapping[str, Any]) -> dict[str, Any]:
    """Write a line to the audience and read its answer."""
    assert process.stdin is not None  # noqa: S101 - both are pipes
    assert process.stdout is not None  # noqa: S101 - both are pipes
    process.stdin.write(orjson.dumps(document) + b"\n")
    process.stdin.flush()
    answer: dict[str, Any] = orjson.loads(process.stdout.readline())
    return answer


def _launch(maker: httpx.Client, filled: Filled) -> dict[str, Any]:
    """Launch a run; its tag comes with it."""
    order = {"sensor_id": filled.sensor_id, "telemetry_set_id": filled.telemetry_set_id}
    answer = maker.post(RUNS, json=order | {"settings": {"method": "batch"}}).raise_for_status()
    made: dict[str, Any] = answer.json()
    return made | {"etag": answer.headers["ETag"]}


def _cancel(maker: httpx.Client, run: Mapping[str, Any]) -> None:
    """Stop a run that waits."""
    maker.post(f"{RUNS}/{run['id']}:cancel", headers={"If-Match": run["etag"]}).raise_for_status()


def _newest(engine: Engine) -> tuple[int, int]:
    """Return the numbers of the newest line of a log and the newest audit record."""
    with reading(engine) as session:
        return run_events.newest_event_id(session), audit.records(session, before_id=None, sought=Sought(), limit=1)[
            0
        ].id


def _happened(engine: Engine, before: tuple[int, int], run_id: int | None) -> dict[str, Sequence[int]]:
    """Return the numbers of everything since, or of what concerns one run."""
    sought = Sought(object=None if run_id is None else f"runs/{run_id}")
    with reading(engine) as session:
        lines = run_events.events_after(session, before[0], limit=1_000_000)
        records = audit.records(session, before_id=None, sought=sought, limit=1_000_000)
        return {
            "run": [line.id for line in lines if run_id in {None, line.run_id}],
            "audit": [record.id for record in reversed(records) if record.id > before[1]],
        }
