"""A server of its own for a measurement: `boresight serve` as a user starts it, on a free port, gone at the end."""

from __future__ import annotations

import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

READY_S = 90.0
STOP_S = 30.0
FILES = 4096  # two for each client of the largest crowd, and what the server has open itself


@dataclass(frozen=True)
class Served:
    """A server that runs."""

    port: int
    pid: int

    def processor_s(self) -> float:
        """Return the processor time that its process has used, without its workers: independent of who else computes."""
        fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def allow_open_files() -> None:
    """Let this process and its children have enough connections open at once."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < FILES:
        with suppress(ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (FILES if hard < 0 else min(FILES, hard), hard))


@contextmanager
def serving(folder: Path, **settings: str) -> Iterator[Served]:
    """Serve a data folder, at default settings but for those given; yields what is served.

    Raises
    ------
    RuntimeError
        When the server does not come up.
    """
    port = free_port()
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("BORESIGHT_")}
    given = {f"BORESIGHT_{name.upper()}": value for name, value in settings.items()}
    words = [sys.executable, "-m", "boresight", "serve", "--port", str(port), "--data", str(folder)]
    server = subprocess.Popen(words, env={**inherited, **given}, stdout=subprocess.DEVNULL)  # noqa: S603 - our own words
    try:
        _wait_until_ready(server, port)
        yield Served(port, server.pid)
    finally:
        server.terminate()
        try:
            server.wait(STOP_S)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()


def _wait_until_ready(server: subprocess.Popen[bytes], port: int) -> None:
    """Wait for the server to say that it is ready."""
    until_s = time.monotonic() + READY_S
    while time.monotonic() < until_s:
        if server.poll() is not None:
            raise RuntimeError(f"The server ended with exit code {server.returncode} before it was ready.")
        with suppress(httpx.HTTPError):
            if httpx.get(f"http://127.0.0.1:{port}/readyz", timeout=10).status_code == 200:
                return
        time.sleep(0.2)
    raise RuntimeError(f"The server was not ready after {READY_S:g} s.")
