"""A flood of requests that are never sent whole, and what people get meanwhile.

    python benchmarks/half_sent_flood.py
    python benchmarks/half_sent_flood.py --checkout DIR    # the server of another checkout, to compare with

600 connections for 45 s, from one address: 270 send a head with `Content-Length` and then nothing, 270 send the body of a
log-in at one byte a second, 60 send half a head. Whoever is disconnected comes back within a second. Beside
them, four times a second each: somebody logged in reads a list, opens a page and saves a preset; somebody unknown opens the
log-in page; and once a second somebody logs in. An answer within 10 s with the right status counts as given.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import httpx

from boresight.measurements.serving import allow_open_files, serving

NAME, PASSWORD = "analyst", "a long enough passphrase"
HEAD = (
    "POST /api/v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 400\r\n\r\n"
)
KINDS = {"head, no body": HEAD, "a byte a second": HEAD + '{"name":"', "half a head": HEAD[:60]}
PATIENCE_S = 10.0
BACK_S = 1.0


class Flood:
    """The connections that never finish a request."""

    def __init__(self, port: int, count: int, seconds: float) -> None:
        self._port, self._count, self._seconds = port, count, seconds
        self.ended: Counter[str] = Counter()

    def run(self) -> None:
        """Flood until the time is over."""
        asyncio.run(self._all())

    async def _all(self) -> None:
        until_s = time.monotonic() + self._seconds
        whole, byte, half = KINDS
        kinds = [half if number % 10 == 0 else (whole, byte)[number % 2] for number in range(self._count)]
        await asyncio.gather(*(self._one(kind, until_s) for kind in kinds))

    async def _one(self, kind: str, until_s: float) -> None:
        """Hold one connection after the other."""
        while time.monotonic() < until_s:
            try:
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
                writer.write(KINDS[kind].encode())
                answer = asyncio.ensure_future(reader.read(200))
                while time.monotonic() < until_s and not answer.done():
                    await asyncio.wait([answer], timeout=BACK_S)
                    if kind == "a byte a second" and not answer.done():
                        writer.write(b"a")
                said = answer.result()[9:12].decode() if answer.done() else "held to the end"
                answer.cancel()
                writer.close()
                self.ended[said or "closed"] += 1
            except OSError as error:
                self.ended[type(error).__name__] += 1
            await asyncio.sleep(BACK_S)


def ask_again(ask: Callable[[], int], wanted: set[int], every_s: float, until_s: float) -> dict[str, object]:
    """Ask until the time is over; tell how many got an answer, and how long that took."""
    given: list[float] = []
    refused: Counter[str] = Counter()
    while (began_s := time.monotonic()) < until_s:
        try:
            status = ask()
            if status in wanted:
                given.append(time.monotonic() - began_s)
            else:
                refused[str(status)] += 1
        except httpx.HTTPError as error:
            refused[type(error).__name__] += 1
        time.sleep(max(0.0, began_s + every_s - time.monotonic()))
    given.sort()
    return {
        "asked": len(given) + sum(refused.values()),
        "given": len(given),
        "median_ms": round(1e3 * given[len(given) // 2], 1) if given else None,
        "greatest_ms": round(1e3 * given[-1], 1) if given else None,
        "refused": dict(refused),
    }


def measure(port: int, count: int, seconds: float) -> dict[str, object]:
    """Flood a server and ask it for what people ask."""
    address = f"http://127.0.0.1:{port}"
    log_in = {"name": NAME, "password": PASSWORD}
    person = httpx.Client(base_url=address, timeout=PATIENCE_S)
    person.headers["X-CSRF-Token"] = person.post("/api/v1/sessions", json=log_in).json()["csrf_token"]
    numbers = iter(range(1_000_000))

    def anew(cookies: httpx.Cookies | None = None) -> httpx.Client:
        """Return a client that opens a connection for every request, as somebody who comes anew."""
        limits = httpx.Limits(max_keepalive_connections=0)
        return httpx.Client(base_url=address, timeout=PATIENCE_S, limits=limits, cookies=cookies)

    def save() -> int:
        name = f"Flooded {next(numbers)}"
        body = {"name": name, "sentence": "While a flood runs.", "settings": {"method": "batch"}}
        return person.post("/api/v1/presets", json=body).status_code

    def enter() -> int:
        enterer.cookies.clear()
        return enterer.post("/api/v1/sessions", json=log_in).status_code

    lister, reader, unknown, enterer = anew(person.cookies), anew(person.cookies), anew(), anew()
    acts: dict[str, tuple[Callable[[], int], set[int], float]] = {
        "logged in: a list": (lambda: lister.get("/api/v1/sensors").status_code, {200}, 0.25),
        "logged in: a page": (lambda: reader.get("/runs").status_code, {200}, 0.25),
        "logged in: a write": (save, {201}, 0.25),
        "unknown: the log-in page": (lambda: unknown.get("/login").status_code, {200}, 0.25),
        "unknown: a log-in": (enter, {201}, 1.0),
    }
    flood = Flood(port, count, seconds + 2)
    threads = [threading.Thread(target=flood.run)]
    threads[0].start()
    time.sleep(2)  # until all are there
    until_s, found = time.monotonic() + seconds, dict[str, object]()
    for name, act in acts.items():
        threads.append(
            threading.Thread(target=lambda n, a: found.update({n: ask_again(*a, until_s)}), args=(name, act))
        )
        threads[-1].start()
    for thread in threads:
        thread.join()
    person.close()
    return {"connections": count, "seconds": seconds, **found, "ends of the flood's connections": dict(flood.ended)}


def main() -> None:
    """Serve, flood, and print what was found."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--checkout", type=Path, help="serve the code of this checkout")
    words.add_argument("--connections", type=int, default=600)
    words.add_argument("--seconds", type=float, default=45.0)
    given = words.parse_args()
    if given.checkout is not None:
        here = {"PYTHONPATH": str(given.checkout.resolve() / "backend")}
        rest = ["--connections", str(given.connections), "--seconds", str(given.seconds)]
        os.execve(sys.executable, [sys.executable, __file__, *rest], {**os.environ, **here})  # noqa: S606 - ourselves
    allow_open_files()
    with tempfile.TemporaryDirectory(prefix="boresight-flood-", ignore_cleanup_errors=True) as place:
        add = [
            sys.executable,
            "-m",
            "boresight",
            "user",
            "add",
            NAME,
            "--role",
            "analyst",
            "--printed-name",
            "Ada Lima",
        ]
        environment = {**os.environ, "BORESIGHT_DATA_FOLDER": place}  # by the command, which both versions have
        subprocess.run([*add, "--password-stdin"], input=f"{PASSWORD}\n", text=True, env=environment, check=True)
        with serving(Path(place), workers="0") as served:
            print(json.dumps(measure(served.port, given.connections, given.seconds), indent=1))


if __name__ == "__main__":
    main()
