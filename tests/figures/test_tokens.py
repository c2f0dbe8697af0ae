"""One source of colour, and its contrasts: letters 4.5:1, symbols, lines and borders 3:1, in every theme (WCAG 2.2 AA)."""

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.figures.style import theme
from boresight.figures.style.theme import THEMES, TOKENS, read_themes
from boresight.resources import folder

STATIC = folder("frontend") / "static"
SHEETS = sorted(STATIC.rglob("*.css"))
EVERY_THEME = pytest.mark.parametrize("tokens", TOKENS.values(), ids=TOKENS)
LETTERS, SHAPES = 4.5, 3.0
PANELS = ("surface-1", "surface-2")  # what a plot may stand on
SURFACES = ("surface-0", "surface-1", "surface-2", "surface-3")
STATUS = ("critical", "serious", "caution", "normal", "standby", "off")
WRITTEN_ON = [
    *itertools.product(("ink", "ink-2", "ink-3", "accent"), SURFACES),
    ("accent-ink", "accent"),
    ("status-ink", "standby"),
    *((f"{mode}-ink", mode) for mode in ("ops", "sim", "training")),
]
DRAWN_ON = [
    *itertools.product(STATUS, SURFACES),
    *itertools.product(("edge",), SURFACES[:3]),
    *itertools.product(("plot", *(f"run-{place}" for place in range(1, 9)), "reference", "truth"), PANELS),
]


def luminance(colour: str) -> float:
    channels = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


colours = st.integers(0, 0xFFFFFF).map("#{:06x}".format)


def too_faint(tokens, pairs, least):
    found = ((one, other, contrast(tokens[one], tokens[other])) for one, other in pairs)
    return [f"{one} on {other}: {ratio:.2f}" for one, other, ratio in found if ratio < least]


@EVERY_THEME
def test_every_letter_has_four_and_a_half_to_one_on_every_surface(tokens):
    assert too_faint(tokens, WRITTEN_ON, LETTERS) == []


@EVERY_THEME
def test_every_symbol_border_and_line_of_a_run_has_three_to_one_where_it_stands(tokens):
    assert too_faint(tokens, DRAWN_ON, SHAPES) == []


def test_high_contrast_is_higher_than_both_others_by_the_enhanced_measure():
    tokens = TOKENS["contrast"]
    assert too_faint(tokens, itertools.product(("ink", "ink-2", "ink-3", "accent"), SURFACES), 7.0) == []
    assert too_faint(tokens, itertools.product(STATUS, SURFACES), 4.5) == []
    for other in ("dark", "light"):
        assert contrast(tokens["ink-3"], tokens["surface-1"]) > contrast(
            TOKENS[other]["ink-3"], TOKENS[other]["surface-1"]
        )


def test_black_on_white_is_twenty_one_and_a_grey_of_the_standard_is_found():
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.01)  # the lightest grey that passes on white


@given(colours, colours)
def test_contrast_does_not_ask_which_is_the_letter(one, other):
    assert 1 <= contrast(one, other) == contrast(other, one) <= 21


@EVERY_THEME
def test_a_theme_knows_every_token_that_a_sheet_uses(tokens):
    used = {name for sheet in SHEETS for name in re.findall(r"var\(--([\w-]+)", sheet.read_text())}
    assert used - set(tokens) == set()


def test_no_token_is_declared_in_vain():
    texts = [path.read_text() for path in (*SHEETS, *(folder("frontend") / "templates").rglob("*.html"))]
    used = {name for text in texts for name in re.findall(r"var\(--([\w-]+)", text)}
    drawn = {f"run-{place}" for place in range(1, 9)} | {"reference", "truth"}
    assert set(TOKENS["dark"]) - used - drawn == set()


@pytest.mark.parametrize("sheet", SHEETS, ids=lambda sheet: sheet.name)
def test_a_colour_stands_in_a_token_and_nowhere_else(sheet):
    rules = re.sub(r"/\*.*?\*/|^\s*:root[^{]*\{[^}]*\}", "", sheet.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert re.findall(r"#[0-9a-fA-F]{3,8}\b|\b(?:rgb|hsl)a?\([^)]*\)", rules) == []


def test_plots_take_their_colours_from_the_sheet():
    assert theme.RUN_COLOURS[0] == TOKENS["dark"]["run-1"]
    changed = read_themes((STATIC / "shared" / "style.css").read_text().replace("--run-1: #3b8fe0", "--run-1: #123456"))
    assert {tokens["run-1"] for tokens in changed.values()} == {"#123456"}


def test_a_sheet_without_a_theme_is_refused():
    with pytest.raises(ValueError, match="without contrast"):
        read_themes(
            (STATIC / "shared" / "style.css").read_text().replace('[data-theme="contrast"]', '[data-theme="lost"]')
        )
    assert set(THEMES) == set(TOKENS)
