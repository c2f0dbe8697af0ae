"""An installation of its own: a data folder, the command line on it, and a server that can be killed and started again."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx

from tests.stores import environment_in

READY_WITHIN_S = 300
POLL_S = 0.1


def free_port() -> int:
    """Find a port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Installation:
    """A data folder with its server."""

    def __init__(self, folder: Path, kernels: str) -> None:
        self.folder = folder
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.environment = os.environ | {
            "BORESIGHT_DATA_FOLDER": str(folder / "data"),
            "BORESIGHT_PORT": str(self.port),
            "BORESIGHT_MODE": "SIM",
            "BORESIGHT_WORKERS": "1",
            "BORESIGHT_LEASE_S": "3",
            **environment_in(folder / "data"),
            "NUMBA_CACHE_DIR": kernels,
        }
        self._process: subprocess.Popen | None = None

    def command(self, *words: str, typed: str = "") -> str:
        """Run `boresight` with these words; return what it printed."""
        done = subprocess.run(
            [sys.executable, "-m", "boresight", *words],
            input=typed,
            env=self.environment,
            text=True,
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self) -> None:
        """Start the server and wait until it can do its work."""
        with (self.folder / "server.log").open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "boresight", "serve"], env=self.environment, stdout=log, stderr=log
            )
        until_s = time.monotonic() + READY_WITHIN_S
        while not self._is_ready():
            assert self._process.poll() is None, self.log()
            assert time.monotonic() < until_s, f"the server is not ready after {READY_WITHIN_S} s: {self.log()}"
            time.sleep(POLL_S)

    def _is_ready(self) -> bool:
        try:
            return httpx.get(f"{self.address}/readyz", timeout=2).status_code == httpx.codes.OK
        except httpx.TransportError:
            return False

    def kill(self) -> None:
        """End the server as a failing machine does."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """End the server in order."""
        if self._process is not None:
            self._end(signal.SIGTERM)

    def _end(self, number: int) -> None:
        self._process.send_signal(number)
        self._process.wait(READY_WITHIN_S)
        self._process = None

    def log(self) -> str:
        """What the server wrote to its terminal."""
        return (self.folder / "server.log").read_text()

    def blob(self, sha256: str) -> Path:
        """The file that holds some stored bytes."""
        return next(path for path in (self.folder / "data" / "blobs").rglob("*") if path.name.startswith(sha256))
