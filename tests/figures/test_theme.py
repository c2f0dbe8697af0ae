"""One source of colour, its contrasts in every theme (WCAG 2.2 AA), and differences that deficient colour vision sees."""

import itertools
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.figures.style import theme
from boresight.figures.style.theme import THEMES, TOKENS, read_themes
from boresight.resources import folder

# Machado, Oliveira and Fernandes 2009, severity 1.0, on linear RGB
DEFICIENCIES = {
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
}
FIRST_COLOURS = theme.RUN_COLOURS[:4]


def linear(colour):
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    f = np.cbrt(np.clip(xyz, 0, None) / [0.9505, 1.0, 1.089])
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize(
    ("name", "template"),
    [("dark", theme.DARK_TEMPLATE), ("light", theme.LIGHT_TEMPLATE), ("contrast", theme.CONTRAST_TEMPLATE)],
)
def test_a_plot_has_the_colours_of_its_page(name, template):
    tokens = TOKENS[name]
    assert template.layout.font.color == template.layout.title.font.color == tokens["ink"]
    assert template.layout.xaxis.title.font.color == tokens["ink-2"]
    assert template.layout.yaxis.linecolor == tokens["edge"]
    assert template.layout.hoverlabel.bgcolor == tokens["surface-2"]
    assert template.layout.colorway == theme.RUN_COLOURS


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_the_first_colours_stay_apart_for_deficient_colour_vision(deficiency):
    seen = [lab(DEFICIENCIES[deficiency] @ linear(colour)) for colour in FIRST_COLOURS]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 25


def test_neighbouring_runs_differ_by_dash_too_and_numbers_are_signed_with_a_true_minus():
    assert all(a != b for a, b in itertools.pairwise(theme.RUN_DASHES))
    assert [theme.signed(number) for number in (-1140.3, 0.0123)] == ["−1,140", "+0.0123"]


STATIC = folder("frontend") / "static"
SHEETS = sorted(STATIC.rglob("*.css"))
EVERY_THEME = pytest.mark.parametrize("tokens", TOKENS.values(), ids=TOKENS)
PANELS = ("surface-1", "surface-2")  # what a plot may stand on
LETTERS, SHAPES = 4.5, 3.0
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

colours = st.integers(0, 0xFFFFFF).map("#{:06x}".format)


def luminance(colour: str) -> float:
    channels = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def too_faint(tokens, pairs, least):
    found = ((one, other, contrast(tokens[one], tokens[other])) for one, other in pairs)
    return [f"{one} on {other}: {ratio:.2f}" for one, other, ratio in found if ratio < least]


@EVERY_THEME
def test_every_letter_has_four_and_a_half_to_one_on_every_surface(tokens):
    assert too_faint(tokens, WRITTEN_ON, LETTERS) == []


@EVERY_THEME
def test_every_symbol_border_and_line_of_a_run_has_three_to_one_where_it_stands(tokens):
    assert too_faint(tokens, DRAWN_ON, SHAPES) == []


def test_contrast_is_that_of_the_standard_and_higher_in_high_contrast():
    tokens = TOKENS["contrast"]
    assert too_faint(tokens, itertools.product(("ink", "ink-2", "ink-3", "accent"), SURFACES), 7.0) == []
    assert too_faint(tokens, itertools.product(STATUS, SURFACES), 4.5) == []
    for other in ("dark", "light"):
        assert contrast(tokens["ink-3"], tokens["surface-1"]) > contrast(
            TOKENS[other]["ink-3"], TOKENS[other]["surface-1"]
        )
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


def test_plots_take_their_colours_from_the_sheet_and_a_sheet_without_a_theme_is_refused():
    sheet = (STATIC / "shared" / "style.css").read_text()
    assert theme.RUN_COLOURS[0] == TOKENS["dark"]["run-1"]
    changed = read_themes(sheet.replace("--run-1: #3b8fe0", "--run-1: #123456"))
    assert {tokens["run-1"] for tokens in changed.values()} == {"#123456"}
    assert set(THEMES) == set(TOKENS)
    with pytest.raises(ValueError, match="without contrast"):
        read_themes(sheet.replace('[data-theme="contrast"]', '[data-theme="lost"]'))
