"""What a page of another site sends is refused, and who is not on this machine is told no more than whether it is ready."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from starlette.datastructures import Headers

from boresight.errors import RefusedInputError
from boresight.platform.web.origins import is_foreign
from tests.served import PASSWORD, House, add_people, serving, settings_in

LOG_IN = {"name": "ada", "password": PASSWORD}
HERE = "https://console.example"


@pytest.mark.parametrize(
    ("given", "foreign"),
    [
        ({}, False),
        ({"origin": "http://boresight.example:8000"}, False),
        ({"origin": "http://BORESIGHT.example:8000"}, False),
        ({"origin": "http://boresight.example"}, True),
        ({"origin": "http://boresight.example:8001"}, True),
        ({"origin": "http://evil.example:8000"}, True),
        ({"origin": "http://boresight.example:8000.evil.example"}, True),
        ({"origin": "http://boresight.example:8000@evil.example"}, True),
        ({"origin": "null"}, True),
        ({"origin": ""}, True),
        ({"origin": "file://"}, True),
        ({"origin": "http://["}, True),
        ({"origin": HERE}, True),
        ({"origin": HERE, "x-forwarded-host": "console.example"}, False),
        ({"origin": HERE + ":443", "x-forwarded-host": "console.example, inner"}, False),
        ({"origin": HERE, "x-forwarded-host": "console.example:8443"}, True),
        ({"origin": "http://boresight.example:8000", "sec-fetch-site": "cross-site"}, True),
        ({"sec-fetch-site": "cross-site"}, True),
        ({"sec-fetch-site": "same-origin"}, False),
    ],
)
def test_an_origin_is_ours_when_it_names_the_host_and_port_that_were_asked(
    given: dict[str, str], foreign: bool
) -> None:
    assert is_foreign(Headers({"host": "boresight.example:8000", **given})) is foreign


@pytest.mark.parametrize(
    ("origin", "foreign"),
    [(HERE, False), (HERE + "/", True), ("http://console.example", True), ("https://console.example:8443", True)],
)
def test_the_public_address_is_ours_with_its_scheme(origin: str, foreign: bool) -> None:
    headers = Headers({"host": "inner:8000", "origin": origin})
    assert is_foreign(headers, HERE + ":443/") is foreign
    assert is_foreign(headers, "") is True


def test_two_origins_are_foreign() -> None:
    own = (b"origin", b"http://here")
    assert is_foreign(Headers(raw=[(b"host", b"here"), own, own])) is True


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:1"])
def test_a_foreign_origin_is_refused_as_a_foreign_fetch_site_is(house: House, origin: str) -> None:
    ada, foreign = house.log_in("ada"), {"Origin": origin}
    for method, path in [("POST", "/api/v1/sensors"), ("DELETE", "/api/v1/sessions/current"), ("POST", "/logout")]:
        assert ada.request(method, path, headers=foreign).status_code == 403, (method, path)
    assert ada.get("/api/v1/sessions/current").status_code == 200


@pytest.mark.parametrize("origin", ["https://evil.example", "null"])
def test_another_site_cannot_log_a_browser_in(house: House, origin: str) -> None:
    anybody = house.anybody(Origin=origin)
    for answer in (anybody.post("/api/v1/sessions", json=LOG_IN), anybody.post("/login", data=LOG_IN)):
        assert answer.status_code == 403
        assert "set-cookie" not in answer.headers


def test_our_own_pages_programs_and_keys_are_not_refused(house: House) -> None:
    assert house.anybody().post("/api/v1/sessions", json=LOG_IN).status_code == 201
    assert house.anybody(Origin=house.address).post("/api/v1/sessions", json=LOG_IN).status_code == 201
    key = house.key("ada", "sensors")
    foreign = {"Origin": "https://evil.example"}
    assert key.post("/api/v1/sensors", json=house.sensor_file(), headers=foreign).status_code == 201
    assert house.person("ada").get("/api/v1/sensors", headers=foreign).status_code == 200


@pytest.mark.parametrize("text", ["boresight.example", "ftp://boresight.example", "https://"])
def test_a_public_address_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(RefusedInputError, match="BORESIGHT_PUBLIC_URL"):
        settings_in(tmp_path, public_url=text)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    settings = settings_in(tmp_path_factory.mktemp("site"), secure_cookies="1", host="0.0.0.0")  # noqa: S104 - the claim
    add_people(settings)
    with serving(settings) as (address, _):
        yield address


def test_who_is_not_known_is_told_only_whether_a_server_of_the_network_is_ready(site: str) -> None:
    with httpx.Client(base_url=site) as client:
        assert client.get("/healthz").json() == {"status": "ok"}
        assert client.get("/readyz").json() == {"status": "ready"}
        assert client.get("/readyz", headers={"Authorization": "Bearer bs_a_b"}).json() == {"status": "ready"}
        assert client.get("/metrics").status_code == 401
        assert client.get("/metrics", headers={"Authorization": "Bearer bs_a_b"}).status_code == 401


def test_an_api_key_without_scopes_reads_metrics_and_the_details_of_readiness(site: str) -> None:
    with httpx.Client(base_url=site) as client:
        opened = client.post("/api/v1/sessions", json=LOG_IN)
        name, _, value = opened.headers["set-cookie"].split(";")[0].partition("=")
        cookie = {"Cookie": f"{name}={value}", "X-CSRF-Token": opened.json()["csrf_token"]}
        made = client.post("/api/v1/api-keys", json={"label": "prometheus", "scopes": []}, headers=cookie)
        for headers in (cookie, {"Authorization": f"Bearer {made.json()['secret']}"}):
            client.cookies.clear()
            assert "boresight_http_requests_total" in client.get("/metrics", headers=headers).text
            assert client.get("/readyz", headers=headers).json()["checks"]["store"]["ready"] is True


@pytest.mark.parametrize(
    "headers",
    [{"X-Forwarded-For": "203.0.113.7"}, {"X-Real-IP": "127.0.0.1"}, {"Via": "1.1 here"}, {"Host": "rebound.example"}],
)
def test_what_a_proxy_passed_on_does_not_count_as_this_machine(house: House, headers: dict[str, str]) -> None:
    assert house.anybody().get("/metrics").status_code == 200
    assert house.anybody().get("/metrics", headers=headers).status_code == 401
    assert house.anybody().get("/readyz", headers=headers).json() == {"status": "ready"}


def test_where_cookies_are_secure_the_log_in_is_bound_to_host_and_https_and_browsers_keep_to_https(
    site: str, house: House
) -> None:
    opened = httpx.post(f"{site}/api/v1/sessions", json=LOG_IN)
    cookie = opened.headers["set-cookie"]
    assert cookie.startswith("__Host-boresight_session=")
    assert {"Secure", "HttpOnly", "Path=/"} <= {part.strip() for part in cookie.split(";")}
    assert "domain" not in cookie.lower()
    assert opened.headers["strict-transport-security"] == "max-age=31536000; includeSubDomains"
    schemes = httpx.get(f"{site}/api/v1/openapi.json", timeout=60).json()["components"]["securitySchemes"].values()
    assert {one["name"] for one in schemes if one.get("in") == "cookie"} == {"__Host-boresight_session"}
    assert "strict-transport-security" not in house.anybody().get("/healthz").headers
