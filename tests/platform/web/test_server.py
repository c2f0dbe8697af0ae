"""What holds for every answer (headers, codings, HEAD), and the server's own routes: health, metrics, static files."""

from __future__ import annotations

import dataclasses
import gzip
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import plotly
import pytest
import uvicorn
from hypothesis import given
from hypothesis import strategies as st
from playwright.sync_api import sync_playwright
from starlette.requests import Request

from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.jobs.worker_news import WorkerState
from boresight.platform.web import static_files
from boresight.platform.web.metrics import CachedCheck
from boresight.platform.web.middleware import SECURITY_HEADERS, SECURITY_POLICY, takes_gzip
from boresight.platform.web.static_files import static_version, versioned_static_file
from boresight.server import _Server, create_app
from tests.browser.window import launch_chromium
from tests.served import House, serving, settings_in

ANSWERS = [
    "/healthz",
    "/docs",
    "/static/shared/style.css",
    "/api/v1/runs",
    "/nothing",
    "/login",
    "/api/v1/openapi.json",
]


@pytest.mark.parametrize("path", ANSWERS)
def test_every_answer_carries_the_security_headers_and_a_request_id(house: House, path: str) -> None:
    answer = house.anybody().get(path)
    for name, value in SECURITY_HEADERS.items():
        assert answer.headers[name] == value
    assert re.fullmatch(r"[0-9a-f]{32}", answer.headers["X-Request-ID"])
    assert "server" not in answer.headers


def test_the_policy_allows_no_inline_script_no_other_host_and_no_frame() -> None:
    rules = dict(rule.split(" ", 1) for rule in SECURITY_POLICY.split("; "))
    assert rules["default-src"] == rules["script-src"] == "'self'"
    assert rules["frame-ancestors"] == rules["object-src"] == rules["base-uri"] == "'none'"
    assert "unsafe-inline" not in rules["style-src"]
    assert "http" not in SECURITY_POLICY
    assert "*" not in SECURITY_POLICY


@pytest.mark.parametrize("given", ["run-42.a_B", "x" * 64])
def test_a_request_id_is_taken_over(house: House, given: str) -> None:
    assert house.anybody().get("/healthz", headers={"X-Request-ID": given}).headers["X-Request-ID"] == given


@pytest.mark.parametrize("given", ["", "x" * 65, "a b", "<script>"])
def test_a_request_id_that_could_not_stand_in_a_log_is_replaced(house: House, given: str) -> None:
    assert house.anybody().get("/healthz", headers={"X-Request-ID": given}).headers["X-Request-ID"] != given


def test_health_asks_nothing_and_readiness_says_what_it_looked_at(house: House) -> None:
    assert house.anybody().get("/healthz").json() == {"status": "ok"}
    ready = house.anybody().get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["checks"]["store"]["revision"] == ready.json()["checks"]["store"]["expected"]
    assert ready.json()["checks"]["workers"]["expected"] is False


def test_a_server_whose_workers_are_not_there_is_not_ready(tmp_path: Path) -> None:
    settings = settings_in(tmp_path, scheduler="tcp://127.0.0.1:1")
    with serving(settings) as (address, _):
        answer = httpx.get(f"{address}/readyz", timeout=60)
        assert httpx.get(f"{address}/healthz", timeout=60).status_code == 200
    assert answer.status_code == 503
    assert answer.json()["checks"]["workers"]["ready"] is False


def test_a_server_that_no_worker_has_joined_yet_is_not_ready(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    state = house.app.state
    monkeypatch.setitem(state._state, "settings", dataclasses.replace(state.settings, workers=2))
    told = [WorkerState(connected=True)]
    monkeypatch.setattr(state.workers, "state", lambda: told[-1])
    assert house.anybody().get("/readyz").status_code == 503
    told.append(WorkerState(connected=True, joined=True, threads=2))
    answer = house.anybody().get("/readyz")
    assert answer.status_code == 200
    assert answer.json()["checks"]["workers"] == {"ready": True, "expected": True, **dataclasses.asdict(told[-1])}
    told.append(WorkerState(connected=True, joined=True))  # its only worker has died and is being replaced
    assert house.anybody().get("/readyz").status_code == 200


def test_a_server_that_cannot_write_its_files_is_not_ready_and_refuses_an_upload_in_a_sentence(
    house: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert house.anybody().get("/readyz").json()["checks"]["files"] == {"ready": True}
    sensor_id = house.new_sensor()["id"]
    nowhere = FolderBlobStore(tmp_path / "file" / "blobs")
    nowhere.folder.parent.write_text("no folder")
    instead = {"blobs": nowhere, "blob_check": CachedCheck(nowhere.refuse_unusable)}
    for name, part in instead.items():
        monkeypatch.setitem(house.app.state._state, name, part)
    unready = house.anybody().get("/readyz")
    refused = house.upload(house.person("ada"), sensor_id)
    assert (unready.status_code, refused.status_code) == (503, 503)
    for sentence in (unready.json()["checks"]["files"]["detail"], refused.json()["detail"]):
        assert f"The folder of files {nowhere.folder} cannot be written (Not a directory)" in sentence


def test_files_are_looked_at_once_in_some_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[None] = []
    watched = CachedCheck(lambda: looks.append(None))
    assert [watched.fault() for _ in range(5)] == [""] * 5
    assert len(looks) == 1
    monkeypatch.setattr("boresight.platform.web.metrics.LOOK_AGAIN_S", -1.0)
    watched.fault()
    assert len(looks) == 2


def test_a_server_says_that_it_is_there_when_it_is(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    answers: list[int] = []
    config = uvicorn.Config(create_app(settings), port=0, log_level="warning")

    def ask() -> None:
        host, port = server.servers[0].sockets[0].getsockname()[:2]
        socket.create_connection((host, port), 5).close()
        answers.append(port)
        server.should_exit = True

    server = _Server(config, ask)
    server.run()
    assert len(answers) == 1


def test_metrics_count_requests_by_route_and_runs_by_state(house: House) -> None:
    run = house.launched()
    house.person("ada").get(f"/api/v1/runs/{run['id']}")
    text = house.anybody().get("/metrics").text
    assert re.search(r'boresight_http_requests_total{method="GET",route="[^"]*{run_id}",status="200"} \d', text)
    assert f"runs/{run['id']}" not in text
    assert re.search(r'boresight_runs{state="QUEUED"} [1-9]', text)
    assert "boresight_event_streams 0.0" in text


def test_large_answers_are_compressed_and_small_ones_are_not(house: House) -> None:
    large = house.person("ada").get(f"/api/v1/runs/{house.finished()}/result", headers={"Accept-Encoding": "gzip"})
    assert large.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in house.anybody().get("/healthz").headers


def test_a_static_file_is_sent_once_and_confirmed_afterwards(house: House) -> None:
    client = house.anybody()
    first = client.get("/static/shared/style.css")
    again = client.get("/static/shared/style.css", headers={"If-None-Match": first.headers["etag"]})
    assert first.headers["cache-control"] == "public, no-cache"
    assert (again.status_code, again.content) == (304, b"")
    assert not first.headers["etag"].startswith("W/")


def test_what_a_page_names_is_kept_by_browsers_and_is_the_same_file(house: House) -> None:
    named = set(
        re.findall(r'"(/static/[^"]+)"', house.person("ada").get("/runs", headers={"Accept": "text/html"}).text)
    )
    assert len(named) > 10
    for address in named:
        answer = house.anybody().get(address)
        assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
        assert answer.content == house.anybody().get(re.sub("/version-[^/]+", "", address)).content


def test_a_file_under_another_servers_version_is_asked_for_again(house: House) -> None:
    address = f"/static/version-{static_version()[::-1]}/shared/style.css"
    assert house.anybody().get(address).headers["cache-control"] == "public, no-cache"


@pytest.fixture
def static_folder(tmp_path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(static_files, "folder", lambda _name: tmp_path)
    (tmp_path / "static").mkdir()
    forget_static_files()
    yield tmp_path / "static"
    forget_static_files()


def forget_static_files() -> None:
    static_files._digests.cache_clear()
    static_version.cache_clear()


def test_a_change_of_any_static_file_is_a_new_version(static_folder: Path) -> None:
    file = static_folder / "one.js"
    versions = set()
    for change in (
        lambda: file.write_text("a"),
        lambda: file.write_text("b"),
        lambda: file.rename(file.with_name("two.js")),
    ):
        change()
        forget_static_files()
        versions.add(static_version())
    assert len(versions) == 3


def test_a_file_that_an_update_replaced_under_a_running_server_is_not_kept_as_its_own(static_folder: Path) -> None:
    file = static_folder / "one.js"
    kept = []
    for text in ("1.0", "1.1"):
        file.write_text(text)
        os.utime(file, (0, len(kept)))
        answer = versioned_static_file(static_version(), file.name, Request({"type": "http", "headers": []}))
        kept.append((answer.body, "immutable" in answer.headers["cache-control"]))
    assert kept == [(b"1.0", True), (b"1.1", False)]


def test_plotly_comes_from_the_python_package(house: House) -> None:
    shipped = (Path(plotly.__file__).parent / "package_data" / "plotly.min.js").read_bytes()
    answer = house.anybody().get("/static/plotly.min.js")
    assert answer.content == shipped
    assert answer.headers["content-type"] == "text/javascript; charset=utf-8"
    with house.anybody().stream("GET", "/static/plotly.min.js") as raw:
        assert gzip.decompress(b"".join(raw.iter_raw())) == shipped


def test_compressed_and_plain_have_tags_of_their_own(house: House) -> None:
    plain = house.anybody().get("/static/shared/style.css", headers={"Accept-Encoding": "identity"})
    compressed = house.anybody().get("/static/shared/style.css", headers={"Accept-Encoding": "gzip"})
    assert compressed.headers["content-encoding"] == "gzip"
    assert plain.headers["etag"] != compressed.headers["etag"]
    assert plain.headers["vary"] == compressed.headers["vary"] == "Accept-Encoding"


@pytest.mark.parametrize(
    "name", ["../templates/frame.html", "%2e%2e/templates/frame.html", "..%2f..%2fpyproject.toml", ""]
)
def test_nothing_outside_the_static_folder_is_sent(house: House, name: str) -> None:
    assert house.anybody().get(f"/static/{name}").status_code == 404


FIGURE_PAGE = """<!doctype html><html lang="en"><title>t</title><link rel="stylesheet" href="/static/shared/style.css">
<div id="d"></div>"""
DRAW = """async () => {
  await new Promise((done, failed) => document.head.append(
    Object.assign(document.createElement("script"), {src: "/static/plotly.min.js", onload: done, onerror: failed})));
  const figure = await Plotly.newPlot("d", [{x: [1, 2, 3], y: [2, 1, 3], name: "a"}], {title: {text: "t"}});
  const picture = await Plotly.toImage(figure, {format: "png", width: 300, height: 200});
  return [document.querySelectorAll("#d svg path").length, picture.slice(0, 22)];
}"""


@pytest.mark.browser
def test_plotly_draws_and_exports_under_the_policy_without_a_word_in_the_console(house: House) -> None:
    said: list[str] = []
    with sync_playwright() as playwright:
        browser = launch_chromium(playwright)
        page = browser.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.route(
            "**/figure-under-policy",
            lambda route: route.fulfill(
                body=FIGURE_PAGE, content_type="text/html", headers={"Content-Security-Policy": SECURITY_POLICY}
            ),
        )
        page.goto(f"{house.address}/figure-under-policy")
        paths, picture = page.evaluate(DRAW)
        browser.close()
    assert paths > 5
    assert picture == "data:image/png;base64,"
    assert said == []


@pytest.mark.sqlite("the modes of its files")
def test_nobody_else_reads_the_database(tmp_path: Path) -> None:
    settings = settings_in(tmp_path / "data")
    with serving(settings):
        modes = {path.name: path.stat().st_mode & 0o777 for path in settings.data_folder.glob("*.sqlite3*")}
    assert modes
    assert set(modes.values()) == {0o600}
    assert settings.data_folder.stat().st_mode & 0o777 == 0o700


TABLE = {
    "gzip": True,
    "GZIP": True,
    "x-gzip": True,
    "*": True,
    "gzip, deflate, br, zstd": True,
    "br;q=1.0, gzip;q=0.8, *;q=0.1": True,
    "gzip;q=0.001": True,
    "Gzip ; Q=1": True,
    "identity;q=0, *": True,
    "gzip;q=0": False,
    "gzip; q=0.000": False,
    "gzip;q=0, identity": False,
    "gzip;q=0, *": False,
    "*;q=0": False,
    "identity": False,
    "identity;q=1, gzip;q=0.5": False,
    "": False,
    "br": False,
    "gzipped": False,
    "gzip;q=much": False,
    "gzip;q=nan": False,
    "gzip;q=2": False,
}
ROUTES = ("/static/shared/style.css", "/metrics", "/api/v1/runs", "/runs", "/api/v1/openapi.json")


@pytest.mark.parametrize(("accepted", "taken"), TABLE.items())
def test_weights_stars_and_capitals_are_read_as_the_standard_has_them(accepted: str, taken: bool) -> None:
    assert takes_gzip(accepted.encode()) is taken


@given(
    st.lists(st.sampled_from(("gzip", "*", "identity", "br", ";q=", ";", ",", "0", "1", ".5", " ", "é")), max_size=12)
)
def test_nothing_is_packed_unless_gzip_or_anything_is_named_and_no_header_is_an_error(parts: list[str]) -> None:
    accepted = "".join(parts)
    assert not takes_gzip(accepted.encode()) or {"gzip", "*"} & set(parts)


@pytest.mark.parametrize("path", ROUTES)
def test_every_route_sends_what_is_accepted(house: House, path: str) -> None:
    for _ in range(3):
        house.launched()
    client = house.person("ada")
    for accepted, taken in TABLE.items():
        answer = client.get(path, headers={"Accept-Encoding": accepted})
        assert answer.status_code == 200
        assert ("content-encoding" in answer.headers) is taken, accepted


def test_a_header_given_in_two_lines_is_one_list(house: House) -> None:
    lines = [("Accept-Encoding", "br"), ("Accept-Encoding", "gzip;q=0")]
    assert "content-encoding" not in house.anybody().get("/static/shared/style.css", headers=lines).headers


PATHS = (
    "/healthz",
    "/readyz",
    "/static/shared/style.css",
    "/api/v1/runs",
    "/api/v1/sensors",
    "/runs",
    "/login",
    "/docs",
)
OF_EACH_ANSWER = {"date", "x-request-id", "transfer-encoding"}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("accepted", ["gzip", "identity"])
def test_the_headers_are_those_of_get_and_there_is_no_body(house: House, path: str, accepted: str) -> None:
    client = house.person("ada")
    for _ in range(2):  # the second may be cached
        whole, head = (
            client.request(method, path, headers={"Accept-Encoding": accepted}) for method in ("GET", "HEAD")
        )
        assert (head.status_code, head.content) == (whole.status_code, b"")
        assert head.headers["content-length"] == whole.headers["content-length"]
        assert _lasting(head.headers) == _lasting(whole.headers)


def _lasting(headers: httpx.Headers) -> dict[str, set[str]]:
    return {name: set(value.split(", ")) for name, value in headers.items() if name not in OF_EACH_ANSWER}


def test_a_file_is_measured_and_not_sent(house: House) -> None:
    _, set_id = house.ready_sensor()
    answer = house.person("ada").head(f"/api/v1/telemetry-sets/{set_id}/file", headers={"Accept-Encoding": "identity"})
    assert int(answer.headers["content-length"]) == len(house.telemetry_csv)
    assert answer.content == b""


def test_the_event_stream_is_not_begun(house: House) -> None:
    begun_s = time.monotonic()
    answer = house.person("ada").head("/api/v1/events")
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-type"].startswith("text/event-stream")
    until_s = begun_s + 5
    while house.app.state.broadcast.listeners:
        assert time.monotonic() < until_s
        time.sleep(0.01)
    assert time.monotonic() - begun_s < 5


def test_what_get_refuses_head_refuses(house: House) -> None:
    assert house.anybody().head("/api/v1/runs").status_code == 401
    assert house.person("ada").head("/nothing").status_code == 404
    assert house.person("ada").head("/api/v1/runs/1:cancel").status_code == 405


def test_it_is_counted_as_what_it_is(house: House) -> None:
    house.anybody().head("/healthz")
    assert (
        'boresight_http_requests_total{method="HEAD",route="/healthz",status="200"}'
        in house.anybody().get("/metrics").text
    )
