"""The API's documentation: a maintained viewer, from this server alone, under its policy, that can try every operation."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, sync_playwright

from tests.served import House

OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update"]
SETTINGS = '{"name": "Tried in the documentation", "sentence": "A trial.", "settings": {}}'


def test_the_documentation_is_found_beside_the_routes_too(house: House) -> None:
    answer = house.anybody().get("/api/v1/docs")
    assert (answer.status_code, answer.headers["location"]) == (307, "/docs")


def test_all_that_the_documentation_loads_comes_from_this_server(house: House) -> None:
    page = house.anybody().get("/docs").text
    loaded = re.findall(r'(?:src|href)="(.*?)"', page)
    assert {"/static/swagger-ui.css", "/static/swagger-ui-bundle.js"} <= set(loaded)
    for address in loaded:
        answer = house.anybody().get(address)
        assert answer.status_code == 200, address


@pytest.fixture
def page(house: House) -> Iterator[Page]:
    """Open the documentation in a browser, and hold it to the policy: nothing is said in the console."""
    said: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=OPTIONS)
        page = browser.new_page(base_url=house.address, viewport={"width": 1280, "height": 720})
        page.on("console", lambda message: said.append(message.text) if "401" not in message.text else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: said.append(request.url) if house.address not in request.url else None)
        yield page
        browser.close()
    assert said == []


def _try(page: Page, body: str) -> tuple[int, dict[str, str]]:
    """Save a preset from the page; returns the status and the headers that were sent."""
    page.locator("#operations-tag-runs").click()
    block = page.locator("#operations-runs-save_preset")
    block.locator("button.opblock-summary-control").click()
    block.locator("textarea.body-param__text").fill(body)
    with page.expect_response(lambda answer: answer.request.method == "POST" and "/presets" in answer.url) as sent:
        block.locator("button.execute").click()
    return sent.value.status, sent.value.request.all_headers()


@pytest.mark.browser
def test_an_operation_is_tried_with_a_log_in_and_its_token(house: House, page: Page) -> None:
    cookies = house.log_in("ada").cookies
    page.context.add_cookies([{"name": name, "value": value, "url": house.address} for name, value in cookies.items()])
    page.goto("/docs")
    status, headers = _try(page, SETTINGS)
    assert page.locator(".opblock-tag").count() == len(house.anybody().get("/api/v1/openapi.json").json()["tags"])
    assert status == 201
    assert headers["x-csrf-token"]


@pytest.mark.browser
def test_an_operation_is_tried_with_a_key(house: House, page: Page) -> None:
    key = house.key("ada", "runs").headers["authorization"].removeprefix("Bearer ")
    page.goto("/docs")
    page.locator("button.authorize").first.click()
    page.locator(".auth-container input").first.fill(key)
    page.locator(".auth-container button.authorize").first.click()
    page.locator("button.btn-done").first.click()
    status, headers = _try(page, SETTINGS.replace("Tried", "Tried again"))
    assert status == 201
    assert headers["authorization"] == f"Bearer {key}"
    assert "x-csrf-token" not in headers
