"""Firefox, where the machine has one: it shows the log-in, opens a page and runs its scripts, driven over Marionette.

Marionette is Firefox's own wire: over TCP, `length:[0, id, command, parameters]` is answered by `length:[1, id, error, value]`.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import time

import pytest

from benchmarks.servers import free_port, wait_until
from tests.browser.people import get_password

pytestmark = pytest.mark.browser

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
READY_WITHIN_S = 60
HAS_MORE = "return [...document.querySelectorAll('nav.side a')].map(link => link.dataset.key).join('')"


class Marionette:
    """A session with a Firefox."""

    def __init__(self, port: int) -> None:
        self._wire = _connected(port)
        self._number = 0
        self._read()
        self.ask("WebDriver:NewSession", strictFileInteractability=True)

    def ask(self, command: str, **parameters: object) -> object:
        """Send a command and return what it gives."""
        self._number += 1
        message = json.dumps([0, self._number, command, parameters]).encode()
        self._wire.sendall(str(len(message)).encode() + b":" + message)
        _, _, error, value = self._read()
        assert error is None, error
        return value

    def run(self, script: str) -> object:
        """Return what a script of the page returns."""
        return self.ask("WebDriver:ExecuteScript", script=script, args=[])["value"]

    def until(self, script: str) -> None:
        """Wait until a script returns what is true."""
        wait_until(lambda: self.run(script), READY_WITHIN_S)

    def close(self) -> None:
        """Hang up."""
        self._wire.close()

    def _read(self) -> object:
        length = b""
        while not length.endswith(b":"):
            length += self._wire.recv(1)
        body = b""
        while len(body) < int(length[:-1]):
            body += self._wire.recv(int(length[:-1]) - len(body))
        return json.loads(body)


def _connected(port: int) -> socket.socket:
    """Connect as soon as the program listens."""
    until_s = time.monotonic() + READY_WITHIN_S
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), READY_WITHIN_S)
        except ConnectionRefusedError:
            assert time.monotonic() < until_s, "Firefox does not listen"
            time.sleep(0.2)


@pytest.fixture
def firefox(tmp_path):
    """A Firefox with a profile of its own."""
    if FIREFOX is None:
        pytest.skip("no Firefox on this machine")
    port = free_port()
    (tmp_path / "user.js").write_text(f'user_pref("marionette.port", {port});\n')
    words = [FIREFOX, "--headless", "--marionette", "--no-remote", "--profile", str(tmp_path)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(words, env=os.environ | {"HOME": str(tmp_path)}, **quiet)
    session = Marionette(port)
    yield session
    session.close()
    process.terminate()
    process.wait(READY_WITHIN_S)


def test_firefox_logs_in_hears_the_server_and_goes_by_keys(firefox, people, batch_run):
    firefox.ask("WebDriver:Navigate", url=f"{people.address}/login")
    firefox.run(
        "document.querySelector('[name=name]').value = 'analyst';"
        f"document.querySelector('[name=password]').value = '{get_password('analyst')}';"
        "document.querySelector('main form').requestSubmit();"
    )
    firefox.until("return document.getElementById('link-state')?.dataset.state === 'live'")
    assert "r" in firefox.run(HAS_MORE)
    for key in "gr":
        firefox.run(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")
    firefox.until(f"return !!document.querySelector('a[href=\"/runs/{batch_run}\"]')")
    firefox.ask("WebDriver:Navigate", url=f"{people.address}/runs/{batch_run}?part=distortion")
    firefox.until("return !!document.querySelector('plot-figure[data-state=ready] .main-svg')")
    assert firefox.run("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")
