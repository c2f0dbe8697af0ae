"""A restart behind a proxy: the other server takes over before the first one stops, and no request fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Self
from unittest.mock import MagicMock

import httpx
import pytest
import sqlalchemy as sa

from boresight.console.runs.tables import Run
from boresight.platform.db.sessions import open_reading
from boresight.settings import Settings
from boresight.workers.dispatcher import RunDispatcher
from tests.served import PASSWORD, PLAIN, add_people, serving, settings_in

DRAIN_S = 1.0
LOOKS_EVERY_S = 0.05
LEFT_OUT = {"connection", "transfer-encoding", "content-encoding", "content-length", "host"}


class Proxy:
    """Sends each request to the first server that is ready, and none twice."""

    def __init__(self) -> None:
        self.servers: list[str] = []
        self.ready: str | None = None
        self._client = httpx.Client(timeout=30, verify=PLAIN)
        self._ends = threading.Event()
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                body = self.rfile.read(int(self.headers.get("content-length", 0)))
                headers = {name: value for name, value in self.headers.items() if name.lower() not in LEFT_OUT}
                try:
                    answer = proxy._client.request(
                        self.command, f"{proxy.ready}{self.path}", content=body, headers=headers
                    )
                    status, content, headers = answer.status_code, answer.content, dict(answer.headers)
                except httpx.HTTPError as error:
                    status, content, headers = 502, repr(error).encode(), {}
                self.send_response(status)
                for name, value in headers.items():
                    if name.lower() not in LEFT_OUT:
                        self.send_header(name, value)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            do_POST = do_GET  # noqa: N815 - the name that the library calls

            def log_message(self, *_: object) -> None:
                pass

        self._listener = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._listener.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._listener.server_port}"
        self._threads = [
            threading.Thread(target=one, daemon=True) for one in (self._listener.serve_forever, self._look)
        ]

    def _look(self) -> None:
        with httpx.Client(timeout=5, verify=PLAIN) as client:
            while not self._ends.wait(LOOKS_EVERY_S):
                for server in list(self.servers):
                    with suppress(httpx.HTTPError):
                        if client.get(f"{server}/readyz").status_code == 200:
                            self.ready = server
                            break

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._listener.shutdown()
        self._threads[1].join(10)
        self._listener.server_close()
        self._client.close()


@pytest.fixture
def settings(tmp_path) -> Settings:
    made = settings_in(tmp_path, drain_s=str(DRAIN_S), login_attempts="1000")
    add_people(made)
    return made


@contextmanager
def _behind(proxy: Proxy, settings: Settings) -> Iterator[Any]:
    """A server that the proxy knows, until it has stopped."""
    with serving(settings) as (address, app):
        proxy.servers.append(address)
        yield app
    proxy.servers.remove(address)


def _wait_for(truth: Any) -> None:
    ends_s = time.monotonic() + 20
    while not truth():
        assert time.monotonic() < ends_s
        time.sleep(0.01)


@pytest.mark.full
def test_two_servers_are_restarted_one_after_the_other_and_no_request_fails(settings, house):
    sensor_file, telemetry = house.sensor_file(), house.telemetry_csv
    failed: list[str] = []
    done, ends = [0, 0], threading.Event()
    with Proxy() as proxy, ThreadPoolExecutor(4) as pool:
        serving_now = ExitStack()
        serving_now.enter_context(_behind(proxy, settings))
        _wait_for(lambda: proxy.ready is not None)
        client = httpx.Client(base_url=proxy.address, timeout=30, verify=PLAIN)
        answer = client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
        client.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
        sensor_id = client.post("/api/v1/sensors", json=sensor_file).json()["id"]
        upload = {"data": {"sensor_id": str(sensor_id)}, "files": {"file": ("t.csv", telemetry)}}
        set_id = client.post("/api/v1/telemetry-sets", **upload).json()["id"]
        order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "batch"}}

        def look() -> None:
            while not ends.is_set():
                for path in ("/runs", "/api/v1/runs", "/healthz", "/"):
                    answer = client.get(path)
                    done[0] += 1
                    if answer.status_code != 200:
                        failed.append(f"{path}: {answer.status_code} {answer.text[:200]}")

        def launch() -> None:
            while not ends.is_set():
                answer = client.post("/api/v1/runs", json={**order, "label": f"run {done[1]}"})
                done[1] += 1
                if answer.status_code != 202:
                    failed.append(f"launch: {answer.status_code} {answer.text[:200]}")

        tasks = [pool.submit(look), pool.submit(look), pool.submit(launch)]
        for _ in range(3):
            coming = ExitStack()
            app = coming.enter_context(_behind(proxy, settings))
            before = proxy.ready
            time.sleep(0.3)
            serving_now.close()  # drains, while the other one takes over
            assert proxy.ready != before
            serving_now = coming
            time.sleep(0.3)
        ends.set()
        for task in tasks:
            task.result(30)
        client.close()
        with open_reading(app.state.engine) as session:
            launched = session.scalar(sa.select(sa.func.count()).select_from(Run))
        serving_now.close()
    assert failed == []
    assert done[0] > 40
    assert launched == done[1] > 10


def test_a_draining_server_says_so_answers_on_and_its_listeners_go_on_elsewhere(settings):
    with ExitStack() as first, serving(settings) as (other, _), httpx.Client(verify=PLAIN, timeout=30) as client:
        address, app = first.enter_context(serving(settings))
        logged_in = client.post(f"{address}/api/v1/sessions", json={"name": "ada", "password": PASSWORD})
        client.headers["X-CSRF-Token"] = logged_in.json()["csrf_token"]
        heard: list[str] = []

        def listen(server: str, **headers: str) -> None:
            with client.stream("GET", f"{server}/api/v1/events", headers=headers) as stream:
                heard.extend(line for line in stream.iter_lines() if line.startswith(("id:", "data:")))

        listening = threading.Thread(target=listen, args=(address,))
        listening.start()
        _wait_for(lambda: app.state.broadcast.listeners == 1)
        stopping = threading.Thread(target=first.close)
        stopping.start()
        _wait_for(lambda: app.state.draining)
        began_s = time.monotonic()
        ready = client.get(f"{address}/readyz")
        assert (ready.status_code, ready.json()["status"]) == (503, "not ready")
        assert client.get(f"{address}/runs").status_code == 200  # everything else it does
        note = client.post(f"{address}/api/v1/saved-views", json={"name": "Mine", "path": "/runs"})
        assert note.status_code == 201, note.text
        listening.join(20)  # the stream ended in order, without an error
        stopping.join(20)
        assert DRAIN_S / 2 < time.monotonic() - began_s < 15
        last = [line.removeprefix("id: ") for line in heard if line.startswith("id:")][-1]
        with client.stream("GET", f"{other}/api/v1/events", headers={"Last-Event-ID": last}) as stream:
            assert stream.status_code == 200
            assert "event: missed" not in next(stream.iter_text())


@pytest.mark.parametrize("draining", [False, True])
def test_a_server_that_drains_claims_no_more_runs_and_keeps_those_under_way(draining):
    dispatcher = MagicMock(_draining=draining)
    RunDispatcher._turn(dispatcher)
    assert dispatcher._launch.called is not draining
    assert dispatcher._renew.called


def test_without_a_time_to_drain_it_stops_as_before(tmp_path: Path):
    made = settings_in(tmp_path)
    add_people(made)
    with ExitStack() as stack:
        stack.enter_context(serving(made))
        began_s = time.monotonic()
        stack.close()
    assert time.monotonic() - began_s < 5
