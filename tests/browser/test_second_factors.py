"""A security key in a browser: enrolled, asked at log-in, and asked for an act, with Chromium's virtual authenticator."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.served import PASSWORD, add_people, serving, settings_in

pytestmark = pytest.mark.browser

CODE = re.compile(r"^[a-z2-9]{4}(-[a-z2-9]{4}){5}$")
AUTHENTICATOR = {
    "protocol": "ctap2",
    "transport": "usb",
    "hasResidentKey": False,
    "hasUserVerification": True,
    "isUserVerified": True,
    "automaticPresenceSimulation": True,
}


@pytest.fixture
def localhost(tmp_path: Path) -> Iterator[str]:
    settings = settings_in(tmp_path)
    add_people(settings)
    with serving(settings) as (address, _):
        yield address.replace("127.0.0.1", "localhost")


def _log_in(page: Page, address: str) -> None:
    page.goto(f"{address}/login?next=/second-factor")
    page.get_by_label("Log-in name").fill("alan")
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Log in", exact=True).click()


def _read_codes(page: Page) -> set[str]:
    expect(page.get_by_role("heading", name="Your recovery codes")).to_be_visible()
    codes = {code.inner_text() for code in page.locator("main code").all()}
    assert len(codes) == 10
    assert all(CODE.match(code) for code in codes)
    return codes


def test_a_security_key_is_enrolled_asked_at_log_in_and_for_an_act(localhost, browser):
    context = browser.new_context()
    page = context.new_page()
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda line: problems.append(line.text) if "Content Security Policy" in line.text else None)
    devtools = page.context.new_cdp_session(page)
    devtools.send("WebAuthn.enable")
    key = devtools.send("WebAuthn.addVirtualAuthenticator", {"options": AUTHENTICATOR})["authenticatorId"]

    _log_in(page, localhost)
    page.get_by_label("Security key or passkey").check()
    page.get_by_label("Your password again").first.fill(PASSWORD)
    page.get_by_role("button", name="Continue").click()
    page.get_by_label("Name of the key").fill("Blue key")
    page.get_by_role("button", name="Register the key").click()
    first = _read_codes(page)
    page.get_by_role("button", name="Log out").click()

    _log_in(page, localhost)
    expect(page.get_by_role("heading", name="Your second factor")).to_be_visible()
    expect(page.get_by_label("Code of your authenticator app")).to_be_visible()
    page.get_by_role("button", name="Use your security key").click()
    expect(page.get_by_role("rowheader", name="Blue key")).to_be_visible()

    page.get_by_role("button", name="Make new ones").click()
    dialog = page.get_by_role("dialog", name="Make new recovery codes")
    dialog.get_by_label("Your password again").fill(PASSWORD)
    dialog.get_by_role("button", name="Use your security key").click()
    expect(dialog.get_by_text("Your security key responded.")).to_be_visible()
    dialog.get_by_role("button", name="Make new recovery codes").click()
    assert first.isdisjoint(_read_codes(page))

    (credential,) = devtools.send("WebAuthn.getCredentials", {"authenticatorId": key})["credentials"]
    assert (credential["rpId"], credential["signCount"]) == ("localhost", 3)
    assert problems == []
    context.close()
