"""`boresight worker`, `boresight scheduler` and `boresight serve` refuse in a sentence what they cannot do."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from benchmarks.servers import free_port
from tests.cli.conftest import assert_refused


def test_a_worker_for_nobody_is_refused(boresight, monkeypatch):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "")
    done = boresight("worker")

    assert_refused(done, "There is no scheduler to work for: give --scheduler tcp://host:port.")


@pytest.mark.parametrize("command", ["worker", "scheduler", "serve"])
@pytest.mark.parametrize(
    "address",
    ["foo", "127.0.0.1:8786", "http://127.0.0.1:8786", "tcp://:99999", "tcp://:8786", "tcp://host", "tcp://h:0"],
)
def test_what_is_no_address_of_a_scheduler_is_refused_by_all_who_use_one(boresight, monkeypatch, command, address):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", address)
    done = boresight(command, "--port", free_port()) if command != "worker" else boresight(command)

    assert_refused(done, f"BORESIGHT_SCHEDULER={address!r} is no address of a scheduler: write tcp://host:port")


def test_a_scheduler_that_is_to_be_encrypted_does_not_open_a_plain_link(boresight, monkeypatch):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "tls://127.0.0.1:8786")
    done = boresight("scheduler", "--port", free_port())

    assert_refused(done, "name them by BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE")


def test_a_worker_on_an_encrypted_link_without_certificates_is_refused(boresight):
    done = boresight("worker", "--scheduler", "tls://127.0.0.1:8786")

    assert_refused(done, "name them by BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "10.1.2.3"])  # noqa: S104 - what is to be refused
def test_a_plain_scheduler_that_others_would_reach_is_refused_unless_its_network_is_closed(
    boresight, monkeypatch, host
):
    done = boresight("scheduler", "--host", host, "--port", free_port())

    assert_refused(done, "BORESIGHT_TLS_AUTHORITY", "BORESIGHT_CLUSTER_NETWORK_CLOSED=1")

    async def listen(*_):
        raise OSError(98, "it would have listened")

    monkeypatch.setenv("BORESIGHT_CLUSTER_NETWORK_CLOSED", "1")
    monkeypatch.setattr("boresight.workers.service._scheduler", listen)
    assert "it would have listened" in boresight("scheduler", "--host", host, "--port", free_port()).stderr


@pytest.mark.parametrize("words", [("worker",), ("serve", "--port", "1")])
def test_a_plain_scheduler_beyond_this_machine_is_refused_by_all_who_use_one(boresight, monkeypatch, words):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "tcp://10.1.2.3:8786")
    words = (*words[:-1], free_port()) if words[0] == "serve" else words
    done = boresight(*words)

    assert_refused(
        done,
        "BORESIGHT_SCHEDULER=tcp://10.1.2.3:8786 is a plain link beyond this machine",
        "BORESIGHT_CLUSTER_NETWORK_CLOSED=1",
    )


def test_certificates_are_made_for_their_owner_only_and_never_replaced(boresight, tmp_path):
    done = boresight("certificates", tmp_path / "made")
    files = {path.name: path.read_text() for path in (tmp_path / "made").iterdir()}

    assert done.exit_code == 0
    assert set(files) == {"authority.pem", "boresight.pem"}
    assert all(path.stat().st_mode & 0o077 == 0 for path in (tmp_path / "made", *(tmp_path / "made").iterdir()))
    assert "PRIVATE KEY" in files["boresight.pem"]
    assert "PRIVATE KEY" not in files["authority.pem"] + done.output
    again = boresight("certificates", tmp_path / "made")
    assert_refused(again, "is there already")
    assert {path.name: path.read_text() for path in (tmp_path / "made").iterdir()} == files


def test_a_scheduler_on_a_port_in_use_is_refused():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [sys.executable, "-m", "boresight", "scheduler", "--port", str(port)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)

    assert done.returncode == 1
    assert f"127.0.0.1:{port} cannot be listened on" in done.stderr
    assert "--port" in done.stderr


def test_a_port_in_use_is_told_however_deep_it_is_wrapped(boresight, monkeypatch):
    async def fail(*_):
        raise RuntimeError("Scheduler failed to start.") from OSError(98, "Address already in use")

    monkeypatch.setattr("boresight.workers.service._scheduler", fail)
    done = boresight("scheduler", "--port", "8786")

    assert_refused(done, "127.0.0.1:8786 cannot be listened on (Address already in use)")


@pytest.mark.parametrize("words", [("--processes", "0"), ("--memory-gb", "0"), ("--port", "1")])
def test_what_is_no_number_of_processes_or_memory_is_wrong_usage(boresight, words):
    assert boresight("worker", *words).exit_code == 2


def test_a_server_whose_files_have_no_place_is_refused_before_it_says_that_it_is_there(
    boresight, monkeypatch, tmp_path
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("BORESIGHT_BLOBS", f"{tmp_path}/file/blobs")
    done = boresight("serve", "--port", free_port())

    assert_refused(done, f"The folder of files {tmp_path}/file/blobs cannot be written")
    assert "Boresight on" not in done.output
