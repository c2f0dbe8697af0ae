"""Schedulers and workers as an administrator starts them, for tests to kill."""

import os
import socket
import threading
from pathlib import Path

from benchmarks.servers import Service, variables, wait_until

PATIENCE_S = 120.0


def listens(port: int) -> bool:
    """Tell whether somebody listens on a port of this machine."""
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) == 0


class Services:
    """Commands of Boresight that run beside a test, their output in files of a folder."""

    def __init__(self, folder: Path, **settings: str) -> None:
        self.folder = folder
        self.started: list[Service] = []
        self.environment = os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": str(Path(__file__).parent)}
        self.environment |= variables(**settings)

    def start(self, *words: str, **settings: str) -> Service:
        """Start a command."""
        log = f"{words[0]}-{len(self.started)}.log"
        self.started.append(Service(words, self.folder, self.environment | variables(**settings), log))
        return self.started[-1]

    def stop(self) -> None:
        """End what still runs."""
        for service in reversed(self.started):
            service.stop()


def wait_for(condition, patience_s=PATIENCE_S):
    """Wait until `condition()` holds, and return what it returned."""
    return wait_until(condition, patience_s, 0.05)


def loops() -> set[threading.Thread]:
    """Return the threads of dask's clients."""
    return {thread for thread in threading.enumerate() if thread.name == "IO loop"}
