"""Every page explains a term where it is first a label, once, by the glossary's own words."""

import html
import re

import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.console.help.glossary import find_term, list_terms, mark_terms, terms_of_parameters

LINK = re.compile(r'<a class="term" href="([^"]+)" data-meaning="([^"]+)">([^<]+)</a>')


def test_the_glossary_is_read_whole_and_every_term_has_a_place_of_its_own(site):
    page = site.visitor("victor").get("/help/glossary")
    anchors = [term.anchor for term in list_terms()]
    assert len(anchors) == len(set(anchors)) >= 75
    assert [page.count(f'id="{anchor}"') for anchor in anchors] == [1] * len(anchors)
    assert LINK.findall(page) == []


@pytest.mark.parametrize(
    ("label", "anchor"),
    [
        ("Baseline", "term-baseline"),
        ("Parameter sets", "term-parameter-set"),
        ("NEES", "term-nis"),
        ("Sigma", "term-covariance"),
        ("State", None),
        ("Label", None),
    ],
)
def test_a_label_is_known_in_the_plural_too_and_not_where_it_means_something_else(label, anchor):
    term = find_term(label)
    assert (term and term.anchor) == anchor


def test_a_term_is_explained_where_it_is_first_a_label_and_nowhere_else():
    page = '<p>Drift</p><h2 id="x">Drift</h2><dl><dt>Drift <span>1</span></dt></dl><th scope="col">Gates</th>'
    marked = mark_terms(page)
    assert [(place, label) for place, _, label in LINK.findall(marked)] == [
        ("/help/glossary#term-drift", "Drift"),
        ("/help/glossary#term-gate", "Gates"),
    ]
    assert marked.startswith('<p>Drift</p><h2 id="x"><a class="term"')
    assert re.sub(r"</?a[^>]*>", "", marked) == page


def test_every_term_in_a_label_is_explained_the_longest_first_and_no_word_that_only_contains_one():
    page = "<h1>Telemetry sets of runs</h1><dt>Innovations (NIS)</dt><th>Re-run</th><th>Framework</th><h2>State of the run</h2>"
    marked = mark_terms(page)
    assert [label for _, _, label in LINK.findall(marked)] == ["Telemetry sets", "runs", "Innovations", "NIS"]
    assert re.sub(r"</?a[^>]*>", "", marked) == page


def test_a_column_that_is_sorted_is_explained_at_its_button_and_what_is_not_seen_nowhere():
    page = '<th scope="col"><button type="button" data-sort="word">Baseline</button></th><h2 class="sr">Verdict</h2>'
    meaning = html.escape(find_term("baseline").meaning)
    assert mark_terms(page) == page.replace('"word">', f'"word" data-meaning="{meaning}">')


def test_every_parameter_of_a_camera_is_explained_wherever_its_letter_stands_first_by_a_link():
    letters = terms_of_parameters()
    assert set(letters) - {"reliable_sigma", "plus_minus", "urad_between"} == {
        name for camera in CAMERA_MODELS.values() for name in camera.parameter_names
    }
    for camera in CAMERA_MODELS.values():
        for name, symbol in zip(camera.parameter_names, camera.symbols, strict=True):
            assert symbol in letters[name].names
    page = '<th scope="row">\n<var data-parameter="f_m">f</var></th><dt><var data-parameter="f_m">f</var></dt><h2>f and s</h2>'
    marked = mark_terms(page)
    meaning = html.escape(letters["f_m"].meaning)
    assert marked.count(f'data-meaning="{meaning}"') == 2
    assert marked.count(f'<a class="term" href="{letters["f_m"].address}"') == 1
    assert "<h2>f and s</h2>" in marked
    assert mark_terms('<var data-parameter="tilt_rad">tilt</var>') == "<var>tilt</var>"


@pytest.mark.parametrize(
    ("path", "least"),
    [
        ("/sensors/1", 4),
        ("/runs/1", 6),
        ("/parameter-sets/1", 3),
        ("/sensors/1/gates", 6),
        ("/telemetry", 2),
        ("/telemetry/1", 2),
        ("/parameter-sets/1/uplink", 1),
    ],
)
def test_a_page_explains_its_terms_by_the_glossary_each_once(site, path, least):
    found = LINK.findall(site.visitor("ada").get(path))
    meanings = {term.address: term.meaning for term in list_terms()}
    assert len(found) >= least
    assert len({place for place, _, _ in found}) == len(found)
    assert all(html.unescape(meaning) == meanings[place] for place, meaning, _ in found)
