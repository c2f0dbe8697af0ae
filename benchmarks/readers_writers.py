"""200 readers and 20 writers at one server for a minute, and how long each waits.

    python benchmarks/readers_writers.py
    python benchmarks/readers_writers.py --checkout DIR    # the server of another checkout, to compare with
    python benchmarks/readers_writers.py --think 1         # each reader pauses so long after an answer

Every client has a connection and a log-in of its own (of ten people, or of `--people N`) and asks again as soon as it is answered:
a closed loop without pauses, on the cores that the server has too, which is harsher than people are. By Little's law a mean of t
seconds for n readers is n / t answers a second. Readers go through the lists of runs, sensors and telemetry sets and one run, by
REST and as pages, and the overview, each from another place of the round. Writers in turn write a note on a run, save a preset,
register a sensor, launch a run, and write a note on a sensor. The store holds 2,000 runs of 12 sensors.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from boresight.measurements.full_store import add_sensors, fill
from boresight.measurements.serving import Served, allow_open_files, serving

READS = (
    "/api/v1/runs",
    "/api/v1/runs/{run}",
    "/api/v1/sensors",
    "/api/v1/telemetry-sets",
    "/",
    "/runs",
    "/runs/{run}",
    "/sensors",
    "/telemetry",
)
RUNS, SENSORS = 2000, 12
PATIENCE_S = 60.0


@dataclass
class Tally:
    """What was answered within the time."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    failures: Counter[str] = field(default_factory=Counter)


class Client:
    """A connection that asks and waits; written by hand, for it shares the cores with the server."""

    def __init__(self, port: int, headers: Mapping[str, str]) -> None:
        self._port = port
        self._headers = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, method: str, path: str, body: object = None, more: str = "") -> tuple[int, bytes]:
        """Ask and return status and body."""
        sent = b"" if body is None else json.dumps(body).encode()
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self._port, limit=1 << 22)
        reader, writer = self._streams
        head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\n{self._headers}{more}"
        kind = f"Content-Type: application/json\r\nContent-Length: {len(sent)}\r\n" if body is not None else ""
        accept = "text/html" if not path.startswith("/api") else "application/json"
        writer.write(f"{head}{kind}Accept: {accept}\r\nAccept-Encoding: gzip\r\n\r\n".encode() + sent)
        lines = (await reader.readuntil(b"\r\n\r\n")).lower().split(b"\r\n")
        named = dict(line.split(b": ", 1) for line in lines[1:] if line)
        answer = await reader.readexactly(int(named.get(b"content-length", 0)))
        if named.get(b"connection") == b"close":
            writer.close()
            self._streams = None
        return int(lines[0].split()[1]), answer


async def timed(tally: Tally, name: str, wanted: int, question: Any) -> bytes | None:
    """Ask and count the answer; None where it is not as wanted."""
    began_s = time.perf_counter()
    try:
        async with asyncio.timeout(PATIENCE_S):
            status, body = await question
    except (OSError, asyncio.IncompleteReadError, TimeoutError) as error:
        tally.failures[f"{name}: {type(error).__name__}"] += 1
        return None
    if status != wanted:
        tally.failures[f"{name}: {status}"] += 1
        return None
    tally.seconds[name].append(time.perf_counter() - began_s)
    return body  # type: ignore[no-any-return]


async def read(client: Client, tally: Tally, number: int, until_s: float, think_s: float) -> None:
    """Read one thing after the other."""
    generator = random.Random(number)  # noqa: S311 - a load, not a secret
    place = number
    await asyncio.sleep(generator.random() * think_s)
    while time.perf_counter() < until_s:
        path = READS[place % len(READS)]
        await timed(tally, f"GET {path}", 200, client.ask("GET", path.format(run=generator.randrange(1, RUNS))))
        place += 1
        if think_s:
            await asyncio.sleep(think_s)


async def write(client: Client, tally: Tally, number: int, until_s: float, order: dict[str, Any]) -> None:
    """Write one thing after the other; number 0 sets the round off at another place than number 1."""
    generator, place = random.Random(1000 + number), number  # noqa: S311 - a load, not a secret
    document = order.pop("sensor_document")
    while time.perf_counter() < until_s:
        name, place = f"{number}-{place}", place + 1
        act = place % 5
        if act == 0:
            path = f"/api/v1/runs/{generator.randrange(1, RUNS)}/notes"
            question = client.ask("POST", path, {"text": f"Note {name}."})
            await timed(tally, "POST note", 201, question)
        elif act == 1:
            body = {"name": f"P {name}", "sentence": "Under load.", "settings": {"method": "batch"}}
            await timed(tally, "POST preset", 201, client.ask("POST", "/api/v1/presets", body))
        elif act == 2:
            body = document | {"name": f"W-{name}"}
            await timed(tally, "POST sensor", 201, client.ask("POST", "/api/v1/sensors", body))
        elif act == 3:
            await timed(tally, "POST run", 202, client.ask("POST", "/api/v1/runs", order))
        else:
            path = f"/api/v1/sensors/{generator.randrange(1, SENSORS)}/notes"
            await timed(tally, "POST note", 201, client.ask("POST", path, {"text": f"Note {name}."}))


def told(seconds: Sequence[float]) -> dict[str, float]:
    """Tell times in ms."""
    found = sorted(seconds)
    places = {"median_ms": 0.5, "p95_ms": 0.95, "greatest_ms": 1.0}
    return {"answers": len(found)} | {
        name: round(1e3 * found[int(share * (len(found) - 1))], 1) for name, share in places.items()
    }


async def load(served: Served, log_ins: Sequence[Mapping[str, str]], order: dict[str, Any], given: Any) -> Tally:
    """Be all clients."""
    tally = Tally()
    until_s = time.perf_counter() + given.seconds
    clients = [Client(served.port, headers) for headers in log_ins]
    tasks = [
        read(client, tally, number, until_s, given.think) for number, client in enumerate(clients[: given.readers])
    ] + [write(client, tally, number, until_s, dict(order)) for number, client in enumerate(clients[given.readers :])]
    await asyncio.gather(*tasks)
    return tally


def with_token(client: httpx.Client, log_in: Mapping[str, str]) -> dict[str, str]:
    """Add to a log-in the token that writing takes."""
    answer = client.get("/api/v1/sessions/current", headers=dict(log_in)).raise_for_status()
    return {**log_in, "X-CSRF-Token": answer.json()["csrf_token"]}


def main() -> None:
    """Fill a store, serve it, load it, and print what was found."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--checkout", type=Path, help="serve the code of this checkout")
    words.add_argument("--readers", type=int, default=200)
    words.add_argument("--writers", type=int, default=20)
    words.add_argument("--people", type=int, default=10, help="whose log-ins they are; every other has one role more")
    words.add_argument("--seconds", type=float, default=60.0)
    words.add_argument("--think", type=float, default=0.0, help="seconds that a reader pauses after an answer")
    given = words.parse_args()
    if given.checkout is not None:
        here = {"PYTHONPATH": str(given.checkout.resolve() / "backend")}
        place = sys.argv.index("--checkout")
        rest = [*sys.argv[1:place], *sys.argv[place + 2 :]]
        os.execve(sys.executable, [sys.executable, __file__, *rest], {**os.environ, **here})  # noqa: S606 - ourselves
    allow_open_files()
    with tempfile.TemporaryDirectory(prefix="boresight-load-", ignore_cleanup_errors=True) as place:
        filled = fill(Path(place), RUNS, given.readers + given.writers, given.people)
        add_sensors(Path(place), filled, SENSORS, 1)
        with serving(Path(place), workers="0") as served:
            with httpx.Client(base_url=f"http://127.0.0.1:{served.port}", timeout=60) as client:
                path = f"/api/v1/sensors/{filled.sensor_id}"
                document = client.get(path, headers=dict(filled.log_ins[0])).json()["document"]
                writers = [with_token(client, one) for one in filled.log_ins[given.readers :]]
                for path in READS:
                    client.get(path.format(run=1), headers=dict(filled.log_ins[0])).raise_for_status()
            log_ins = [*filled.log_ins[: given.readers], *writers]
            order = {
                "sensor_id": filled.sensor_id,
                "telemetry_set_id": filled.telemetry_set_id,
                "settings": {"method": "batch"},
                "sensor_document": document,
            }
            print(f"loading process {served.pid}", file=sys.stderr, flush=True)
            before_s, own_before_s = served.processor_s(), time.process_time()
            tally = asyncio.run(load(served, log_ins, order, given))
            used_s = served.processor_s() - before_s
            own_s = time.process_time() - own_before_s
    reads = [one for name, found in tally.seconds.items() if name.startswith("GET") for one in found]
    writes = [one for name, found in tally.seconds.items() if name.startswith("POST") for one in found]
    found = {
        "readers": given.readers,
        "writers": given.writers,
        "seconds": given.seconds,
        "think_s": given.think,
        "reads": told(reads),
        "writes": told(writes),
        "failures": dict(tally.failures),
        "people": given.people,
        "server_processor_s": round(used_s, 1),
        "client_processor_s": round(own_s, 1),
        "by_kind": {name: told(one) for name, one in sorted(tally.seconds.items())},
    }
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
