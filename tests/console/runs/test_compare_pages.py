"""The comparison of runs."""

import re
from types import SimpleNamespace
from urllib.parse import parse_qsl

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.runs.comparisons import ASSUMPTION, MOST_RUNS, read_run_ids
from boresight.console.runs.pages import compare
from boresight.console.runs.pages.compare import read_view, together
from boresight.console.runs.tables import Run
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.platform.db.sessions import open_reading
from tests.sites import as_shown, codes


def test_every_figure_overlays_the_other_runs_on_the_reference(site):
    page = site.visitor("victor").get("/compare?runs=1,2&reference=2")
    for name in FIGURES:
        assert f'src="/api/v1/runs/2/figures/{name}?compare=1"' in page
        assert f'href="/api/v1/runs/2/figures/{name}/data?compare=1" download="run-2-1-{name}.csv"' in page
        assert f'data-figure-table="/api/v1/runs/2/figures/{name}/data?compare=1"' in page


def test_only_what_differs_is_shown_unless_asked_for(site, read):
    victor = site.visitor("victor")
    few, all_rows = read(victor.get("/compare?runs=1,2")), read(victor.get("/compare?runs=1,2&all=1"))
    assert "NIS mean not applicable" in few  # of the batch
    assert "Square-root filter" in few
    assert "Calibration set" not in few
    assert "Calibration set" in all_rows


def test_a_difference_names_the_run_that_differs_and_the_reference(site, read, monkeypatch):
    monkeypatch.setattr(compare, "UNLIKELY", 2.0)
    monkeypatch.setattr(compare, "NEGLIGIBLE", 0.0)
    text = read(site.visitor("victor").get("/compare?runs=1,2&reference=2"))
    assert "#1 differs significantly from the reference #2" in text


def test_a_run_without_a_result_is_compared_as_far_as_it_has_come(site, read):
    queued = site.add_run()
    text = read(site.visitor("victor").get(f"/compare?runs=1,{queued}"))
    assert "QUEUED" in text


@pytest.mark.parametrize(
    ("asked", "said"),
    [(["1,x"], "'x' is not a run number"), ([",".join(map(str, range(30)))], f"at most {MOST_RUNS}")],
)
def test_what_cannot_be_compared_is_refused_in_one_sentence(asked, said):
    with pytest.raises(RefusedInputError, match=said):
        read_run_ids(asked)


@given(st.lists(st.integers(1, 99), max_size=MOST_RUNS))
def test_each_run_is_compared_once_in_the_order_given(numbers):
    read = read_run_ids([",".join(map(str, numbers))])
    assert read == list(dict.fromkeys(numbers))


@given(
    st.lists(st.integers(1, 99), min_size=2, max_size=MOST_RUNS, unique=True),
    st.sampled_from(["", "1", "7", "x"]),
    st.booleans(),
    st.sampled_from(["", "frame", "time", "update", "moon"]),
    st.sampled_from(["", "lines", "band", "table", "pie"]),
)
def test_the_address_of_a_view_opens_the_same_view(numbers, reference, everything, align, overlay):
    view = read_view(numbers, reference, "1" if everything else "", align, overlay)
    asked = dict(parse_qsl(view.query()))
    again = read_view(
        read_run_ids([asked["runs"]]),
        asked.get("reference", ""),
        asked.get("all", ""),
        asked.get("align", ""),
        asked.get("overlay", ""),
    )
    assert again == view


def test_the_view_is_in_every_address_of_the_page_and_tables_alone_draw_nothing(site):
    victor = site.visitor("victor")
    page = victor.get("/compare?runs=1,2&reference=2&align=update&overlay=band")
    assert 'src="/api/v1/runs/2/figures/rms?compare=1&amp;align=update&amp;overlay=band"' in page
    assert 'href="/compare?runs=1,2&amp;reference=2&amp;all=1&amp;align=update&amp;overlay=band"' in page
    assert '<option value="update" selected>' in page
    assert 'src="/api/v1/runs/1/figures/rms?compare=2"' in victor.get("/compare?runs=1&runs=2")  # the list's form
    page = victor.get("/compare?runs=1,2&overlay=table")
    assert "<plot-figure" not in page
    assert 'id="parameters-title"' in page
    for address in ("/compare?runs=1", "/compare"):
        assert codes(victor.get(address)) == ["choose-runs"]


def test_two_methods_on_one_set_differ_by_no_noise_and_the_page_says_on_what_that_rests(site, read):
    text = read(site.visitor("victor").get("/compare?runs=1,2"))
    assert "same data, TS-calibration" in text
    assert as_shown(ASSUMPTION) in text


def test_more_than_eight_runs_are_warned_of_with_the_table_and_the_band_at_hand(site, results):
    runs = [1, 2, *(site.add_run(state="SUCCEEDED", result=results["batch"]) for _ in range(7))]
    page = site.visitor("victor").get(f"/compare?runs={','.join(map(str, runs))}")
    assert "crowded" in codes(page)
    assert 'overlay=table">Tables only' in page
    assert 'overlay=band">' in page


def test_unlike_models_are_refused_with_both_named_and_a_set_to_convert(site, read, results):
    with open_reading(site.engine) as session:
        document = session.get_one(Run, 1).sensor_document | {"camera_model": "pinhole_radial"}
    other = site.add_run(state="SUCCEEDED", result=results["batch"], sensor_document=document)
    ada = site.visitor("ada")
    made = ada.send("POST", "/api/v1/parameter-sets", json={"run_id": 1}, headers={"X-CSRF-Token": ada.csrf_token})
    assert made.status_code == 201
    page = ada.get(f"/compare?runs=1,{other}", status=422)
    assert codes(page) == ["unlike-models"]
    assert re.search(f"#1 .*inverted_wang.* #{other} .*pinhole_radial", read(page))
    assert f'<a href="/parameter-sets/{made.json()["id"]}">' in page


@pytest.mark.parametrize(("p", "said"), [(0.0, "p < 10⁻³⁰⁰"), (0.25, "p = 0.25")])
def test_no_chance_is_nought_however_large_chi_square_is(p, said):
    found = SimpleNamespace(reference=0, contrasts=[None, SimpleNamespace(joint=(51_280.0, 8, p))])
    assert together(found)[1].note.endswith(said)
