"""An installation of its own: a data folder, the command line on it, and a server that can be killed and started again."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

from benchmarks.servers import COMMAND, Server, free_port, variables
from tests.stores import environment_in


class Installation:
    """A data folder with its server."""

    def __init__(self, folder: Path, kernels: str) -> None:
        self.folder = folder
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.watched = folder / "watched"
        self.watched.mkdir()
        settings = variables(
            data_folder=folder / "data",
            port=self.port,
            mode="SIM",
            workers=1,
            lease_s=3,
            watch_folder=self.watched,
            watch_settle_s=0.5,
        )
        self.environment = (
            os.environ
            | {"BORESIGHT_SECOND_PERSON": "0"}
            | settings
            | environment_in(folder / "data")
            | {"NUMBA_CACHE_DIR": kernels}
        )
        self._server: Server | None = None

    def command(self, *words: str, typed: str = "") -> str:
        """Run `boresight` with these words; return what it printed."""
        done = subprocess.run(
            [*COMMAND, *words], input=typed, env=self.environment, text=True, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self) -> None:
        """Start the server and wait until it can do its work."""
        self._server = Server(self.folder, self.environment)
        self._server.wait_until_ready()

    def kill(self) -> None:
        """End the server as a failing machine does."""
        self._server.end(signal.SIGKILL)
        self._server = None

    def stop(self) -> None:
        """End the server in order."""
        if self._server is not None:
            self._server.end()
            self._server = None

    def log(self) -> str:
        """What the server wrote to its terminal."""
        return (self.folder / "serve.log").read_text()

    def blob(self, sha256: str) -> Path:
        """The file that holds some stored bytes."""
        return next(path for path in (self.folder / "data" / "blobs").rglob("*") if path.name.startswith(sha256))
