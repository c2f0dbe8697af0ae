"""Views of a figure and thinning that keeps the extremes; one source of colour, with its contrasts in every theme (WCAG 2.2 AA)."""

import itertools
import re
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from boresight.errors import RefusedInputError
from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.style import theme
from boresight.figures.style.axes import ALIGNMENTS
from boresight.figures.style.theme import THEMES, TOKENS, label_styles, read_themes
from boresight.figures.style.thinning import POINT_LIMIT, keep_extremes, thinning
from boresight.figures.views import POINT_BUDGET, aligned, as_band, find_span, focus
from boresight.resources import folder
from boresight.verdicts.numbers import signed
from tests.calibrations import changed
from tests.figures.examined import examined, sequential, shadow, trust
from tests.refusals import has_code

LONG = 30_000


def timed(result, start="2026-01-01T00:00:00Z"):
    """Give a history a time every 30 seconds."""
    n = len(result.history.frame)
    times = np.datetime64(start.rstrip("Z")) + np.arange(n) * np.timedelta64(30, "s")
    return replace(result, history=replace(result.history, time_utc=[f"{time}Z" for time in times]))


def later(result, frames):
    """Move a history's frame numbers."""
    return replace(result, history=replace(result.history, frame=[k + frames for k in result.history.frame]))


def test_runs_of_other_weeks_lie_over_each_other_by_time_and_by_update_but_not_by_frame():
    first = timed(sequential(100, seed=1))
    second = later(timed(sequential(100, seed=2), "2026-03-01T00:00:00Z"), 5000)
    starts = {
        along: [trace.result.history.frame[0] for trace in aligned([Trace("a", first), Trace("b", second)], along)]
        for along in ALIGNMENTS
    }
    assert starts == {"frame": [0, 5000], "time": [0.0, 0.0], "update": [1.0, 1.0]}
    (hours, _) = (trace.result.history.frame for trace in aligned([Trace("a", first), Trace("b", second)], "time"))
    assert hours[-1] == pytest.approx(99 * 30 / 3600)


def test_updates_are_counted_over_all_and_a_run_without_times_says_what_else_there_is():
    result = changed(sequential(100), trust={"nis_over_time": {"points_in_all": 1981}})
    (trace,) = aligned([Trace("a", result)], "update")
    assert trace.result.history.frame[:2] == [1.0, 21.0]
    assert trace.result.history.frame[-1] == 1981
    with pytest.raises(RefusedInputError, match="Run 7", check=has_code("no-times")):
        aligned([Trace("Run 7", sequential(20))], "time")
    with pytest.raises(RefusedInputError, match=r"frame.*time.*update", check=has_code("unknown-alignment")):
        aligned([Trace("Run 7", sequential(20))], "moon")


@pytest.mark.few(20)
@pytest.mark.parametrize("along", ["time", "update"])
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_names_the_axis_that_its_runs_were_moved_to_and_no_other_does(name, along):
    traces = [Trace("a", timed(sequential(50))), Trace("b", examined("batch"))]
    figure = FIGURES[name].draw(aligned(traces, along))
    titles = [figure.layout[axis].title.text or "" for axis in figure.layout if axis.startswith("xaxis")]
    moved = [title for title in titles if title.startswith(ALIGNMENTS[along])]
    if name in {"convergence", "rms", "innovations", "methods", "smoothed"}:
        assert moved
        assert not any(title.startswith("frame") for title in titles)
    else:  # what is drawn is counted in frames whatever the runs are aligned by, and says so
        assert not moved


@given(
    st.lists(st.lists(st.tuples(st.integers(0, 50), st.floats(-9, 9)), min_size=1, max_size=20), min_size=1, max_size=6)
)
def test_a_band_holds_every_point_of_every_curve_and_touches_the_extremes(drawn):
    curves = []
    for points in drawn:
        by_place = dict(points)
        x = np.array(sorted(by_place), dtype=float)
        curves.append((x, np.array([by_place[int(place)] for place in x])))
    places, low, high = find_span(curves)
    for x, y in curves:
        at = np.searchsorted(places, x)
        assert np.all(low[at] <= y)
        assert np.all(high[at] >= y)
    assert low.min() == min(y.min() for _, y in curves)
    assert high.max() == max(y.max() for _, y in curves)


@pytest.mark.parametrize(
    "labels", [[f"Run {k}" for k in range(1, 13)], ["Run 12", "Run 1", "Run 2", "±3σ and more"]], ids=["many", "alike"]
)
def test_a_band_keeps_the_reference_and_replaces_all_others(labels):
    traces = [Trace(label, sequential(60, seed=k)) for k, label in enumerate(labels)]
    figure, band = as_band(FIGURES["rms"].draw(traces), traces), f"lowest to highest of {len(labels) - 1} runs"
    assert {drawn.name for drawn in figure.data} == {f"{labels[0]} · tail", f"{labels[0]} · aggregate", band}
    assert sum(drawn.name == band for drawn in figure.data) == 2  # of two curves
    assert len(labels) < 12 or len(figure_json(figure)) < len(figure_json(FIGURES["rms"].draw(traces))) / 2


def test_a_curve_says_whose_it_is_a_band_its_sigmas_and_twenty_runs_have_twenty_lines():
    drawn = FIGURES["convergence"].draw([Trace("a", sequential(60))]).data
    bands = [trace for trace in drawn if trace.fill == "toself"]
    assert bands
    assert all(trace.meta == {"run": "a", "part": "", "sigmas": 3} for trace in bands)
    styles = label_styles([f"Run {k}" for k in range(20)])
    assert len({(style.colour, style.dash) for style in styles}) == 20


@pytest.mark.parametrize(("name", "runs"), [("whiteness", 4), ("coverage", 4), ("rms", 2)])
def test_bars_and_maps_and_two_runs_have_no_band_and_stay(name, runs):
    traces = [Trace(f"Run {k}", sequential(60, seed=k)) for k in range(runs)]
    figure = FIGURES[name].draw(traces)
    assert len(as_band(figure, traces).data) == len(figure.data)
    assert runs > 2 or as_band(figure, traces).data == figure.data


def test_a_window_shows_the_points_that_were_thinned_away_and_what_they_add_up_to():
    traces = [Trace("a", sequential(LONG))]
    with thinning() as watched:
        coarse = FIGURES["convergence"].draw(traces)
    assert watched.too_long
    with thinning(whole=True):
        fine = focus(FIGURES["convergence"].draw(traces), 10_000, 10_100)
    line = next(drawn for drawn in fine.data if drawn.name == "a")
    seen = next(drawn for drawn in coarse.data if drawn.name == "a")
    assert len(line.x) == 103  # both ends and a neighbour beyond each
    assert np.sum((seen.x >= 10_000) & (seen.x <= 10_100)) < 20
    assert len(line.customdata) == len(line.x)
    judge, coarse_judge = ([drawn for drawn in figure.data if drawn.name == "a"][-2] for figure in (fine, coarse))
    at = np.interp(10_050, coarse_judge.x, coarse_judge.y)
    assert np.interp(10_050, judge.x, judge.y) == pytest.approx(at, rel=0.02)  # the mean so far, not of the window


@given(st.integers(3, 4000), st.floats(-10, 4100), st.floats(0.5, 3000))
def test_a_window_of_an_outline_keeps_low_and_high_together(n_points, start, width):
    x = np.arange(n_points, dtype=float)
    outline = go.Scatter(x=np.append(x, x[::-1]), y=np.append(x + 1, x[::-1] - 1), fill="toself", mode="lines")
    figure = focus(go.Figure([outline]), start, start + width)
    (drawn,) = figure.data
    half = len(drawn.x) // 2
    assert np.array_equal(drawn.x[:half], drawn.x[half:][::-1])
    assert np.allclose(drawn.y[:half] - drawn.y[half:][::-1], 2)
    assert len(drawn.x) <= POINT_BUDGET + 4


def test_putting_thinning_off_ends_with_the_block_and_an_empty_window_is_refused():
    values = np.arange(100.0)
    with thinning(whole=True):
        assert len(keep_extremes([values], 10)) == 100
    assert len(keep_extremes([values], 10)) < 20
    assert np.array_equal(keep_extremes([values]), np.arange(100))
    with pytest.raises(RefusedInputError, match="x_from below x_to"):
        focus(go.Figure(), 3, 3)


@pytest.mark.few(3)
@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_of_twenty_long_runs_is_over_500_kb(name, long_result):
    alone, many = ([Trace(f"Run {k} · ST-1", long_result) for k in range(n_runs)] for n_runs in (1, 20))
    assert len(figure_json(FIGURES[name].draw(alone))) < 500_000
    assert len(figure_json(FIGURES[name].draw(many))) < 500_000


@pytest.fixture(scope="module")
def long_result():
    """A history longer than any budget: from here on more updates make no figure larger."""
    judged = trust(6000)
    stars = {key: (2 * cells)[:2000] for key, cells in judged["residuals"].items() if isinstance(cells, list)}
    flown = shadow(6000, range(100), range(200, 300))
    return changed(sequential(6000), trust=judged | {"residuals": judged["residuals"] | stars}, shadow=flown)


SERIES = arrays.arrays(
    np.float64, st.integers(1, 5000), elements=st.floats(-1e9, 1e9) | st.just(np.nan), fill=st.floats(-1, 1)
)


@given(SERIES, st.integers(10, 400))
def test_the_extremes_and_the_ends_are_kept(values, limit):
    kept = keep_extremes([values], limit)
    assert kept[0] == 0
    assert kept[-1] == len(values) - 1
    assert np.all(np.diff(kept) > 0)
    if np.isfinite(values).any():
        assert np.nanmin(values[kept]) == np.nanmin(values)
        assert np.nanmax(values[kept]) == np.nanmax(values)


@given(SERIES, SERIES, st.integers(20, 400))
def test_about_as_many_points_are_kept_as_asked(one, other, limit):
    n_points = min(len(one), len(other))
    kept = keep_extremes([one[:n_points], other[:n_points]], limit)
    assert len(kept) <= max(limit, 4) + 2


def test_a_single_spike_among_a_million_points_is_kept():
    values = np.zeros(1_000_000)
    values[654_321] = 1.0
    kept = keep_extremes([values])
    assert 654_321 in kept
    assert len(kept) <= POINT_LIMIT + 2


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
    assert [signed(number) for number in (-1140.3, 0.0123)] == ["−1\u202f140", "+0.0123"]


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
    scripts = (folder("frontend") / "static").rglob("*.js")
    of_scripts = {name for path in scripts for name in re.findall(r'setProperty\("--([\w-]+)"', path.read_text())}
    assert used - set(tokens) - of_scripts == set()


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
