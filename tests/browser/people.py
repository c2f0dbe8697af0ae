"""Who works at the installation, each with a browser of their own that stays logged in."""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, BrowserContext

from tests.browser.installation import Installation
from tests.browser.window import NARROW, Window

PRINTED_NAMES = {
    "administrator": "Adele Administrator",
    "analyst": "Ada Analyst",
    "approver": "Alan Approver",
    "operator": "Olga Operator",
}


def password_of(name: str) -> str:
    return f"on-the-night-shift-{zlib.crc32(name.encode()):08x}"


class People:
    def __init__(self, installation: Installation, browser: Browser) -> None:
        self._browser = browser
        self.address = installation.address
        self._contexts: dict[str, BrowserContext] = {}

    def stranger(self) -> BrowserContext:
        return self._browser.new_context(base_url=self.address, viewport=NARROW, reduced_motion="reduce")

    @contextmanager
    def seat(self, name: str | None = None) -> Iterator[Window]:
        context = self.stranger() if name is None else self._context_of(name)
        window = Window(context)
        try:
            yield window
        finally:
            window.close()
            if name is None:
                context.close()
        assert not window.complaints, "\n".join(window.complaints)

    def _context_of(self, name: str) -> BrowserContext:
        if name not in self._contexts:
            context = self._contexts[name] = self.stranger()
            window = Window(context)
            window.open("/login")
            window.enter(name, password_of(name))
            window.page.wait_for_url("**/")
            window.page.close()
        return self._contexts[name]
