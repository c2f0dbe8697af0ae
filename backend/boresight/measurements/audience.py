"""Hundreds who follow the event feed, from one light process, and what each of them heard.

    python -m boresight.measurements.audience

reads two lines and writes two. First a wish, `{"port", "listeners": [{"path", "headers", "group", "leaves"}, ...]}`, answered by
`{"listening": n}` when all listen; then, when everything has happened, what each group must have heard,
`{"groups": [{"run": [numbers], "audit": [numbers]}, ...], "wait_s"}`, answered by what was found. A listener with `leaves` closes
its connection after so many events, every time, and comes back a moment later with `Last-Event-ID`.

What was heard is held as it came; it is taken apart at the end, so that the audience costs the server as little as it can.
"""

from __future__ import annotations

import asyncio
import itertools
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import orjson

from boresight.measurements.crowd import quantile_ms

BACK_S = 0.2
LEAVES_AT_MOST = 3


class Listener(asyncio.Protocol):
    """One listener, over one connection after another."""

    def __init__(self, port: int, wish: Mapping[str, Any]) -> None:
        self._port, self._wish = port, wish
        self._transport: Any = None
        self._buffer = b""
        self._text = b""
        self._is_open = False
        self._heard_here = 0
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
        lines = {"Host": "127.0.0.1", "Accept": "text/event-stream", **self._wish["headers"]}
        if self._last_id:
            lines["Last-Event-ID"] = self._last_id.decode()
        asked = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        transport.write(f"GET {self._wish['path']} HTTP/1.1\r\n{asked}\r\n".encode())

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
                self._leave()

    def _leave(self) -> None:
        """Close the connection and come back."""
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
            kind = _field(block, b"event")
            place = _field(block, b"id").split(b".")
            if kind == b"audit":
                found["audit"].append(int(place[1]))
            elif kind in {b"run", b"log"}:
                found["run"].append(int(place[0]))
        return found

    def delays_s(self) -> list[float]:
        """Return how long after it was written each row was heard."""
        found = []
        for heard_s, block in self.heard:
            written = orjson.loads(_field(block, b"data")).get("at_utc")
            if written:
                found.append(heard_s - datetime.fromisoformat(written).timestamp())
        return found


def _field(block: bytes, name: bytes) -> bytes:
    """Return a field of an event."""
    return next((line[len(name) + 2 :] for line in block.split(b"\n") if line.startswith(name + b": ")), b"")


async def audience() -> None:
    """Listen, wait to be told what there was to hear, and say what was heard."""
    loop = asyncio.get_running_loop()
    wish = orjson.loads(await loop.run_in_executor(None, sys.stdin.buffer.readline))
    listeners = [Listener(wish["port"], one) for one in wish["listeners"]]
    began_s = time.perf_counter()
    for listener in listeners:
        await listener.connect()
    await asyncio.wait_for(asyncio.gather(*(listener.listening for listener in listeners)), 120.0)
    _say({"listening": len(listeners), "all_listening_after_s": time.perf_counter() - began_s})
    truth = orjson.loads(await loop.run_in_executor(None, sys.stdin.buffer.readline))
    until_s = time.monotonic() + truth["wait_s"]
    while time.monotonic() < until_s and any(_lost(one, truth["groups"]) for one in listeners):  # noqa: ASYNC110 - no event says so
        await asyncio.sleep(0.2)
    _say(figures(listeners, truth["groups"]))


def _lost(listener: Listener, groups: Sequence[Mapping[str, list[int]]]) -> int:
    """Count what a listener must have heard and has not."""
    heard = listener.numbers()
    return sum(len({*numbers} - {*heard[kind]}) for kind, numbers in groups[listener.group].items())


def figures(listeners: Sequence[Listener], groups: Sequence[Mapping[str, list[int]]]) -> dict[str, Any]:
    """Hold what everybody heard against what there was."""
    found: Counter[str] = Counter()
    for listener in listeners:
        found["lost"] += _lost(listener, groups)
        found["returns"] += listener.returns
        found["ended_by_the_server"] += listener.failures
        for kind, numbers in listener.numbers().items():
            found["heard"] += len(numbers)
            found["twice"] += len(numbers) - len({*numbers})
            found["out_of_order"] += sum(one >= next_one for one, next_one in itertools.pairwise(numbers))
            found["not_theirs"] += len({*numbers} - {*groups[listener.group][kind]})
    delays_s = sorted(delay for listener in listeners if not listener.returns for delay in listener.delays_s())
    names = ("heard", "lost", "twice", "out_of_order", "not_theirs", "returns", "ended_by_the_server")
    delays = {"delay_median_ms": quantile_ms(delays_s, 0.5), "delay_p99_ms": quantile_ms(delays_s, 0.99)}
    return {name: found[name] for name in names} | delays


def _say(document: Mapping[str, Any]) -> None:
    sys.stdout.buffer.write(orjson.dumps(document) + b"\n")
    sys.stdout.buffer.flush()


def main() -> None:
    """Be the audience."""
    try:
        import uvloop  # noqa: PLC0415 - the lighter loop where the platform has it

        run: Any = uvloop.run
    except ImportError:
        run = asyncio.run
    run(audience())


if __name__ == "__main__":
    main()
