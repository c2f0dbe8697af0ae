"""HEAD is GET without the body, wherever GET is (RFC 9110, 9.1), and ends at once."""

import time

import httpx
import pytest

from tests.served import House

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
    for _ in range(2):  # the second may stand ready
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
