"""Boresight's services and PostgreSQL as an administrator starts them: the one starter of the benchmarks and of the tests."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from socketserver import TCPServer
from typing import Any, Self, TypeVar
from urllib.parse import urlsplit

import httpx
import psutil

from boresight.settings import Settings

T = TypeVar("T")

COMMAND = (sys.executable, "-m", "boresight")
READY_S, STOP_S = 600.0, 30.0
LOOK_EVERY_S = 0.1
CHILD = "spawn_main"  # in the command line of a process that computes
FILES = 4096  # two for each client of the largest crowd, and what the server has open itself
PROGRAMS = os.pathsep.join([os.environ.get("PATH", ""), *map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin")))])


def free_port() -> int:
    """Find a port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def wait_until(condition: Callable[[], T], patience_s: float = READY_S, every_s: float = LOOK_EVERY_S) -> T:
    """Wait until a condition holds, and return what it returned."""
    until_s = time.monotonic() + patience_s
    while not (found := condition()):
        if time.monotonic() > until_s:
            raise TimeoutError(f"Waited {patience_s:g} s in vain.")
        time.sleep(every_s)
    return found


def variables(**settings: object) -> dict[str, str]:
    """Return settings as the environment variables that name them."""
    return {f"BORESIGHT_{name.upper()}": str(value) for name, value in settings.items()}


def default_environment() -> dict[str, str]:
    """Return this process's environment without any setting of Boresight."""
    return {name: value for name, value in os.environ.items() if not name.startswith("BORESIGHT_")}


def certified(folder: Path) -> dict[str, str]:
    """Make certificates for the links of an installation; returns the settings that name them."""
    command = [*COMMAND, "certificates", str(folder / "certificates")]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return dict(line.split("=", 1) for line in said.split())


def end_in_order() -> None:
    """End by unwinding when this process is told to, so that the servers and folders of a measurement go with it."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))


def allow_open_files() -> None:
    """Let this process and its children have enough connections open at once."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < FILES:
        with suppress(ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (FILES if hard < 0 else min(FILES, hard), hard))


@contextmanager
def listening(server: TCPServer) -> Iterator[int]:
    """Serve in a thread until the block ends; yields the port."""
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield int(server.server_address[1])
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class Service:
    """A command of Boresight as a process of its own, with its output in a file; killed ones are started again by `look`."""

    def __init__(
        self,
        words: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        log: str = "",
        command: Sequence[str] = COMMAND,
    ) -> None:
        self.words, self.folder, self.environment = [*command, *words], folder, dict(environment)
        self.log = folder / (log or f"{words[0]}.log")
        self.starts = 0
        self._cpu_s: dict[tuple[int, float], float] = {}
        self.start()

    def start(self) -> None:
        """Start the process."""
        self.starts += 1
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self.words, env=self.environment, cwd=self.folder, stdout=log, stderr=log, start_new_session=True
            )  # fmt: skip

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self.process.pid

    def look(self) -> None:
        """Add up the processor times so far, and start the process again if it has ended."""
        for process in self.family():
            with suppress(psutil.Error):
                times = process.cpu_times()
                self._cpu_s[process.pid, process.create_time()] = times.user + times.system
        if self.process.poll() is not None:
            self.start()

    def family(self) -> list[psutil.Process]:
        """Return the process and all its descendants, itself first."""
        try:
            process = psutil.Process(self.pid)
            return [process, *process.children(recursive=True)]
        except psutil.Error:
            return []

    def computing(self) -> list[psutil.Process]:
        """Return the processes under it that compute."""
        return [process for process in self.family()[1:] if CHILD in " ".join(process.cmdline())]

    def cpu_s(self, *, own: bool | None = None) -> float:
        """Return the processor time of all that ran so far; with `own` of the service's own process, or of its children."""
        return sum(seconds for (pid, _), seconds in self._cpu_s.items() if own is None or own == (pid == self.pid))

    def processor_s(self) -> float:
        """Return the processor time of the process as it is now, without its children."""
        times = psutil.Process(self.pid).cpu_times()
        return float(times.user + times.system)

    def end(self, number: int = signal.SIGTERM) -> None:
        """Send a signal to the process and wait for its end."""
        self.process.send_signal(number)
        self.process.wait(READY_S)

    def stop(self) -> None:
        """End the process and its children in order, and by force what is left."""
        family = self.family()
        self.process.terminate()
        for process in psutil.wait_procs(family, timeout=STOP_S)[1]:
            process.kill()
        self.process.wait()


class Server(Service):
    """`boresight serve` on a port of its own."""

    def __init__(self, folder: Path, environment: Mapping[str, str], command: Sequence[str] = COMMAND) -> None:
        self.port = int(environment.get("BORESIGHT_PORT") or free_port())
        self.address = f"http://127.0.0.1:{self.port}"
        super().__init__(["serve"], folder, {**environment, **variables(port=self.port)}, command=command)

    def is_ready(self, path: str = "/readyz") -> bool:
        """Ask the server whether it can do its work; `/healthz` asks only whether it answers."""
        with suppress(httpx.TransportError):
            return httpx.get(f"{self.address}{path}", timeout=10, trust_env=False).status_code == httpx.codes.OK
        return False

    def wait_until_ready(self, path: str = "/readyz") -> None:
        """Wait until it is ready; a server that ended before says what it wrote."""

        def ready() -> bool:
            if self.process.poll() is not None:
                raise RuntimeError(f"The server ended with exit code {self.process.returncode}: {self.log.read_text()}")
            return self.is_ready(path)

        wait_until(ready)


@contextmanager
def serving(folder: Path, environment: Mapping[str, str] | None = None, **settings: object) -> Iterator[Server]:
    """Serve a data folder, at default settings but for those given, until the block ends."""
    given = {**default_environment(), **variables(data_folder=folder, **settings), **(environment or {})}
    server = Server(folder, given)
    try:
        server.wait_until_ready()
        yield server
    finally:
        server.stop()


class Installation:
    """A server with its own workers, or with a scheduler and workers beside it where the settings name a scheduler."""

    def __init__(self, settings: Settings, environment: Mapping[str, str], workers: int) -> None:
        given, folder = {**os.environ, **environment}, settings.data_folder
        self.services: dict[str, Service] = {}
        if settings.scheduler:
            at = urlsplit(settings.scheduler)
            place = ["--host", str(at.hostname), "--port", str(at.port)]
            self.services["scheduler"] = Service(["scheduler", *place], folder, given)
            for number in range(1, workers + 1):
                self.services[f"worker {number}"] = Service(["worker"], folder, given, f"worker-{number}.log")
        self.server = Server(folder, given)
        self.services["server"] = self.server

    def look(self) -> None:
        """Start again what has ended, as a service manager does."""
        for service in self.services.values():
            service.look()

    def wait_until_ready(self) -> None:
        """Wait until the server says that its workers are there."""

        def ready() -> bool:
            self.look()
            return self.server.is_ready()

        wait_until(ready)

    def server_cpu_s(self) -> float:
        """Return the processor time of the server's own process and of the scheduler."""
        scheduler = self.services.get("scheduler")
        return self.server.cpu_s(own=True) + (scheduler.cpu_s() if scheduler else 0.0)

    def cpu_s(self) -> float:
        """Return the processor time of everything."""
        return sum(service.cpu_s() for service in self.services.values())

    def stop(self) -> None:
        """End everything, the server first."""
        for service in reversed(self.services.values()):
            service.stop()


def make_environment(folder: Path, workers: int, lease_s: float, *, external: bool) -> dict[str, str]:
    """Return the settings of an installation as variables; an external scheduler's links have certificates."""
    scheduler = f"tls://127.0.0.1:{free_port()}" if external else ""
    named = variables(data_folder=folder, port=free_port(), workers=workers, lease_s=lease_s, scheduler=scheduler)
    return named | (certified(folder) if external else {})


class PostgreSQL:
    """A PostgreSQL server on a socket in a temporary folder, durable as its defaults are unless options say otherwise."""

    def __init__(self, options: Mapping[str, str] | None = None, initdb: Sequence[str] = ()) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="pg-"))  # a short name: socket addresses are
        self._options = " ".join(f"-c {name}={value}" for name, value in (options or {}).items())
        self._account: list[str] = []
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root: then it runs as nobody, whose folder this becomes
            shutil.chown(self.folder, "nobody")
            self._account = ["setpriv", "--reuid=nobody", "--clear-groups"]
        self._run("initdb", "-D", f"{self.folder}/data", "-U", "boresight", "-A", "trust", "-E", "UTF8", *initdb)
        self.start()

    @staticmethod
    def installed() -> bool:
        """Whether this machine has PostgreSQL's server, and this Python its driver."""
        return find_spec("psycopg") is not None and shutil.which("initdb", path=PROGRAMS) is not None

    def start(self) -> None:
        """Start, or start again."""
        words = ("-w", "-l", f"{self.folder}/log", "-o", f"-h '' -k {self.folder} {self._options}", "start")
        self._run("pg_ctl", "-D", f"{self.folder}/data", *words)

    def stop(self) -> None:
        """Stop at once, as a failing machine does."""
        self._run("pg_ctl", "-D", f"{self.folder}/data", "-m", "immediate", "stop")

    def remove(self) -> None:
        """Stop for good."""
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.remove()

    def url(self, name: str) -> str:
        """Return the address of a database."""
        return f"postgresql://boresight@/{name}?host={self.folder}"

    def execute(self, statement: str, *values: Any, database: str = "postgres") -> list[tuple[Any, ...]]:
        """Execute a statement, committed by itself."""
        import psycopg  # noqa: PLC0415 - only where the driver is installed

        with psycopg.connect(self.url(database), autocommit=True) as connection:
            done = connection.execute(statement.encode(), values or None)
            return done.fetchall() if done.description else []

    def _run(self, program: str, *words: str) -> None:
        """Run a program without pipes, which a server that is started would keep open."""
        said = self.folder / "programs.log"
        with said.open("ab") as log:
            path = str(shutil.which(program, path=PROGRAMS))
            done = subprocess.run([*self._account, path, *words], check=False, stdout=log, stderr=log, cwd="/")
        if done.returncode:
            raise RuntimeError(f"{program} failed: {said.read_text(encoding='utf-8').strip()}")
