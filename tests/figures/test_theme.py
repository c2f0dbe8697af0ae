"""The palette is judged by what people see: the colours of the page, and difference for deficient colour vision."""

import itertools

import numpy as np
import pytest

from boresight.figures.style import theme
from boresight.figures.style.theme import TOKENS

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


def test_neighbouring_runs_differ_by_dash_too():
    assert all(a != b for a, b in itertools.pairwise(theme.RUN_DASHES))


def test_numbers_are_signed_with_a_true_minus_and_without_exponents():
    assert theme.signed(-1140.3) == "−1,140"
    assert theme.signed(0.0123) == "+0.0123"
