"""Claims that hold for every figure of the registry, and so for every figure that joins it."""

import re
from functools import cache

import numpy as np
import orjson
import plotly.graph_objects as go
import pytest

from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.style.theme import DARK_TEMPLATE, LIGHT_TEMPLATE, UI_REVISION
from tests.figures.examined import frame_observability, trust
from tests.figures.flown import matching, shadow

EVERY_FIGURE = pytest.mark.parametrize("figure", FIGURES.values(), ids=FIGURES.keys())
LIMIT_BYTES = 500_000
MAPS = {"coverage", "arc-uncertainty", "residual-rms"}  # one colour scale for all runs, each in a map of its own
FIRST_RUN_ONLY = {"residual-map", "residual-quiver"}  # says so


def words(drawn: go.Figure) -> str:
    return " ".join(str(annotation.text) for annotation in drawn.layout.annotations)


def test_the_registry_has_the_figures_that_addresses_name():
    assert set(FIGURES) >= {"convergence", "rms", "radial", "observability", "coverage", "parameters"}


@EVERY_FIGURE
@pytest.mark.parametrize("method", ["sequential", "batch"])
def test_a_finished_run_is_drawn_with_something_on_it(figure, method, sequential_result, batch_result):
    result = sequential_result if method == "sequential" else batch_result
    drawn = figure.draw([Trace("Run 1", result)])
    assert len(drawn.data) > 0
    assert figure_json(drawn).startswith(b"{")


@EVERY_FIGURE
def test_every_key_may_be_missing_and_the_figure_says_what_is(figure, sequential_result):
    for key in sequential_result:
        partial = {name: value for name, value in sequential_result.items() if name != key}
        figure.draw([Trace("partial", partial)])
    figure.draw([Trace("partial", dict.fromkeys(sequential_result))])
    nothing = figure.draw([Trace("empty", {"status": "running"})])
    assert not nothing.data
    assert len(words(nothing)) > 20


@EVERY_FIGURE
def test_a_run_without_the_data_does_not_hide_the_others(figure, sequential_result):
    drawn = figure.draw([Trace("empty", {"status": "running"}), Trace("full", sequential_result)])
    assert len(drawn.data) > 0


@EVERY_FIGURE
def test_a_comparison_gives_each_run_its_own_colour_and_a_legend_entry(figure, sequential_result, batch_result):
    drawn = figure.draw([Trace("Run 1", sequential_result), Trace("Run 2", batch_result)])
    text = figure_json(drawn).decode()
    assert "Run 1" in text
    assert "Run 2" in text or figure.name in FIRST_RUN_ONLY
    if figure.name not in MAPS:
        assert "#3b8fe0" in text or "rgba(59,143,224" in text
        assert "#d9730d" in text or figure.name in FIRST_RUN_ONLY


@EVERY_FIGURE
def test_a_long_history_and_a_comparison_of_eight_stay_below_the_payload_limit(figure):
    long_run = long_result(6_000)
    assert len(figure_json(figure.draw([Trace("long", long_run)]))) < LIMIT_BYTES
    assert len(figure_json(figure.draw([Trace(f"Run {i}", long_run) for i in range(8)]))) < LIMIT_BYTES


@cache
def long_result(n_frames):
    rng = np.random.default_rng(1)
    names = ("f_m", "m0_px", "n0_px", "b4_per_m4", "b2_per_m2", "a1_rad", "a2_rad", "g_y")
    walk = rng.normal(size=(n_frames, 8)).cumsum(axis=0) * 1e-3
    return {
        "status": "running",
        "free": list(names),
        "initial": dict.fromkeys(names, 0.0),
        "parameters": dict(zip(names, walk[-1].tolist(), strict=True)),
        "history": {
            "frame": list(range(n_frames)),
            "parameters": walk.tolist(),
            "sigma": np.abs(walk + 1.0).tolist(),
            "tail_rms_rad": rng.uniform(8e-5, 9e-5, n_frames).tolist(),
            "aggregate_rms_rad": rng.uniform(8e-5, 9e-5, n_frames).tolist(),
            "nis": rng.chisquare(19, n_frames).tolist(),
            "nis_dof": [19] * n_frames,
        },
        "trust": trust(dict(zip(names, np.abs(walk[-1]), strict=True)), n_frames),
        "frame_observability": frame_observability(),
        "matching": matching(),
        "shadow": shadow(n_frames, range(100), range(200, 300)),
    }


@EVERY_FIGURE
def test_only_svg_traces_are_used(figure, sequential_result):
    kinds = {trace.type for trace in figure.draw([Trace("Run", sequential_result)]).data}
    assert kinds <= {"scatter", "bar", "heatmap"}


@EVERY_FIGURE
def test_zoom_survives_a_refresh_and_white_is_one_template_away(figure, sequential_result):
    first, second = (figure.draw([Trace("Run", sequential_result)]) for _ in range(2))
    assert first.layout.uirevision == second.layout.uirevision == UI_REVISION
    assert first.layout.template == DARK_TEMPLATE
    assert first.layout.meta["light"] == LIGHT_TEMPLATE.to_plotly_json()
    assert first.layout.paper_bgcolor is None
    assert first.layout.font.color is None


@EVERY_FIGURE
def test_drawing_is_a_pure_function(figure, sequential_result):
    before = orjson.dumps(sequential_result)
    assert figure_json(figure.draw([Trace("Run", sequential_result)])) == figure_json(
        figure.draw([Trace("Run", sequential_result)])
    )
    assert orjson.dumps(sequential_result) == before


@EVERY_FIGURE
def test_a_label_cannot_bring_markup_into_the_page(figure, sequential_result):
    labels = ["<b>bold</b><a href='x'>link</a>", "other"]
    text = figure_json(figure.draw([Trace(label, sequential_result) for label in labels])).decode()
    assert "<b>bold" not in text
    assert "<a href" not in text


@EVERY_FIGURE
def test_the_guide_is_two_sentences(figure):
    assert len(re.findall(r"\.(?:\s|$)", figure.guide)) == 2


@EVERY_FIGURE
@pytest.mark.parametrize("method", ["sequential", "batch"])
def test_the_table_has_columns_of_one_length_and_no_thinning(figure, method, sequential_result, batch_result):
    result = sequential_result if method == "sequential" else batch_result
    columns = figure.table(result)
    assert columns
    assert len({len(column) for column in columns.values()}) == 1
    assert orjson.dumps(columns)
    assert figure.table({"status": "running"}) == {}
