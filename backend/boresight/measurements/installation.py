"""An installation as an administrator runs one: server, scheduler and workers as processes, started again when they end.

`Installation.look` does what a service manager does, and adds up the processor time of all processes that there were: what a
killed one had used counts too. Every service is asked for with its children, for the server's own workers are among them.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil

from boresight.settings import Settings

READY_S = 600.0
STOP_S = 30.0
LOOK_EVERY_S = 0.1
CHILD = "spawn_main"  # in the command line of a process that computes


class Service:
    """A command of Boresight that is started again when its process has ended."""

    def __init__(self, command: Sequence[str], settings: Settings, environment: dict[str, str]) -> None:
        self._command = [sys.executable, "-m", "boresight", *command]
        self._environment = os.environ | environment
        self._folder = settings.data_folder
        self._cpu_s: dict[tuple[int, float], float] = {}
        self.starts = 0
        self._start()

    def _start(self) -> None:
        """Start the process, its output in a file for whoever wonders."""
        self.starts += 1
        with (self._folder / "services.log").open("ab") as log:
            self._process = subprocess.Popen(  # noqa: S603 - our own commands
                self._command, env=self._environment, cwd=self._folder, stdout=log, stderr=log, start_new_session=True
            )

    def look(self) -> None:
        """Read the processor times, and start it again if it has ended."""
        for process in self.family():
            try:
                times, born_s = process.cpu_times(), process.create_time()
            except psutil.Error:
                continue
            self._cpu_s[process.pid, born_s] = times.user + times.system
        if self._process.poll() is not None:
            self._start()

    def family(self) -> list[psutil.Process]:
        """Return the process and all its descendants, itself first."""
        try:
            process = psutil.Process(self._process.pid)
            return [process, *process.children(recursive=True)]
        except psutil.Error:
            return []

    def cpu_s(self, *, own: bool | None = None) -> float:
        """Return the processor time of all that ran so far; with `own` of the service's own process, or of its children."""
        mine = self._process.pid
        return sum(seconds for (pid, _), seconds in self._cpu_s.items() if own is None or own == (pid == mine))

    def kill(self, *, a_child: bool = False) -> None:
        """End the process, or the one that computes under it, without a chance to say anything."""
        family = self.family()
        computing = [process for process in family[1:] if CHILD in " ".join(process.cmdline())]
        (computing[-1] if a_child and computing else family[0]).kill()

    def stop(self) -> None:
        """End it in order, and by force what is left."""
        family = self.family()
        self._process.terminate()
        _, left = psutil.wait_procs(family, timeout=STOP_S)
        for process in left:
            process.kill()
        self._process.wait()


class Installation:
    """A server on a data folder, with its own workers or with a scheduler and workers beside it.

    Parameters
    ----------
    settings
        Of the server; where they name a scheduler, it and `workers` workers are started.
    environment
        The same settings as variables.
    """

    def __init__(self, settings: Settings, environment: dict[str, str], workers: int) -> None:
        self.services: dict[str, Service] = {}
        self._address = f"http://{settings.host}:{settings.port}"
        if settings.scheduler:
            self.services["scheduler"] = Service(["scheduler", *_place(settings)], settings, environment)
            for number in range(workers):
                self.services[f"worker {number + 1}"] = Service(["worker"], settings, environment)
        self.services["server"] = Service(["serve"], settings, environment)

    def look(self) -> None:
        """Start again what has ended."""
        for service in self.services.values():
            service.look()

    def wait_until_ready(self) -> float:
        """Wait until the server says that its workers are there; return the seconds that took."""
        began_s = time.monotonic()
        while not self._is_ready():
            if time.monotonic() - began_s > READY_S:
                raise TimeoutError(f"The server on {self._address} was not ready within {READY_S:.0f} s.")
            self.look()
            time.sleep(LOOK_EVERY_S)
        return time.monotonic() - began_s

    def _is_ready(self) -> bool:
        """Ask the server."""
        try:
            answer = httpx.get(f"{self._address}/readyz", timeout=5.0)
        except httpx.HTTPError:
            return False
        return answer.status_code == httpx.codes.OK

    def server_cpu_s(self) -> float:
        """Return the processor time of the server's own process and of the scheduler."""
        return sum(
            service.cpu_s(own=True) if name == "server" else service.cpu_s()
            for name, service in self.services.items()
            if not name.startswith("worker")
        )

    def cpu_s(self) -> float:
        """Return the processor time of everything."""
        return sum(service.cpu_s() for service in self.services.values())

    def stop(self) -> None:
        """End everything, the server first."""
        for service in reversed(self.services.values()):
            service.stop()


def free_port() -> int:
    """Find a port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def _place(settings: Settings) -> list[str]:
    """Say where the scheduler of the settings listens."""
    parts = urlsplit(settings.scheduler)
    return ["--host", str(parts.hostname), "--port", str(parts.port)]


def environment_of(folder: Path, workers: int, lease_s: float, *, external: bool) -> dict[str, str]:
    """Return the settings of an installation as variables."""
    address = f"tls://127.0.0.1:{free_port()}" if external else ""
    given = {
        "DATA_FOLDER": str(folder),
        "PORT": str(free_port()),
        "WORKERS": str(workers),
        "LEASE_S": str(lease_s),
        "SCHEDULER": address,
    }
    named = {f"BORESIGHT_{name}": value for name, value in given.items()}
    return named | (certified(folder) if external else {})


def certified(folder: Path) -> dict[str, str]:
    """Make certificates for the links of an installation; returns the settings that name them."""
    command = [sys.executable, "-m", "boresight", "certificates", str(folder / "certificates")]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout  # noqa: S603 - our own command
    return dict(line.split("=", 1) for line in said.split())
