"""Claims for every figure of the registry, its guide and the example it draws; in a notebook a figure is one call away."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import orjson
import plotly.graph_objects as go
import pytest

from benchmarks.pages.drawings import ALSO_SHOWN, TOO_FEW_FRAMES, _shortened, guide_page, name_image
from boresight.calibration.calibration import Calibration
from boresight.errors import RefusedInputError
from boresight.estimation.statistics.observability import WEAK
from boresight.figures import FIGURES, Trace, figure_json
from boresight.figures.example_calibration import PLACE, get_example_calibrations, make_example_traces
from boresight.figures.notebook import TEMPLATES, draw, table
from boresight.figures.style.theme import DARK_TEMPLATE, LIGHT_TEMPLATE, TOKENS, UI_REVISION
from tests.effort import effort
from tests.refusals import has_code

EVERY_FIGURE = pytest.mark.parametrize("figure", FIGURES.values(), ids=FIGURES.keys())
MAPS = {"coverage", "arc-uncertainty", "residual-rms"}  # one colour scale for all runs, each in a map of its own
FIRST_RUN_ONLY = {"residual-map", "residual-quiver"}  # says so


def words(drawn: go.Figure) -> str:
    return " ".join(str(annotation.text) for annotation in drawn.layout.annotations)


@pytest.mark.few(12)
@EVERY_FIGURE
@pytest.mark.parametrize("method", ["sequential", "batch"])
def test_a_finished_run_is_drawn_in_svg_with_something_on_it_as_a_pure_function(
    figure, method, sequential_result, batch_result
):
    result = sequential_result if method == "sequential" else batch_result
    before = result.to_json()
    drawn, again = (figure.draw([Trace("Run 1", result)]) for _ in range(2))
    assert {trace.type for trace in drawn.data} <= {"scatter", "bar", "heatmap"}
    assert len(drawn.data) > 0
    assert figure_json(drawn) == figure_json(again)
    assert figure_json(drawn).startswith(b"{")
    assert result.to_json() == before


NOTHING = Calibration(status="running")
MEMBERS = [item.name for item in fields(Calibration) if item.name != "status"]


class Watched(Calibration):
    """Keeps which members were read."""

    def __getattribute__(self, name):
        if name in MEMBERS:
            super().__getattribute__("__dict__").setdefault("read", set()).add(name)
        return super().__getattribute__(name)


@pytest.mark.few(12)
@EVERY_FIGURE
def test_every_member_may_be_missing_and_the_figure_says_what_is(figure, sequential_result):
    whole = Watched(**vars(sequential_result))
    figure.draw([Trace("whole", whole)])
    for name in effort(sorted(vars(whole)["read"]), MEMBERS):
        figure.draw([Trace("partial", replace(sequential_result, **{name: getattr(NOTHING, name)}))])
    nothing = figure.draw([Trace("empty", NOTHING)])
    assert not nothing.data
    assert len(words(nothing)) > 20


@EVERY_FIGURE
def test_a_run_without_the_data_does_not_hide_the_others(figure, sequential_result):
    drawn = figure.draw([Trace("empty", NOTHING), Trace("full", sequential_result)])
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


@pytest.mark.few(8)
@EVERY_FIGURE
def test_zoom_survives_a_refresh_and_white_is_one_template_away(figure, sequential_result):
    first, second = (figure.draw([Trace("Run", sequential_result)]) for _ in range(2))
    assert first.layout.uirevision == second.layout.uirevision == UI_REVISION
    assert first.layout.template == DARK_TEMPLATE
    assert first.layout.meta["light"] == LIGHT_TEMPLATE.to_plotly_json()
    assert first.layout.paper_bgcolor is None
    assert first.layout.font.color is None


@pytest.mark.few(8)
@EVERY_FIGURE
def test_a_label_cannot_bring_markup_into_the_page(figure, sequential_result):
    labels = ["<b>bold</b><a href='x'>link</a>", "other"]
    text = figure_json(figure.draw([Trace(label, sequential_result) for label in labels])).decode()
    assert "<b>bold" not in text
    assert "<a href" not in text


@EVERY_FIGURE
@pytest.mark.parametrize("method", ["sequential", "batch"])
def test_the_table_has_columns_of_one_length_and_no_thinning(figure, method, sequential_result, batch_result):
    result = sequential_result if method == "sequential" else batch_result
    columns = figure.table(result)
    assert columns
    assert len({len(column) for column in columns.values()}) == 1
    assert orjson.dumps(columns)
    assert figure.table(NOTHING) == {}


MOST_BYTES = 400_000


@pytest.mark.few(12)
@EVERY_FIGURE
@pytest.mark.parametrize("names", [("filter",), ("batch",), ("filter", "batch")], ids="-".join)
def test_every_figure_has_something_to_draw_of_the_example(figure, names):
    renew = f"`python -m benchmarks.pages --figures --renew`: {figure.name} lacks its data"
    assert figure.draw(make_example_traces(names)).data, renew
    assert figure.table(get_example_calibrations()[names[0]])
    assert PLACE.parent.name == "figures"
    assert PLACE.stat().st_size < MOST_BYTES


def test_the_example_with_too_few_frames_has_weak_directions_that_are_amber_and_named_in_the_guide():
    weak = get_example_calibrations()["weak"]
    assert weak.frames == TOO_FEW_FRAMES
    values = np.array(weak.observability.singular_values)
    assert 0 < (values < 1 / WEAK).sum() < len(values)
    bars = FIGURES["observability"].draw(make_example_traces(("weak",))).data[0]
    assert [bool(shape) for shape in bars.marker.pattern.shape] == (values < 1 / WEAK).tolist()
    assert name_image(FIGURES["observability"], "weak") in guide_page()


@EVERY_FIGURE
def test_where_nothing_is_known_every_figure_says_so(figure):
    drawn = figure.draw(make_example_traces(("nothing",)))
    assert not drawn.data
    assert drawn.layout.annotations


def test_half_way_a_filter_has_half_a_history_and_numbers_keep_seven_digits():
    whole, half = get_example_calibrations()["filter"], get_example_calibrations()["partial"]
    assert len(half.history.frame) == len(half.history.parameters) == len(whole.history.frame) // 2
    assert half.status == "running"
    assert half.frames_done < half.frames
    assert half.trust is None
    assert whole.trust is not None
    shortened = {"a": [1.234568e-5, [2.0, 3]], "b": "1.23456789", "c": None}
    assert _shortened({"a": [1.23456789e-5, (2.0, 3)], "b": "1.23456789", "c": None}) == shortened


DOCS = Path(__file__).resolve().parents[2] / "docs"
MOST_IMAGE_BYTES = 1_000_000


def test_the_page_and_its_small_images_are_those_of_the_registry():
    renew = "write it again with `python -m benchmarks.pages --figures`"
    assert (DOCS / "figures.md").read_text() == guide_page(), renew
    images = list((DOCS / "figures").iterdir())
    also = {f"{name}-{of}" for name, (of, _) in ALSO_SHOWN.items()}
    assert {image.stem for image in images} == set(FIGURES) | also
    assert sum(image.stat().st_size for image in images) < MOST_IMAGE_BYTES
    assert set(FIGURES) >= {"convergence", "rms", "radial", "observability", "coverage", "parameters"}


@EVERY_FIGURE
def test_a_figure_is_named_explained_in_two_sentences_and_shown(figure):
    page = guide_page()
    assert f"`{figure.name}`" in page
    assert f"![{figure.title}]({name_image(figure)})" in page
    assert (DOCS / name_image(figure)).read_bytes()[8:12] == b"WEBP"
    assert len(re.findall(r"\.(?:\s|$)", figure.guide)) == 2


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "result.json"
    get_example_calibrations()["filter"].save(path)
    return path


@pytest.mark.parametrize("name", ["rms", "convergence"])
def test_a_file_and_the_result_in_it_give_the_same_drawing(name, file):
    assert draw(file, name) == draw(str(file), name) == draw(get_example_calibrations()["filter"], name)
    assert table(file, name) == FIGURES[name].table(get_example_calibrations()["filter"])


@pytest.mark.parametrize("theme", TEMPLATES)
def test_a_notebook_draws_on_an_opaque_surface_of_its_theme(theme, file):
    drawn = draw(file, "rms", theme=theme)
    assert drawn.layout.paper_bgcolor == drawn.layout.plot_bgcolor == TOKENS[theme]["surface-1"]
    assert drawn.layout.template.layout.font.color == TOKENS[theme]["ink"]
    assert drawn.layout.meta is None


def test_a_notebook_shows_it_and_several_calibrations_under_their_labels(file):
    shown = draw(file, "rms")
    assert callable(shown._repr_html_)
    assert callable(shown._repr_mimebundle_)
    drawn = draw({"on the ground": get_example_calibrations()["batch"], "in flight": file}, "rms")
    names = " ".join(str(trace.name) for trace in drawn.data)
    assert "on the ground" in names
    assert "in flight" in names


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("absent.json", "rms"), "cannot be read"),
        (({}, "rms"), "not a complete calibration"),
        (({"schema": "boresight.evaluation/1"}, "rms"), "not a complete calibration"),
        ((get_example_calibrations()["filter"], "nothing"), "There is no figure nothing; choose from"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(arguments, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        draw(*arguments)


def test_what_is_no_json_and_what_is_no_theme_are_refused(tmp_path, file):
    (tmp_path / "words.json").write_text("words")
    with pytest.raises(RefusedInputError, check=has_code("incomplete-calibration")):
        draw(tmp_path / "words.json", "rms")
    with pytest.raises(RefusedInputError, match=r"light.*dark.*contrast", check=has_code("unknown-theme")):
        draw(file, "rms", theme="pink")
