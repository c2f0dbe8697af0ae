"""`boresight worker` and `boresight scheduler` refuse in a sentence what they cannot do."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest


@pytest.mark.parametrize("address", ["", "127.0.0.1:8786", "http://127.0.0.1:8786"])
def test_a_worker_for_nobody_is_refused(boresight, monkeypatch, address):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", address)
    done = boresight("worker")

    assert done.exit_code == 1
    assert f"{address!r} is no scheduler to work for: give --scheduler tcp://host:port." in done.stderr


def test_a_worker_on_an_encrypted_link_without_certificates_is_refused(boresight):
    done = boresight("worker", "--scheduler", "tls://127.0.0.1:8786")

    assert done.exit_code == 1
    assert "name them by BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE" in done.stderr


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


@pytest.mark.parametrize("words", [("--processes", "0"), ("--memory-gb", "0"), ("--port", "1")])
def test_what_is_no_number_of_processes_or_memory_is_wrong_usage(boresight, words):
    assert boresight("worker", *words).exit_code == 2
