"""The gallery shows every figure and every element to whoever is logged in, and reads nothing of the fleet."""

import re

import orjson
import pytest

from boresight.console.administration.pages import STATES
from boresight.console.pages.formats import LEVEL_OF_STATE, LEVELS
from boresight.figures import FIGURES


def test_every_figure_of_the_registry_is_in_the_gallery_with_its_guide(site, read):
    page = site.visitor("victor").get("/gallery")
    drawn = re.findall(r'<plot-figure src="/gallery/figures/([\w-]+)\?of=one"', page)
    assert sorted(drawn) == sorted(FIGURES)
    assert all(figure.title in read(page) for figure in FIGURES.values())


def test_every_state_word_and_level_is_among_the_elements(site, read):
    shown = read(site.visitor("victor").get("/gallery?part=elements"))
    assert all(re.search(rf"\b{word}\b", shown) for word in (*LEVEL_OF_STATE, *LEVELS))
    for state in ("Empty", "Loading", "Partial", "Stale", "Error", "Forbidden", "Disconnected", "Conflict"):
        assert state in shown


@pytest.mark.parametrize("of", STATES)
def test_a_figure_of_the_gallery_comes_as_drawing_and_as_numbers(site, of):
    visitor = site.visitor("victor")
    drawn = orjson.loads(visitor.get(f"/gallery/figures/rms?of={of}"))
    lines = visitor.get(f"/gallery/figures/rms/data?of={of}").splitlines()
    assert bool(drawn["data"]) == (of != "nothing") == (len(lines) > 2)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/gallery?part=secrets", 404),
        ("/gallery?of=secrets", 404),
        ("/gallery/figures/secrets", 404),
        ("/gallery/figures/rms?of=secrets", 404),
        ("/gallery/figures/rms/data?of=secrets", 404),
        ("/gallery/figures/rms?of=broken", 422),
    ],
)
def test_what_the_gallery_does_not_have_is_refused_in_a_sentence(site, path, status):
    assert re.search(r"There is no|fails on purpose", site.visitor("victor").get(path, status=status))


@pytest.mark.parametrize("path", ["/gallery", "/gallery/figures/rms", "/gallery/figures/rms/data"])
def test_nobody_who_is_not_logged_in_sees_the_gallery(site, path):
    stranger = site.visitor("victor")
    stranger.cookies.clear()
    assert stranger.send("GET", path).status_code in {303, 401}


def test_the_administration_page_leads_to_the_gallery(site):
    site.app.state.workers = None
    assert 'href="/gallery"' in site.visitor("adele").get("/administration")
