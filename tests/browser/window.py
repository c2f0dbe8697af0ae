"""One person's browser window: it opens pages, takes screenshots, and remembers everything the browser complained of."""

import re
import shutil
import zlib
from pathlib import Path
from typing import Any

from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import (
    APIResponse,
    Browser,
    BrowserContext,
    CDPSession,
    ConsoleMessage,
    Locator,
    Page,
    Playwright,
    Request,
    Route,
    expect,
)

from tests.effort import effort

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")  # the first takes a third less
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SCREENSHOTS = Path(__file__).parents[2] / "artefacts" / "screenshots"
NARROW, WIDE = {"width": 1280, "height": 800}, {"width": 1920, "height": 1080}
GLANCE = {"width": 1280, "height": 720}
PHONE = {"width": 390, "height": 844}
TABLET, TABLET_ASIDE = {"width": 820, "height": 1180}, {"width": 1024, "height": 768}
LOOKS = (  # theme and width, and what axe is asked there: everything in every theme
    # (all of them with `--full`, and paper, else one a page, which page has which told by its name)
    ("dark", GLANCE, {}),
    ("light", WIDE, {}),
    ("contrast", TABLET, {}),
    ("light", PHONE, {}),
    ("dark", TABLET_ASIDE, None),
)
WIDTHS = (390, 1280, 820, 1440, 1920, 2560)  # the first two always, all of them with `--full`
WIDEST_PX = 1840
PATIENCE_MS = 240_000  # nothing here is a claim about speed, and a machine may be slow and busy

TRACES = """figure => figure._fullData.map(t => Object.fromEntries(
    ["type", "name", "x", "y", "z", "text", "customdata", "fill", "visible"].map(key => [key, plain(t[key])])
))"""
# A page that is about to be left may draw nothing any more, and an evaluation has no time limit of its own.
SETTLED = """new Promise(done => {
    requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50)));
    setTimeout(done, 5000);
})"""
HIGHEST_PX = 420
FIRST_TABLE = SCREENSHOTS.parent / "first-figure.csv"
FIRST_TOPS: dict[tuple[str, str, str], int] = {}
#: Where the first figure's axes begin, as soon as they are drawn, or what stands in its place.
FIRST = """() => {
    const first = document.querySelector("plot-figure, .answer, main .empty, main .log");
    if (first.localName === "plot-figure" && first.dataset.state === "loading") return null;
    return (first.querySelector(".nsewdrag") ?? first).getBoundingClientRect().top || null;
}"""
LAST_VIEW = """() => Math.max(0, ...[...document.querySelectorAll(".small-view")]
    .map(one => one.getBoundingClientRect().bottom))"""
FORGET_THEME = """() => {
    localStorage.removeItem("boresight-theme");
    document.cookie = "boresight-theme=; path=/; max-age=0";
}"""
FITS = "() => document.documentElement.scrollWidth <= document.documentElement.clientWidth"
OVERLAPS = """() => [...document.querySelectorAll("plot-figure .js-plotly-plot")].flatMap(figure => {
    const boxes = [...figure.querySelectorAll("svg text")].filter(one => one.checkVisibility() && one.textContent.trim())
        .map(one => [one.textContent, one.getBoundingClientRect(), one]).filter(([, box]) => box.width);
    const place = figure.getBoundingClientRect(), name = figure.closest("[id]").id;
    const isSlanted = ([, , one]) => /rotate\\((?!0[,)]|-?90[,)])/.test(one.getAttribute("transform") ?? "");
    const over = ([, a], [, b]) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 2;
    const panels = [...figure.querySelectorAll(".nsewdrag")].map(one => one.getBoundingClientRect());
    const axes = boxes.filter(([, , one]) => one.closest("[class$=tick], [class^=g-x], [class^=g-y]"));
    const isCut = ([, a]) => a.left < place.left - 2 || a.top < place.top - 2
        || a.right > place.right + 2 || a.bottom > place.bottom + 2;
    return [...boxes.filter(isCut).map(([text]) => [name, text, "is cut"]),
        ...axes.filter(one => panels.some(panel => over(one, [, panel]))).map(([text]) => [name, text, "lies in a panel"]),
        ...boxes.flatMap((one, k) =>
        boxes.slice(k + 1).filter(other => over(one, other) && !(isSlanted(one) && isSlanted(other)))
            .map(other => [name, one[0], other[0]]))];
})"""
CUT = """() => [...document.querySelectorAll("table.data")].map(table => table.parentElement)
    .filter(place => place.scrollWidth > place.clientWidth && !place.closest("details:not([open])")
        && !place.querySelector("[data-fit=pinned]"))
    .map(place => place.ariaLabel)"""
#: Words of cells, of 2 to 15 letters, that stand on more than one line.
BROKEN = r"""() => {
    const told = [];
    for (const cell of document.querySelectorAll("table :is(th, td)")) {
        if (!cell.checkVisibility() || cell.getBoundingClientRect().width <= 1) continue;
        const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
        for (let text = walker.nextNode(); text; text = walker.nextNode()) {
            const place = text.parentElement;
            if (!place.checkVisibility() || place.closest(".sr, svg, option, textarea, dialog:not([open])")) continue;
            for (const word of text.data.matchAll(/[\p{L}\p{N}]{2,15}/gu)) {
                const range = document.createRange();
                range.setStart(text, word.index);
                range.setEnd(text, word.index + word[0].length);
                const tops = [...range.getClientRects()].filter(one => one.width > 0.5).map(one => one.top);
                if (Math.max(...tops) - Math.min(...tops) > 6) told.push(`${word[0]} in ${cell.textContent.trim().slice(0, 60)}`);
            }
        }
    }
    return told;
}"""
#: What would write now: whatever opens the dialog of an act, or sends a form by POST.
WRITES = """() => [...document.querySelectorAll("button, input[type=submit], input[type=image]")].filter(one => !one.disabled
    && (one.dataset.act !== undefined || (["submit", "image"].includes(one.type)
        && (one.getAttribute("formmethod") ?? one.form?.getAttribute("method")) === "post"))
).map(one => (one.textContent || one.value).trim())"""
#: The page's own event when the server is not heard any more; what would write then.
CUT_OFF = f"""() => {{
    const detail = {{ state: "disconnected", sinceMs: Date.now() }};
    document.dispatchEvent(new CustomEvent("boresight:link", {{ detail }}));
    return ({WRITES})();
}}"""
GROWN = """([place, length]) => {
    const points = document.querySelector(place)?._fullData?.[1]?.x?.length;
    return points > length && points;
}"""
PUT_ASIDE = """() => {
    window.aside = [...document.querySelectorAll(".main-svg")].map(drawing => [drawing, document.createComment("")]);
    for (const [drawing, place] of aside) drawing.replaceWith(place);
}"""
PUT_BACK = "() => { for (const [drawing, place] of aside) place.replaceWith(drawing); }"
AXE = """options => axe.run(document, {resultTypes: ["violations"], ...options}).then(found =>
    found.violations.flatMap(one => one.nodes.map(node => `${one.id}: ${one.help} at ${node.target}`)))"""
CHOOSE_THEME = """theme => {
    const button = document.getElementById("theme");
    for (let k = 0; k < 4 && document.documentElement.dataset.theme !== theme; k++) button.click();
    return document.documentElement.dataset.theme;
}"""
NOTHING = """<link rel="icon" href="data:,">"""
# Downloads are not begun: they change nothing, and a report takes the server seconds.
PRESS_EVERYTHING = """keys => {
    document.addEventListener("click", event => event.target.closest("a[download]") && event.preventDefault());
    const press = key => document.activeElement.dispatchEvent(
        new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true, shiftKey: key !== key.toLowerCase()}));
    const leave = () => {
        for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
        document.activeElement.blur();
    };
    for (const row of [false, true]) for (const key of keys) {
        if (row) press("j");
        press(key);
        leave();
        press("g");
        press(key);
        leave();
    }
}"""
KEYS = [chr(code) for code in range(33, 127)] + ["Escape", "Delete", "Backspace", "F2", "ArrowDown", "ArrowRight"]
PLAIN = """const plain = value =>
    ArrayBuffer.isView(value) || Array.isArray(value) ? Array.from(value, plain) : value;"""

expect.set_options(timeout=PATIENCE_MS)


def launch_chromium(playwright: Playwright) -> Browser:
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    assert path, f"install one of {', '.join(BROWSERS)}"
    return playwright.chromium.launch(executable_path=path, args=ARGUMENTS)


class Window:
    def __init__(self, context: BrowserContext) -> None:
        self.page: Page = context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.complaints: list[str] = []
        self._link: CDPSession | None = None
        self._themed = False
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.complaints.append(f"{self.page.url}: {error}"))

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            self.complaints.append(f"{self.page.url}: {message.text} ({message.location.get('url')})")

    def leave(self) -> list[str]:
        """Clear the window for who comes next, with no theme chosen; returns what the browser complained of."""
        self.page.unroute_all(behavior="ignoreErrors")
        if self._themed:
            self.page.evaluate(FORGET_THEME)
        complaints, self.complaints, self._themed = self.complaints, [], False
        self.page.goto("about:blank")
        self.page.mouse.move(0, 0)  # nothing is pointed at
        self.page.set_viewport_size(NARROW)
        return complaints

    def forgive(self, pattern: str) -> None:
        kept = [line for line in self.complaints if not re.search(pattern, line)]
        assert len(kept) < len(self.complaints), f"nobody complained of {pattern}: {self.complaints}"
        self.complaints = kept

    def open(self, path: str) -> None:
        self.page.goto(path)

    def read(self, address: str) -> Any:
        answer = self.page.request.get(address)
        assert answer.ok, answer.text()
        return answer.json()

    def result(self, run_id: int) -> dict[str, Any]:
        return self.read(f"/api/v1/runs/{run_id}/result")

    def send(self, address: str, form: dict[str, str]) -> APIResponse:
        token = self.page.locator("input[name=csrf_token]").first.input_value()
        return self.page.request.post(address, form=form | {"csrf_token": token}, headers={"Accept": "text/html"})

    def enter(self, name: str, password: str) -> None:
        self.page.get_by_label("Log-in name").fill(name)
        self.page.get_by_label("Password").fill(password)
        self.page.get_by_role("button", name="Log in").click()

    def slow_down(self, bytes_per_s: float) -> None:
        self._link = self._link or self.page.context.new_cdp_session(self.page)
        self._link.send(
            "Network.emulateNetworkConditions",
            {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": bytes_per_s},
        )

    def figures_drawn(self) -> None:
        waiting = ":not(details:not([open]) *) > plot-figure:not([data-state=ready]):not([data-state=empty])"
        self.page.locator(waiting).evaluate_all("all => { for (const one of all) one.begin?.(); }")  # out of turn
        expect(self.page.locator(waiting)).to_have_count(0)

    def leave_figures_out(self) -> None:
        """Let no figure arrive at this window any more, where they are not what is looked at."""
        self.page.route("**/figures/*", lambda _: None)

    def figure(self, name: str) -> Locator:
        return self.page.locator(f"#figure-{name}")

    def unfold(self) -> None:
        """Open what is for research, and let its figures be drawn."""
        self.page.locator("details.advanced").evaluate_all("all => { for (const one of all) one.open = true; }")
        for figure in self.page.locator("details.advanced plot-figure").all():
            figure.scroll_into_view_if_needed()
        self.figures_drawn()

    def drawn(self, name: str) -> list[dict[str, Any]]:
        self.figure(name).evaluate(
            "one => { for (let at = one; at; at = at.parentElement) if (at.localName === 'details') at.open = true; }"
        )
        self.figure(name).scroll_into_view_if_needed()
        drawing = self.figure(name).locator(".js-plotly-plot")
        expect(drawing).to_have_count(1)
        return drawing.evaluate(f"figure => {{ {PLAIN} return ({TRACES})(figure) }}")

    def grown(self, name: str, length: int) -> int:
        points = self.page.wait_for_function(GROWN, arg=[f"#figure-{name} .js-plotly-plot", length])
        return points.json_value()

    def use_theme(self, theme: str) -> None:
        self._themed = True
        assert self.page.evaluate(CHOOSE_THEME, theme) == theme

    def shoot(self, name: str, *, wide: bool = False) -> None:
        for size in ((NARROW, WIDE) if wide else (NARROW,)) if effort(0, 1) else ():
            self.page.set_viewport_size(size)
            self.keep(f"{name}-{size['width']}")
        self.page.set_viewport_size(NARROW)

    def keep(self, name: str, *, whole: bool = True) -> None:
        """Keep how the page looks, with `--full`: for people, no test asks for it."""
        if not effort(0, 1):
            return
        self.page.evaluate("scrollTo(0, 0)")
        self.settle()
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=whole)

    def settle(self) -> None:
        self.page.evaluate(SETTLED)

    def begins_high(self, address: str) -> None:
        """Hold that the first figure's axes, or what stands in their place, and all small views are in sight at 1280 x 720."""
        self.open(address)
        self.page.set_viewport_size(GLANCE)
        expect(self.page.locator(".link-banner")).to_have_count(0)  # a busy machine's server answers late
        top = self.page.wait_for_function(FIRST).json_value()
        assert top <= HIGHEST_PX, f"the first figure of {address} begins at {top} px"
        last = self.page.evaluate(LAST_VIEW)
        self._note_first(address, top)
        assert last <= GLANCE["height"], f"the views of {address} end at {last} px"

    def _note_first(self, address: str, top: float) -> None:
        """Keep where the first figure of a run's part begins, with `--full` in a table of all that were looked at."""
        state = self.page.locator("#run-head .page-head > .status").first.inner_text()
        name = self.page.locator("h1").inner_text()
        FIRST_TOPS[name, state, address.partition("part=")[2] or "result"] = round(top)
        if effort(0, 1):
            rows = [",".join((*map(quoted, key), str(px))) for key, px in sorted(FIRST_TOPS.items())]
            FIRST_TABLE.parent.mkdir(exist_ok=True)
            FIRST_TABLE.write_text("\n".join(["run,state,part,first_figure_px", *rows, ""]))

    def overlaps(self) -> list[list[str]]:
        """Texts of the drawn figures that lie over each other or are cut: the figure, the one, and the other."""
        found: list[list[str]] = self.page.evaluate(OVERLAPS)
        return found

    def fits(self) -> None:
        self.page.wait_for_function(FITS)

    def holds_in_widths(self, name: str) -> None:
        """Hold that nothing leads sideways, that no table is cut, and that lines do not get ever longer; keep the widest look."""
        for width in WIDTHS[: effort(2, len(WIDTHS))]:
            self.page.set_viewport_size({"width": width, "height": 900})
            self.fits()
            self.settle()
            assert self.page.evaluate(CUT) == [], f"at {width} px"
            assert self.page.evaluate(BROKEN) == [], f"at {width} px"
            assert self.page.locator("main").evaluate("main => main.clientWidth") <= min(width, WIDEST_PX)
        self.keep(f"page-{name}-{width}", whole=False)

    def barriers(self, options: dict[str, Any] | None = None, *, drawings: bool = True) -> list[str]:
        """What axe finds that keeps people out, a line each; `options` are axe's own.

        Without the drawings it is many times faster on a page of charts, and enough where only colours have changed: to
        people who listen a chart is one image with a name, and axe judges letters by `color`, not by the `fill` of a drawing.
        """
        if not drawings:
            self.page.evaluate(PUT_ASIDE)
        if not self.page.evaluate("'axe' in window"):
            self.page.evaluate(AXE_SCRIPT)
        found = self.page.evaluate(AXE, options or {})
        if not drawings:
            self.page.evaluate(PUT_BACK)
        return found

    def wear(self, name: str) -> None:
        """Show every page from now on in the look that is this name's own: one that is drawn again costs as much again."""
        theme, size, _ = _read_look(name)
        self._themed = True
        self.page.route("**/nothing", lambda route: route.fulfill(content_type="text/html", body=NOTHING))
        self.page.goto("/nothing")
        self.page.evaluate(FORGET_THEME)
        self.page.evaluate("theme => localStorage.setItem('boresight-theme', theme)", theme)
        self.page.set_viewport_size(size)

    def holds_in_themes_and_widths(self, name: str) -> None:
        """Hold that the page fits and keeps nobody out, opened once; keep its looks under a name.

        Axe looks around the drawings: the gallery's test has it look at every figure there is, drawn, in every theme.
        """
        charts = self.page.locator(".main-svg").count()
        for place, (theme, size, asked) in enumerate(LOOKS if effort(0, 1) else [_read_look(name)]):
            self.use_theme(theme)
            self.page.set_viewport_size(size)
            self.fits()
            self.keep(f"page-{name}-{theme}-{size['width']}", whole=not place and not charts)
            if asked is not None:
                expect(self.page.locator("[aria-busy=true]")).to_have_count(0)  # is faded until it is answered
                found = self.barriers(asked, drawings=False)
                assert found == [], f"{name}, {theme}, {size['width']} px: {found}"
        if effort(0, 1):
            self.page.emulate_media(media="print")
            self.settle()
            found = self.barriers({"runOnly": ["color-contrast"]}, drawings=False)
            self.page.emulate_media(media="screen")
            assert found == [], f"{name}, on paper: {found}"

    def sends_nothing_by_keys(self) -> None:
        sent: list[str] = []

        def note(asked: Request) -> None:
            if asked.method not in {"GET", "HEAD"}:
                sent.append(f"{asked.method} {asked.url}")

        self.page.on("request", note)
        self.page.route("**/*", _stay)
        self.page.evaluate(PRESS_EVERYTHING, KEYS)
        self.settle()
        self.page.remove_listener("request", note)
        assert sent == []


def quoted(text: str) -> str:
    return f'"{text}"'


def _read_look(name: str) -> tuple[str, dict[str, int], dict[str, Any]]:
    theme, size, _ = LOOKS[zlib.crc32(name.encode()) % len(LOOKS)]
    return theme, size, {}


def _stay(route: Route) -> None:
    if route.request.is_navigation_request():
        route.fulfill(status=204)
    else:
        route.continue_()
