"""The gallery, with `--full` in every theme, looks as it was kept, keeps nobody out, and fails if it has lost something.

The looks of a run with `--full` are in `artefacts/gallery.npz`. Where a figure or an element was changed on purpose, look at
`artefacts/screenshots/gallery-*.png`, and then copy that file to `tests/browser/gallery.npz`.
"""

import time
from pathlib import Path

import pytest
from playwright.sync_api import expect

from boresight.figures import FIGURES
from boresight.figures.style.theme import TOKENS
from tests.browser.thumbnails import colour, ink, looks, read_looks, write_looks
from tests.browser.window import GLANCE, NARROW, PHONE
from tests.effort import effort, few_of

pytestmark = pytest.mark.browser

KEPT = Path(__file__).with_name("gallery.npz")
SEEN = Path(__file__).parents[2] / "artefacts" / "gallery.npz"
PARTS = {"figures": 0.4, "elements": 0.8}  # the ink that may differ: letters of another font are as long again
PATIENCE_MS = 240_000
UNREST_S = 30.0
MOST_COLOUR = 0.25
MOST_WIDTH, MOST_HEIGHT = 0.03, {"figures": 0.03, "elements": 0.4}  # of a size
THEMES = ("dark", "light", "contrast")
VIEWED = list(PARTS)[effort(1, 0) :]  # that a page draws its figures, the pages' own tests say
EVERY_VIEW = pytest.mark.parametrize("view", [f"{part}-{theme}" for part in VIEWED for theme in THEMES[: effort(1, 3)]])

INKS = (
    """() => [...new Set([...document.querySelectorAll(".js-plotly-plot .xtitle")].map(title => title.style.fill))]"""
)
WRITTEN = (
    """ink => [...document.querySelectorAll(".js-plotly-plot .xtitle")].every(title => title.style.fill === ink)"""
)
DRESS = """css => {
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(css);
    document.adoptedStyleSheets = [sheet];
}"""
PLOTS = {"rms-partial", "rms-compared"}
DAMAGE = {
    "figures are missing": (".js-plotly-plot .main-svg { visibility: hidden; }", PLOTS),
    "their curves are missing": (".js-plotly-plot .scatterlayer { visibility: hidden; }", PLOTS),
    "colours are lost": (":is(.js-plotly-plot, .symbol) { filter: grayscale(1); }", {"status", *PLOTS}),
    "symbols are missing": (".symbol { visibility: hidden; }", {"status"}),
    "columns are lost": (".grid { display: block; }", {"status", "fields", *PLOTS}),
}
OTHER_FONT = ":root { --sans: 'DejaVu Serif', 'Liberation Serif', serif !important; }"


def judged(window):
    window.page.locator("plot-figure").evaluate_all("all => { for (const one of all) one.begin?.(); }")  # out of turn
    expect(window.page.locator("plot-figure:is(:not([data-state]), [data-state=loading])")).to_have_count(
        0, timeout=PATIENCE_MS
    )


def looked_at(window, theme):
    judged(window)
    window.page.wait_for_function(WRITTEN, arg=format_rgb(TOKENS[theme]["ink-2"]), timeout=PATIENCE_MS)
    window.settle()
    canvas = window.page.context.new_page()
    seen = looks(window.page, canvas, TOKENS[theme]["surface-1"])
    canvas.close()
    return seen


def looked_at_in_rest(window, part, theme):
    began_s = time.monotonic()
    kept = read_looks(KEPT, f"{part}-{theme}")
    while True:
        seen = looked_at(window, theme)
        if not differences(seen, kept, part) or time.monotonic() - began_s > UNREST_S:
            return seen


def differences(seen, kept, part):
    found = [f"{name} is not there" for name in set(kept) ^ set(seen)]
    for name in kept.keys() & seen.keys():
        one, other = seen[name], kept[name]
        measured = {
            "ink": (ink(one.look, other.look), PARTS[part]),
            "colour": (colour(one.look, other.look), MOST_COLOUR),
            "width": (abs(one.width / other.width - 1), MOST_WIDTH),
            "height": (abs(one.height / other.height - 1), MOST_HEIGHT[part]),
        }
        found += [f"{name}: {what} {value:.2f}" for what, (value, most) in measured.items() if value > most]
    return sorted(found)


def format_rgb(rgb):
    return f"rgb({', '.join(str(int(rgb[i : i + 2], 16)) for i in (1, 3, 5))})"


@pytest.fixture(scope="module")
def seat(people):
    with people.seat("analyst", new=True) as window:
        yield window
        window.forgive("422")


@pytest.fixture(scope="module")
def views(seat):
    found = {}
    for part in VIEWED:
        seat.open(f"/gallery?part={part}")
        for theme in THEMES[: effort(1, 3)]:
            seat.use_theme(theme)
            looked = looked_at_in_rest(seat, part, theme)
            found[f"{part}-{theme}"] = (looked, seat.barriers(), seat.page.evaluate(INKS))
            seat.keep(f"gallery-{part}-{theme}")
    if len(found) == len(PARTS) * len(THEMES):  # not a part of what is kept
        write_looks(SEEN, {view: looked for view, (looked, _, _) in found.items()})
    return found


@EVERY_VIEW
def test_the_gallery_looks_as_it_was_kept(views, view):
    assert differences(views[view][0], read_looks(KEPT, view), view.partition("-")[0]) == []


@EVERY_VIEW
def test_the_gallery_and_its_drawings_keep_nobody_out(views, view):
    assert views[view][1] == []


@EVERY_VIEW
def test_a_plot_changes_its_ink_with_the_page_without_being_loaded_again(views, view):
    assert views[view][2] == [format_rgb(TOKENS[view.partition("-")[2]]["ink-2"])]


@pytest.mark.full
def test_every_figure_of_the_registry_is_looked_at(views):
    assert set(views["figures-dark"][0]) == set(FIGURES)


@pytest.mark.full
def test_another_font_passes_and_what_is_lost_does_not(seat):
    seat.open("/gallery?part=elements")
    seat.use_theme("light")
    whole = looked_at(seat, "light")
    seat.page.evaluate(DRESS, OTHER_FONT)
    assert differences(looked_at(seat, "light"), whole, "elements") == []
    for damage, (css, hurt) in DAMAGE.items():
        seat.page.evaluate(DRESS, css)
        found = differences(looked_at(seat, "light"), whole, "elements")
        assert hurt <= {line.partition(":")[0] for line in found}, damage


@pytest.mark.parametrize("of", few_of(["one", "two", "partial"], 0))
def test_no_text_of_a_figure_lies_over_another_or_is_cut_on_a_phone_or_a_desk(seat, of):
    for size in (PHONE, GLANCE):
        seat.page.set_viewport_size(size)
        seat.open(f"/gallery?of={of}")
        seat.figures_drawn()
        assert seat.overlaps() == [], f"at {size['width']} px"
    seat.page.set_viewport_size(NARROW)


def test_who_asks_the_system_for_more_contrast_gets_it_until_a_theme_is_chosen(people):
    context = people.stranger()
    page = context.new_page()
    page.emulate_media(contrast="more")
    page.goto("/login")
    assert page.evaluate("document.documentElement.dataset.theme") == "contrast"
    page.get_by_role("button", name="Theme: high contrast. Change to dark").click()
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    context.close()


def test_paper_is_white_whatever_the_theme_and_nothing_moves_for_who_asks_for_calm(seat):
    seat.open("/gallery?part=elements")
    seat.use_theme("contrast")
    judged(seat)
    assert seat.page.locator(".skeleton").evaluate("element => getComputedStyle(element).animationName") == "none"
    seat.page.emulate_media(media="print")
    seat.page.wait_for_function(WRITTEN, arg=format_rgb(TOKENS["light"]["ink-2"]))
    assert seat.page.evaluate("getComputedStyle(document.body).backgroundColor") == format_rgb(
        TOKENS["print"]["surface-0"]
    )
    seat.page.emulate_media(media="screen")
    seat.use_theme("dark")
