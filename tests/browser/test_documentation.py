"""The API's documentation under the server's policy: it can try every operation, and loads nothing from elsewhere."""

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


@pytest.fixture
def documentation(request, people):
    asked = []
    with people.seat(request.param) as window:
        window.page.on("request", lambda request: asked.append(request.url))
        window.open("/api/v1/docs")
        expect(window.page.locator(".opblock-tag")).to_have_count(len(window.read("/api/v1/openapi.json")["tags"]))
        yield window
    assert [url for url in asked if not url.startswith(people.address)] == []


def save_preset(window, name):
    """Save a preset from the page; return the status and the headers that were sent. By keys: the page moves as it is drawn."""
    window.page.locator("#operations-tag-runs .expand-operation").press("Enter")
    operation = window.page.locator("#operations-runs-save_preset")
    operation.locator("button.opblock-summary-control").press("Enter")
    body = f'{{"name": "{name}", "sentence": "A trial.", "settings": {{}}}}'
    operation.locator("textarea.body-param__text").fill(body)
    with window.page.expect_response(lambda answer: answer.request.method == "POST") as sent:
        operation.locator("button.execute").press("Enter")
    return sent.value.status, sent.value.request.all_headers()


@pytest.mark.full
@pytest.mark.parametrize("documentation", ["analyst"], indirect=True)
def test_an_operation_is_tried_with_a_log_in_and_its_token(documentation):
    status, headers = save_preset(documentation, "Tried")
    assert status == 201
    assert headers["x-csrf-token"]


@pytest.mark.full
@pytest.mark.parametrize("documentation", [None], indirect=True)
def test_an_operation_is_tried_with_a_key(documentation, key):
    documentation.page.locator("button.authorize").first.press("Enter")
    documentation.page.locator(".auth-container input").first.fill(key)
    documentation.page.locator(".auth-container button.authorize").first.press("Enter")
    documentation.page.locator("button.btn-done").first.press("Enter")
    status, headers = save_preset(documentation, "Tried again")
    assert status == 201
    assert headers["authorization"] == f"Bearer {key}"
    assert "x-csrf-token" not in headers
