"""How long a signed-in person's write takes while others flood the log-in: `python -m benchmarks.login_flood`.

A server of its own is started on a store of its own; an analyst logs in and makes an API key now and then, first in peace, then
while so many connections log in with wrong passwords, each under another name, as fast as they are answered.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

PASSWORD = "correct horse battery"  # noqa: S105 - of a store that is removed with the measurement
READY_WITHIN_S = 120.0


def main() -> None:
    """Measure, and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connections", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--python", default=sys.executable, help="The interpreter that has the version to measure.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="boresight-flood-") as folder:
        figures = _measured(Path(folder), options)
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


def _measured(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Serve, and measure in peace and under the flood."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    own = {"BORESIGHT_DATA_FOLDER": str(folder), "BORESIGHT_PORT": str(port), "BORESIGHT_WORKERS": "0"}
    environment, command = {**os.environ, **own}, [options.python, "-m", "boresight"]
    add = [*command, "user", "add", "ada", "--role", "analyst", "--printed-name", "Ada", "--password-stdin"]
    subprocess.run(add, input=f"{PASSWORD}\n", text=True, env=environment, check=True)
    server = subprocess.Popen([*command, "serve"], env=environment, stderr=subprocess.DEVNULL)
    try:
        return asyncio.run(_flooded(f"http://127.0.0.1:{port}", options.connections, options.seconds))
    finally:
        server.terminate()
        server.wait(30)


async def _flooded(address: str, connections: int, seconds: float) -> dict[str, Any]:
    """Write in peace, then under the flood."""
    async with httpx.AsyncClient(base_url=address, timeout=120) as analyst:
        await _ready(analyst)
        answer = await analyst.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
        analyst.headers["X-CSRF-Token"] = answer.raise_for_status().json()["csrf_token"]
        peace = await _writes(analyst, seconds / 3)
        answers: Counter[int] = Counter()
        ends_s = time.monotonic() + seconds
        floods = [asyncio.create_task(_flood(address, number, ends_s, answers)) for number in range(connections)]
        flooded = await _writes(analyst, seconds)
        await asyncio.gather(*floods)
    return {
        "connections": connections,
        "seconds": seconds,
        "write_s_in_peace": peace,
        "write_s_under_flood": flooded,
        "answers_to_the_flood": dict(sorted(answers.items())),
    }


async def _ready(client: httpx.AsyncClient) -> None:
    """Wait until the server answers."""
    ends_s = time.monotonic() + READY_WITHIN_S
    while time.monotonic() < ends_s:
        try:
            if (await client.get("/healthz")).is_success:
                return
        except httpx.TransportError:
            pass
        await asyncio.sleep(0.2)
    raise TimeoutError("The server did not answer in time.")


async def _writes(client: httpx.AsyncClient, seconds: float) -> dict[str, float]:
    """Write again and again for so long; returns median, 95 % and count."""
    took_s, ends_s = [], time.monotonic() + seconds
    while time.monotonic() < ends_s:
        began_s = time.monotonic()
        (await client.post("/api/v1/api-keys", json={"label": "flood"})).raise_for_status()
        took_s.append(time.monotonic() - began_s)
        await asyncio.sleep(0.2)
    ranked = sorted(took_s)
    share = ranked[min(int(0.95 * len(ranked)), len(ranked) - 1)]
    return {"median": round(statistics.median(ranked), 3), "p95": round(share, 3), "writes": len(ranked)}


async def _flood(address: str, number: int, ends_s: float, answers: Counter[int]) -> None:
    """Log in wrongly over one connection, each time under another name."""
    async with httpx.AsyncClient(base_url=address, timeout=120) as client:
        attempt = 0
        while time.monotonic() < ends_s:
            attempt += 1
            wrong = {"name": f"nobody-{number}-{attempt}", "password": "wrong horse battery"}
            try:
                answers[(await client.post("/api/v1/sessions", json=wrong)).status_code] += 1
            except httpx.TransportError:
                answers[0] += 1
            await asyncio.sleep(0.05)


if __name__ == "__main__":
    main()
