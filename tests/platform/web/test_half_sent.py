"""Requests that are never sent whole shut nobody out: they hold no place, they have deadlines, and they go first."""

import asyncio
import json
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from starlette.exceptions import HTTPException

from benchmarks.servers import wait_until
from boresight.platform.web import connections as connections_module
from boresight.platform.web.concurrency_limit import ConcurrencyLimits, Slots
from boresight.platform.web.connections import MOST_OPEN, OTHER_FILES, Connections, Deadlines, open_file_limit
from boresight.platform.web.request_bodies import BodyRate, RequestBody
from tests.platform.web.test_concurrency_limit import get_limit
from tests.served import PASSWORD, add_people, serving, settings_in

LOG_IN = {"name": "ada", "password": PASSWORD}
HALF_HEAD = b"POST /api/v1/sessions HTTP/1.1\r\nHost: here\r\nContent-"
HALF_BODY = (
    b"POST /api/v1/sessions HTTP/1.1\r\nHost: here\r\nContent-Type: application/json\r\nContent-Length: 500\r\n\r\n{"
)
UPLOAD = (
    b"POST /api/v1/telemetry-sets HTTP/1.1\r\nHost: here\r\nContent-Type: multipart/form-data; boundary=x\r\n"
    b"Content-Length: 400000000\r\n"
)
SHORT = Deadlines(head_s=0.4, idle_s=0.4, linger_s=0.4, stuck_s=0.4)
QUICK = ConcurrencyLimits(unknown=6, unknown_each=2, large=2, large_each=1, unknown_body_s=0.4)


@dataclass
class Site:
    address: str
    app: Any
    connections: Connections
    ada: httpx.Client

    @property
    def credentials(self) -> bytes:
        cookie, csrf = self.ada.cookies["boresight_session"], self.ada.headers["X-CSRF-Token"]
        return f"Cookie: boresight_session={cookie}\r\nX-CSRF-Token: {csrf}\r\n".encode()

    def connect(self) -> socket.socket:
        host, port = self.address.removeprefix("http://").split(":")
        return socket.create_connection((host, int(port)), 5)


@contextmanager
def serve_site(folder: Any, connections: Connections, **given: Any) -> Iterator[Site]:
    settings = settings_in(folder)
    add_people(settings)
    with (
        serving(settings, None, connections, **given) as (address, app),
        httpx.Client(base_url=address, timeout=10) as ada,
    ):
        answer = ada.post("/api/v1/sessions", json=LOG_IN)
        ada.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
        yield Site(address, app, connections, ada)


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    pace = BodyRate(window_s=0.4, floor_bytes=4000, slowest_bytes_per_s=300_000)
    folder = tmp_path_factory.mktemp("quick")
    with serve_site(folder, Connections(40, SHORT), limits=QUICK, pace=pace) as site:
        yield site


def read_answer(connection: socket.socket, wait_s: float = 30.0) -> tuple[int, dict[str, str], bytes]:
    connection.settimeout(wait_s)
    received = b""
    while piece := connection.recv(65536):
        received += piece
    head, _, body = received.partition(b"\r\n\r\n")
    lines = head.decode().split("\r\n")
    status = int(lines[0].split()[1]) if received else 0
    return status, {name.lower(): value for name, _, value in (line.partition(": ") for line in lines[1:])}, body


def test_540_half_sent_requests_shut_out_nobody(tmp_path: Any) -> None:
    open_file_limit()
    with serve_site(tmp_path, Connections()) as site, ExitStack() as opened:
        for number in range(540):
            connection = opened.enter_context(site.connect())
            connection.sendall((HALF_BODY, HALF_BODY, HALF_HEAD, UPLOAD)[number % 4])
        wait_until(lambda: site.connections.count >= 540, 5)
        began_s = time.monotonic()
        assert site.ada.get("/api/v1/sensors").status_code == 200
        assert site.ada.get("/", headers={"Accept": "text/html"}).status_code == 200
        assert httpx.get(site.address + "/login").status_code == 200
        assert httpx.post(site.address + "/api/v1/sessions", json=LOG_IN).status_code == 201
        assert time.monotonic() - began_s < 5
        limit = get_limit(site.app)
        assert (limit.known.taken, limit.unknown.taken, limit.large.taken) == (0, 0, 0)


@pytest.mark.parametrize("begun", [b"", b"\r\n", HALF_HEAD, HALF_BODY])
def test_half_a_request_is_refused_in_time(quick: Site, begun: bytes) -> None:
    with quick.connect() as connection:
        connection.sendall(begun)
        began_s = time.monotonic()
        status, headers, body = read_answer(connection)
    assert (status, headers["connection"]) == (408, "close")
    assert headers["content-type"] == "application/problem+json"
    assert json.loads(body)["status"] == 408
    assert 0.2 < time.monotonic() - began_s < 2


@pytest.mark.parametrize("begun", [HALF_HEAD, HALF_BODY])
def test_a_byte_now_and_then_saves_no_request(quick: Site, begun: bytes) -> None:
    with quick.connect() as connection:
        connection.sendall(begun)
        began_s = time.monotonic()
        ended = threading.Event()

        def dribble() -> None:
            while not ended.wait(0.05) and time.monotonic() - began_s < 4:
                try:
                    connection.sendall(b"a")
                except OSError:
                    return

        thread = threading.Thread(target=dribble)
        thread.start()
        try:
            assert read_answer(connection)[0] == 408
        except ConnectionResetError:
            pass  # a byte came after the answer
        finally:
            ended.set()
            thread.join()
        assert time.monotonic() - began_s < 2


def test_a_further_request_on_a_connection_has_the_same_deadline(quick: Site) -> None:
    with quick.connect() as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: here\r\n\r\n" + HALF_HEAD)
        status, _, rest = read_answer(connection)
    assert status == 200
    assert b"HTTP/1.1 408 " in rest


def test_who_is_known_has_a_deadline_too(quick: Site) -> None:
    with quick.connect() as connection:
        connection.sendall(UPLOAD + quick.credentials + b"\r\n--x\r\n")
        began_s = time.monotonic()
        assert read_answer(connection)[0] == 408
    assert time.monotonic() - began_s < 2
    assert get_limit(quick.app).large.taken == 0


def test_a_slow_body_that_goes_on_is_taken(quick: Site) -> None:
    head = b"POST /api/v1/sensors HTTP/1.1\r\nHost: here\r\nConnection: close\r\nContent-Type: application/json\r\n"
    with quick.connect() as connection:
        connection.sendall(head + quick.credentials + b"Content-Length: 60000\r\n\r\n")
        for _ in range(12):  # 1.2 s in all, three times the window
            connection.sendall(b" " * 5000)
            time.sleep(0.1)
        assert read_answer(connection)[0] == 422


def test_a_body_has_a_time_for_all_of_it_whatever_its_pace() -> None:
    pace = BodyRate(window_s=0.05, floor_bytes=1, slowest_bytes_per_s=1000)
    assert BodyRate().longest_s(513_000_000) < 6 * 3600

    async def piece() -> dict[str, Any]:
        await asyncio.sleep(0.02)
        return {"type": "http.request", "body": b"abc", "more_body": True}

    async def read() -> int:
        body = RequestBody(piece, pace, 100, "too large")
        for number in range(100):
            try:
                await body.receive()
            except HTTPException as refusal:
                return refusal.status_code * (number < 10)
        return 0

    assert asyncio.run(read()) == 408


def test_a_large_body_of_nobody_is_refused_before_it_comes(quick: Site) -> None:
    for credentials in (b"", b"Cookie: boresight_session=forged\r\n", b"Authorization: Bearer bs_a_b\r\n"):
        with quick.connect() as connection:
            connection.sendall(UPLOAD + credentials + b"Connection: close\r\n\r\n")
            began_s = time.monotonic()
            assert read_answer(connection)[0] == 401
            assert time.monotonic() - began_s < 0.4


def test_who_goes_on_sending_after_the_answer_is_let_go(quick: Site) -> None:
    with quick.connect() as connection:
        connection.sendall(UPLOAD + b"\r\n")
        began_s = time.monotonic()
        assert read_answer(connection)[0] == 401
    assert 0.2 < time.monotonic() - began_s < 2


def test_who_takes_nothing_of_an_answer_is_let_go(quick: Site) -> None:
    with quick.connect() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for _ in range(4):
            connection.sendall(b"GET /static/plotly.min.js HTTP/1.1\r\nHost: here\r\n\r\n")
        wait_until(lambda: all(one.known for one in quick.connections._open), 5)


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 400),
        (b"\x00" * 300, 400),
        (b"GET /healthz HTTP/1.1\r\nHost: here\r\nX-Long: " + b"a" * 200_000, 431),
        (b"GET /healthz HTTP/1.1\r\nHost: here\r\nX-Long: " + b"a" * 70_000 + b"\r\n\r\n", 431),
    ],
)
def test_what_is_no_request_is_refused_at_once(quick: Site, sent: bytes, status: int) -> None:
    with quick.connect() as connection:
        try:
            connection.sendall(sent)
            answer = read_answer(connection)
        except ConnectionError:
            assert status == 431  # closed while more came
        else:
            assert (answer[0], answer[1]["connection"]) == (status, "close")


def test_an_idle_connection_is_closed(quick: Site) -> None:
    with quick.connect() as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: here\r\n\r\n")
        began_s = time.monotonic()
        assert read_answer(connection)[0] == 200
    assert time.monotonic() - began_s < 2


def test_a_new_connection_takes_the_place_of_one_that_waits_and_never_of_one_that_is_known(tmp_path: Any) -> None:
    with serve_site(tmp_path, Connections(20)) as site, ExitStack() as opened:
        assert site.ada.get("/api/v1/sensors").status_code == 200  # over a connection that is kept
        crowd = [opened.enter_context(site.connect()) for _ in range(40)]
        for connection in crowd:
            connection.sendall(HALF_HEAD)
        assert httpx.get(site.address + "/login").status_code == 200
        kept = [one for one in site.connections._open if one.known]
        assert len(kept) == 1
        assert site.connections.count <= 20
        assert site.ada.get("/api/v1/sensors").status_code == 200
        assert kept == [one for one in site.connections._open if one.known]
        assert read_answer(crowd[0])[0] == 503


def test_where_all_connections_are_of_people_who_are_known_a_newcomer_is_told_to_come_back(tmp_path: Any) -> None:
    with serve_site(tmp_path, Connections(1)) as site:
        assert site.ada.get("/api/v1/sensors").status_code == 200
        with site.connect() as connection:
            status, headers, _ = read_answer(connection)
        assert (status, headers["connection"], headers["retry-after"]) == (503, "close", "2")
        assert site.ada.get("/api/v1/sensors").status_code == 200


def test_slots_of_who_is_not_known_are_others_than_of_who_is(quick: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = get_limit(quick.app)
    monkeypatch.setattr(limit.unknown, "most", 0)
    assert quick.ada.get("/api/v1/presets").status_code == 200
    forged = {"Cookie": "boresight_session=forged"}
    assert httpx.get(quick.address + "/login").status_code == 503
    assert httpx.get(quick.address + "/api/v1/presets", headers=forged).status_code == 503
    monkeypatch.undo()
    monkeypatch.setattr(limit.known, "most", 0)
    assert quick.ada.get("/api/v1/webhooks").status_code == 503
    assert httpx.get(quick.address + "/login").status_code == 200


def test_an_address_has_its_share_of_slots_also_behind_a_proxy(quick: Site) -> None:
    limit = get_limit(quick.app)
    for _ in range(QUICK.unknown_each):
        assert limit.unknown.take("203.0.113.7")
    try:
        for address, status in [("203.0.113.7", 503), ("203.0.113.8", 200), ("6.6.6.6, 203.0.113.7", 503)]:
            answer = httpx.get(quick.address + "/login", headers={"X-Forwarded-For": address})
            assert answer.status_code == status, address
        proxied = quick.ada.get("/api/v1/presets", headers={"X-Forwarded-For": "203.0.113.7"})
        assert proxied.status_code == 200
    finally:
        for _ in range(QUICK.unknown_each):
            limit.unknown.give_back("203.0.113.7")
    assert limit.unknown.taken == 0


def test_one_person_may_not_hold_every_place_of_large_bodies() -> None:
    slots = Slots(most=3, most_each=2)
    assert [slots.take("1"), slots.take("1"), slots.take("1"), slots.take("2"), slots.take("3")] == [
        True, True, False, True, False,
    ]  # fmt: skip
    slots.give_back("1")
    assert slots.take("3")


@pytest.mark.parametrize(
    ("soft", "hard", "opened", "left"),
    [
        (1024, 1_000_000, MOST_OPEN + OTHER_FILES, MOST_OPEN),
        (1024, 1024, 1024, 1024 - OTHER_FILES),
        (256, 256, 256, 128),
        (1024, resource.RLIM_INFINITY, MOST_OPEN + OTHER_FILES, MOST_OPEN),
        (resource.RLIM_INFINITY, resource.RLIM_INFINITY, resource.RLIM_INFINITY, MOST_OPEN),
    ],
)
def test_there_are_fewer_connections_than_files_that_may_be_open(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, opened: int, left: int
) -> None:
    limits = {"soft": soft}
    monkeypatch.setattr(connections_module.resource, "getrlimit", lambda _: (limits["soft"], hard))
    monkeypatch.setattr(connections_module.resource, "setrlimit", lambda _, new: limits.update(soft=new[0]))
    assert open_file_limit() == left
    assert limits["soft"] == opened
