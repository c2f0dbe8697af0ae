"""Methods beside each other: their numbers, their way to the bound, and what references hold."""

import math

import numpy as np
import pytest

from boresight.figures import FIGURES, Trace
from boresight.figures.charts.methods import method_scores
from boresight.figures.trust_parts import column


def changed(result, **keys):
    return result | keys


def test_the_claimed_error_is_the_geometric_mean_of_the_ratios(sequential_result):
    efficiency = {"ratio": {"f_m": 1.0, "g_y": 4.0}, "cramer_rao_sigma": {"f_m": 1e-7, "g_y": 1e-6}}
    found = method_scores(changed(sequential_result, trust={"efficiency": efficiency}))
    assert found.claimed == pytest.approx(2.0)


def test_the_true_error_is_counted_in_sigmas_of_the_bound(sequential_result):
    efficiency = {"ratio": {"f_m": 1.0, "g_y": 1.0}, "cramer_rao_sigma": {"f_m": 1e-7, "g_y": 1e-6}}
    truth, parameters = {"f_m": 0.016, "g_y": 1.0}, {"f_m": 0.016 + 3e-7, "g_y": 1.0 - 4e-6}
    result = changed(sequential_result, trust={"efficiency": efficiency}, truth=truth, parameters=parameters)
    assert method_scores(result).true_error == pytest.approx(math.sqrt((9 + 16) / 2), rel=1e-6)


def test_the_nees_takes_correlation_into_account_over_ten_decades(sequential_result):
    sigma, correlation = np.array([1e-7, 1e3]), np.array([[1.0, 0.8], [0.8, 1.0]])
    offset = np.array([1.0, 1.0])  # in sigmas, along the well-correlated direction
    result = changed(
        sequential_result,
        truth={"f_m": 0.0, "b2_per_m2": 0.0},
        parameters={"f_m": float(sigma[0]), "b2_per_m2": float(sigma[1])},
        covariance={"names": ["f_m", "b2_per_m2"], "matrix": (correlation * np.outer(sigma, sigma)).tolist()},
    )
    assert method_scores(result).honesty.mean == pytest.approx(offset @ np.linalg.solve(correlation, offset) / 2)


def test_the_cost_is_that_of_the_method_a_frame_and_a_replay_has_none(sequential_result):
    assert method_scores(sequential_result).ms_per_frame == pytest.approx(1e3 * 0.4 / 200)
    replay = changed(sequential_result, inputs={"settings": {"replay_frames_per_s": 5.0}})
    assert method_scores(replay).ms_per_frame is None


def steps(values, sigma):
    return {
        "status": "converged",
        "parameter_names": ["f_m"],
        "free": ["f_m"],
        "frames": len(values),
        "history": {
            "frame": list(range(len(values))),
            "parameters": [[value] for value in values],
            "sigma": [[sigma] for _ in values],
        },
    }


def test_a_filter_has_settled_after_its_last_departure_and_not_after_its_first_return():
    assert method_scores(steps([9.0, 0.0, 9.0, 0.1, 0.2, 0.0], 1.0)).settled_frames == 4


def test_a_filter_that_never_departs_has_settled_with_its_first_frame():
    assert method_scores(steps([0.1, 0.2, 0.0], 1.0)).settled_frames == 1


def test_a_shortened_history_counts_the_frames_of_the_set():
    result = steps([9.0, 0.0, 0.0], 1.0) | {"frames": 2001}
    assert method_scores(result).settled_frames == 1001


def test_a_batch_settles_in_iterations_and_a_run_on_its_way_not_at_all(batch_result, sequential_result):
    found = method_scores(batch_result)
    assert found.settled_frames is None
    assert 0 < found.settled_iterations < 7
    assert method_scores(sequential_result | {"status": "running"}).settled_frames is None


def test_a_result_that_knows_nothing_has_no_scores():
    assert set(vars(method_scores({})).values()) == {None}


def test_claims_and_true_errors_end_at_their_scores(sequential_result):
    table, scores = FIGURES["methods"].table(sequential_result), method_scores(sequential_result)
    assert table["claimed_over_bound"][-1] == pytest.approx(scores.claimed, rel=1e-6)
    assert table["true_over_bound"][-1] == pytest.approx(scores.true_error, rel=1e-6)


def test_a_real_sensor_has_no_true_error(sequential_result):
    drawn = FIGURES["methods"].draw([Trace("Run", sequential_result | {"truth": None})])
    assert len(drawn.data) == 1
    assert "true" not in drawn.layout.title.text


def test_a_batch_beside_a_filter_is_a_level_and_alone_has_iterations(sequential_result, batch_result):
    both = FIGURES["methods"].draw([Trace("filter", sequential_result), Trace("batch", batch_result)])
    level = next(line for line in both.data if line.name.startswith("batch"))
    assert level.y[0] == level.y[-1]
    assert level.x[-1] == 199
    alone = FIGURES["methods"].draw([Trace("batch", batch_result)])
    assert alone.layout.xaxis.title.text == "iteration"


def test_the_legend_of_methods_has_what_a_frame_costs(sequential_result):
    assert FIGURES["methods"].draw([Trace("Run", sequential_result)]).data[0].name == "Run (2.0 ms a frame)"


def test_without_a_bound_the_figure_of_methods_says_why(sequential_result):
    trust = {"efficiency": None, "unavailable": {"efficiency": "There is no bound: hold a parameter fixed."}}
    drawn = FIGURES["methods"].draw([Trace("Run", sequential_result | {"trust": trust})])
    assert drawn.layout.annotations[0].text == "There is no bound: hold a parameter fixed."


def test_frames_that_determine_too_little_are_gaps_in_every_curve(sequential_result):
    drawn = FIGURES["frame-observability"].draw([Trace("Run", sequential_result)])
    assert [line.name for line in drawn.data] == [
        *(f"Model {model}" for model in (1, 2, 3, 4)), *(f"σ{k} alone" for k in (1, 2, 3))
    ]  # fmt: skip
    assert all(np.isnan(line.y[7]) and not line.connectgaps for line in drawn.data)
    assert "120 spaced evenly over 200" in drawn.layout.xaxis2.title.text


def test_one_frame_that_hardly_determines_anything_does_not_flatten_the_others(sequential_result):
    view = sequential_result["frame_observability"]
    curves = dict(view["minimum_singular_value"])
    curves["model_4"] = [1e-11, *curves["model_4"][1:]]
    result = sequential_result | {"frame_observability": view | {"minimum_singular_value": curves}}
    low, high = FIGURES["frame-observability"].draw([Trace("Run", result)]).layout.yaxis.range
    assert high - low < 4


def test_where_no_frame_determines_all_the_sentence_is_drawn_instead(sequential_result):
    view = sequential_result["frame_observability"]
    gaps = {name: [None] * 120 for name in view["minimum_singular_value"]}
    result = sequential_result | {"frame_observability": view | {"minimum_singular_value": gaps}}
    drawn = FIGURES["frame-observability"].draw([Trace("Run", result)])
    assert not drawn.data
    assert drawn.layout.annotations[0].text == view["sentence"]


def test_an_old_result_asks_to_be_computed_again(sequential_result):
    old = {key: value for key, value in sequential_result.items() if key != "frame_observability"}
    for name in ("frame-observability", "reference-information"):
        assert "clone its run" in FIGURES[name].draw([Trace("Run", old)]).layout.annotations[0].text


def test_a_reference_that_leaves_a_parameter_open_has_no_bar_and_says_so(sequential_result):
    bars = FIGURES["reference-information"].draw([Trace("Run", sequential_result)]).data[0]
    place = list(bars.x).index("σ1")
    assert np.isnan(bars.y[place])
    assert bars.text[place] == "open"


def test_the_information_table_gives_the_share_as_a_ratio_of_sigmas_too(sequential_result):
    table = FIGURES["reference-information"].table(sequential_result)
    assert table["reference"][5] == "model_4"
    assert column(table["sigma_over_bound"])[5] == pytest.approx(0.91**-0.5)


def test_the_sentence_stands_under_the_bars(sequential_result):
    drawn = FIGURES["reference-information"].draw([Trace("Run", sequential_result)])
    said = " ".join(note.text.replace("<br>", " ") for note in drawn.layout.annotations if note.text)
    assert sequential_result["frame_observability"]["sentence"] in said
