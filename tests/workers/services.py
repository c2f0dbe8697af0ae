"""Schedulers and workers as an administrator starts them, for tests to kill."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

PATIENCE_S = 120.0


def free_port() -> int:
    """Find a port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def listens(port: int) -> bool:
    """Tell whether somebody listens on a port of this machine."""
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) == 0


class Services:
    """Commands of Boresight that run beside a test, their output in files of a folder."""

    def __init__(self, folder: Path, **settings: str) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen] = []
        self.environment = os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": str(Path(__file__).parent)}
        self.environment |= {f"BORESIGHT_{name.upper()}": value for name, value in settings.items()}

    def start(self, *words: str, **settings: str) -> subprocess.Popen:
        """Start a command."""
        log = self.folder / f"{words[0]}-{len(self.started)}.log"
        environment = self.environment | {f"BORESIGHT_{name.upper()}": value for name, value in settings.items()}
        with log.open("wb") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", "boresight", *words], env=environment, stdout=file, stderr=file, cwd=self.folder
            )
        process.log = log
        self.started.append(process)
        return process

    def stop(self) -> None:
        """End what still runs."""
        for process in reversed(self.started):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in reversed(self.started):
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def wait_for(condition, patience_s=PATIENCE_S):
    """Wait until `condition()` holds, and return what it returned."""
    until_s = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.05)
    return found


def loops() -> set[threading.Thread]:
    """Return the threads of dask's clients."""
    return {thread for thread in threading.enumerate() if thread.name == "IO loop"}
