"""The documentation of the figures is of today: names, guides and an image of each, small."""

from pathlib import Path

import pytest

from benchmarks.pages.drawings import guide_page, name_image
from boresight.figures import FIGURES

DOCS = Path(__file__).resolve().parents[2] / "docs"
MOST_BYTES = 1_000_000


def test_the_page_says_what_the_registry_says():
    assert (DOCS / "figures.md").read_text() == guide_page(), (
        "write it again with `python -m benchmarks.pages --figures`"
    )


@pytest.mark.parametrize("figure", FIGURES.values(), ids=FIGURES.keys())
def test_a_figure_is_named_explained_and_shown(figure):
    page = guide_page()
    assert f"`{figure.name}`" in page
    assert f"![{figure.title}]({name_image(figure)})" in page
    assert (DOCS / name_image(figure)).read_bytes()[8:12] == b"WEBP"


def test_the_images_are_those_of_the_registry_and_small_together():
    images = list((DOCS / "figures").iterdir())
    assert {image.stem for image in images} == set(FIGURES)
    assert sum(image.stat().st_size for image in images) < MOST_BYTES
