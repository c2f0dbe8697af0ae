"""What people get from a server while others flood it, or while very many read and write.

    python -m benchmarks.floods half-sent
    python -m benchmarks.floods log-ins --seconds 12
    python -m benchmarks.floods readers-writers --people 10 --think 1

With `--checkout DIR` the server is that of another checkout, to compare with; its store must have the same form.

**half-sent**: 600 connections for 45 s, from one address: 270 send a head with `Content-Length` and then nothing, 270 send the
body of a log-in at one byte a second, 60 send half a head. Whoever is disconnected comes back within a second. Beside them, over
new connections four times a second each: somebody logged in reads a list, opens a page and saves a preset; somebody unknown opens
the log-in page; and once a second somebody logs in. An answer within 10 s with the right status counts as given.

**log-ins**: how long a signed-in analyst's write takes (an API key made, five a second at most), first in peace, then while so many
connections log in with wrong passwords, each under another name, as fast as they are answered.

**readers-writers**: 200 readers and 20 writers for a minute. Every client has a connection and a log-in of its own (of ten people,
or of `--people N`) and asks again as soon as it is answered, or `--think` seconds later: a closed loop, on the cores that the
server has too, which is harsher than people are. By Little's law a mean of t seconds for n readers is n / t answers a second.
Readers go through the lists of runs, sensors and telemetry sets and one run, by REST and as pages, and the overview, each from
another place of the round. Writers in turn write a note on a run, save a preset, register a sensor, launch a run, and write a note
on a sensor. The store holds 2,000 runs of 12 sensors.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import subprocess
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np

from benchmarks.crowd import quantile_ms
from benchmarks.servers import COMMAND, Server, allow_open_files, default_environment, serving, variables
from benchmarks.stores import add_sensors, fill

NAME, PASSWORD = "analyst", "a long enough passphrase"
LOG_IN = {"name": NAME, "password": PASSWORD}
HEAD = (
    "POST /api/v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 400\r\n\r\n"
)
HALVES = {"head, no body": HEAD, "a byte a second": HEAD + '{"name":"', "half a head": HEAD[:60]}
BACK_S = 1.0
READS = (
    "/api/v1/runs", "/api/v1/runs/{run}", "/api/v1/sensors", "/api/v1/telemetry-sets", "/", "/runs", "/runs/{run}", "/sensors",
    "/telemetry",
)  # fmt: skip
RUNS, SENSORS = 2000, 12

checkout_option = click.option(
    "--checkout", type=click.Path(exists=True, path_type=Path), help="Serve the code of this checkout."
)


class Client:
    """A connection that asks and waits; written by hand, for it shares the cores with the server."""

    def __init__(self, port: int, headers: Mapping[str, str] | None = None, *, keep: bool = True) -> None:
        self._port, self._keep = port, keep
        self._headers = "".join(f"{name}: {value}\r\n" for name, value in (headers or {}).items())
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, method: str, path: str, body: object = None) -> tuple[int, bytes]:
        """Ask and return status and body."""
        sent = b"" if body is None else json.dumps(body).encode()
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self._port, limit=1 << 22)
        reader, writer = self._streams
        head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\n{self._headers}"
        kind = f"Content-Type: application/json\r\nContent-Length: {len(sent)}\r\n" if body is not None else ""
        accept = "application/json" if path.startswith("/api") else "text/html"
        writer.write(f"{head}{kind}Accept: {accept}\r\nAccept-Encoding: gzip\r\n\r\n".encode() + sent)
        try:
            lines = (await reader.readuntil(b"\r\n\r\n")).lower().split(b"\r\n")
            named = dict(line.split(b": ", 1) for line in lines[1:] if line)
            answer = await reader.readexactly(int(named.get(b"content-length", 0)))
        except BaseException:
            self._close(writer)
            raise
        if named.get(b"connection") == b"close" or not self._keep:
            self._close(writer)
        return int(lines[0].split()[1]), answer

    def _close(self, writer: asyncio.StreamWriter) -> None:
        writer.close()
        self._streams = None


class Tally:
    """What was answered as it should be within the time, and what was not, by the name of the act."""

    def __init__(self, patience_s: float) -> None:
        self.patience_s = patience_s
        self.seconds: dict[str, list[float]] = defaultdict(list)
        self.failures: dict[str, Counter[str]] = defaultdict(Counter)

    async def timed(self, name: str, wanted: int, question: Awaitable[tuple[int, bytes]]) -> None:
        """Ask and count the answer."""
        began_s = time.perf_counter()
        try:
            async with asyncio.timeout(self.patience_s):
                status, _ = await question
        except (OSError, asyncio.IncompleteReadError, TimeoutError) as error:
            self.failures[name][type(error).__name__] += 1
            return
        if status == wanted:
            self.seconds[name].append(time.perf_counter() - began_s)
        else:
            self.failures[name][str(status)] += 1

    def told(self, *names: str) -> dict[str, Any]:
        """Tell the times of some acts together, in ms."""
        found, refused = sorted(s for name in names for s in self.seconds[name]), Counter[str]()
        for name in names:
            refused.update(self.failures[name])
        shares = {"median_ms": 0.5, "p95_ms": 0.95, "greatest_ms": 1.0}
        times = {key: quantile_ms(found, share) for key, share in shares.items()}
        return {"asked": len(found) + refused.total(), "given": len(found), **times, "refused": dict(refused)}


async def again(ask: Callable[[], Coroutine[Any, Any, None]], every_s: float, until_s: float) -> None:
    """Do something over and over until the time is over, every so often at most."""
    while (began_s := time.perf_counter()) < until_s:
        await ask()
        await asyncio.sleep(max(0.0, began_s + every_s - time.perf_counter()))


@contextmanager
def one_analyst(checkout: Path | None) -> Iterator[tuple[Server, dict[str, str]]]:
    """Serve a store with one person; yields the server and the headers of a log-in."""
    allow_open_files()
    path = _make_path(checkout)
    with tempfile.TemporaryDirectory(prefix="boresight-flood-", ignore_cleanup_errors=True) as place:
        add = [*COMMAND, "user", "add", NAME, "--role", "analyst", "--printed-name", "Ada", "--password-stdin"]
        environment = (
            default_environment() | variables(data_folder=place) | path
        )  # by the command, which every version has
        subprocess.run(add, input=f"{PASSWORD}\n", text=True, env=environment, check=True)
        with serving(Path(place), workers=0, environment=path) as server:
            with httpx.Client(base_url=server.address, timeout=60) as client:
                token = client.post("/api/v1/sessions", json=LOG_IN).raise_for_status().json()["csrf_token"]
                cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
            yield server, {"Cookie": cookie, "X-CSRF-Token": token}


def _make_path(checkout: Path | None) -> dict[str, str]:
    return {} if checkout is None else {"PYTHONPATH": str(checkout.resolve() / "backend")}


def _show(found: Mapping[str, Any]) -> None:
    click.echo(json.dumps(found, indent=1))


@click.group(help=__doc__)
def main() -> None:
    """Flood a server."""


@main.command("half-sent")
@checkout_option
@click.option("--connections", default=600)
@click.option("--seconds", default=45.0)
def half_sent(*, checkout: Path | None, connections: int, seconds: float) -> None:
    """Requests that are never sent whole."""
    with one_analyst(checkout) as (server, headers):
        _show(asyncio.run(half_sent_flood(server.port, headers, connections, seconds)))


async def half_sent_flood(port: int, headers: Mapping[str, str], count: int, seconds: float) -> dict[str, Any]:
    """Flood a server and ask it for what people ask."""
    tally, ended, numbers = Tally(patience_s=10.0), Counter[str](), itertools.count()
    until_s = time.perf_counter() + 2 + seconds
    whole, byte, half = HALVES
    kinds = [half if number % 10 == 0 else (whole, byte)[number % 2] for number in range(count)]
    floods = [asyncio.create_task(_half_senders(port, kind, until_s + 2, ended)) for kind in kinds]
    await asyncio.sleep(2)  # until all are there

    def preset() -> dict[str, Any]:
        return {"name": f"Flooded {next(numbers)}", "sentence": "While a flood runs.", "settings": {"method": "batch"}}

    person, unknown, enterer = (Client(port, one, keep=False) for one in (headers, None, None))
    reader = Client(port, headers, keep=False)
    acts: dict[str, tuple[int, float, Callable[[], Awaitable[tuple[int, bytes]]]]] = {
        "logged in: a list": (200, 0.25, lambda: reader.ask("GET", "/api/v1/sensors")),
        "logged in: a page": (200, 0.25, lambda: Client(port, headers, keep=False).ask("GET", "/runs")),
        "logged in: a write": (201, 0.25, lambda: person.ask("POST", "/api/v1/presets", preset())),
        "unknown: the log-in page": (200, 0.25, lambda: unknown.ask("GET", "/login")),
        "unknown: a log-in": (201, 1.0, lambda: enterer.ask("POST", "/api/v1/sessions", LOG_IN)),
    }

    async def act(name: str) -> None:
        wanted, every_s, question = acts[name]
        await again(lambda: tally.timed(name, wanted, question()), every_s, until_s)

    await asyncio.gather(*map(act, acts))
    await asyncio.gather(*floods)
    return {
        "connections": count,
        "seconds": seconds,
        **{name: tally.told(name) for name in acts},
        "ends of the flood": dict(ended),
    }


async def _half_senders(port: int, kind: str, until_s: float, ended: Counter[str]) -> None:
    """Hold one connection after the other that never finishes a request."""
    while time.perf_counter() < until_s:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(HALVES[kind].encode())
            answer = asyncio.ensure_future(reader.read(200))
            while time.perf_counter() < until_s and not answer.done():
                await asyncio.wait([answer], timeout=BACK_S)
                if kind == "a byte a second" and not answer.done():
                    writer.write(b"a")
            said = answer.result()[9:12].decode() if answer.done() else "held to the end"
            answer.cancel()
            writer.close()
            ended[said or "closed"] += 1
        except OSError as error:
            ended[type(error).__name__] += 1
        await asyncio.sleep(BACK_S)


@main.command("log-ins")
@checkout_option
@click.option("--connections", default=60)
@click.option("--seconds", default=30.0)
def log_ins(*, checkout: Path | None, connections: int, seconds: float) -> None:
    """Log-ins with wrong passwords."""
    with one_analyst(checkout) as (server, headers):
        _show(asyncio.run(log_in_flood(server.port, headers, connections, seconds)))


async def log_in_flood(port: int, headers: Mapping[str, str], count: int, seconds: float) -> dict[str, Any]:
    """Write in peace, then under the flood."""
    analyst, tally, answers = Client(port, headers), Tally(patience_s=120.0), Counter[int]()

    def write(name: str) -> Callable[[], Coroutine[Any, Any, None]]:
        return lambda: tally.timed(name, 201, analyst.ask("POST", "/api/v1/api-keys", {"label": "flood"}))

    async def enter(number: int, until_s: float) -> None:
        client, attempts = Client(port), itertools.count()

        async def wrongly() -> None:
            wrong = {"name": f"nobody-{number}-{next(attempts)}", "password": "wrong horse battery"}
            try:
                answers[(await client.ask("POST", "/api/v1/sessions", wrong))[0]] += 1
            except (OSError, asyncio.IncompleteReadError):
                answers[0] += 1
            await asyncio.sleep(0.05)

        await again(wrongly, 0.0, until_s)

    await again(write("in peace"), 0.2, time.perf_counter() + seconds / 3)
    until_s = time.perf_counter() + seconds
    await asyncio.gather(
        again(write("under flood"), 0.2, until_s), *(enter(number, until_s) for number in range(count))
    )
    return {
        "connections": count,
        "seconds": seconds,
        "write_in_peace": tally.told("in peace"),
        "write_under_flood": tally.told("under flood"),
        "answers_to_the_flood": dict(sorted(answers.items())),
    }


@main.command("readers-writers")
@checkout_option
@click.option("--readers", default=200)
@click.option("--writers", default=20)
@click.option("--people", default=10, help="Whose log-ins they are; every other has one role more.")
@click.option("--seconds", default=60.0)
@click.option("--think", default=0.0, help="Seconds that a reader pauses after an answer.")
def readers_writers(
    *, checkout: Path | None, readers: int, writers: int, people: int, seconds: float, think: float
) -> None:
    """Very many who read and some who write."""
    allow_open_files()
    with tempfile.TemporaryDirectory(prefix="boresight-load-", ignore_cleanup_errors=True) as place:
        filled = fill(Path(place), RUNS, readers + writers, people)
        add_sensors(Path(place), filled, SENSORS, 1)
        with serving(Path(place), workers=0, environment=_make_path(checkout)) as server:
            log_ins = [dict(one) for one in filled.log_ins]
            with httpx.Client(base_url=server.address, timeout=60) as client:
                path = f"/api/v1/sensors/{filled.sensor_id}"
                document = client.get(path, headers=log_ins[0]).raise_for_status().json()["document"]
                for one in log_ins[readers:]:
                    current = client.get("/api/v1/sessions/current", headers=one).raise_for_status().json()
                    one["X-CSRF-Token"] = current["csrf_token"]
                for path in READS:
                    client.get(path.format(run=1), headers=log_ins[0]).raise_for_status()
            before_s, own_before_s = server.processor_s(), time.process_time()
            tally = asyncio.run(
                load(server.port, log_ins[:readers], log_ins[readers:], filled.order, document, seconds, think)
            )
            used_s, own_s = server.processor_s() - before_s, time.process_time() - own_before_s
    names = sorted({*tally.seconds, *tally.failures})
    _show({
        "readers": readers, "writers": writers, "people": people, "seconds": seconds, "think_s": think,
        "reads": tally.told(*(name for name in names if name.startswith("GET"))),
        "writes": tally.told(*(name for name in names if name.startswith("POST"))),
        "server_processor_s": round(used_s, 1), "client_processor_s": round(own_s, 1),
        "by_kind": {name: tally.told(name) for name in names},
    })  # fmt: skip


async def load(
    port: int, readers: Sequence[Mapping[str, str]], writers: Sequence[Mapping[str, str]], order: Mapping[str, Any],
    document: Mapping[str, Any], seconds: float, think_s: float,
) -> Tally:  # fmt: skip
    """Be all clients."""
    tally, until_s = Tally(patience_s=60.0), time.perf_counter() + seconds

    async def read(number: int, headers: Mapping[str, str]) -> None:
        client, rng, places = Client(port, headers), np.random.default_rng(number), itertools.count(number)
        await asyncio.sleep(rng.random() * think_s)

        async def one() -> None:
            path = READS[next(places) % len(READS)]
            await tally.timed(f"GET {path}", 200, client.ask("GET", path.format(run=rng.integers(1, RUNS))))
            await asyncio.sleep(think_s)

        await again(one, 0.0, until_s)

    async def write(number: int, headers: Mapping[str, str]) -> None:
        client, rng, places = Client(port, headers), np.random.default_rng(1000 + number), itertools.count(number)

        async def one() -> None:
            place = next(places)
            name = f"{number}-{place}"
            note, preset = (
                {"text": f"Note {name}."},
                {"name": f"P {name}", "sentence": "Under load.", "settings": order["settings"]},
            )
            acts: tuple[tuple[str, int, str, object], ...] = (
                ("POST sensor", 201, "sensors", {**document, "name": f"W-{name}"}),
                ("POST run", 202, "runs", order),
                ("POST note", 201, f"sensors/{rng.integers(1, SENSORS)}/notes", note),
                ("POST note", 201, f"runs/{rng.integers(1, RUNS)}/notes", note),
                ("POST preset", 201, "presets", preset),
            )
            act, wanted, path, body = acts[place % len(acts)]
            await tally.timed(act, wanted, client.ask("POST", f"/api/v1/{path}", body))

        await again(one, 0.0, until_s)

    await asyncio.gather(*itertools.starmap(read, enumerate(readers)), *itertools.starmap(write, enumerate(writers)))
    return tally


if __name__ == "__main__":
    main()
