"""The comparison of runs."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.parameter_table import contrasts
from boresight.pages.compare import MOST_RUNS, read_run_ids


def test_every_figure_overlays_the_other_runs_on_the_reference(house):
    page = house.visitor("victor").get("/compare?runs=1,2&reference=2")
    for name in FIGURES:
        assert f'src="/api/v1/runs/2/figures/{name}?compare=1"' in page
        assert f'href="/api/v1/runs/2/figures/{name}/data?compare=1" download="run-2-1-{name}.csv"' in page
        assert f'data-figure-table="/api/v1/runs/2/figures/{name}/data?compare=1"' in page


def test_only_what_differs_is_shown_unless_asked_for(house, read):
    victor = house.visitor("victor")
    few, all_rows = read(victor.get("/compare?runs=1,2")), read(victor.get("/compare?runs=1,2&all=1"))
    assert "Square-root filter" in few
    assert "Calibration set" not in few
    assert "Calibration set" in all_rows


def test_a_batch_has_no_innovations_to_compare(house, read):
    text = read(house.visitor("victor").get("/compare?runs=1,2"))
    assert "NIS mean not applicable" in text


def test_repeated_fields_of_the_list_s_form_are_read_as_a_list(house):
    assert 'src="/api/v1/runs/1/figures/rms?compare=2"' in house.visitor("victor").get("/compare?runs=1&runs=2")


def test_unlike_camera_models_are_refused_with_both_named(house, read, results):
    other = house.add_run(
        state="SUCCEEDED", result=results["batch"], sensor_document={"camera_model": "pinhole_radial"}
    )
    text = read(house.visitor("victor").get(f"/compare?runs=1,{other}", status=422))
    assert f"Run #1 uses the camera model inverted_wang and run #{other} uses pinhole_radial" in text


def test_one_run_alone_asks_for_another(house, read):
    assert "Choose two or more runs" in read(house.visitor("victor").get("/compare?runs=1"))
    assert "Choose two or more runs" in read(house.visitor("victor").get("/compare"))


def test_a_run_without_a_result_is_compared_as_far_as_it_has_come(house, read):
    queued = house.add_run()
    text = read(house.visitor("victor").get(f"/compare?runs=1,{queued}"))
    assert "QUEUED" in text


@pytest.mark.parametrize(
    ("asked", "said"),
    [(["1,x"], "'x' is no run number"), ([",".join(map(str, range(30)))], f"at most {MOST_RUNS}")],
)
def test_what_cannot_be_compared_is_refused_in_one_sentence(asked, said):
    with pytest.raises(RefusedInputError, match=said):
        read_run_ids(asked)


@given(st.lists(st.integers(1, 99), max_size=MOST_RUNS))
def test_each_run_is_compared_once_in_the_order_given(numbers):
    read = read_run_ids([",".join(map(str, numbers))])
    assert read == list(dict.fromkeys(numbers))


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 3), st.floats(0.1, 3))
def test_two_runs_are_apart_by_the_sigma_of_their_difference(a, b, sigma_a, sigma_b):
    results = [
        {"parameters": {"f_m": a}, "sigma": {"f_m": sigma_a}},
        {"parameters": {"f_m": b}, "sigma": {"f_m": sigma_b}},
    ]
    (row,) = contrasts(results, 0)
    assert row.separations[0] is None
    assert row.separations[1] == pytest.approx((b - a) / math.hypot(sigma_a, sigma_b))


def test_a_parameter_that_no_run_estimated_has_no_separation():
    results = [
        {"parameters": {"g_y": 1.0}, "sigma": {"g_y": None}},
        {"parameters": {"g_y": 1.1}, "sigma": {"g_y": None}},
    ]
    assert contrasts(results, 0)[0].separations[1] is None
