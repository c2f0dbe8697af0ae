"""Clients by the hundred from one light process each: what a load generator has to be beside a server on the same two cores.

`python -m benchmarks.crowd ask` reads a line and writes one. A wish is `{"port", "paths", "headers", "seconds", "pause_s",
"validate"}`. Client i keeps one connection, sends the i-th of `headers` with every request, asks for the paths in turn, and asks
again at once (`pause_s` 0, a closed loop) or so long after its last question. With `validate` it sends the `ETag` of its last
answer in `If-None-Match`. Timing begins when every client was answered once; how long that took is told by itself. Requests are
written whole and answers are cut by `Content-Length`; the body is taken off the wire and not looked at. What is timed is a
question's first byte out to its answer's last byte in.

`python -m benchmarks.crowd listen` reads two lines and writes two. First `{"port", "listeners": [{"path", "headers", "group",
"leaves"}, ...]}`, answered by `{"listening": n}` when all listen to the event feed; then, when everything has happened, what each
group must have heard, `{"groups": [{"run": [numbers], "audit": [numbers]}, ...], "wait_s"}`, answered by what was found. A
listener with `leaves` closes its connection after so many events, every time, and comes back a moment later with `Last-Event-ID`.
What was heard is held as it came and taken apart at the end, so that it costs the server as little as it can.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import re
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import orjson

LENGTH = re.compile(rb"\r\ncontent-length: (\d+)", re.IGNORECASE)
ETAG = re.compile(rb"\r\netag: ([^\r]+)", re.IGNORECASE)
PATIENCE_S = 120.0  # until every client was answered once, and for the last answers
BACK_S, LEAVES_AT_MOST = 0.2, 3


def request(path: str, headers: Mapping[str, str]) -> bytes:
    """Write a request without its last line."""
    lines = {"Host": "127.0.0.1", **headers}
    return (f"GET {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items())).encode()


def quantile_ms(sorted_s: Sequence[float], share: float) -> float | None:
    """Return a quantile of sorted times, in ms; None of none."""
    return 1e3 * sorted_s[int(share * (len(sorted_s) - 1))] if sorted_s else None


@dataclass
class Tally:
    """What all clients found; times are taken from when each was answered once."""

    clients: int
    duration_s: float
    began_s: float = field(default_factory=time.perf_counter)
    from_s: float = math.inf
    until_s: float = math.inf
    seconds: list[float] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    received_bytes: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    asked: int = 0

    def answered(self, began_s: float, status: str, size: int) -> None:
        """Count an answer; only those that were asked for after everybody's first are timed."""
        self.asked += 1
        if began_s < self.until_s and status not in {"200", "304"}:
            self.failures[f"status {status}"] += 1
        if began_s >= self.from_s:
            self.seconds.append(time.perf_counter() - began_s)
            self.statuses[status] += 1
            self.received_bytes += size

    def first(self) -> None:
        """Count the first answer of a client; the last of these begins the timing."""
        self.clients -= 1
        if self.clients == 0:
            self.from_s = time.perf_counter()
            self.until_s = self.from_s + self.duration_s

    def figures(self) -> dict[str, Any]:
        """Tell what was found: times in ms, answers other than 200 and 304 among the failures."""
        found = sorted(self.seconds)
        return {
            "asked": self.asked,
            "requests": len(found),
            "all_answered_once_after_s": self.from_s - self.began_s if found else None,
            "requests_per_s": len(found) / self.duration_s,
            "median_ms": quantile_ms(found, 0.5),
            "p99_ms": quantile_ms(found, 0.99),
            "greatest_ms": quantile_ms(found, 1.0),
            "statuses": dict(self.statuses),
            "failures": sum(self.failures.values()),
            "failed_by": {name: count for name, count in self.failures.items() if count},
            "received_mb": self.received_bytes / 1e6,
        }


class Client(asyncio.Protocol):
    """One client on one connection."""

    def __init__(self, wish: Mapping[str, Any], headers: Mapping[str, str], tally: Tally) -> None:
        self._questions = [request(path, {"Accept-Encoding": "gzip", **headers}) for path in wish["paths"]]
        self._pause_s, self._validate, self._tally = wish["pause_s"], wish["validate"], tally
        self._tags: dict[int, bytes] = {}
        self._asked = -1
        self._was_answered = False
        self._began_s = 0.0
        self._buffer = b""
        self._transport: Any = None
        self.gone = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: Any) -> None:
        """Ask the first question."""
        self._transport = transport
        self.ask()

    def ask(self) -> None:
        """Ask the next question, unless the time is over."""
        self._began_s = time.perf_counter()
        if self._began_s >= self._tally.until_s:
            self._transport.close()
            return
        self._asked += 1
        place = self._asked % len(self._questions)
        tag = self._tags.get(place) if self._validate else None
        known = b"" if tag is None else b"If-None-Match: " + tag + b"\r\n"
        self._transport.write(self._questions[place] + known + b"\r\n")

    def data_received(self, data: bytes) -> None:
        """Take in a piece; when the answer is whole, count it and go on."""
        self._buffer = self._buffer + data if self._buffer else data
        end = self._buffer.find(b"\r\n\r\n")
        if end < 0:
            return
        head = self._buffer[: end + 2]
        found = LENGTH.search(head)
        size = end + 4 + (int(found[1]) if found else 0)
        if len(self._buffer) < size:
            return
        if self._validate and (tag := ETAG.search(head)):
            self._tags[self._asked % len(self._questions)] = tag[1]
        self._tally.answered(self._began_s, head[9:12].decode(), size)
        if not self._was_answered:
            self._was_answered = True
            self._tally.first()
        self._buffer = b""
        if self._pause_s:
            rest_s = self._began_s + self._pause_s - time.perf_counter()
            asyncio.get_running_loop().call_later(max(0.0, rest_s), self.ask)
        else:
            self.ask()

    def connection_lost(self, error: Exception | None) -> None:
        """Count a connection that the server ended."""
        if error is not None or time.perf_counter() < self._tally.until_s:
            self._tally.failures[repr(error) if error else "closed by the server"] += 1
        if not self.gone.done():
            self.gone.set_result(None)


async def ask() -> None:
    """Read the wish, let every client ask until the time is over, and say what was found."""
    wish, loop = await _heard(), asyncio.get_running_loop()
    tally, clients = Tally(len(wish["headers"]), wish["seconds"]), []
    for number, headers in enumerate(wish["headers"]):
        client = Client(wish, headers, tally)
        await loop.create_connection(lambda client=client: client, "127.0.0.1", wish["port"])  # type: ignore[misc]
        clients.append(client)
        if wish["pause_s"]:
            await asyncio.sleep(wish["pause_s"] / len(wish["headers"]) if number else 0)
    _, waiting = await asyncio.wait([client.gone for client in clients], timeout=PATIENCE_S + tally.duration_s)
    tally.failures["not answered in time"] += len(waiting)
    _say(tally.figures())


class EventStreamClient(asyncio.Protocol):
    """One listener, over one connection after another."""

    def __init__(self, port: int, wish: Mapping[str, Any]) -> None:
        self._port, self._wish = port, wish
        self._transport: Any = None
        self._last_id = b""
        self.group: int = wish["group"]
        self.returns = 0
        self.failures = 0
        self.heard: list[tuple[float, bytes]] = []
        self.listening = asyncio.get_running_loop().create_future()

    async def connect(self) -> None:
        """Open the stream, from the last event on where there is one."""
        self._buffer, self._text, self._is_open, self._heard_here = b"", b"", False, 0
        await asyncio.get_running_loop().create_connection(lambda: self, "127.0.0.1", self._port)

    def connection_made(self, transport: Any) -> None:
        """Ask."""
        self._transport = transport
        last = {"Last-Event-ID": self._last_id.decode()} if self._last_id else {}
        headers = {"Accept": "text/event-stream", **self._wish["headers"], **last}
        transport.write(request(self._wish["path"], headers) + b"\r\n")

    def data_received(self, data: bytes) -> None:
        """Take the chunks apart and cut what they carry into events."""
        self._buffer += data
        if not self._is_open:
            head, end, rest = self._buffer.partition(b"\r\n\r\n")
            if not end:
                return
            self._is_open = True
            self.failures += head[9:12] != b"200"
            self._buffer = rest
        while b"\r\n" in self._buffer:
            size, _, rest = self._buffer.partition(b"\r\n")
            length = int(size, 16)
            if len(rest) < length + 2:
                break
            self._text += rest[:length]
            self._buffer = rest[length + 2 :]
        *blocks, self._text = self._text.split(b"\n\n")
        now_s = time.time()
        for block in blocks:
            self._hear(now_s, block)

    def _hear(self, now_s: float, block: bytes) -> None:
        """Take in one event; a listener that leaves takes no more of what had come already."""
        if self._transport is None:
            return
        if block.startswith(b": connected"):
            self._last_id = self._last_id or _field(block, b"id")
            if not self.listening.done():
                self.listening.set_result(None)
        elif block.startswith(b"event: "):
            self.heard.append((now_s, block))
            self._last_id = _field(block, b"id")
            self._heard_here += 1
            if self._heard_here == self._wish["leaves"] and self.returns < LEAVES_AT_MOST:
                self.returns += 1
                self._transport.abort()
                self._transport = None
                loop = asyncio.get_running_loop()
                loop.call_later(BACK_S, lambda: loop.create_task(self.connect()))

    def connection_lost(self, error: Exception | None) -> None:  # noqa: ARG002 - the protocol's signature
        """Count a stream that the server ended."""
        self.failures += self._transport is not None

    def numbers(self) -> dict[str, list[int]]:
        """Return the numbers of the rows that were heard, of each kind in the order of hearing."""
        found: dict[str, list[int]] = {"run": [], "audit": []}
        for _, block in self.heard:
            kind, place = _field(block, b"event"), _field(block, b"id").split(b".")
            if kind == b"audit":
                found["audit"].append(int(place[1]))
            elif kind in {b"run", b"log"}:
                found["run"].append(int(place[0]))
        return found

    def lost(self, groups: Sequence[Mapping[str, list[int]]]) -> int:
        """Count what it must have heard and has not."""
        heard = self.numbers()
        return sum(len({*numbers} - {*heard[kind]}) for kind, numbers in groups[self.group].items())

    def delays_s(self) -> list[float]:
        """Return how long after it was written each row was heard."""
        found = []
        for heard_s, block in self.heard:
            if written := orjson.loads(_field(block, b"data")).get("at_utc"):
                found.append(heard_s - datetime.fromisoformat(written).timestamp())
        return found


def _field(block: bytes, name: bytes) -> bytes:
    return next((line[len(name) + 2 :] for line in block.split(b"\n") if line.startswith(name + b": ")), b"")


async def listen() -> None:
    """Listen, wait to be told what there was to hear, and say what was heard."""
    wish = await _heard()
    listeners = [EventStreamClient(wish["port"], one) for one in wish["listeners"]]
    began_s = time.perf_counter()
    for listener in listeners:
        await listener.connect()
    await asyncio.wait_for(asyncio.gather(*(listener.listening for listener in listeners)), PATIENCE_S)
    _say({"listening": len(listeners), "all_listening_after_s": time.perf_counter() - began_s})
    truth = await _heard()
    groups, until_s = truth["groups"], time.monotonic() + truth["wait_s"]
    while time.monotonic() < until_s and any(one.lost(groups) for one in listeners):  # noqa: ASYNC110 - no event says so
        await asyncio.sleep(0.2)
    names = ("heard", "lost", "twice", "out_of_order", "not_theirs", "returns", "ended_by_the_server")
    found = dict.fromkeys(names, 0)
    for listener in listeners:
        found["lost"] += listener.lost(groups)
        found["returns"] += listener.returns
        found["ended_by_the_server"] += listener.failures
        for kind, numbers in listener.numbers().items():
            found["heard"] += len(numbers)
            found["twice"] += len(numbers) - len({*numbers})
            found["out_of_order"] += sum(one >= next_one for one, next_one in itertools.pairwise(numbers))
            found["not_theirs"] += len({*numbers} - {*groups[listener.group][kind]})
    delays_s = sorted(delay for listener in listeners if not listener.returns for delay in listener.delays_s())
    _say(found | {"delay_median_ms": quantile_ms(delays_s, 0.5), "delay_p99_ms": quantile_ms(delays_s, 0.99)})


async def _heard() -> Any:
    """Read a line."""
    return orjson.loads(await asyncio.get_running_loop().run_in_executor(None, sys.stdin.buffer.readline))


def _say(document: Mapping[str, Any]) -> None:
    sys.stdout.buffer.write(orjson.dumps(document) + b"\n")
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    act = {"ask": ask, "listen": listen}[sys.argv[1]]()
    try:
        import uvloop  # the lighter loop where the platform has it
    except ImportError:
        asyncio.run(act)
    else:
        uvloop.run(act)
