"""Who works at the installation, each with a browser of their own that stays logged in."""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, BrowserContext

from tests.browser.installation import Installation
from tests.browser.window import FORGET_THEME, NARROW, Window

PRINTED_NAMES = {
    "administrator": "Adele Administrator",
    "analyst": "Ada Analyst",
    "approver": "Alan Approver",
    "operator": "Olga Operator",
}


def get_password(name: str) -> str:
    return f"on-the-night-shift-{zlib.crc32(name.encode()):08x}"


class People:
    def __init__(self, installation: Installation, browser: Browser) -> None:
        self._browser = browser
        self.address = installation.address
        self._contexts: dict[str, BrowserContext] = {}
        self._windows: dict[
            str, list[Window]
        ] = {}  # of whom nobody looks at now: a new one costs as much as many pages

    def stranger(self) -> BrowserContext:
        return self._browser.new_context(base_url=self.address, viewport=NARROW, reduced_motion="reduce")

    @contextmanager
    def seat(self, name: str | None = None, *, new: bool = False) -> Iterator[Window]:
        """Sit at a window that is cleared, or at a new one, where a picture must not tell what was drawn there before."""
        window = self._get_window(name, new=new)
        try:
            yield window
        except BaseException:
            window.page.close()
            raise
        complaints = window.leave()
        if name is None:
            window.page.context.close()
        elif new:
            window.page.close()
        else:
            self._windows[name].append(window)
        assert not complaints, "\n".join(complaints)

    def _get_window(self, name: str | None, *, new: bool) -> Window:
        if name is None:
            return Window(self.stranger())
        if name not in self._contexts:
            context = self._contexts[name] = self.stranger()
            window = Window(context)
            window.open("/login")
            window.enter(name, get_password(name))
            window.page.wait_for_url("**/")
            window.page.evaluate(FORGET_THEME)  # which a log-in tells of a test that chose one as the same person
            self._windows[name] = [window]
        return self._windows[name].pop() if self._windows[name] and not new else Window(self._contexts[name])
