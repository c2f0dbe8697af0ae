"""The built documentation at a phone's width and a desk's: nothing leads sideways, and axe finds nothing that keeps people out."""

import functools
import http.server

import pytest

from benchmarks.servers import listening
from tests.browser.window import Window
from tests.effort import few_of

pytestmark = pytest.mark.browser
PAGES = (
    "index", "tutorials/index", "how-to/index", "how-to/respond-to-advice", "how-to/respond-to-a-gate", "explanation/arcs",
    "explanation/observability", "reference/commands", "reference/settings", "reference/rest", "reference/versions",
    "reference/tests-and-causes", "figures", "glossary",
)  # fmt: skip
SIDEWAYS_PX = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def address(built_site):
    quiet = functools.partial(Quiet, directory=str(built_site))
    with listening(http.server.ThreadingHTTPServer(("127.0.0.1", 0), quiet)) as port:
        yield f"http://127.0.0.1:{port}"


@pytest.mark.full
@pytest.mark.parametrize("width", few_of([390, 1440], 1))
def test_a_page_of_the_documentation_fits_and_keeps_nobody_out(browser, address, width):
    context = browser.new_context(viewport={"width": width, "height": 900}, reduced_motion="reduce")
    window = Window(context)
    found = {}
    for name in PAGES:
        answer = window.page.goto(f"{address}/{name}.html")
        assert answer.status == 200, name
        window.keep(f"documentation-{name.replace('/', '-')}-{width}", whole=False)
        found[name] = (window.page.evaluate(SIDEWAYS_PX), window.barriers())
    context.close()
    assert found == dict.fromkeys(PAGES, (0, []))
    assert window.complaints == []
