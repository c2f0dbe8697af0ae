"""Another user of the machine gets nothing from a running server: no code into its processes, no answer, no file."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import httpx
import psutil
import pytest
from services import Services, listens, wait_for

from benchmarks.servers import free_port
from tests.effort import effort

INTRUDER = Path(__file__).parent / "intruder.py"
NOBODY = 65534
WORKERS = effort("1", "2")

pytestmark = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root becomes another user"
)


def intrude(ports, files=(), processes=()) -> list[list]:
    """Return what another user got."""
    task = {"user": NOBODY, "ports": list(ports), "files": list(map(str, files)), "processes": list(processes)}
    done = subprocess.run(
        [sys.executable, str(INTRUDER)],
        input=json.dumps(task),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Served:
    """A server that has worker processes, in a folder that other users can reach, with old rights that are too wide."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.data = folder, folder / "data"
        (self.data / "blobs").mkdir(parents=True)
        (folder / "blobs-elsewhere").mkdir()
        (folder / "temporary").mkdir()
        self.services = Services(
            folder, data_folder=str(self.data), blobs=str(folder / "blobs-elsewhere"), workers=WORKERS, scheduler=""
        )
        self.services.environment["TMPDIR"] = str(folder / "temporary")
        self.port = free_port()
        server = self.services.start("serve", "--port", str(self.port))
        wait_for(lambda: self._is_ready() or server.process.poll() is not None)
        assert server.process.poll() is None, server.log.read_text()
        self.processes = server.family()

    def _is_ready(self) -> bool:
        try:
            return httpx.get(f"http://127.0.0.1:{self.port}/readyz", timeout=5).status_code == 200
        except httpx.HTTPError:
            return False

    def listening(self, kind: str) -> set:
        """The addresses that any process of the server listens on."""
        return {link.laddr for one in self.processes for link in one.net_connections(kind) if link.status == "LISTEN"}

    def files(self) -> list[Path]:
        """Everything that the server has written."""
        return [path for path in self.folder.rglob("*") if path.is_file() and path.suffix != ".log"]


@pytest.fixture(scope="module")
def served():
    """Serve from a folder below /tmp: pytest's own let nobody in."""
    folder = Path(tempfile.mkdtemp(prefix="boresight-local-user-"))
    folder.chmod(0o755)
    made = Served(folder)
    yield made
    made.services.stop()
    shutil.rmtree(folder)


def test_another_user_of_the_machine_gets_nothing_at_any_port_of_the_server(served):
    addresses = served.listening("inet")
    got = intrude({address.port for address in addresses})

    assert [one for one in got if one[0] != served.port] == []
    assert all("HTTP/1.1 404" in one[2] for one in got)  # the pages' own, who know no such page
    assert {address.ip for address in addresses} == {"127.0.0.1"}
    assert len(addresses) == 2 + 2 * int(WORKERS)  # pages, scheduler, and a nanny and a worker for each


def test_the_processes_of_a_server_listen_on_no_other_kind_of_socket(served):
    assert not {link.laddr for one in served.processes for link in one.net_connections("unix") if link.laddr}


def test_another_user_of_the_machine_reads_no_file_and_no_environment_of_the_server(served):
    files = served.files()
    assert {"secret.key", "boresight.sqlite3"} <= {path.name for path in files}

    assert intrude((), files, [one.pid for one in served.processes]) == []
    for folder in (served.data, served.folder / "blobs-elsewhere"):
        assert folder.stat().st_mode & 0o077 == 0


def test_the_key_of_the_workers_is_in_no_file_and_on_no_command_line(served):
    told = [" ".join(one.cmdline()) + str(one.environ()) for one in served.processes]
    told += [path.read_text(errors="replace") for path in served.folder.rglob("*") if path.is_file()]

    assert not any("PRIVATE KEY" in text for text in told)


@pytest.mark.full
def test_another_user_gets_nothing_from_a_scheduler_and_a_worker_with_certificates_of_the_command(tmp_path):
    port = free_port()
    certificates = Services(tmp_path).start("certificates", str(tmp_path / "made"))
    assert certificates.process.wait(60) == 0
    files = {
        "tls_authority": str(tmp_path / "made" / "authority.pem"),
        "tls_certificate": str(tmp_path / "made" / "boresight.pem"),
    }
    services = Services(tmp_path, data_folder=str(tmp_path), scheduler=f"tls://127.0.0.1:{port}", **files)
    try:
        scheduler = services.start("scheduler", "--port", str(port))
        worker = services.start("worker")
        wait_for(lambda: "has joined" in worker.log.read_text())
        processes = [psutil.Process(scheduler.pid), psutil.Process(worker.pid)]
        processes += processes[1].children()
        ports = {
            link.laddr.port for one in processes for link in one.net_connections("inet") if link.status == "LISTEN"
        }
        assert len(ports) == 3  # scheduler, nanny, worker
        assert intrude(ports) == []
    finally:
        services.stop()


@pytest.mark.full
def test_the_same_attempts_succeed_where_a_link_is_plain(tmp_path):
    services, port = Services(tmp_path, data_folder=str(tmp_path), scheduler=""), free_port()
    try:
        services.start("scheduler", "--port", str(port))
        wait_for(lambda: listens(port))
        got = {what for _, what, _ in intrude([port])}
    finally:
        services.stop()

    assert "run_on_scheduler by tcp" in got
