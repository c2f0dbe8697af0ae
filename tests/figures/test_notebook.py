"""In a notebook a figure is one call away from a calibration, and shows itself."""

import orjson
import pytest

from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.example_calibration import get_example_calibrations
from boresight.figures.notebook import TEMPLATES, draw, table
from boresight.figures.style.theme import TOKENS


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "result.json"
    path.write_bytes(orjson.dumps(get_example_calibrations()["filter"]))
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


def test_a_notebook_finds_out_by_itself_how_to_show_it(file):
    shown = draw(file, "rms")
    assert callable(shown._repr_html_)
    assert callable(shown._repr_mimebundle_)


def test_several_calibrations_are_drawn_over_one_another_under_their_labels(file):
    drawn = draw({"on the ground": get_example_calibrations()["batch"], "in flight": file}, "rms")
    names = " ".join(str(trace.name) for trace in drawn.data)
    assert "on the ground" in names
    assert "in flight" in names


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("absent.json", "rms"), "cannot be read"),
        (({}, "rms"), "no calibration"),
        (({"schema": "boresight.evaluation/1"}, "rms"), "no calibration"),
        ((get_example_calibrations()["filter"], "nothing"), "There is no figure nothing; choose from"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(arguments, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        draw(*arguments)


def test_what_is_no_json_and_what_is_no_theme_are_refused(tmp_path, file):
    (tmp_path / "words.json").write_text("words")
    with pytest.raises(RefusedInputError, match="is no JSON"):
        draw(tmp_path / "words.json", "rms")
    with pytest.raises(RefusedInputError, match="choose from light, dark, contrast"):
        draw(file, "rms", theme="pink")
