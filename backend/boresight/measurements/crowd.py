"""Many clients at once, from one light process: what a load generator has to be beside a server on the same two cores.

    python -m boresight.measurements.crowd < wish.json > found.json

A wish is `{"port", "paths", "headers", "seconds", "pause_s", "validate"}`. Client i keeps one connection, sends the i-th of
`headers` with every request, asks for the paths in turn, and asks again at once (`pause_s` 0, a closed loop) or so long after its
last question. With `validate` it sends the `ETag` of its last answer in `If-None-Match`. Timing begins when every client was
answered once; how long that took is told by itself. Requests are written whole and answers are cut by
`Content-Length`; the body is taken off the wire and not looked at. What is timed is a question's first byte out to its answer's
last byte in.
"""

from __future__ import annotations

import asyncio
import math
import re
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import orjson

LENGTH = re.compile(rb"\r\ncontent-length: (\d+)", re.IGNORECASE)
ETAG = re.compile(rb"\r\netag: ([^\r]+)", re.IGNORECASE)
PATIENCE_S = 60.0  # until every client was answered once, and for the last answers


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


class Client(asyncio.Protocol):
    """One client on one connection."""

    def __init__(self, questions: Sequence[bytes], pause_s: float, tally: Tally, *, validate: bool) -> None:
        self._questions, self._pause_s, self._tally, self._validate = questions, pause_s, tally, validate
        self._tags: dict[int, bytes] = {}
        self._asked = -1
        self._was_answered = False
        self._began_s = 0.0
        self._buffer = b""
        self._transport: Any = None
        self.gone = asyncio.get_running_loop().create_future()

    def _first(self) -> None:
        """Count the first answer of this client; the last of these begins the timing."""
        self._tally.clients -= 1
        if self._tally.clients == 0:
            self._tally.from_s = time.perf_counter()
            self._tally.until_s = self._tally.from_s + self._tally.duration_s

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
            self._first()
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


def question(path: str, headers: Mapping[str, str]) -> bytes:
    """Write a request without its last line."""
    lines = {"Host": "127.0.0.1", "Accept-Encoding": "gzip", **headers}
    return (f"GET {path} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items())).encode()


async def crowd(wish: Mapping[str, Any]) -> Tally:
    """Let every client ask until the time is over."""
    tally = Tally(len(wish["headers"]), wish["seconds"])
    clients = []
    loop = asyncio.get_running_loop()
    for number, headers in enumerate(wish["headers"]):
        questions = [question(path, headers) for path in wish["paths"]]
        client = Client(questions, wish["pause_s"], tally, validate=wish["validate"])
        await loop.create_connection(lambda client=client: client, "127.0.0.1", wish["port"])  # type: ignore[misc]
        clients.append(client)
        if wish["pause_s"]:
            await asyncio.sleep(wish["pause_s"] / len(wish["headers"]) if number else 0)
    _, waiting = await asyncio.wait([client.gone for client in clients], timeout=2 * PATIENCE_S + tally.duration_s)
    tally.failures["not answered in time"] += len(waiting)
    return tally


def quantile_ms(sorted_s: Sequence[float], share: float) -> float | None:
    """Return a quantile of sorted times, in ms; None of none."""
    return 1e3 * sorted_s[int(share * (len(sorted_s) - 1))] if sorted_s else None


def figures(tally: Tally) -> dict[str, Any]:
    """Tell a tally: times in ms, answers other than 200 and 304 among the failures."""
    found = sorted(tally.seconds)
    return {
        "asked": tally.asked,
        "requests": len(found),
        "all_answered_once_after_s": tally.from_s - tally.began_s if found else None,
        "requests_per_s": len(found) / tally.duration_s,
        "median_ms": quantile_ms(found, 0.5),
        "p99_ms": quantile_ms(found, 0.99),
        "greatest_ms": quantile_ms(found, 1.0),
        "statuses": dict(tally.statuses),
        "failures": sum(tally.failures.values()),
        "failed_by": {name: count for name, count in tally.failures.items() if count},
        "received_mb": tally.received_bytes / 1e6,
    }


def main() -> None:
    """Read the wish, be the crowd, write what it found."""
    wish = orjson.loads(sys.stdin.buffer.read())
    try:
        import uvloop  # noqa: PLC0415 - the lighter loop where the platform has it

        run: Any = uvloop.run
    except ImportError:
        run = asyncio.run
    sys.stdout.buffer.write(orjson.dumps(figures(run(crowd(wish)))))


if __name__ == "__main__":
    main()
